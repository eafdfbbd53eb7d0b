"""Problems that cannot be solved: the constraints that contradict each other are named, by
``octo.explain``; and what a solution says of its own end."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import octo
from octo.cli.main import main
from octo.errors import OctoError
from octo.solve import evaluated
from octo.solver.elastic import Elastic
from octo.solver.status import Status

DT, STEPS = 0.05, 40


def mass(**more: Any) -> octo.Problem:
    """1 kg that a force pushes along a line, at rest at 0."""
    fd = octo.CustomDynamics(lambda a, b, c, p: (a - 2 * b + c) / p["dt"] ** 2, 1, [0], {"dt": DT})
    given = {"costs": [octo.Effort(weight=1.0, reference=1.0)], "x0": np.zeros(1)}
    return octo.Problem(fd, **{**given, "steps": STEPS, "dt": DT, **more})


def falling(**more: Any) -> octo.Problem:
    """The same beside 1 kg that falls, which nothing drives."""

    def fd(a: Any, b: Any, c: Any, p: Any) -> Any:
        return (a - 2 * b + c) / p["dt"] ** 2 + ca.vertcat(0.0, 9.81)

    dynamics = octo.CustomDynamics(fd, 2, [0], {"dt": DT})
    costs = [octo.Effort(weight=1.0, reference=1.0)]
    return octo.Problem(dynamics, steps=STEPS, dt=DT, costs=costs, x0=np.zeros(2), **more)


def place(name: str, lower: float, upper: float, row: int = 0, **more: Any) -> octo.Constraint:
    return octo.CustomConstraint(lambda step, p: step.x_next[row], lower, upper, name=name, **more)


def crouching() -> octo.Problem:
    """Legs that cannot fold as far as the height asks for."""
    return octo.Problem(
        octo.gallery.mammal(),
        steps=16,
        dt=0.03,
        costs=[octo.Effort()],
        constraints=[
            octo.TorqueLimits(),
            octo.JointLimits(margin=0.5),
            octo.BaseHeightRange(upper=0.1, at=range(6, 16)),
            octo.TiltLimit(0.4),
        ],
    )


AT_REST = {"x_end": np.array([0.8]), "v_end": np.zeros(1)}
KEYFRAME = octo.PoseTarget(target=np.array([0.8]), at=[-2, -1], name="End")
INFEASIBLE: dict[str, tuple[Callable[[], octo.Problem], tuple[str, ...]]] = {
    "a force too small for a fixed end": (
        lambda: mass(constraints=[octo.TorqueLimits(0.1)], **AT_REST),
        ("TorqueLimits", "the fixed end"),
    ),
    "a force just too small": (
        lambda: mass(constraints=[octo.StepLimit(0.5), octo.TorqueLimits(0.79)], **AT_REST),
        ("TorqueLimits", "the fixed end"),
    ),
    "a force too small for a keyframe": (
        lambda: mass(constraints=[octo.StepLimit(0.5), octo.TorqueLimits(0.1), KEYFRAME]),
        ("TorqueLimits", "End"),
    ),
    "a speed too small": (
        lambda: mass(
            constraints=[octo.TorqueLimits(9.0), octo.JointSpeedLimits(0.3)],
            basis=octo.Hermite(5),
            **AT_REST,
        ),
        ("JointSpeedLimits", "the fixed end"),
    ),
    "two places at once": (
        lambda: mass(
            constraints=[
                octo.TorqueLimits(50.0),
                place("near", -np.inf, 0.4, at=[19, 20]),
                place("far", 0.5, np.inf, at=[20]),
            ]
        ),
        ("near", "far"),
    ),
    "what falls": (
        lambda: falling(constraints=[octo.TorqueLimits(5.0), place("up", -1.0, np.inf, row=1)]),
        ("up",),
    ),
    "what falls, to a fixed end": (
        lambda: falling(x_end=np.zeros(2), constraints=[octo.TorqueLimits(5.0)]),
        ("the fixed end",),
    ),
    "legs that cannot fold": (crouching, ("JointLimits", "BaseHeightRange")),
}


@pytest.mark.parametrize("name", INFEASIBLE)
def test_a_contradiction_is_named(name: str) -> None:
    make, names = INFEASIBLE[name]
    problem = make()
    solution = octo.solve(problem, passes=1, max_iterations=60)
    assert not solution.converged
    conflict = octo.explain(problem, solution).conflict
    assert conflict is not None and conflict.names == names and conflict.motion is None
    assert conflict.solves <= 2 * (len(problem.constraints) + 2)
    assert all(not row.held for row in conflict.rows)
    text = str(conflict)
    assert all(name in text for name in names)
    assert ("cannot hold together" in text) == (len(names) > 1)


def test_where_and_what_contradicts() -> None:
    """Half of the way at the least force: it is beyond its limit at every step alike."""
    problem = mass(constraints=[octo.TorqueLimits(0.1)], **AT_REST)
    conflict = octo.explain(problem, octo.solve(problem, max_iterations=30)).conflict
    assert conflict is not None and conflict.certain and conflict.end
    (torque,) = conflict.rows
    # of x_N = 0.8 at rest the least Σ (|u| − 0.1)²: a force that falls along a line
    assert torque.step in (0, STEPS - 1) and torque.excess == pytest.approx(10.5, rel=0.1)
    assert "and the fixed end at 2 s cannot hold together" in str(conflict)


@pytest.mark.parametrize("limit", [0.8, 1.0])
def test_what_can_hold_together_is_no_contradiction(limit: float) -> None:
    """0.8 N is exactly enough; the motion that is found is one to start from."""
    problem = mass(constraints=[octo.TorqueLimits(limit)], **AT_REST)
    solution = octo.solve(problem, max_iterations=3)
    assert not solution.converged
    conflict = octo.explain(problem, solution).conflict
    assert conflict is not None and conflict.names == () and conflict.motion is not None
    assert conflict.motion.shape == (STEPS + 1, 1)
    force = np.diff(np.pad(conflict.motion[:, 0], (1, 0)), 2) / DT**2
    assert np.abs(force).max() <= limit * (1.0 + 1e-3)
    assert octo.solve(problem, start=conflict.motion).converged


def test_without_constraints_only_the_laws_of_physics_are_asked() -> None:
    problem = falling()
    conflict = octo.explain(problem, octo.solve(problem)).conflict
    assert conflict is not None and conflict.names == () and conflict.motion is not None


def test_a_problem_is_as_it_was() -> None:
    problem = mass(constraints=[octo.TorqueLimits(0.1)], **AT_REST)
    solution = octo.solve(problem, max_iterations=20)
    octo.explain(problem, solution)
    again = octo.solve(problem, max_iterations=20)
    np.testing.assert_array_equal(again.x, solution.x)


@pytest.mark.parametrize(
    "given, said",
    [(lambda p, s: (s, s), "Problem"), (lambda p, s: (p, p), "Solution"), (None, "steps|shape")],
)
def test_what_is_no_problem_or_not_its_solution_is_refused(given: Any, said: str) -> None:
    problem = mass()
    solution = octo.solve(problem)
    other = problem.replace(steps=STEPS - 1)
    with pytest.raises(OctoError, match=said):
        octo.explain(*((other, solution) if given is None else given(problem, solution)))


# -- what a solution says itself -------------------------------------------------------------------


def test_the_end_of_a_solve_names_what_is_broken() -> None:
    problem = mass(constraints=[octo.StepLimit(0.5), octo.TorqueLimits(0.1), KEYFRAME])
    solution = octo.solve(problem)
    assert solution.status is Status.STALLED
    worst = max(solution.bounds, key=lambda own: own.excess)
    assert solution.sentence.startswith("stalled: the constraint")
    assert f"{worst.row} is " in solution.sentence and worst.name in solution.sentence
    assert "StepLimit" not in solution.sentence
    assert solution.report()["status_sentence"] == solution.sentence
    assert solution.sentence in str(solution)
    told = solution.explain()
    assert told.stopped == solution.sentence and told.conflict is None
    assert [own.held for own in told.bounds] == sorted(own.held for own in told.bounds)
    assert told.broken[0] is told.bounds[0] is worst
    assert "octo.explain(problem, solution)" in str(told)


def test_a_solve_that_ran_out_of_iterations_says_so_first() -> None:
    problem = mass(constraints=[octo.TorqueLimits(0.1)], **AT_REST)
    solution = octo.solve(problem, max_iterations=2)
    assert solution.sentence.startswith(f"{Status.ITERATION_LIMIT.value}; the constraint Torque")
    assert octo.solve(mass()).sentence == Status.CONVERGED.value


def test_laws_that_do_not_hold_yet_are_said_with_their_step(tmp_path: Path) -> None:
    """Nothing holds the mass that should fall: where it accelerates otherwise, N are missing."""
    nodes = np.zeros((STEPS + 1, 2))
    fall = -0.5 * 9.81 * DT**2 * np.arange(STEPS + 1) * np.arange(1, STEPS + 2)
    nodes[:, 1] = fall
    nodes[30:, 1] += 0.05  # kicked at x_30
    solution = evaluated(falling(), nodes, Status.STALLED)
    (row,) = solution.residuals
    assert (
        row.row == "x1" and row.step in (29, 30) and row.time == pytest.approx(DT * (row.step + 1))
    )
    assert abs(row.value) == pytest.approx(0.05 / DT**2) and not row.held
    told = solution.explain()
    assert told.residuals == (row,) and f"x1 is out of balance by {0.05 / DT**2:.3g}" in str(told)
    solution.save(tmp_path / "solution.npz")
    assert octo.Solution.load(tmp_path).residuals == solution.residuals


def test_residuals_of_a_robot_are_newtons_and_newton_metres() -> None:
    problem = octo.Problem(octo.gallery.mammal(), steps=8, dt=0.03, costs=[octo.Effort()])
    solution = octo.solve(problem, passes=1, max_iterations=2)
    rows = {own.row: own for own in solution.residuals}
    assert rows["joint 'base_z'"].unit == "N" and rows["joint 'base_pitch'"].unit == "N m"
    most = max(own.part for own in solution.residuals) * solution.weight
    assert most == pytest.approx(solution.violation)
    told = solution.explain()
    assert [own.part for own in told.residuals] == sorted(
        (own.part for own in told.residuals), reverse=True
    )


def test_terms_that_dominate_are_said() -> None:
    there = octo.PoseTarget(weight=100.0, target=np.array([1.0]))
    nodes = 1e-3 * np.linspace(0.0, 1.0, STEPS + 1)[:, None] ** 2
    costs = [octo.Effort(weight=1.0, reference=1.0), there]
    told = evaluated(mass(costs=costs), nodes, Status.SIMULATED).explain()
    assert list(told.terms) == ["PoseTarget", "Effort"]
    assert list(told.shares) == ["PoseTarget"] and "PoseTarget 100%" in str(told)
    assert told.broken == () and told.residuals == () and told.hints == ()
    assert repr(told) == str(told)


def test_the_command_reads_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    problem = mass(constraints=[octo.TorqueLimits(0.1)], **AT_REST)
    solution = octo.solve(problem, max_iterations=20)
    solution.save(tmp_path / "solution.npz")
    assert main(["explain", str(tmp_path)]) == 0
    assert capsys.readouterr().out == f"{solution.explain()}\n"
    assert main(["explain", str(tmp_path / "solution.npz"), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["status"] == solution.status.label and not report["bounds"][0]["held"]
    assert main(["explain", str(tmp_path / "none")]) == 2


def test_weights_and_shifts_are_derivatives_of_the_price() -> None:
    rows = np.linspace(-3.0, 3.0, 41).reshape(1, 1, -1)
    lower, upper = np.full_like(rows, -1.0), np.full_like(rows, 1.5)
    lower[..., ::3], upper[..., 1::3] = -np.inf, np.inf
    lower[..., 2::6] = upper[..., 2::6]
    for width in (1.0, 0.1):
        elastic, h = Elastic(lower, upper, width), 1e-5
        behind, here, ahead = (elastic._prices(rows + side * h) for side in (-1.0, 0.0, 1.0))
        np.testing.assert_allclose((ahead[0] - behind[0]) / (2 * h), here[1], atol=1e-8)
        np.testing.assert_allclose((ahead[1] - behind[1]) / (2 * h), here[2], atol=1e-8)
        assert (here[2] >= 0.0).all()


def in_phases(weak: float) -> Any:
    """A second to get to 0.8 m by a force of 5 N at most, and one more with a weak motor to be at
    rest."""
    strong = mass(steps=STEPS // 2, constraints=[octo.TorqueLimits(5.0), place("slow", -1.0, 0.3)])
    rest = mass(steps=STEPS, x0=None, dt=0.5 * DT, constraints=[octo.TorqueLimits(weak)], **AT_REST)
    return octo.phases([strong, rest])


def test_a_contradiction_between_phases_is_named_with_them() -> None:
    """From 0.3 m at most to 0.8 m at rest in a second: a mean of 0.5 m/s, stopped by 0.1 N."""
    phases = in_phases(0.1)
    found = octo.solve(phases, max_iterations=60)
    assert not found.converged
    conflict = octo.explain(phases, found).conflict
    assert conflict is not None and conflict.end
    assert conflict.names == ("slow (phase 0)", "TorqueLimits (phase 1)", "the fixed end")
    slow, torque = conflict.rows
    assert slow.time <= 1.0 < torque.time and torque.step >= STEPS // 2
    assert conflict.seconds == pytest.approx(2.0)


def test_phases_that_can_hold_together() -> None:
    phases = in_phases(2.5)
    conflict = octo.explain(phases, octo.solve(phases, max_iterations=3)).conflict
    assert conflict is not None and conflict.names == () and conflict.motion is not None
    assert octo.solve(phases, start=conflict.motion).converged


def test_a_solution_of_other_phases_is_refused() -> None:
    phases = in_phases(2.5)
    whole = octo.solve(mass(steps=phases.steps), max_iterations=3)
    with pytest.raises(OctoError, match="the solution has 0 phases, the problem 2"):
        octo.explain(phases, whole)
