"""Every way a solve can end: what is returned, what it is called, and that the other members of a
batch do not notice."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap

import numpy as np
import pytest

import octo
from octo.errors import OctoError
from octo.problem.compiled import CompiledProblem
from octo.solver import sqp
from octo.solver.options import SqpOptions
from octo.solver.sqp import Monitor
from octo.solver.status import Status


def score(history, row, weight=1.0) -> float:
    return history["energy"][row] + 100.0 * history["violation"][row] / weight


def test_a_start_that_is_not_finite_ends_alone(swing_up, turning):
    problem = CompiledProblem([swing_up()] * 3)
    before = turning[:1]
    nodes = np.stack([np.concatenate([before, path]) for path in (turning, turning, turning**1.1)])
    nodes[:, -1], nodes[:, -2] = 0.0, 0.0
    unknowns = problem.unknowns(nodes)
    unknowns[1, 7] = np.nan
    for options in (SqpOptions(), SqpOptions.paper(max_iterations=60)):
        result = sqp.run(problem, unknowns, None, options)
        assert result.status[1] is Status.NOT_FINITE and not result.status[1].converged
        assert result.iterations[1] == 0 and result.history[1]["iteration"].shape == (0,)
        for k in (0, 2):
            alone = sqp.run(CompiledProblem([swing_up()]), unknowns[[k]], None, options)
            assert (
                result.status[k] is alone.status[0] and result.iterations[k] == alone.iterations[0]
            )
            np.testing.assert_array_equal(result.at.unknowns[k], alone.at.unknowns[0])
            np.testing.assert_array_equal(result.lam[k], alone.lam[0])
            for name in ("energy", "violation", "sigma", "factorizations"):
                np.testing.assert_array_equal(result.history[k][name], alone.history[0][name])


def test_a_term_that_is_not_finite_is_said(balance):
    broken = octo.CustomCost(lambda step, p: 1.0 / (step.x_next[0] - step.x_next[0]), name="broken")
    solution = octo.solve(balance(costs=[broken]))
    assert (
        solution.status is Status.NOT_FINITE and not solution.converged and solution.iterations == 0
    )


def test_limit_of_iterations(swing_up, turning):
    for limit in (1, 7):
        solution = octo.solve(swing_up(), start=turning, max_iterations=limit)
        assert solution.status is Status.ITERATION_LIMIT and solution.iterations == limit
        assert len(solution.history["energy"]) == limit
        found = solution.energy + 100.0 * solution.violation
        assert all(found <= score(solution.history, row) * (1 + 1e-9) for row in range(limit))


def test_the_best_iterate_is_returned_and_not_the_last(swing_up, turning):
    """Gauss–Newton steps go up and down: whatever the limit, nothing that was seen is better than
    what is returned."""
    options, better = SqpOptions(hessian="gauss_newton"), 0
    whole = octo.solve(swing_up(), start=turning, options=options, max_iterations=30).history
    for limit in range(1, 29):
        solution = octo.solve(swing_up(), start=turning, options=options, max_iterations=limit)
        # the last one is where the limit left it
        seen = [score(whole, row) for row in range(limit + 1)]
        assert solution.energy + 100.0 * solution.violation == pytest.approx(min(seen), rel=1e-9)
        better += min(seen) < seen[-1]
    assert better > 3


def test_limit_of_time(swing_up, turning):
    solution = octo.solve(swing_up(), start=turning, time_limit=1e-9)
    assert solution.status is Status.TIME_LIMIT and solution.iterations <= 1
    assert np.isfinite(solution.x).all()


@pytest.mark.parametrize("paper", [False, True])
def test_a_callback_sees_every_iteration_and_may_stop(swing_up, turning, paper):
    seen = []

    def callback(at: sqp.Iterate) -> bool:
        seen.append(at)
        return at.iteration == 4

    options = SqpOptions.paper() if paper else SqpOptions()
    solution = octo.solve(swing_up(), start=turning, callback=callback, options=options)
    assert solution.status is Status.INTERRUPTED and solution.iterations == len(seen) == 5
    assert [at.iteration for at in seen] == list(range(5))
    assert all((at.number, at.passes, at.nodes.shape) == (1, 1, (1, 42, 2)) for at in seen)
    np.testing.assert_allclose([at.energy[0] for at in seen[:-1]], solution.history["energy"][1:])
    assert "E " in seen[0].words and "N" in seen[0].words
    scores = [score(solution.history, row) for row in range(5)] + [
        seen[-1].energy[0] + 100.0 * seen[-1].violation[0]
    ]
    assert solution.energy + 100.0 * solution.violation == pytest.approx(min(scores))


def test_ctrl_c_returns_the_best_iterate(swing_up, turning):
    def press(at: sqp.Iterate) -> None:
        if at.iteration == 6:
            raise KeyboardInterrupt

    solution = octo.solve(swing_up(), start=turning, callback=press)
    assert solution.status is Status.INTERRUPTED and solution.iterations == 7
    scores = [score(solution.history, row) for row in range(7)]
    assert solution.energy + 100.0 * solution.violation <= min(scores) * (1 + 1e-9)
    assert np.isfinite(solution.x).all() and "interrupted" in str(solution)


def test_what_a_callback_raises_is_not_swallowed(balance):
    def broken(at: sqp.Iterate) -> None:
        raise RuntimeError("mine")

    with pytest.raises(RuntimeError, match="mine"):
        octo.solve(balance(), callback=broken)


def test_a_stop_is_not_forgotten():
    """A monitor that was told to stop stays stopped in the passes that follow."""
    lines = []
    monitor = Monitor(progress=lambda at, final=False: lines.append(final))
    monitor.stopped = True
    at = type("At", (), {"energy": np.ones(1), "nodes": np.zeros((1, 3, 1))})
    assert monitor.show(0, at, np.zeros(1)) and monitor.stopped
    monitor.end()
    assert lines == [False, True]


def test_a_progress_line_on_the_error_stream(swing_up, turning, capfd):
    solution = octo.solve(swing_up(), start=turning, progress=True)
    lines = [line for line in capfd.readouterr().err.splitlines() if line.startswith("octo: pass")]
    assert (
        lines[-1].startswith(f"octo: pass 1/1, iteration {solution.iterations - 1}: E ")
        and "‖C‖∞" in lines[-1]
    )


def test_members_leave_when_they_are_done(balance):
    """A member that converged early keeps its numbers while the others go on."""
    problems = [balance(x0=np.array([0.0, tilt])) for tilt in (0.02, 0.9, 0.4)]
    counts = []
    found = octo.solve(problems, callback=lambda at: counts.append(len(at.energy)))
    assert counts[0] == 3 and counts == sorted(counts, reverse=True)
    assert len({solution.iterations for solution in found}) > 1 and all(
        solution.converged for solution in found
    )


@pytest.mark.parametrize("options", [SqpOptions(), SqpOptions.paper()])
def test_ends_that_no_motion_joins(options):
    """A mass that nothing pushes cannot come to rest elsewhere: never called converged, and the
    violation is said."""
    free = octo.CustomDynamics(
        lambda x_next, x, x_prev, p: (x_next - 2 * x + x_prev) / p["dt"] ** 2, 2, [0], {"dt": 0.1}
    )
    problem = octo.Problem(
        free, steps=10, dt=0.1, x0=np.zeros(2), x_end=np.ones(2), costs=[octo.Effort()]
    )
    solution = octo.solve(problem, max_iterations=300, options=options)
    assert not solution.converged and solution.status in (Status.STALLED, Status.ITERATION_LIMIT)
    assert solution.violation > 0.1


def test_wrong_starts_are_refused(balance):
    for start in (np.zeros((41, 3)), np.zeros((1, 2)), np.full((41, 2), np.nan)):
        with pytest.raises(OctoError, match="start"):
            octo.solve(balance(), start=start)
    with pytest.raises(OctoError, match="list of problems is empty"):
        octo.solve([])


def test_without_a_compiler_it_solves_and_says_so_once(balance):
    script = """
        import logging, sys
        logging.basicConfig()
        sys.path.insert(0, sys.argv[1])
        import numpy as np, conftest
        for _ in range(2):
            problem = conftest._balance(steps=20)
            solution = __import__("octo").solve(problem)
            assert solution.converged, solution
        print(solution.energy.hex())
    """
    command = [sys.executable, "-c", textwrap.dedent(script), os.path.dirname(__file__)]
    environment = {**os.environ, "OCTO_NO_COMPILER": "1"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("OCTO_NO_COMPILER is set") == 1
    expected = octo.solve(balance(steps=20))
    assert float.fromhex(done.stdout.strip()) == pytest.approx(expected.energy, rel=1e-9)
