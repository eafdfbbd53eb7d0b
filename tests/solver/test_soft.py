"""Soft constraints (§8.4): E + ½ρ‖C‖² by Levenberg–Marquardt and by L-BFGS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import octo
from octo import SqpOptions
from octo.errors import DeviceError, ProblemError, UnknownNameError, ValueRangeError
from octo.gpu.backend import DeviceBackend
from octo.problem.compiled import CompiledProblem
from octo.solver.blocks import KKTBlocks
from octo.solver.soft import Softened, squared
from octo.solver.status import HISTORY, Status
from tests.dense import kkt_matrix

LM = SqpOptions(step="levenberg_marquardt", hessian="gauss_newton", penalty=100.0)
LBFGS = SqpOptions(step="lbfgs", penalty=100.0)


@pytest.fixture
def soft(balance: Callable[..., octo.Problem]) -> Softened:
    return Softened(CompiledProblem([balance()], exact=True), 7.0)


def somewhere(problem: Softened) -> np.ndarray:
    return np.random.default_rng(0).normal(0.0, 0.3, (1, problem.K, problem.nc))


def test_the_objective_has_the_squares_of_the_constraints(soft: Softened) -> None:
    v = somewhere(soft)
    at, hard = soft.evaluate(v), soft.inner.evaluate(v)
    assert at.energy[0] == pytest.approx(hard.energy[0] + 3.5 * np.sum(hard.C**2), rel=1e-13)
    assert (at.largest, at.size[0]) == (hard.largest, 0.0)


def test_its_gradient_has_taylor_slopes(soft: Softened) -> None:
    v, way = somewhere(soft), somewhere(soft)[:, ::-1]
    b, A = soft.gradient(soft.evaluate(v))
    slope, value = float(np.sum(b * way)), soft.evaluate(v).energy[0]
    rests = [abs(soft.evaluate(v + h * way).energy[0] - value - h * slope) for h in (1e-3, 1e-4)]
    assert A.shape[3] == 0 and 80.0 < rests[0] / rests[1] < 120.0


@pytest.mark.parametrize("exact", [False, True])
def test_its_model_is_that_of_the_problem_and_of_the_squares(soft: Softened, exact: bool) -> None:
    v = somewhere(soft)
    at = soft.evaluate(v)
    model = soft.linearize(at, np.zeros((1, soft.K, 0)) if exact else None)
    lam = soft.multipliers(at) if exact else None
    hard = soft.inner.linearize(at, lam)
    H, A, b, C = (np.array(part) for part in (hard.H, hard.A, hard.b, hard.C))
    whole = kkt_matrix(KKTBlocks(H, A, b, C))[0]
    made = kkt_matrix(KKTBlocks(model.H, model.A, model.b, model.C))[0]
    n = soft.K * soft.nc
    rows = whole[n:, :n]
    np.testing.assert_allclose(made, whole[:n, :n] + 7.0 * rows.T @ rows, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(
        model.b.ravel(), b.ravel() + 7.0 * rows.T @ C.ravel(), rtol=1e-12, atol=1e-12
    )
    if exact:  # it is the second derivative
        way, h = somewhere(soft)[:, ::-1], 1e-5
        ends = [soft.gradient(soft.evaluate(v + s * h * way))[0].ravel() for s in (1, -1)]
        along = (ends[0] - ends[1]) / (2.0 * h)
        np.testing.assert_allclose(made @ way.ravel(), along, rtol=1e-6, atol=1e-5)


def test_squares_of_blocks() -> None:
    A = np.random.default_rng(1).normal(size=(2, 5, 3, 2, 3))
    A[:, 0, 1:] = A[:, 1, 2:] = 0.0
    H = squared(A)
    zero = np.zeros
    dense = kkt_matrix(kkt := _blocks(zero((2, 5, 3, 3, 3)), A))
    n = kkt.units * kkt.nc
    rows = dense[:, n:, :n]
    found = kkt_matrix(_blocks(H, zero((2, 5, 3, 0, 3))))
    np.testing.assert_allclose(found, rows.swapaxes(1, 2) @ rows, atol=1e-13)


def _blocks(H: np.ndarray, A: np.ndarray) -> KKTBlocks:
    shape = H.shape[:2]
    return KKTBlocks(H, A, np.zeros((*shape, 3)), np.zeros((*shape, A.shape[3])))


def test_with_a_larger_penalty_it_comes_nearer_to_the_hard_problem(
    balance: Callable[..., octo.Problem],
) -> None:
    """‖C‖ falls as 1/ρ, ρC tends to the multipliers, and E comes from below."""
    hard = octo.solve(balance(), tolerance=1e-9)
    ends = [octo.solve(balance(), options=replace(LM, penalty=rho)) for rho in (1e2, 1e4)]
    assert all(one.status is Status.CONVERGED for one in ends)
    assert ends[0].energy < ends[1].energy < hard.energy
    assert 80.0 < ends[0].violation / ends[1].violation < 120.0
    off = [np.abs(one.multipliers - hard.multipliers).max() for one in ends]
    assert off[1] < 0.02 * off[0] < 0.02 * np.abs(hard.multipliers).max()


def test_both_find_the_same_minimum(balance: Callable[..., octo.Problem]) -> None:
    one = octo.solve(balance(steps=10), options=replace(LM, penalty=1.0))
    gentle = replace(LBFGS, penalty=1.0, dual_tolerance=1e-4)
    other = octo.solve(balance(steps=10), options=gentle)
    assert one.status is Status.CONVERGED and other.status is Status.CONVERGED
    assert other.iterations > 5 * one.iterations
    np.testing.assert_allclose(other.x, one.x, atol=1e-3)
    for found in (one, other):
        assert len(found.history["energy"]) == found.iterations
        assert set(found.history) == set(HISTORY)
        assert found.energy == pytest.approx(one.energy, rel=1e-3)


@pytest.mark.parametrize("options", [LM, LBFGS], ids=["lm", "lbfgs"])
def test_a_swing_up_from_far_away(swing_up, turning, options: SqpOptions) -> None:  # noqa: ANN001
    seen: list[float] = []
    found = octo.solve(
        swing_up(), start=turning, options=options, max_iterations=300,
        callback=lambda at: seen.append(float(at.at.energy[0])),
    )  # fmt: skip
    assert len(seen) == found.iterations > 10
    assert (np.diff(seen) <= 1e-9).all()  # the objective never rises
    assert found.violation < 1.0


@pytest.mark.parametrize("options", [LM, LBFGS], ids=["lm", "lbfgs"])
def test_stops(swing_up, turning, options: SqpOptions) -> None:  # noqa: ANN001
    def press(at: object) -> None:
        if getattr(at, "iteration") == 4:  # noqa: B009
            raise KeyboardInterrupt

    problem = swing_up()
    found = octo.solve(problem, start=turning, options=options, callback=press)
    assert found.status is Status.INTERRUPTED and np.isfinite(found.x).all()
    told = octo.solve(problem, start=turning, options=options, callback=lambda at: True)
    assert told.status is Status.INTERRUPTED and told.iterations == 1
    short = octo.solve(problem, start=turning, options=options, max_iterations=3)
    assert short.status is Status.ITERATION_LIMIT and short.iterations == 3
    late = octo.solve(problem, start=turning, options=options, time_limit=1e-9)
    assert late.status is Status.TIME_LIMIT and late.iterations <= 1


def test_several_starts(balance: Callable[..., octo.Problem]) -> None:
    for options in (LM, LBFGS):
        own = replace(options, max_iterations=20)
        together = octo.solve(balance(), options=own, seeds=2)
        alone = [octo.solve(balance(), options=own, seed=k) for k in range(2)]
        for record, one in zip(together.starts, alone, strict=True):
            assert (record["iterations"], record["energy"]) == (one.iterations, one.energy)


@pytest.mark.parametrize("options", [LM, LBFGS], ids=["lm", "lbfgs"])
def test_what_they_do_not_take(balance, options: SqpOptions) -> None:  # noqa: ANN001
    limits = [octo.TorqueLimits(limit=1.0)]
    with pytest.raises(ProblemError, match=f"TorqueLimits .*step='{options.step}'"):
        octo.solve(balance(constraints=limits), options=options)
    with pytest.raises(ProblemError, match="duration is free"):
        octo.solve(balance(duration=(1.0, 3.0)), options=options)
    backend = DeviceBackend.__new__(DeviceBackend)
    with pytest.raises(DeviceError, match="soft constraints"):
        backend.prepare(CompiledProblem([balance()]), options)


def test_bad_options() -> None:
    with pytest.raises(ValueRangeError, match="penalty"):
        SqpOptions(step="lbfgs", penalty=0.0)
    with pytest.raises(UnknownNameError, match="step"):
        SqpOptions(step="newton")  # type: ignore[arg-type]
