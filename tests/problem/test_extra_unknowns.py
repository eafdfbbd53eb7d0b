"""Unknowns and rows of a unit beside those of its nodes: E, H, A, b, C are those without them in
wider arrays, and what ties them is solved as dense algebra solves it."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import casadi as ca
import numpy as np
import pytest
from walker import START, walker

import octo
from octo import native
from octo.problem.compiled import CompiledProblem, Model
from octo.solver.blocks import KKTBlocks
from octo.solver.kkt import factorize
from tests.dense import kkt_matrix

EXTRA, ROWS = 2, 1
KINDS = ["nodes", "nodes to a fixed end", "hermite", "hermite to a fixed end", "cycle"]
COMPILER = native.compiler() is not None
METHODS = ["cyclic_reduction", *(["elimination"] if COMPILER else [])]


def _swing(x_next, x, x_prev, p):
    """Two masses on a line with a spring that stiffens; a motor pushes the first one."""
    acceleration = (x_next - 2.0 * x + x_prev) / p["dt"] ** 2
    spring = p["k"] * (x_next[1] - x_next[0]) ** 3
    return ca.vertcat(acceleration[0] - spring, 0.5 * acceleration[1] + spring)


@lru_cache
def compiled(kind: str, threads: int = 1) -> CompiledProblem:
    """Two problems of a kind, whose terms have all of their curvature."""
    if kind == "cycle":
        first = octo.Problem(
            walker(),
            cycle=octo.Cycle(speed=0.4, period=0.35, mirror=False),
            steps=7,
            costs=[octo.Effort(), octo.costs.Posture(reference=START)],
        )
        return CompiledProblem([first, first.replace(costs=first.costs)], threads, exact=True)
    basis, _, fixed = kind.partition(" to a fixed end")
    rate = octo.costs.NeighbourCost(lambda c, following, p: following[2:] - c[2:], name="rate")
    near = octo.CustomCost(lambda step, p: step.x_next - 0.3, name="near")
    first = octo.Problem(
        octo.CustomDynamics(_swing, nx=2, actuated=[0], parameters={"k": 3.0}),
        steps=40,
        dt=0.05,
        x0=np.array([0.0, 0.4]),
        x_end=np.array([0.1, 0.2]) if " to a " in kind else None,
        costs=[near, octo.Effort(weight=1e-2), *([rate] if basis == "hermite" else [])],
        basis=octo.Hermite(4) if basis == "hermite" else "nodes",
    )
    return CompiledProblem([first, first.replace(x0=np.array([0.1, 0.0]))], threads, exact=True)


def widened(problem: CompiledProblem) -> CompiledProblem:
    """The same with extra unknowns and rows."""
    return problem.with_data(replace(problem.plan, extra=EXTRA, extra_rows=ROWS), problem.data)


def somewhere(problem: CompiledProblem, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Unknowns (batch, K, nc) off the start, and multipliers (batch, K, ma)."""
    random = np.random.default_rng(seed)
    nodes = np.repeat(problem.start[:, None], problem.steps + 2, axis=1)
    unknowns = problem.unknowns(nodes + 0.05 * random.standard_normal(nodes.shape))
    unknowns[..., problem.plan.nodal :] = random.standard_normal(
        (*unknowns.shape[:2], problem.plan.extra)
    )
    return unknowns, random.standard_normal((problem.batch, problem.K, problem.ma))


def tie(problem: CompiledProblem, model: Model, unknowns: np.ndarray) -> KKTBlocks:
    """Adds ½‖e_k‖² to E and the rows (1, 1)·e_k + (0, 2)·e_{k−1} + Σ v_k = 0.3, v_k the unit's
    other unknowns, as terms over extra unknowns do it."""
    plan, own = problem.plan, problem.plan.nodal
    H, A, b, C = (array.copy() for array in (model.H, model.A, model.b, model.C))
    v, e = unknowns[..., :own].copy(), unknowns[..., own:]
    v[:, plan.fixed] = 0.0
    H[:, :, 0, own:, own:] += np.eye(EXTRA)
    b[..., own:] += e
    A[:, :, 0, -1] = 1.0
    A[:, plan.fixed, 0, -1, :own] = 0.0
    A[:, 1:, 1, -1, own + 1] = 2.0
    C[..., -1] = e.sum(axis=2) + v.sum(axis=2) - 0.3
    C[:, 1:, -1] += 2.0 * e[:, :-1, 1]
    return KKTBlocks(H, A, b, C)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("how", ["interpreted", *(["native", "two threads"] if COMPILER else [])])
def test_all_numbers_are_those_without_them(kind, how):
    """With other strides; what nothing moves is the identity, and extra blocks are zero."""
    plain = compiled(kind, 2 if how == "two threads" else 1)
    if how == "interpreted":
        plain = plain.interpreted()
    wide = widened(plain)
    n, m = plain.nc, plain.ma
    assert (wide.nc, wide.ma) == (n + EXTRA, m + ROWS)
    unknowns, lam = somewhere(wide)
    own, own_lam = (np.ascontiguousarray(a[..., :k]) for a, k in ((unknowns, n), (lam, m)))
    at, expected = wide.evaluate(unknowns), plain.evaluate(own)
    for name in ("nodes", "fd", "terms", "energy"):
        np.testing.assert_array_equal(getattr(at, name), getattr(expected, name))
    np.testing.assert_array_equal(at.C[..., :m], expected.C)
    np.testing.assert_array_equal(at.C[..., m:], 0.0)
    np.testing.assert_allclose(wide.reduce(at.fd), at.C, atol=1e-12)
    for multipliers, others in ((None, None), (lam, own_lam)):
        model, narrow = wide.linearize(at, multipliers), plain.linearize(expected, others)
        H = np.zeros_like(model.H)
        H[..., :n, :n] = narrow.H
        if kind.startswith(("hermite", "cycle")):
            H[:, -1, 0, n:, n:] = np.eye(EXTRA)
        A, b, C = (np.zeros_like(a) for a in (model.A, model.b, model.C))
        A[..., :m, :n], b[..., :n], C[..., :m] = narrow.A, narrow.b, narrow.C
        for found, wanted in zip((model.H, model.A, model.b, model.C), (H, A, b, C), strict=True):
            scale = np.abs(wanted).max(initial=1.0)
            np.testing.assert_allclose(found / scale, wanted / scale, rtol=0.0, atol=1e-14)


def solved(matrix: np.ndarray, rhs: np.ndarray) -> np.ndarray:
    """By dense algebra, after equilibration; 0 where the matrix has a row of zeros."""
    live = np.flatnonzero(matrix.any(axis=1))
    part, scale = matrix[np.ix_(live, live)], np.ones(len(live))
    for _ in range(5):
        scale /= np.sqrt(np.abs(part * scale[:, None] * scale).max(axis=1))
    x = np.zeros(len(rhs))
    x[live] = scale * np.linalg.solve(part * scale[:, None] * scale, scale * rhs[live])
    return x


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("method", METHODS)
def test_the_linear_solvers_against_dense_algebra(kind, method):
    """Inertia by eigenvalues, with weights that are too small and large enough; after a full step
    the rows that tie extra unknowns hold, whatever they were."""
    problem = widened(compiled(kind))
    unknowns, lam = somewhere(problem)
    model = problem.linearize(problem.evaluate(unknowns), 3.0 * lam)
    system = tie(problem, model, unknowns)
    counts = []
    for weight in (1e-6, 1e4):
        sigma = np.full((problem.batch, problem.K), weight)
        factor = factorize(system.H, system.A, sigma, method=method, stop=False)
        dense = kkt_matrix(system, sigma)
        # a row of zeros (a cycle has some) counts as one
        excess = (np.linalg.eigvalsh(dense) < 1e-9).sum(axis=1) - problem.K * problem.ma
        np.testing.assert_array_equal(factor.negative, excess)
        counts.append(excess)
        dv, lam = factor.solve(-system.b, -system.C, tolerance=1e-14)
        for k in range(problem.batch):
            expected = solved(dense[k], -np.concatenate([system.b[k].ravel(), system.C[k].ravel()]))
            found = np.concatenate([dv[k].ravel(), lam[k].ravel()])
            found[~dense[k].any(axis=1)] = 0.0
            np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-7 * np.abs(found).max())
        after = tie(problem, model, unknowns + dv)
        np.testing.assert_allclose(after.C[..., -1], 0.0, atol=1e-8)
    assert (counts[0] > 0).any() and (counts[1] == 0).all()
