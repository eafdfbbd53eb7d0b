"""Motions of dynamics that the user wrote which leap are solved on with a limit of their steps, and
only these."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

import octo
from octo.continuation.run import Continuation
from octo.errors import OctoError
from octo.result.solution import Solution
from octo.solve import solve_all
from octo.solver.status import Status
from tests.solver.test_textbook_bounds import HELD, G, double_pendulum, places

Array = NDArray[np.float64]
LEAPING = np.zeros((41, 2))
LEAPING[20:] = np.pi
SWINGING = np.linspace(0.0, np.pi, 41)[:, None] * np.ones(2)
NAME = "implied StepLimit"


def changes(motion: Solution) -> Array:
    return np.abs(np.diff(motion.x[1:], axis=0))


def replayed(motion: Solution) -> float:
    """rad, how far masses that move in continuous time are from the motion at most: pushed by its
    torques, which a spring and a damper of each joint correct."""
    q, u = ca.SX.sym("q", 2), ca.SX.sym("u", 2)
    v = ca.SX.sym("v", 2)
    slope = ca.jacobian(places(q), q)
    drift = ca.jtimes(ca.jtimes(places(q), q, v), q, v) + ca.DM([0.0, G, 0.0, G])
    a = ca.solve(slope.T @ slope, u - slope.T @ drift)
    law = ca.Function("law", [q, v, u], [a])
    state, worst, fine = np.zeros(4), 0.0, 50
    x = motion.x[1:]

    def flow(state: Array, wanted: Array, speed: Array, torque: Array) -> Array:
        push = torque + 60.0 * (wanted - state[:2]) + 6.0 * (speed - state[2:])
        return np.concatenate([state[2:], law(state[:2], state[2:], push).full().ravel()])

    h = motion.dt / fine
    for step in range(motion.steps):
        speed = (x[step + 1] - x[step]) / motion.dt
        for part in range(fine):
            wanted = x[step] + part * h * speed
            own = (wanted, speed, motion.u[step])
            half = state + 0.5 * h * flow(state, *own)
            state = state + h * flow(half, *own)
        worst = max(worst, float(np.abs(state[:2] - x[step + 1]).max()))
    return worst


def test_a_double_pendulum_does_not_leap(tmp_path: Any, capsys: Any) -> None:
    free = octo.solve(double_pendulum(step_limit=None), start=LEAPING)
    assert changes(free).max() > 3.0 and len(free.passes) == 1 and len(free.warnings) == 1
    motion = octo.solve(double_pendulum(), start=LEAPING, progress=True)
    assert motion.status is Status.CONVERGED and changes(motion).max() <= 1.0 + HELD
    assert (
        "x0 leaps by 3.14 in the step at 0.95 s; going on with implied" in capsys.readouterr().err
    )
    assert replayed(motion) < 0.1 and replayed(free) > 1.0
    first, second = motion.passes
    assert first["iterations"] == free.iterations and first["energy"] == free.energy
    assert motion.iterations == first["iterations"] + second["iterations"]
    assert motion.iterations == len(motion.history["pass"]) and set(motion.history["pass"]) == {
        1,
        2,
    }
    assert [bound.name for bound in motion.bounds] == [NAME] and motion.bounds[0].held
    assert "x0 leaps by 3.14 in the step at 0.95 s" in second["limited"]
    assert motion.warnings == () and "step_limit=None" in str(motion.explain())
    motion.save(tmp_path / "swing.npz")
    assert str(Solution.load(tmp_path / "swing.npz").explain()) == str(motion.explain())


def test_what_does_not_leap_is_solved_as_without() -> None:
    own = [
        octo.solve(double_pendulum(step_limit=limit), start=SWINGING) for limit in ("auto", None)
    ]
    np.testing.assert_array_equal(own[0].x, own[1].x)
    assert own[0].iterations == own[1].iterations and len(own[0].passes) == 1
    assert own[0].bounds == ()


def test_of_a_batch_those_that_leap_are_solved_again() -> None:
    problem = double_pendulum()
    batch = octo.solve([problem, problem, problem], start=[SWINGING, LEAPING, SWINGING])
    assert [len(motion.passes) for motion in batch] == [1, 2, 1]
    alone = [octo.solve(problem, start=start) for start in (SWINGING, LEAPING)]
    for motion, other in zip(batch, (*alone, alone[0]), strict=True):
        np.testing.assert_array_equal(motion.x, other.x)
        assert motion.iterations == other.iterations


def test_a_start_that_leaps_is_no_better_than_one_that_does_not() -> None:
    """Though it went through two passes: of starts that converged the one of least E is best."""
    members = solve_all(double_pendulum(), seeds=4)
    best = octo.solve(double_pendulum(), seeds=4)
    assert best.energy == min(motion.energy for motion in members)


@pytest.mark.parametrize(
    "more",
    [
        {"basis": octo.Hermite(4)},
        {
            "duration": (1.5, 2.5),
            "costs": [octo.Effort(weight=0.01, reference=1.0), octo.Duration(weight=0.05)],
        },
    ],
    ids=["hermite", "free time"],
)
def test_in_other_bases_and_in_free_time(more: Any) -> None:
    leap = np.where(np.arange(41)[:, None] < 20, 0.0, 2 * np.pi) * np.ones(2)
    problem = double_pendulum(**more, x_end=np.full(2, 2 * np.pi))
    free = octo.solve(problem.replace(step_limit=None), start=leap)
    assert changes(free).max() > 1.01
    motion = octo.solve(problem, start=leap)
    assert motion.converged and len(motion.passes) == 2
    assert changes(motion).max() <= 1.0 + HELD


def test_in_phases() -> None:
    whole = double_pendulum()
    ends = {"x_end": whole.x_end, "v_end": whole.v_end}
    first = whole.replace(steps=20, x_end=None, v_end=None)
    second = octo.Problem(whole.model, steps=20, dt=0.05, costs=whole.costs, **ends)
    motion = octo.solve(octo.phases([first, second]), start=LEAPING)
    assert motion.converged and changes(motion).max() <= 1.0 + HELD
    assert [bound.name for bound in motion.bounds] == [f"{NAME} (phase {k})" for k in (0, 1)]
    alone = octo.solve(whole, start=LEAPING)
    np.testing.assert_allclose(motion.x, alone.x, atol=1e-4)
    free = [one.replace(step_limit=None) for one in (first, second)]
    assert changes(octo.solve(octo.phases(free), start=LEAPING)).max() > 3.0


def test_a_limit_of_ones_own() -> None:
    """As a field it is put in where it is needed, as a constraint it is there from the start."""
    motion = octo.solve(double_pendulum(step_limit=[4.0, 0.25]), start=SWINGING)
    assert len(motion.passes) == 2 and changes(motion)[:, 1].max() <= 0.25 * (1.0 + HELD)
    said = octo.StepLimit(1.0, name="mine")
    held = octo.solve(double_pendulum(constraints=[said]), start=LEAPING)
    assert len(held.passes) == 1 and [bound.name for bound in held.bounds] == ["mine"]


def test_what_knows_no_constraints_warns_and_says_why() -> None:
    options = octo.SqpOptions.paper(max_iterations=50)
    motion = octo.solve(double_pendulum(), start=LEAPING, options=options)
    assert len(motion.passes) == 1 and changes(motion).max() > 3.0
    assert "octo.solve does not: step='trust_region' knows no constraints" in motion.warnings[0]


def test_an_end_further_than_the_steps_reach_is_left_where_it_is() -> None:
    """Units of the user's own, say: 200 mm in 40 steps."""
    mass = octo.CustomDynamics(lambda a, b, c, p: (a - 2 * b + c) / p["dt"] ** 2, 1, [0], {})
    given: dict[str, Any] = {"x0": [0.0], "x_end": [200.0], "costs": [octo.Effort(reference=1.0)]}
    motion = octo.solve(octo.Problem(mass, steps=40, dt=0.05, **given))
    assert motion.converged and len(motion.passes) == 1
    assert "x0 is to end 200 from its start, the steps reach 40" in motion.warnings[0]
    assert octo.solve(octo.Problem(mass, steps=40, dt=0.05, step_limit=9.0, **given)).converged


def test_it_can_be_stopped() -> None:
    def stopping(number: int, most: int) -> Any:
        return lambda at: (at.number, at.iteration) == (number, most)

    first = octo.solve(double_pendulum(), start=SWINGING, callback=stopping(1, 2))
    assert first.status is Status.INTERRUPTED and len(first.passes) == 1
    second = octo.solve(double_pendulum(), start=LEAPING, callback=stopping(2, 3))
    assert second.status is Status.INTERRUPTED
    assert [own["iterations"] for own in second.passes] == [1, 4]
    limited = octo.solve(double_pendulum(), start=LEAPING, max_iterations=5)
    assert limited.status is Status.ITERATION_LIMIT
    assert [own["iterations"] for own in limited.passes] == [1, 5]


def test_ctrl_c_while_the_limit_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(self: Any, problems: Any, places: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Continuation, "_within_steps", interrupted)
    problem = double_pendulum()
    motions = octo.solve([problem, problem], start=[SWINGING, LEAPING])
    assert [motion.status for motion in motions] == [Status.CONVERGED, Status.INTERRUPTED]


def test_a_limit_that_cannot_hold_is_said_and_explained() -> None:
    """A mass that must be 3 m away after two steps, between which it is free."""
    mass = octo.CustomDynamics(lambda a, b, c, p: (a - 2 * b + c) / p["dt"] ** 2, 1, [0], {})
    place = octo.PoseTarget(target=[3.0], at=[1])
    problem = octo.Problem(
        mass, steps=4, dt=0.5, x0=[0.0], costs=[octo.Effort(reference=1.0)], constraints=[place]
    )
    motion = octo.solve(problem, max_iterations=200)
    assert not motion.converged and NAME in motion.sentence
    assert "step_limit=None" in str(motion.explain())
    conflict = octo.explain(problem, motion).conflict
    assert conflict is not None and set(conflict.names) == {NAME, "PoseTarget"}
    assert octo.solve(problem.replace(step_limit=None)).converged


@pytest.mark.parametrize(
    ("limit", "words"),
    [
        (-1.0, "step_limit has -1, must be positive"),
        ([1.0, 1.0, 1.0], r"step_limit.*\(3,\).*\(\) or \(2,\)"),
        ("none", "step_limit 'none' is not known; valid: auto"),
        (np.inf, "step_limit is not finite"),
    ],
)
def test_what_is_no_limit_is_refused(limit: Any, words: str) -> None:
    with pytest.raises(OctoError, match=words):
        double_pendulum(step_limit=limit)


def test_a_robot_has_constraints() -> None:
    robot = octo.gallery.mammal()
    with pytest.raises(OctoError, match="step_limit is 1.0, which is for dynamics that you wrote"):
        octo.Problem(robot, steps=4, dt=0.02, costs=[octo.Effort()], step_limit=1.0)
