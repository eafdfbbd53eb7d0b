"""Corner blocks: a chain that closes on itself, folded in the middle, against dense algebra of the
cyclic matrix.

Node k of N is coupled with k, k − 1 and k − 2 counted around the circle, and so is constraint row
k.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.linalg import null_space

import octo
from octo import native
from octo.problem.basis import Folded
from octo.problem.compiled import CompiledProblem
from octo.solver import elimination
from octo.solver.blocks import KKTBlocks
from octo.solver.kkt import factorize
from octo.solver.normal import NormalFactor
from octo.starts import first_nodes
from tests.dense import kkt_matrix

COMPILER = native.compiler() is not None
METHODS = [("cyclic_reduction", 1), *([("elimination", 1), ("elimination", 2)] if COMPILER else [])]
SIZES = [(3, 1), (6, 4), (4, 0)]  # n, m of a node
STEPS = [4, 5, 6, 7, 14, 17]  # two threads share a problem from 8 units on, 13 steps


@dataclass
class Cyclic:
    """Dense H (batch, N n, N n), A (batch, N m, N n) of a closed chain, right-hand sides, and the
    chain folded."""

    H: np.ndarray
    A: np.ndarray
    b: np.ndarray  # (batch, N n)
    C: np.ndarray  # (batch, N m)
    folded: KKTBlocks
    variable: np.ndarray  # (N n,) where each variable is among the K·nc folded ones
    row: np.ndarray  # (N m,) where each row is among the K·ma folded ones

    @property
    def matrix(self) -> np.ndarray:
        """(batch, N(n + m), N(n + m))."""
        zero = np.zeros((len(self.A), self.A.shape[1], self.A.shape[1]))
        return np.block([[self.H, np.swapaxes(self.A, 1, 2)], [self.A, zero]])

    def excess(self) -> np.ndarray:
        """(batch,) eigenvalues below zero beyond one for each row."""
        return (np.linalg.eigvalsh(self.matrix) < 0.0).sum(axis=1) - self.A.shape[1]


def cyclic(seed: int, batch: int, N: int, n: int, m: int, lowered: float = 0.0) -> Cyclic:
    """H a sum of squares over three neighbouring nodes plus I, minus a random diagonal in [0,
    lowered)."""
    random = np.random.default_rng(seed)
    H, A = np.zeros((batch, N, n, N, n)), np.zeros((batch, N, m, N, n))
    for k in range(N):
        near = [(k - o) % N for o in range(3)]
        slopes = random.standard_normal((3, batch, n, n)) / np.sqrt(n)
        for a, one in zip(near, slopes, strict=True):
            A[:, k, :, a] = random.standard_normal((batch, m, n))
            for c, other in zip(near, slopes, strict=True):
                H[:, a, :, c] += np.swapaxes(one, 1, 2) @ other
    H, A = H.reshape(batch, N * n, N * n), A.reshape(batch, N * m, N * n)
    diagonal = np.arange(N * n)
    H[:, diagonal, diagonal] += 1.0 - lowered * random.random((batch, N * n))
    b, C = random.standard_normal((batch, N * n)), random.standard_normal((batch, N * m))
    return fold(H, A, b, C, N)


def fold(H: np.ndarray, A: np.ndarray, b: np.ndarray, C: np.ndarray, N: int) -> Cyclic:
    """By the tables of the stencil: node i + 1 is a part of a unit, residual i a part of a row
    block."""
    batch, n, m = len(H), H.shape[1] // N, A.shape[1] // N
    s = Folded().stencil(N)
    K, nc, ma = s.units, s.parts * n, s.parts * m
    variable = ((s.unit[2:] * nc + s.part[2:] * n) + np.arange(n)).ravel()
    row = ((s.test_row * ma + s.test_part * m) + np.arange(m)).ravel()
    wide, tall = np.zeros((batch, K * nc, K * nc)), np.zeros((batch, K * ma, K * nc))
    wide[:, variable[:, None], variable] = H
    tall[:, row[:, None], variable] = A
    idle = np.setdiff1d(
        np.arange(K * nc), variable
    )  # the dummy, and half of the pair at the fold where N is odd
    wide[:, idle, idle] = 1.0
    gradient, residual = np.zeros((batch, K * nc)), np.zeros((batch, K * ma))
    gradient[:, variable], residual[:, row] = b, C
    blocks = (
        lags(wide, K),
        lags(tall, K),
        gradient.reshape(batch, K, nc),
        residual.reshape(batch, K, ma),
    )
    return Cyclic(H, A, b, C, KKTBlocks(*blocks), variable, row)


def lags(dense: np.ndarray, K: int) -> np.ndarray:
    """(batch, K, 3, rows, columns) of a matrix that is symmetric or has nothing above its
    diagonal."""
    batch, rows, columns = len(dense), dense.shape[1] // K, dense.shape[2] // K
    blocks = np.zeros((batch, K, 3, rows, columns))
    for k in range(K):
        for j in range(K):
            block = dense[:, k * rows : (k + 1) * rows, j * columns : (j + 1) * columns]
            if 0 <= k - j <= 2:
                blocks[:, k, k - j] = block
            else:
                assert not block.any() or (rows == columns and -2 <= k - j < 0), (
                    "the fold does not close"
                )
    return blocks


def solved(system: Cyclic, method, threads: int) -> tuple[np.ndarray, object]:
    """(batch, N(n + m)) by the open chain's solver, and its factor."""
    blocks = system.folded
    factor = factorize(
        blocks.H, blocks.A, method=method, stop=False, threads=threads * blocks.batch
    )
    dv, lam = factor.solve(-blocks.b, -blocks.C, tolerance=1e-14)
    flat = (
        dv.reshape(blocks.batch, -1)[:, system.variable],
        lam.reshape(blocks.batch, -1)[:, system.row],
    )
    return np.concatenate(flat, axis=1), factor


@pytest.mark.parametrize("method,threads", METHODS)
@pytest.mark.parametrize("n,m", SIZES)
@pytest.mark.parametrize("lowered", [0.0, 4.0, 20.0])
def test_solution_and_inertia_are_those_of_the_cyclic_matrix(
    monkeypatch, method, threads, n, m, lowered
):
    """Three members, definite and indefinite; two threads a problem come from both ends of the
    folded chain."""
    monkeypatch.setattr(elimination, "SHARED_WORK", 0)
    wrong = 0
    for N in STEPS:
        system = cyclic(N, 3, N, n, m, lowered)
        found, factor = solved(system, method, threads)
        rhs = -np.concatenate([system.b, system.C], axis=1)
        expected = np.linalg.solve(system.matrix, rhs[..., None])[..., 0]
        scale = np.abs(expected).max(axis=1, keepdims=True)
        np.testing.assert_allclose(found / scale, expected / scale, rtol=0.0, atol=1e-10)
        np.testing.assert_array_equal(factor.negative, system.excess())
        np.testing.assert_array_equal(factor.inertia_ok, system.excess() == 0)
        wrong += int((factor.negative > 0).sum())
    assert (wrong > 0) == (lowered > 1.0)


@pytest.mark.skipif(not COMPILER, reason="no C compiler")
@pytest.mark.parametrize("N", [12, 17])
def test_stops_where_the_inertia_is_wrong_in_one_member_only(N):
    good, bad = cyclic(1, 1, N, 4, 1), cyclic(1, 1, N, 4, 1, lowered=20.0)
    both = fold(
        *(np.concatenate([getattr(s, name) for s in (good, bad)]) for name in ("H", "A", "b", "C")),
        N,
    )
    factor = factorize(both.folded.H, both.folded.A)
    np.testing.assert_array_equal(factor.inertia_ok, [True, False])
    assert factor.first_bad[0] == -1 and 0 <= factor.first_bad[1] < both.folded.units
    dv, _ = factor.solve(-both.folded.b, -both.folded.C)
    alone, _ = solved(good, "elimination", 1)
    np.testing.assert_allclose(dv[0].ravel()[both.variable], alone[0, : N * 4], atol=1e-9)


@pytest.mark.parametrize("compiled", [False, True] if COMPILER else [False])
@pytest.mark.parametrize("n,m", SIZES)
def test_normal_step_and_multipliers(compiled, n, m):
    """The empty rows at the fold are dropped, and no others; what is left is the pseudo-inverse of
    the cyclic A."""
    for N in STEPS:
        system = cyclic(N, 2, N, n, m)
        blocks, inverse = system.folded, np.linalg.pinv(system.A)
        factor = NormalFactor(blocks.A, compiled=compiled)
        step = factor.least_norm(-blocks.C).reshape(2, -1)[:, system.variable]
        np.testing.assert_allclose(step, -(inverse @ system.C[..., None])[..., 0], atol=1e-9)
        lam = factor.multipliers(blocks.b).reshape(2, -1)[:, system.row]
        np.testing.assert_allclose(
            lam, -(np.swapaxes(inverse, 1, 2) @ system.b[..., None])[..., 0], atol=1e-9
        )
        np.testing.assert_array_equal(factor.dropped, blocks.units * blocks.ma - N * m)


@pytest.fixture(scope="module")
def mammal() -> octo.Character:
    return octo.gallery.mammal()


def unfolded(problem: CompiledProblem, blocks: KKTBlocks) -> Cyclic:
    """The dense cyclic matrix of a robot's cycle, without the dummies of the folded one."""
    s, dense = problem.stencil, kkt_matrix(blocks)
    variable = ((s.unit[2:] * blocks.nc + s.part[2:] * problem.n) + np.arange(problem.n)).ravel()
    row = ((s.test_row * blocks.ma + s.test_part * problem.m) + np.arange(problem.m)).ravel()
    tall = blocks.units * blocks.nc + row
    H, A = dense[:, variable[:, None], variable], dense[:, tall[:, None], variable]
    b = blocks.b.reshape(blocks.batch, -1)[:, variable]
    C = blocks.C.reshape(blocks.batch, -1)[:, row]
    return Cyclic(H, A, b, C, blocks, variable, row)


@pytest.mark.parametrize("steps", [12, 13])
def test_the_cycle_of_a_robot(mammal, steps):
    """Mirrored, feet in the ground, exact curvature: definite where it is damped, indefinite where
    it is not."""
    described = octo.Problem(
        mammal, steps=steps, costs=octo.costs.natural(), cycle=octo.Cycle(speed=0.5, period=0.6)
    )
    problem = CompiledProblem([described, described.replace(parameters={"gravity_z": -12.0})])
    nodes = np.stack([first_nodes(each, seed, None) for seed, each in enumerate(problem.problems)])
    at = problem.evaluate(problem.unknowns(nodes))
    lam = 0.1 * np.random.default_rng(0).standard_normal((2, problem.K, problem.ma))
    model = problem.linearize(at, lam)
    blocks = KKTBlocks(model.H, model.A, model.b, model.C)
    plain = unfolded(problem, blocks)
    assert np.linalg.matrix_rank(plain.A[0]) == steps * problem.m
    for sigma in (0.0, 1e4):
        damped = KKTBlocks(blocks.H.copy(), blocks.A, blocks.b, blocks.C)
        own = np.arange(blocks.nc)
        damped.H[:, :, 0, own, own] += sigma
        system = unfolded(problem, damped)
        free = [null_space(A) for A in system.A]
        reduced = [np.linalg.eigvalsh(Z.T @ H @ Z) for H, Z in zip(system.H, free, strict=True)]
        expected = np.array([(values < 0.0).sum() for values in reduced])
        assert (expected == 0).all() == (sigma > 0.0)
        for method, threads in METHODS:
            found, factor = solved(system, method, threads)
            np.testing.assert_array_equal(factor.negative, expected)
            rhs = -np.concatenate([system.b, system.C], axis=1)[..., None]
            left = system.matrix @ found[..., None] - rhs
            assert np.abs(left).max() < 1e-8 * np.abs(rhs).max()


def test_the_rule_of_the_paper_runs_on_a_cycle(mammal):
    """Normal step, Gauss-Newton and trust region: feasible and cheaper than where it began."""
    problem = octo.Problem(
        mammal, steps=12, costs=octo.costs.natural(), cycle=octo.Cycle(speed=0.5, period=0.6)
    )
    options = octo.SqpOptions.paper(max_iterations=120)
    found = octo.solve(problem, options=options, passes=1, device="cpu")
    assert (
        found.violation < options.c_max
        and found.history["energy"][-1] < 0.5 * found.history["energy"][0]
    )
    np.testing.assert_allclose(found.cycle.on(found.x[:2]), found.x[-2:], atol=1e-12)
