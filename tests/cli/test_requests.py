"""Requests in the shell and in Python: what is ill-posed is one line that names it, what is hard
but can be done is solved, what cannot be done is explained by the constraints' names."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import octo
from octo.cli.main import REFUSED, main
from octo.cli.solve import with_place
from octo.errors import OctoError

DT, STEPS = 0.05, 40

ARM = """<mujoco model="arm"><worldbody><body><joint name="elbow" type="hinge" axis="0 1 0"/>
<geom type="sphere" size="0.1"/></body></worldbody><actuator><motor joint="elbow"/></actuator>
</mujoco>"""

# -- ill-posed: one line, exit code 2 --------------------------------------------------------------

SHELL: dict[str, tuple[str, str]] = {
    "another word": (
        "solve mammal --limits rigid",
        "limits 'rigid' is not known; did you mean hard",
    ),
    "friction of no cone": (
        "solve mammal --mu 0.5",
        "--mu is of limits that hold: it goes with --limits hard",
    ),
    "no friction": ("solve mammal --limits hard --mu 0", "--mu: is '0', must be positive"),
    "friction that is none": (
        "cycle mammal --limits hard --mu nan",
        "--mu: is 'nan', must be a finite number",
    ),
    "friction of a stride without cones": (
        "cycle mammal --mu 0.4",
        "--mu is of limits that hold: it goes with --limits hard",
    ),
    "a place of two numbers": (
        "solve mammal --goal to 1,2",
        "--goal to is followed by '1,2', must be X,Y,YAW: m ahead, m to the left, rad to the left",
    ),
    "no place": ("solve mammal --goal to", "--goal to is followed by '', must be X,Y,YAW"),
    "a place of a word": ("solve mammal --goal to 1,left,0", "followed by '1,left,0', must be X,Y"),
    "a place at infinity": ("solve mammal --goal to inf,0,0", "followed by 'inf,0,0', must be X"),
    "a place too far": (
        "solve mammal --goal to -1e9,0,0",
        "place is -1e+09, must be at most 1e+06 in size",
    ),
    "a place of other terms": (
        "solve mammal --goal to 1,0,0 --costs paper",
        "--goal to is reached in strides: it goes with octo solve, --costs natural and --basis",
    ),
    "a place on splines": (
        "solve mammal --goal to 1,0,0 --basis hermite",
        "--goal to is reached in strides",
    ),
    "a place to compare at": (
        "compare mammal --goal to 1,0,0 --seconds 1",
        "--goal to is reached in strides",
    ),
    "a place to control to": ("mpc mammal --goal to 1,0,0", "goal 'to 1,0,0' is not known"),
    "a start of several pieces": (
        "solve mammal --goal to 1,0,0 --start old.npz",
        "--start is of one problem, a to 1,0,0 of natural terms is several",
    ),
    "a place by who cannot go": (
        "solve arm.xml --goal to 1,0,0",
        "goal 'to' needs a floating base, robot 'arm' is fixed",
    ),
}


@pytest.mark.parametrize("name", SHELL)
def test_the_shell_says_it_in_one_line(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words, message = SHELL[name]
    (tmp_path / "arm.xml").write_text(ARM)
    monkeypatch.chdir(tmp_path)
    assert main(words.split()) == REFUSED
    out, err = capsys.readouterr()
    assert not out and err.count("\n") == 1 and err.startswith("octo: error: ")
    assert message in err
    assert [path.name for path in tmp_path.iterdir()] == ["arm.xml"]


def walk(*constraints: Any, **more: Any) -> octo.Solution:
    return octo.walk(octo.gallery.mammal(), 0.3, 2.5, constraints=constraints, **more)


PYTHON: dict[str, tuple[Callable[[], object], str]] = {
    "a word": (
        lambda: octo.walk(octo.gallery.mammal(), constraints="rigid"),
        "constraints 'rigid' is not known; did you mean hard",
    ),
    "at some steps of several pieces": (
        lambda: walk(octo.PointPosition(target=(1.0, 0.0, 0.2), at=[3, 4])),
        r"PointPosition.at is \[3, 4\], must be 'all': a motion from rest to rest is",
    ),
    "at a time": (
        lambda: walk(octo.TorqueLimits(at=octo.At(1.0))),
        "TorqueLimits.at is an At, must be 'all'",
    ),
    "too low for who stands there at the end": (
        lambda: walk(octo.BaseHeightRange(upper=0.2)),
        "BaseHeightRange: the base is 0.23.* m at step 98, where the state is fixed, must be at",
    ),
    "another height than the one it stands at": (
        lambda: walk(octo.BaseHeight(0.1)),
        "BaseHeight: height of the base − target is 0.13.* m at step 98, .* must be 0",
    ),
    "no number between two": (
        lambda: walk(octo.BaseHeightRange(0.3, 0.2)),
        "BaseHeightRange: the base has the lower bound 0.3 and the upper bound 0.2 m at step 0",
    ),
    "a foot that is none": (
        lambda: walk(octo.FrictionCones(contacts=("paw",))),
        "contact 'paw' is not known; valid: front_left",
    ),
    "what has no hard form": (
        lambda: octo.jump(octo.gallery.mammal(), constraints=[octo.TorqueRate()]),
        "TorqueRate is over two steps in a row and has no hard form",
    ),
    "a place that is a number": (
        lambda: octo.go_to(octo.gallery.mammal(), 1.0),
        r"place has shape \(\), expected \(3,\)",
    ),
    "a place without a speed": (
        lambda: octo.go_to(octo.gallery.mammal(), (1.0, 0.0, 0.0), speed=0.0),
        "speed is 0.0 m/s, must be positive",
    ),
    "a slippery ground": (
        lambda: octo.limits(octo.gallery.mammal(), mu=-0.1),
        "mu is -0.1, must be positive",
    ),
    "limits of a file": (lambda: octo.limits("mammal.urdf"), "robot is 'mammal.urdf', must be"),
}


@pytest.mark.parametrize("name", PYTHON)
def test_python_says_it_in_one_line(name: str) -> None:
    call, message = PYTHON[name]
    with pytest.raises(OctoError, match=message) as refused:
        call()
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "words, joined",
    [
        ("solve m --goal to -1,2,0 --dt 1", ["solve", "m", "--goal=to -1,2,0", "--dt", "1"]),
        ("solve m --goal=to 1,2,0", ["solve", "m", "--goal=to 1,2,0"]),
        ("solve m --goal to --dt 1", ["solve", "m", "--goal=to", "--dt", "1"]),
        ("solve to --goal walk", ["solve", "to", "--goal", "walk"]),
        ("", []),
    ],
)
def test_a_place_may_begin_with_a_minus(words: str, joined: list[str]) -> None:
    assert with_place(words.split()) == joined


# -- hard but feasible, and infeasible -------------------------------------------------------------


def mass(**more: Any) -> octo.Problem:
    """1 kg that a force pushes along a line, from rest at 0, in 2 s."""
    fd = octo.CustomDynamics(lambda a, b, c, p: (a - 2 * b + c) / p["dt"] ** 2, 1, [0], {"dt": DT})
    given = {"costs": [octo.Effort(weight=1.0, reference=1.0)], "x0": np.zeros(1), **more}
    return octo.Problem(fd, steps=STEPS, dt=DT, **given)


def pushed_up(**more: Any) -> octo.Problem:
    """1 kg that a force of at most ``limit`` N holds up against gravity."""

    def fd(a: Any, b: Any, c: Any, p: Any) -> Any:
        return (a - 2 * b + c) / p["dt"] ** 2 + 9.81

    dynamics = octo.CustomDynamics(fd, 1, [0], {"dt": DT})
    costs = [octo.Effort(weight=1.0, reference=9.81)]
    return octo.Problem(dynamics, steps=STEPS, dt=DT, costs=costs, x0=np.zeros(1), **more)


def place(name: str, lower: float, upper: float, **more: Any) -> octo.Constraint:
    return octo.CustomConstraint(lambda step, p: step.x_next[0], lower, upper, name=name, **more)


def crouching() -> octo.Problem:
    """Legs that fold as far as the height asks for."""
    limits = [octo.TorqueLimits(), octo.JointLimits(margin=0.05)]
    low = octo.BaseHeightRange(upper=0.18, at=range(6, 16))
    given: dict[str, Any] = {"steps": 16, "dt": 0.03, "costs": [octo.Effort()]}
    constraints = [*limits, low, octo.TiltLimit(0.4)]
    return octo.Problem(octo.gallery.mammal(), constraints=constraints, **given)


AT_REST = {"x_end": np.array([0.8]), "v_end": np.zeros(1)}
KEYS = [
    octo.PoseTarget(target=[x], at=octo.At(t), name=f"at {t:g} s")
    for t, x in ((0.5, 0.3), (1, -0.3))
]
FEASIBLE: dict[str, Callable[[], octo.Problem]] = {
    "a force that is just enough": lambda: mass(constraints=[octo.TorqueLimits(0.81)], **AT_REST),
    "a speed that is just enough": lambda: mass(
        constraints=[octo.TorqueLimits(9.0), octo.JointSpeedLimits(0.45)], **AT_REST
    ),
    "there and back in time": lambda: mass(constraints=[*KEYS, octo.TorqueLimits(4.6)]),
    "three places with force to spare": lambda: mass(
        constraints=[*KEYS, octo.PoseTarget(target=[0.3], at=octo.At(1.5)), octo.TorqueLimits(20.0)]
    ),
    "through a gate and back": lambda: mass(
        constraints=[octo.TorqueLimits(4.0), place("gate", 0.5, 0.52, at=[18, 19, 20])],
        x_end=np.zeros(1),
        v_end=np.zeros(1),
    ),
    "a force that just carries": lambda: pushed_up(
        constraints=[octo.TorqueLimits(9.9), place("up", -0.01, np.inf)]
    ),
    "legs that fold": crouching,
}
INFEASIBLE: dict[str, tuple[Callable[[], octo.Problem], set[str]]] = {
    "a force that is not enough": (
        lambda: mass(constraints=[octo.TorqueLimits(0.7)], **AT_REST),
        {"TorqueLimits", "the fixed end"},
    ),
    "a speed that is not enough": (
        lambda: mass(constraints=[octo.JointSpeedLimits(0.35), octo.StepLimit(1.0)], **AT_REST),
        {"JointSpeedLimits", "the fixed end"},
    ),
    "there and back too late": (
        lambda: mass(constraints=[*KEYS, octo.TorqueLimits(4.5)]),
        {"at 0.5 s", "at 1 s", "TorqueLimits"},
    ),
    "two gates at once": (
        lambda: mass(
            constraints=[
                octo.TorqueLimits(50.0),
                place("left", -np.inf, -0.2, at=[20]),
                place("right", 0.2, np.inf, at=[20]),
            ]
        ),
        {"left", "right"},
    ),
    "a force that does not carry": (
        lambda: pushed_up(constraints=[octo.TorqueLimits(9.0), place("up", -0.1, np.inf)]),
        {"TorqueLimits", "up"},
    ),
}


@pytest.mark.parametrize("name", FEASIBLE)
def test_what_is_hard_but_feasible_is_solved(name: str) -> None:
    motion = octo.solve(FEASIBLE[name](), passes=1, device="cpu")
    assert motion.converged and all(bound.held for bound in motion.bounds)


@pytest.mark.parametrize("name", INFEASIBLE)
def test_what_is_infeasible_is_explained(name: str) -> None:
    make, names = INFEASIBLE[name]
    problem = make()
    motion = octo.solve(problem, passes=1, max_iterations=60, device="cpu")
    assert not motion.converged
    conflict = octo.explain(problem, motion).conflict
    assert conflict is not None and set(conflict.names) == names


def test_the_shell_says_what_is_broken(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It runs, writes everything, exits with 1 and says where it is explained."""
    out = tmp_path / "slope"
    words = "solve mammal --goal stand --terrain slope:30 --limits hard --mu 0.2 --seconds 0.5"
    quick = "--passes 1 --max-iterations 20"
    assert main(f"{words} {quick} --out {out}".split()) == 1
    said = capsys.readouterr().out
    assert "FrictionCones broken" in said and f"why it failed: octo explain {out}" in said
    bounds = json.loads((out / "report.json").read_text())["bounds"]
    assert {one["name"]: one["held"] for one in bounds}["FrictionCones"] is False
    assert main(["explain", str(out)]) == 0
    explained = capsys.readouterr().out
    assert "the constraint" in explained and "must be at most 0.2" in explained
