"""Goals: what they ask for as terms of E, and how far a motion is from them."""

from __future__ import annotations

import types

import numpy as np
import pytest

import octo
from octo.errors import ProblemError, UnknownNameError, ValueRangeError
from octo.goals import Goal
from octo.model import gallery
from octo.model.character import Body, Character, Joint


def motion(
    velocity=(0.0, 0.0, 0.0),
    yaw_rate: float = 0.0,
    top: float = 0.0,
    steps: int = 10,
    dt: float = 0.1,
):
    """What Goal.error looks at, of a centre of mass that moves, with a leap in the middle, and a
    base that turns."""
    times = dt * np.arange(steps + 1)
    com = times[:, None] * np.array(velocity)
    com[steps // 2, 2] += top
    return types.SimpleNamespace(steps=steps, dt=dt, com=com, yaw=0.3 + yaw_rate * times)


ERRORS = {
    "walk": (Goal("walk", 0.5), motion((0.4, 0.1, 0.0)), np.hypot(0.1, 0.1) / 0.5),
    "walk uphill": (Goal("walk", 0.5), motion((0.5, 0.0, 0.1)), 0.0),
    "walk backwards": (Goal("walk", -0.5), motion((-0.5, 0.0, 0.0)), 0.0),
    "stride": (Goal("stride", 0.5), motion((0.0, 0.45, 0.0)), 0.1),
    "slow walk": (Goal("walk", 0.05), motion(), 0.5),
    "turn left": (Goal("turn", 0.5), motion(yaw_rate=0.4), 0.2),
    "turn right": (Goal("turn", -0.5), motion(yaw_rate=0.5), 2.0),
    "jump": (Goal("jump", distance=0.6, height=0.8), motion((0.6, 0.0, 0.0), top=0.8), 0.0),
    "jump that stays below": (Goal("jump", distance=0.6, height=0.8), motion((0.6, 0.0, 0.0)), 0.8),
    "jump that does not land": (
        Goal("jump", distance=0.6, height=0.8),
        motion((0.5, 0.0, 0.8)),
        0.1,
    ),
    "small jump": (Goal("jump", distance=0.0, height=0.05), motion(top=0.03), 0.2),
    "stand": (Goal("stand"), motion((0.02, 0.0, 0.0)), 0.2),
}


@pytest.mark.parametrize("name", ERRORS)
def test_error(name):
    goal, found, expected = ERRORS[name]
    assert goal.error(found) == pytest.approx(expected, abs=1e-12)
    assert goal.met(found) == (expected <= 0.1)
    assert f"goal {goal.kind} {'met' if expected <= 0.1 else 'missed'}: " in goal.verdict(found)


def test_verdicts_have_units_and_what_is_allowed():
    turn = Goal("turn", -0.5).verdict(motion(yaw_rate=0.5))
    assert (
        turn == "goal turn missed: the base turns at 0.50 rad/s, asked for was -0.50; off by 1 "
        "rad/s, 0.05 is allowed"
    )
    jump = Goal("jump", distance=0.6, height=0.8).verdict(motion((0.6, 0.0, 0.0), top=0.75))
    assert jump == (
        "goal jump met: the centre of mass ends ahead of its start and rises at its top by "
        "(0.60, 0.75) m, "
        "asked for was (0.60, 0.80); off by 0.05 m, 0.1 is allowed"
    )
    assert (
        Goal("stand").verdict(motion((0.02, 0.0, 0.0))).endswith("off by 0.02 m/s, 0.01 is allowed")
    )
    assert Goal("walk").verdict(motion((np.nan, 0.0, 0.0))).startswith("goal walk missed")


@pytest.mark.parametrize("preset", ["natural", "paper", "robot"])
@pytest.mark.parametrize("kind", ["walk", "stride", "turn", "stand"])
def test_terms_compile_to_an_energy_of_about_one(kind, preset):
    """At the start, standing, E is of order one for every goal (a stand that stands has nothing to
    do)."""
    robot = gallery.biped()
    goal = Goal(kind, preset=preset)
    setting = octo.Problem(
        robot, steps=10, dt=0.05, costs=[octo.Effort()], x0=robot.default_pose
    ).setting
    terms = {term.label: term for term in goal.costs()}
    if kind == "stand" and preset == "natural":
        assert "CenterOfMassVelocity" not in terms  # its last state is fixed
        return
    velocity = np.asarray(terms["CenterOfMassVelocity"].velocity)
    np.testing.assert_allclose(
        velocity, {"walk": [0.5, 0, 0], "stride": [0, 0.5, 0]}.get(kind, [0, 0, 0])
    )
    if kind == "turn":
        turn = terms["BaseAngularVelocity"]
        assert tuple(turn.velocity) == (0.0, 0.0, 0.5) and tuple(turn.axes) == (0.0, 0.0, 1.0)
    elif kind in ("walk", "stride"):
        expected = 1.5 if preset == "robot" else 1.0
        size = (
            terms["CenterOfMassVelocity"].weight
            * (velocity @ velocity)
            / terms["CenterOfMassVelocity"].scale(setting)
        )
        assert size == pytest.approx(expected)


def test_refused():
    with pytest.raises(UnknownNameError, match="did you mean walk"):
        Goal("wlak")
    with pytest.raises(UnknownNameError, match="robot"):
        Goal(preset="robots")
    with pytest.raises(ValueRangeError, match="speed is not finite"):
        Goal(speed=np.nan)
    hinge = Joint("hinge", "hinge", np.array([0.0, 1.0, 0.0]))
    arm = Character("arm", (Body("link", -1, (hinge,), mass=1.0),), base="fixed")
    with pytest.raises(ProblemError, match="goal 'walk' needs a floating base"):
        Goal().check(arm)
    Goal().check(gallery.biped())
    with pytest.raises(ProblemError, match="the terms of a jump go with its steps"):
        Goal("jump").costs()


def test_a_walk_of_the_robot_preset_starts_from_rest():
    times = 0.1 * np.arange(1, 11)
    terms = {term.label: term for term in Goal("walk", 0.4, preset="robot").costs(times=times)}
    expected = 0.4 * np.minimum(times / 0.5, 1.0)
    np.testing.assert_allclose(
        terms["CenterOfMassVelocity"].velocity, np.stack([expected, 0 * times, 0 * times], axis=1)
    )


def test_the_robot_preset_holds_a_slow_walk_no_harder_than_a_stand():
    """Per m²/s² of error; a fast one less, so that a tenth of the speed costs the same."""
    weight = {}
    for speed in (0.0, 0.1, 0.2, 0.6, 1.2):
        term = Goal("walk", speed, preset="robot").costs()[0]
        weight[speed] = term.weight / max(speed**2, 0.1**2)
    assert weight[0.0] == pytest.approx(weight[0.1]) == pytest.approx(weight[0.2])
    assert weight[0.6] == pytest.approx(4.0 * weight[1.2])
