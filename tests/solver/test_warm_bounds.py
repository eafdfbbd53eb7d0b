"""Warm starts of problems with bounds: slacks, multipliers and the barrier's weight stay, over
files and over another number of steps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import octo
from octo.problem.compiled import CompiledProblem
from octo.reference import Ipopt
from octo.solver.status import Status
from octo.starts import first_slacks
from tests.solver.test_barrier import double_integrator, swing_up


def push(steps: int, limit: float = 1.0) -> octo.Problem:
    """A mass that is moved in two seconds by a force that just suffices."""
    return octo.Problem(
        double_integrator(2.0 / steps),
        steps=steps,
        dt=2.0 / steps,
        costs=[octo.Effort(weight=1.0, reference=1.0)],
        constraints=[octo.TorqueLimits(limit=limit)],
        x0=np.zeros(1),
        x_end=np.array([0.8]),
        v_end=np.zeros(1),
    )


@pytest.mark.parametrize("limit", [20.0, 10.0, 8.0])
def test_a_converged_solve_goes_on_from_its_file_at_once(limit: float, tmp_path: Path) -> None:
    problem = swing_up(limit)
    cold = octo.solve(problem)
    assert cold.status is Status.CONVERGED and cold.iterations > 10
    cold.save(tmp_path / "cold.npz")
    kept = octo.Solution.load(tmp_path / "cold.npz")
    for name, values in cold.slacks.items():
        np.testing.assert_array_equal(kept.slacks[name], values)
    warm = octo.solve(problem, start=tmp_path / "cold.npz")
    assert warm.status is Status.CONVERGED and warm.iterations <= 3
    np.testing.assert_allclose(warm.x, cold.x, atol=1e-6)


@pytest.mark.parametrize("change", ["limit", "weight"])
def test_a_warm_start_of_another_problem_is_raised_from_its_weight(change: str) -> None:
    """Slacks on bounds that have moved, or that are held back by another cost, come off them."""
    cold = octo.solve(swing_up(10.0))
    other = swing_up(9.0 if change == "limit" else 10.0)
    if change == "weight":
        other = other.replace(costs=[octo.Effort(weight=0.3, reference=1.0)])
    again, known = octo.solve(other), octo.solve(other, start=cold)
    assert known.status is Status.CONVERGED
    # from 10 to 9 N another optimum is found, 6e-4 below
    assert (1.0 - 1e-3) * again.energy <= known.energy <= (1.0 + 1e-5) * again.energy


def test_over_another_number_of_steps() -> None:
    few, many = push(40), push(80)
    first = octo.solve(few)
    cold, warm = octo.solve(many), octo.solve(many, start=first)
    assert warm.status is Status.CONVERGED and warm.iterations < cold.iterations
    np.testing.assert_allclose(warm.energy, cold.energy, rtol=1e-5)
    blind = octo.solve(many, start=replace(first, slacks={}))
    assert warm.iterations < blind.iterations


def test_multipliers_are_of_a_mean_over_the_steps() -> None:
    """Twice the steps: half of each multiplier, at twice the times."""
    first, last = octo.solve(push(40)), octo.solve(push(80))
    known = first_slacks([first], CompiledProblem([push(80)]))
    assert known is not None and known.s.shape == (1, 80, 1)
    own = known.upper[0] - known.lower[0]
    most = np.abs(last.row_multipliers).max()
    np.testing.assert_allclose(own, last.row_multipliers, atol=0.1 * most)
    assert first_slacks([replace(first, slacks={})], CompiledProblem([push(80)])) is None


def test_ipopt_takes_over_the_multipliers_of_rows() -> None:
    problem = swing_up(10.0)
    cold = octo.solve(problem)
    solver = Ipopt(problem)
    blind = solver.solve(cold.x, cold.multipliers).solution
    warm = solver.solve(cold.x, cold.multipliers, row_multipliers=cold.row_multipliers).solution
    assert blind.converged and warm.converged
    assert warm.iterations < blind.iterations
    np.testing.assert_allclose(warm.energy, cold.energy, rtol=1e-5)
