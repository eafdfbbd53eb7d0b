"""The loop on user-written dynamics: every kind of step converges; batches, seeds, warm starts and
files keep every bit."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import octo
from octo import native
from octo.model.character import Body, Character, Joint
from octo.result.solution import Solution
from octo.solver.status import HISTORY, Status

OPTIONS = {
    "exact": octo.SqpOptions(),
    "gauss_newton": octo.SqpOptions(hessian="gauss_newton"),
    "gauss_newton_first": octo.SqpOptions(gauss_newton_first=5),
    "paper": octo.SqpOptions.paper(),
    "paper_exact": octo.SqpOptions(step="trust_region", tolerance=1e-5),
}
BASES = {"nodes": "nodes", "hermite": octo.Hermite(5)}


def same(one: Solution, other: Solution) -> None:
    """Bit for bit, whatever the clock said."""
    for name in ("x", "u", "unknowns", "multipliers"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert (one.status, one.iterations, one.terms) == (other.status, other.iterations, other.terms)
    for name in set(HISTORY) - {"seconds"}:
        np.testing.assert_array_equal(one.history[name], other.history[name])


@pytest.mark.parametrize("name", OPTIONS)
@pytest.mark.parametrize("basis", BASES)
def test_balance(balance, basis, name):
    solution = octo.solve(balance(basis=BASES[basis]), options=OPTIONS[name])
    assert solution.converged and solution.iterations <= 30
    assert solution.violation <= 1e-5
    assert np.abs(solution.x[-1]).max() < 0.02 < np.abs(solution.x[1]).max()


@pytest.mark.parametrize("name", OPTIONS)
@pytest.mark.parametrize("basis", BASES)
def test_swing_up(swing_up, turning, basis, name):
    solution = octo.solve(
        swing_up(basis=BASES[basis]), options=OPTIONS[name], start=turning, max_iterations=1000
    )
    assert solution.converged and solution.violation <= 1e-5
    np.testing.assert_allclose(solution.x[-1], 0.0, atol=1e-12)
    if basis == "nodes":
        np.testing.assert_allclose(solution.x[-2], 0.0, atol=1e-12)
        assert solution.pointwise_residual <= 1e-5
    work = np.sum(solution.u[:, 0] * np.diff(solution.x[1:, 0]))
    # the pole is raised by twice its length; the differences damp
    assert work > 2 * 0.2 * 9.81 * 0.5


def test_all_ways_find_the_same_swing_up(swing_up, turning):
    energies = {
        name: octo.solve(
            swing_up(), options=dataclasses.replace(OPTIONS[name], plateau=200), start=turning
        ).energy
        for name in ("exact", "gauss_newton_first")
    }
    assert energies["exact"] == pytest.approx(energies["gauss_newton_first"], rel=1e-4)


@pytest.mark.parametrize("hessian", ["exact", "gauss_newton"])
@pytest.mark.parametrize("step", ["line_search", "trust_region"])
def test_a_fully_actuated_arm_has_no_constraints(hessian, step):
    y = np.array([0.0, 1.0, 0.0])
    inertia = np.diag([0.01, 0.01, 0.001])
    upper = Body(
        "upper",
        -1,
        (Joint("shoulder", "hinge", y),),
        mass=1.0,
        com=np.array([0, 0, -0.2]),
        inertia=inertia,
    )
    lower = Body(
        "lower",
        0,
        (Joint("elbow", "hinge", y),),
        np.array([0, 0, -0.4]),
        mass=0.5,
        com=np.array([0, 0, -0.2]),
        inertia=inertia,
    )
    arm = Character("arm", (upper, lower), base="fixed")
    target = np.array([0.6, -0.8])
    costs = [octo.PoseTarget(target, weight=10.0), octo.Effort()]
    for basis in ("nodes", octo.Hermite(5)):
        problem = octo.Problem(
            arm, steps=20, dt=0.05, costs=costs, basis=basis, x0=np.array([0.1, 0.1])
        )
        tolerance = 1e-5 if step == "trust_region" else 2e-7
        solution = octo.solve(
            problem, options=octo.SqpOptions(hessian=hessian, step=step, tolerance=tolerance)
        )
        assert solution.converged and solution.multipliers.size == 0
        assert solution.violation == solution.pointwise_residual == 0.0
        assert np.abs(solution.x[-1] - target).max() < 0.1


def test_twice_the_same_bits(swing_up, turning):
    same(*(octo.solve(swing_up(), start=turning, seed=3) for _ in range(2)))


def test_several_starts_as_one_batch_are_those_of_one_by_one(balance):
    seen: list[dict[str, np.ndarray]] = []
    problem = balance(x0=np.array([0.0, 0.6]))
    together = octo.solve(problem, seeds=3, seed=4, callback=lambda at: seen.append(at.energy))
    alone = [octo.solve(problem, seed=4 + k) for k in range(3)]
    assert len(seen[0]) == 3 and together.converged
    for record, own in zip(together.starts, alone, strict=True):
        assert (
            record["iterations"] == own.iterations
            and record["energy"] == own.energy
            and record["seed"] == own.seed
        )
    same(together, alone[together.seed - 4])
    assert together.energy == min(own.energy for own in alone)
    assert len({own.x.tobytes() for own in alone}) == 3  # the seeds do differ


@pytest.mark.parametrize("basis", BASES)
def test_a_list_of_problems_is_one_batch(balance, basis):
    """Starts, time steps, parameters, weights and ends of their own: bit for bit the solves one by
    one."""
    longer = balance(parameters={"length": 1.0})
    problems = [
        balance(),
        balance(dt=0.04, x0=np.array([0.3, -0.2]), v0=np.array([0.1, -0.2])),
        longer.replace(costs=[dataclasses.replace(c, weight=2.0 * c.weight) for c in longer.costs]),
    ]
    for ends in ([None] * 3, [np.zeros(2), np.array([0.1, 0.0]), np.array([-0.2, 0.0])]):
        listed = [
            problem.replace(basis=BASES[basis], x_end=end)
            for problem, end in zip(problems, ends, strict=True)
        ]
        for solution, problem in zip(octo.solve(listed), listed, strict=True):
            assert solution.converged
            np.testing.assert_array_equal(solution.x[1], problem.x0)
            same(solution, octo.solve(problem))
    assert len(octo.solve([balance()])) == 1


def test_a_list_of_problems_with_several_starts(balance):
    problems = [balance(), balance(x0=np.array([0.3, -0.2]))]
    found = octo.solve(problems, seeds=2)
    for solution, problem in zip(found, problems, strict=True):
        np.testing.assert_array_equal(solution.x[1], problem.x0)
        assert solution.energy == min(octo.solve(problem, seed=k).energy for k in range(2))


def test_a_warm_start_resumes(swing_up, turning, tmp_path):
    cold = octo.solve(swing_up(), start=turning)
    cold.save(tmp_path / "swing.npz")
    for start in (cold, octo.Solution.load(tmp_path / "swing.npz")):
        warm = octo.solve(swing_up(), start=start)
        # 20 of them see that E does not change
        assert warm.converged and warm.iterations <= 22 < cold.iterations
        assert warm.energy <= cold.energy * (1 + 1e-4)
    half = octo.solve(swing_up(), start=turning, max_iterations=10)
    assert half.status is Status.ITERATION_LIMIT
    assert octo.solve(swing_up(), start=half).iterations < cold.iterations


def test_saved_and_loaded(swing_up, turning, tmp_path):
    solution = octo.solve(swing_up(), start=turning)
    solution.save(tmp_path / "swing.npz")
    loaded = octo.Solution.load(tmp_path / "swing.npz")
    for item in dataclasses.fields(Solution):
        kept, found = getattr(solution, item.name), getattr(loaded, item.name)
        if isinstance(kept, np.ndarray):
            np.testing.assert_array_equal(kept, found, strict=True)
        elif item.name == "history":
            assert list(kept) == list(found) and all(
                (kept[name] == found[name]).all() for name in kept
            )
        else:
            assert kept == found, item.name
    assert loaded.report() == solution.report() and str(loaded) == str(solution)


@pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
def test_both_linear_solvers_take_the_same_iterations(swing_up, turning):
    first, second = (
        octo.solve(
            swing_up(),
            start=turning,
            options=octo.SqpOptions(linear_solver=solver),
            max_iterations=20,
        )
        for solver in ("elimination", "cyclic_reduction")
    )
    for name in ("energy", "violation", "step", "sigma", "factorizations", "ratio"):
        np.testing.assert_allclose(first.history[name], second.history[name], rtol=1e-6, atol=1e-9)


def test_history_has_a_row_per_iteration(swing_up, turning):
    solution = octo.solve(swing_up(), start=turning)
    history = solution.history
    assert tuple(history) == HISTORY and {len(column) for column in history.values()} == {
        solution.iterations
    }
    np.testing.assert_array_equal(history["iteration"], np.arange(solution.iterations))
    np.testing.assert_array_equal(history["pass"], 1.0)
    assert (
        history["factorizations"][-1] == solution.factorizations
        and (np.diff(history["factorizations"]) >= 1).all()
    )
    assert (np.diff(history["seconds"]) >= 0).all() and np.isfinite(history["energy"]).all()
    assert set(solution.stages) == {"linearize", "factor", "solve", "evaluate"}
    assert sum(solution.stages.values()) <= solution.seconds
    assert solution.passes[0]["iterations"] == solution.iterations and len(solution.passes) == 1


def test_numbers_of_a_problem_change_without_a_new_model(balance):
    """replace() shares the dynamics: longer poles, other weights, another time step."""
    first = balance()
    for changes in (
        {"parameters": {"length": 1.0}},
        {"dt": 0.04},
        {"steps": 50},
        {"costs": [octo.Effort(), first.costs[0]]},
    ):
        changed = first.replace(**changes)
        assert changed.dynamics is first.dynamics
        assert octo.solve(changed).converged
