"""The short doors with what must hold: octo.walk, go_to and jump hand it to every piece, and
octo.limits lists what a robot cannot do."""

from __future__ import annotations

import types
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

import octo
from octo.errors import OctoError
from octo.jump import jump_problem
from octo.model.kinematics import body_poses
from octo.motions import search
from octo.motions.budget import Budget
from octo.motions.journey import Journey
from octo.motions.path import Path
from octo.motions.transitions import Transition, _within
from octo.problem.closure import along_arc, arc_to
from octo.problem.hard import SOFT, beside, standing

MU, FASTER = 0.6, 1.0 + 1e-6  # a bound holds to a millionth of itself
PLACE = (0.4, 0.1, 0.4)  # m, m, rad


@lru_cache
def gone() -> octo.Solution:
    own = {"starts": 1, "period": 0.8, "constraints": "hard", "device": "cpu"}
    return octo.go_to(octo.gallery.mammal(), PLACE, 1.6, **own)


def test_it_ends_at_the_place_from_rest_to_rest() -> None:
    motion = gone()
    robot = motion.character
    assert robot is not None and motion.converged and motion.steps == 64
    rotation, position = (part[:, robot.base_body] for part in body_poses(robot, motion.x[[1, -1]]))
    travel = position[1] - position[0]
    turned = np.arctan2(rotation[1, 1, 0], rotation[1, 0, 0])
    # 2 cm and 2 degrees are asked for
    np.testing.assert_allclose([*travel[:2], turned], PLACE, atol=1e-6)
    for ends in ([0, 1], [-1, -2]):
        np.testing.assert_allclose(motion.x[ends[0]], motion.x[ends[1]], atol=1e-12)
    assert len(motion.asked) == 1 and motion.asked[0].met and motion.asked[0].off < 1e-6


def test_every_limit_holds_at_every_step() -> None:
    """By formulas of its own: torques, joints, speeds, friction of the feet."""
    motion = gone()
    robot = motion.character
    assert robot is not None and all(bound.held for bound in motion.bounds)
    assert [bound.name for bound in motion.bounds] == [
        one.label for one in octo.limits(robot, mu=MU)
    ]
    assert (np.abs(motion.u) <= FASTER * robot.torque_limit).all()
    joints = robot.actuated
    x = motion.x[2:, joints]
    assert (x <= robot.upper[joints] + 1e-6).all() and (x >= robot.lower[joints] - 1e-6).all()
    assert np.abs(np.diff(motion.x[1:, joints], axis=0)).max() <= FASTER * 12.0 * motion.dt
    along = np.sum(motion.contact_force * motion.contact_normal, axis=2)
    across = np.linalg.norm(motion.contact_force - along[..., None] * motion.contact_normal, axis=2)
    feet = motion.loaded.any(axis=0)
    carries = along[:, feet] > 0.25 * motion.weight  # the cone is half a percent wider there
    assert (across[:, feet][carries] <= 1.005 * MU * along[:, feet][carries]).all()
    assert not {term.__name__ for term in SOFT} & set(motion.terms)


def test_gait_of_a_motion_within_limits_is_one_to_keep() -> None:
    gait = gone().gait
    assert gait is not None and gait.touchdowns is not None and gait.touchdowns <= 2.5
    assert gait.shortest_stance is not None and gait.shortest_stance >= 0.1 - 1e-9
    assert gone().slip <= 0.05 and gone().penetration <= 0.004


@pytest.mark.parametrize("turn", [0.0, 0.4, -2.0, np.pi])
def test_an_arc_leads_to_every_place(turn: float) -> None:
    place = np.array([0.7, -0.3])
    way = arc_to(place, turn)
    np.testing.assert_allclose(along_arc(way / 3.0, turn, 3.0), place, atol=1e-12)


def test_a_place_takes_what_its_speed_needs() -> None:
    robot = octo.gallery.mammal()
    given = {"dt": 0.025, "starts": 1}
    near, far = (Journey.to(robot, (x, 0.0, 0.0), None, 0.5, **given) for x in (0.05, 3.0))
    assert near.counts() and near.steps * near.dt < 3.0
    count = far.counts()[0]
    # the strides in the middle are as fast as was asked for
    assert far.velocity[0] * far.faster(count) == pytest.approx(0.5, rel=0.05)
    np.testing.assert_allclose(far.way()[:6], [3.0, 0, 0, 0, 0, 0], atol=1e-9)
    given_time = Journey.to(robot, (0.0, -0.4, 3.0), 5.0, 0.5, **given)
    assert given_time.steps == 200 and given_time.rate == pytest.approx(0.6)
    np.testing.assert_allclose(given_time.way()[[0, 1, 3]], [0.0, -0.4, 3.0], atol=1e-9)


def test_a_heading_is_the_shorter_way_round() -> None:
    goal = octo.Goal("to", place=(0.0, 0.0, 2.0 * np.pi - 0.3))
    assert goal.place[2] == pytest.approx(-0.3)


def test_limits_are_those_that_a_robot_has() -> None:
    robot = octo.gallery.mammal()
    names = ["TorqueLimits", "JointLimits", "JointSpeedLimits", "FrictionCones"]
    assert [one.label for one in octo.limits(robot)] == names
    free = {"torque_limit": np.inf, "lower": -np.inf, "upper": np.inf}
    bodies = tuple(
        replace(body, joints=tuple(replace(joint, **free) for joint in body.joints))
        for body in robot.bodies
    )
    assert [one.label for one in octo.limits(replace(robot, bodies=bodies))] == names[2:]
    with pytest.raises(OctoError, match="mu is 0, must be positive"):
        octo.limits(robot, mu=0.0)
    with pytest.raises(OctoError, match="speed is -1.0 rad/s, must be positive"):
        octo.limits(robot, speed=-1.0)


def test_what_is_held_is_not_priced_beside_it() -> None:
    robot = octo.gallery.mammal()
    natural = octo.costs.natural(length=0.3)
    names = [term.label for term in natural]
    soft = {term.__name__ for term in SOFT}
    assert soft < set(names)
    assert beside([], natural) == natural
    assert [one.label for one in beside(octo.limits(robot), natural)] == [
        name for name in names if name not in soft
    ]
    one = beside([octo.TorqueLimit(), octo.TiltLimit()], natural)  # a term, meant hard
    assert set(names) - {term.label for term in one} == {"TorqueLimit"}
    jump = jump_problem(robot, constraints="hard")
    assert not soft & {term.label for term in jump.costs} and len(jump.constraints) == 4


def test_what_a_piece_begins_with_does_not_change_what_is_asked() -> None:
    """The way out of a stride begins in mid-air, bent: heights, upright and feet are those of the
    robot that stands."""
    robot = octo.gallery.mammal()
    constraints: list[Any] = [
        octo.BaseHeight().hard(),
        octo.TiltLimit(0.3),
        octo.FrictionCones(contacts="feet"),
    ]
    journey = Journey(robot, (0.4, 0.0), 0.0, 2.5, period=0.8, constraints=constraints)
    rest = journey.whole
    bent = rest.start.copy()
    bent[2] += 0.3
    bent[4] += 0.2
    setting = rest.replace(x0=bent, pose=None).setting
    for own in rest.terms[len(rest.costs) :]:
        stands = standing(own.placed(rest.setting), rest.start)
        assert stands.label == own.label and len(stands.rows(setting)) == len(
            own.rows(rest.setting)
        )
        wanted, found = own.references(rest.setting), stands.references(setting)
        for name in wanted:
            np.testing.assert_array_equal(found[name], wanted[name])
    assert not np.allclose(
        rest.terms[-3].references(setting)["height"],
        rest.terms[-3].references(rest.setting)["height"],
    )
    free = replace(journey, constraints=())
    stride = octo.solve(free.cycle(32), passes=1, max_iterations=1, device="cpu")
    out = Path(journey, stride).leave(3, 40)[0]
    assert [own.label for own in out.terms[len(out.costs) :]] == [
        "BaseHeight",
        "TiltLimit",
        "FrictionCones",
    ]


@pytest.mark.slow
def test_three_poses_at_given_times() -> None:
    """Keyframes of a trunk: low, to the left, high."""
    robot = octo.gallery.mammal()
    problem = octo.Problem(robot, steps=36, dt=0.025, costs=octo.costs.natural())
    moves = {0.3: (0.0, 0.0, -0.05), 0.6: (0.0, 0.03, -0.02), 0.9: (0.02, 0.0, 0.0)}
    trunk = np.arange(robot.nx) < 6
    poses = {time: problem.start + np.pad(move, (0, robot.nx - 3)) for time, move in moves.items()}
    keyframes = [
        octo.PoseTarget(target=pose, coordinates=trunk * 1.0, at=octo.At(time), name=f"at {time}")
        for time, pose in poses.items()
    ]
    motion = octo.solve(problem.replace(constraints=[*keyframes, *octo.limits(robot)]))
    assert motion.converged
    for time, pose in poses.items():
        node = 1 + round(time / problem.dt)
        np.testing.assert_allclose(motion.x[node, trunk], pose[trunk], atol=1e-6)


def test_what_was_scouted_is_led_to_the_limits_best_first() -> None:
    """Three are tried at most, and none after one that is clean."""

    def way(at: int, *rank: float) -> Transition:
        motion = types.SimpleNamespace(converged=at != 4)
        return Transition(at, motion, rank)  # type: ignore[arg-type]

    path: Any = types.SimpleNamespace(scout=None)
    scouted = [way(1, 0, 2, 0, 0.3), way(2, 0, 0, 1, 0.5), way(3, 0, 0, 0, 0.4), way(4, 1, 0, 0, 0)]
    tried: list[int] = []

    def led(failing: set[int]) -> Transition:
        tried.clear()

        def held(one: Transition) -> list[Transition]:
            tried.append(one.at)
            return [way(one.at, int(one.at in failing), 0, 0, 1.0)]

        return _within(path, scouted, held)

    assert led(set()).at == 3 and tried == [3]
    assert led({3}).at == 2 and tried == [3, 2]
    assert not led({1, 2, 3}).clean and tried == [3, 2, 1]
    path.scout = path
    assert led(set()).at == 3 and tried == []
    assert scouted[3].start is None and scouted[0].start is scouted[0].motion


@pytest.mark.slow
def test_strides_that_keep_no_limit_are_looked_for_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no stride that was scouted is led to its limits, others hold them from the first."""
    robot = octo.gallery.mammal()
    journey = Journey(robot, (0.4, 0.0), 0.0, 2.5, period=0.8, constraints=octo.limits(robot))
    kept: list[bool] = []

    def around(*given: Any) -> Any:
        kept.append(bool(given[1][0].bounds))
        return None if given[-1] else given[1][0]

    monkeypatch.setattr(search, "_around", around)
    monkeypatch.setattr(search, "_good", list)
    given = {"passes": 1, "max_iterations": 3, "device": "cpu"}
    motion = search.from_rest_to_rest(replace(journey, starts=1), Budget(given, held=True))
    assert kept == [False, True] and len(motion.starts) == 2
    assert journey.priced.priced is journey.priced and not journey.priced.whole.constraints
