"""A second of a robot on its feet, in both bases and over passes: found within the laws of physics,
and told honestly."""

from __future__ import annotations

import importlib

import numpy as np
import pytest

import octo
from octo.continuation.schedule import schedule, shifted
from octo.errors import ProblemError
from octo.problem.compiled import CompiledProblem
from octo.solver import sqp
from octo.solver.options import SqpOptions
from octo.solver.status import Status


def standing(robot=None, speed: float = 0.0, **changes) -> octo.Problem:
    costs = octo.costs.paper((speed, 0.0, 0.0))
    return octo.Problem(
        robot or octo.gallery.biped(), **{"steps": 20, "dt": 0.05, "costs": costs, **changes}
    )


@pytest.fixture(scope="module")
def two_passes() -> octo.Solution:
    return octo.solve(standing(), passes=2)


def check(solution: octo.Solution) -> None:
    assert solution.converged
    weight = solution.weight
    assert solution.violation <= 1e-5 * max(1.0, weight / 49.0)
    if solution.basis == "nodes":
        assert solution.pointwise_residual <= 1e-4 * max(1.0, weight / 49.0)


@pytest.mark.parametrize("name", ["chain", "biped"])
@pytest.mark.parametrize("basis", ["nodes", "hermite"])
def test_standing(name, basis):
    solution = octo.solve(standing(getattr(octo.gallery, name)(), basis=basis), passes=1)
    check(solution)
    lift = solution.normal_force.sum(axis=1)
    assert lift.mean() == pytest.approx(solution.weight, rel=0.1)
    assert np.linalg.norm(solution.com[-1] - solution.com[0]) < 0.1
    assert solution.energy < 0.05


@pytest.mark.parametrize("basis", ["nodes", "hermite"])
def test_a_slow_second_of_walking(basis):
    solution = octo.solve(standing(speed=0.2, basis=basis), passes=1)
    check(solution)
    assert (solution.com[-1] - solution.com[0])[0] == pytest.approx(0.2, rel=0.2)


def test_the_acceleration_of_the_centre_of_mass_is_the_contacts(two_passes):
    """Newton's law, from the solution's own arrays: m·a = Σ f + m·g at every step."""
    solution = two_passes
    assert solution.character is not None
    from octo.model.kinematics import center_of_mass

    com = center_of_mass(solution.character, solution.x)
    acceleration = np.diff(com, n=2, axis=0) / solution.dt**2
    mass = solution.weight / 9.81
    force = solution.contact_force.sum(axis=1) + [0.0, 0.0, -solution.weight]
    # rotations are differenced, not the com
    np.testing.assert_allclose(mass * acceleration, force, atol=0.05 * solution.weight)


def test_a_second_pass_halves_the_penetration(two_passes):
    check(two_passes)
    first, second = two_passes.passes
    assert first["converged"] and second["converged"]
    assert second["penetration"] == pytest.approx(0.5 * first["penetration"], rel=0.15)
    assert second["contact.w_perp"] == pytest.approx(4.0 * first["contact.w_perp"])
    assert two_passes.iterations == first["iterations"] + (two_passes.history["pass"] == 2.0).sum()
    assert two_passes.parameters["contact.w_perp"] == second["contact.w_perp"]


def test_passes_of_a_batch_are_those_of_one_by_one(two_passes):
    together = octo.solve(standing(), passes=2, seeds=2)
    for seed, alone in ((0, two_passes), (1, octo.solve(standing(), passes=2, seed=1))):
        record = together.starts[seed]
        assert (record["energy"], record["iterations"]) == (alone.energy, alone.iterations)


def test_problems_whose_passes_differ_are_refused():
    fixed = standing(parameters={"contact.w_perp": 1e5})
    with pytest.raises(ProblemError, match="differ in stiffness or friction"):
        octo.solve([standing(), fixed])


def interrupted(problem: octo.Problem, stop) -> octo.Solution:
    solution = octo.solve(problem, passes=3, callback=stop)
    assert solution.status is Status.INTERRUPTED and np.isfinite(solution.x).all()
    return solution


def test_stopping_while_the_stiffness_grows_keeps_the_converged_pass():
    """The first iterations of a pass are at stiffnesses on the way to its own: nothing after the
    stop is computed."""
    for stops in (lambda at: at.number == 2, _ctrl_c):
        seen: list[int] = []

        def watch(at: sqp.Iterate, stops=stops, seen=seen) -> bool | None:
            seen.append(at.number)
            return stops(at)

        solution = interrupted(standing(), watch)
        assert seen.count(2) == 1 and 3 not in seen
        assert [record["converged"] for record in solution.passes] == [True, False]
        assert solution.parameters["contact.w_perp"] == solution.passes[0]["contact.w_perp"]
        assert solution.violation <= 1e-4


def _ctrl_c(at: sqp.Iterate) -> None:
    if at.number == 2:
        raise KeyboardInterrupt


def test_ctrl_c_between_two_passes_keeps_the_converged_pass(monkeypatch):
    def press(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(importlib.import_module("octo.continuation.run"), "shifted", press)
    solution = interrupted(standing(), lambda at: None)
    assert [record["converged"] for record in solution.passes] == [True]


def test_passes_are_said_by_how_deep_feet_sink():
    problem = standing()
    first, second = (
        stage.parameters(problem.weight) for stage in schedule(problem, 2) if stage is not None
    )
    # on four feet
    assert first["contact.w_perp"] == pytest.approx(
        problem.weight / 4 / (0.08 * problem.length) ** 2
    )
    assert second["contact.w_perp"] == pytest.approx(4 * first["contact.w_perp"])
    assert [len(schedule(p, None)) for p in (problem, problem.replace(basis="hermite"))] == [4, 1]
    fixed = problem.replace(parameters={"contact.w_perp": 1e5})
    assert schedule(fixed, None) == [None]
    with pytest.raises(ProblemError, match="passes is 2"):
        schedule(fixed, 2)


def test_moved_nodes_begin_at_the_new_start():
    before = standing()
    after = standing(parameters={"contact.w_perp": 1e6, "contact.w_par": 1e7}, v0=0.1 * np.ones(14))
    nodes = np.repeat(before.start[None], 22, axis=0) + np.linspace(0.0, 0.1, 22)[:, None]
    nodes[1] = before.start
    moved = shifted(nodes, before, after)
    np.testing.assert_allclose(moved[1], after.start, atol=1e-15)
    np.testing.assert_allclose(moved[0], after.start - 0.05 * after.start_velocity, atol=1e-15)
    np.testing.assert_allclose(np.diff(moved[1:], axis=0), np.diff(nodes[1:], axis=0), atol=1e-12)


def test_threads_and_batches_of_a_robot(two_passes):
    """Three threads find what one does; the members of a batch are the solves of their own."""
    problem = standing(
        parameters={"contact.w_perp": 1e4, "contact.w_par": 1e5, "contact.onset": 0.01}
    )
    together = octo.solve(problem, seeds=2, max_iterations=25)
    for k in range(2):
        alone = octo.solve(problem, seed=k, max_iterations=25)
        assert (together.starts[k]["energy"], together.starts[k]["violation"]) == (
            alone.energy,
            alone.violation,
        )
    threaded = octo.solve(problem, seeds=2, max_iterations=25, threads=3)
    assert threaded.energy == pytest.approx(together.energy, rel=1e-6)
    again = octo.solve(problem, seeds=2, max_iterations=25, threads=3)
    np.testing.assert_array_equal(threaded.x, again.x)


def test_elimination_and_cyclic_reduction_on_a_robot():
    problem = CompiledProblem([standing(basis="hermite")])
    nodes = np.repeat(problem.start[:, None], 22, axis=1)
    results = [
        sqp.run(
            problem,
            problem.unknowns(nodes),
            None,
            SqpOptions(linear_solver=solver, max_iterations=15),
        )
        for solver in ("elimination", "cyclic_reduction")
    ]
    for name in ("energy", "violation", "sigma"):
        np.testing.assert_allclose(
            results[0].history[0][name], results[1].history[0][name], rtol=1e-4, atol=1e-7
        )
