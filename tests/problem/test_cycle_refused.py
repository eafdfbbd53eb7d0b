"""Cycles that cannot be: one line that names the field, and nothing is compiled for it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

import octo
from octo import native
from octo.errors import (
    MirrorError,
    OctoError,
    ProblemError,
    ShapeError,
    UnknownNameError,
    ValueRangeError,
)
from octo.model.character import Body, Character, Joint

ROBOT = octo.gallery.mammal()
WAVES = octo.Terrain(lambda point, p: point[2] - 0.01 * ca.sin(point[0]))
ACROSS = octo.Plane(slope=0.1, direction=np.pi / 2)
CYCLE, WHOLE = octo.Cycle(speed=0.5), octo.Cycle(speed=0.5, mirror=False)
TURNING = octo.Cycle(speed=0.5, mirror=False, turn=0.3)
X = np.zeros(18)
NAN, INFINITE = float("nan"), float("inf")


def problem(model: Any = ROBOT, cycle: Any = None, **given: Any) -> octo.Problem:
    return octo.Problem(
        model, costs=[octo.Effort()], cycle=CYCLE if cycle is None else cycle, **given
    )


def lopsided() -> Character:
    """The mammal without the sphere of its front left foot."""
    contacts = [contact for contact in ROBOT.contacts if contact.name != "front_left"]
    return Character("lopsided", ROBOT.bodies, contacts, base="floating")


def arm() -> Character:
    upper, lower = (
        Body(
            name,
            parent,
            (Joint(name, "hinge", np.array([0.0, 1.0, 0.0])),),
            mass=1.0,
            inertia=0.01 * np.eye(3),
        )
        for parent, name in ((-1, "upper"), (0, "lower"))
    )
    return Character("arm", (upper, lower), base="fixed")


def brick() -> Character:
    """The mammal's trunk alone."""
    return Character("brick", ROBOT.bodies[:1], base="floating")


def pendulum() -> octo.CustomDynamics:
    return octo.CustomDynamics(lambda a, b, c, p: (a - 2 * b + c) / p["dt"] ** 2, 1, [0], {})


CYCLES: dict[str, tuple[dict[str, Any], type[OctoError], tuple[str, ...]]] = {
    "speed and shift": (
        {"speed": 0.5, "shift": 0.4},
        ProblemError,
        ("speed 0.5", "shift 0.4", "give one"),
    ),
    "no speed and shift": (
        {"speed": 0.0, "shift": 0.4},
        ProblemError,
        ("speed 0 ", "shift 0.4", "give one"),
    ),
    "turning, mirrored": ({"turn": 0.3}, ProblemError, ("cycle.turn is 0.3", "mirror=False")),
    "sideways, mirrored": (
        {"sideways": 0.2},
        ProblemError,
        ("cycle.sideways is 0.2", "mirror=False"),
    ),
    "sideways, pairs given": (
        {"sideways": 0.2, "mirror": {"a": "b"}},
        ProblemError,
        ("sideways", "mirror=False"),
    ),
    "no period": ({"period": 0.0}, ValueRangeError, ("cycle.period is 0.0", "positive")),
    "negative period": ({"period": -0.8}, ValueRangeError, ("cycle.period is -0.8", "positive")),
    "period NaN": ({"period": NAN}, ValueRangeError, ("cycle.period", "finite")),
    "endless period": ({"period": INFINITE}, ValueRangeError, ("cycle.period", "finite")),
    "a range backwards": ({"period": (0.8, 0.5)}, ValueRangeError, ("(0.8, 0.5)", "shortest")),
    "a range of one": ({"period": (0.8, 0.8)}, ValueRangeError, ("(0.8, 0.8)", "less")),
    "a range from zero": ({"period": (0.0, 0.8)}, ValueRangeError, ("cycle.period", "positive")),
    "a range without end": (
        {"period": (0.5, INFINITE)},
        ValueRangeError,
        ("cycle.period", "finite"),
    ),
    "three periods": (
        {"period": (0.5, 0.8, 1.0)},
        ValueRangeError,
        ("(0.5, 0.8, 1.0)", "(shortest, longest)"),
    ),
    "period in words": (
        {"period": "long"},
        ValueRangeError,
        ("cycle.period is 'long'", "positive"),
    ),
    "no period at all": ({"period": None}, ValueRangeError, ("cycle.period is None", "positive")),
    "speed NaN": ({"speed": NAN}, ValueRangeError, ("cycle.speed", "finite")),
    "speed in words": ({"speed": "fast"}, ValueRangeError, ("cycle.speed is 'fast'", "numbers")),
    "a velocity": ({"speed": (0.5, 0.0, 0.0)}, ShapeError, ("cycle.speed", "(3,)")),
    "endless turn": (
        {"turn": INFINITE, "mirror": False},
        ValueRangeError,
        ("cycle.turn", "finite"),
    ),
    "a mirror of glass": (
        {"mirror": "glass"},
        ProblemError,
        ("cycle.mirror is 'glass'", "octo.Mirror"),
    ),
}


@pytest.mark.parametrize(("given", "kind", "words"), CYCLES.values(), ids=list(CYCLES))
def test_a_cycle_is_refused(
    given: dict[str, Any], kind: type[OctoError], words: tuple[str, ...]
) -> None:
    with pytest.raises(kind) as caught:
        octo.Cycle(**given)
    assert "\n" not in str(caught.value)
    assert all(word in str(caught.value) for word in words), str(caught.value)


PROBLEMS: dict[str, tuple[Callable[[], Any], type[OctoError], tuple[str, ...]]] = {
    "no mirror": (
        lambda: problem(lopsided()),
        MirrorError,
        ("'lopsided'", "no left-right mirror", "front_right"),
    ),
    "a joint that is none": (
        lambda: problem(cycle=octo.Cycle(mirror={"hip": "hop"})),
        UnknownNameError,
        ("joint 'hip'",),
    ),
    "the mirror of another robot": (
        lambda: problem(cycle=octo.Cycle(mirror=octo.mirror_of(octo.gallery.biped()))),
        ProblemError,
        ("cycle.mirror", "14 coordinates", "'mammal' has 18"),
    ),
    "uneven ground": (
        lambda: problem(terrain=WAVES),
        ProblemError,
        ("the same everywhere", "octo.Plane"),
    ),
    "uneven ground, whole stride": (
        lambda: problem(cycle=WHOLE, terrain=WAVES),
        ProblemError,
        ("the same everywhere",),
    ),
    "ground that rises across": (
        lambda: problem(terrain=ACROSS),
        ProblemError,
        ("rises along the stride", "mirror=False"),
    ),
    "gravity across": (
        lambda: problem(parameters={"gravity_y": 1.0}),
        ProblemError,
        ("rises along the stride", "mirror=False"),
    ),
    "turning on a slope": (
        lambda: problem(cycle=TURNING, terrain=octo.Plane(slope=0.1)),
        ProblemError,
        ("turning", "level ground"),
    ),
    "no whole steps": (
        lambda: problem(dt=0.03),
        ProblemError,
        ("cycle.period is 0.8 s", "13.3333 steps of 0.03 s", "0.78 s"),
    ),
    "steps and dt": (
        lambda: problem(steps=20, dt=0.025),
        ProblemError,
        ("cycle.period is 0.8 s", "16 steps", "the 20 steps", "of 1 s"),
    ),
    "dt and a range": (
        lambda: problem(dt=0.025, cycle=octo.Cycle(period=(0.5, 1.0))),
        ProblemError,
        ("dt is 0.025 s", "a range"),
    ),
    "hermite": (lambda: problem(basis="hermite"), ProblemError, ("basis is 'hermite'", "'nodes'")),
    "a Hermite basis": (
        lambda: problem(basis=octo.Hermite()),
        ProblemError,
        ("basis is 'hermite'", "'nodes'"),
    ),
    "no basis": (lambda: problem(basis="spline"), UnknownNameError, ("basis 'spline'", "nodes")),
    "user-written dynamics": (
        lambda: problem(pendulum(), WHOLE),
        ProblemError,
        ("cycle needs a robot", "user-written"),
    ),
    "three steps": (lambda: problem(steps=3), ProblemError, ("steps is 3", "at least 4")),
    "a part of a step": (
        lambda: problem(steps=16.5),
        ValueRangeError,
        ("steps is 16.5", "whole number"),
    ),
    "negative dt": (lambda: problem(dt=-0.025), ValueRangeError, ("dt is -0.025", "positive")),
    "x0": (lambda: problem(x0=X), ProblemError, ("x0 is given with cycle",)),
    "v0": (lambda: problem(v0=X), ProblemError, ("v0 is given with cycle",)),
    "x_end": (lambda: problem(x_end=X), ProblemError, ("x_end is given with cycle",)),
    "v_end": (lambda: problem(v_end=X), ProblemError, ("v_end is given with cycle",)),
    "no Cycle": (
        lambda: problem(cycle={"speed": 0.5}),
        ProblemError,
        ("cycle is {'speed': 0.5}", "octo.Cycle"),
    ),
    "a fixed base": (
        lambda: problem(arm(), WHOLE),
        ProblemError,
        ("floating base", "'arm' is fixed"),
    ),
    "no actuator": (
        lambda: problem(brick(), WHOLE),
        ProblemError,
        ("actuator", "'brick' has none"),
    ),
}


@pytest.mark.parametrize(("make", "kind", "words"), PROBLEMS.values(), ids=list(PROBLEMS))
def test_a_problem_is_refused(
    make: Callable[[], Any],
    kind: type[OctoError],
    words: tuple[str, ...],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def load(*_: Any) -> None:
        raise AssertionError("compiled before it was refused")

    monkeypatch.setattr(native, "load", load)
    with pytest.raises(kind) as caught:
        make()
    assert "\n" not in str(caught.value)
    assert all(word in str(caught.value) for word in words), str(caught.value)


def test_what_is_replaced_is_checked_and_derived_anew() -> None:
    walk = problem()
    assert (walk.steps, walk.dt) == (16, 0.025)
    slower = walk.replace(cycle=octo.Cycle(speed=0.5, period=1.0))
    assert (slower.steps, slower.dt) == (16, 0.03125)
    assert walk.replace(steps=20).dt == pytest.approx(0.02)
    both = walk.replace(cycle=octo.Cycle(speed=0.5, period=(0.5, 0.8))).replace(
        parameters={"gravity_z": -1.6}
    )
    assert both.steps == 16 and both.dt == pytest.approx(np.sqrt(0.4) / 32)
    assert [term.label for term in both.costs] == ["Effort", "Anchor"]
    end = walk.closure.forward @ walk.start + walk.closure.forward_constant
    faster = walk.replace(cycle=octo.Cycle(speed=1.0))
    assert walk.costs[-1].target == pytest.approx(end)
    assert faster.costs[-1].target[0] == pytest.approx(end[0] + 0.2)
    with pytest.raises(
        UnknownNameError, match="field of a Problem 'cycles' is not known; did you mean cycle"
    ):
        walk.replace(cycles=CYCLE)
    assert walk.replace(dt=0.05).steps == 8
    with pytest.raises(ProblemError, match="cycle.period is 0.8 s"):
        walk.replace(dt=0.03)
    with pytest.raises(ProblemError, match="cycle.period a range"):
        both.replace(dt=0.03)
