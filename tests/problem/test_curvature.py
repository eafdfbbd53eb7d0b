"""Exact second derivatives of terms over the state: against CasADi's of the whole problem, against
differences of the gradient, and of one term alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import casadi as ca
import numpy as np
import pytest
from curved import DT, NAMES, STEPS, described
from walker import START, walker, wiggle_near_ground

import octo
from octo import native
from octo.errors import OctoError, ProblemError
from octo.problem.codegen import cost_text
from octo.problem.compiled import CompiledProblem
from octo.problem.curvature import NAME
from octo.reference.program import free_places, nlp, point_of, rows_of

needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")


@pytest.fixture(params=NAMES)
def problem(request: pytest.FixtureRequest, every_cost: Callable) -> octo.Problem:
    return described(request.param, every_cost(STEPS))


@lru_cache
def exact(problem: octo.Problem) -> CompiledProblem:
    return CompiledProblem([problem], exact=True)


def multipliers(compiled: CompiledProblem) -> np.ndarray:
    return np.random.default_rng(5).standard_normal((compiled.batch, compiled.K, compiled.ma))


def dense(compiled: CompiledProblem, H: np.ndarray) -> np.ndarray:
    """∂²/∂x², of the free unknowns, of blocks H (1, K, 3, nc, nc)."""
    whole = np.zeros((compiled.K, compiled.nc, compiled.K, compiled.nc))
    for k in range(compiled.K):
        for lag in range(min(k, 2) + 1):
            whole[k, :, k - lag], whole[k - lag, :, k] = H[0, k, lag], H[0, k, lag].T
    at = free_places(compiled)
    return whole.reshape(compiled.K * compiled.nc, -1)[np.ix_(at, at)]


def close(found: np.ndarray, wanted: np.ndarray, relative: float, scale: float) -> None:
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=relative * scale)


def test_hessian_of_the_whole_problem(problem: octo.Problem) -> None:
    """E + lamᵀC, to 1e-9 of what is added to Gauss and Newton's model."""
    compiled, made = exact(problem).interpreted(), nlp(problem)
    unknowns, lam = wiggle_near_ground(compiled), multipliers(compiled)
    at = compiled.evaluate(unknowns)
    H = dense(compiled, compiled.linearize(at, lam).H)
    plain = dense(compiled, compiled.linearize(at, lam, np.zeros(1, dtype=bool)).H)
    given = point_of(compiled, unknowns), made.parameters, 1.0, rows_of(compiled, lam[0])
    wanted = made.hessian(*given).full()
    added = np.abs(wanted - plain).max()
    assert added > 1e-3
    close(H, wanted, 1e-9, added)


@needs_compiler
def test_native_equals_interpreted(problem: octo.Problem) -> None:
    compiled = exact(problem)
    plain, unknowns = compiled.interpreted(), wiggle_near_ground(compiled)
    for lam in (None, multipliers(compiled)):
        one, other = (each.linearize(each.evaluate(unknowns), lam) for each in (compiled, plain))
        for field in ("H", "A", "b", "C"):
            found, wanted = getattr(one, field), getattr(other, field)
            close(found, wanted, 1e-11, np.abs(wanted).max(initial=1e-300))


def test_remainder_of_the_gradient(
    problem: octo.Problem, remainder_slope: Callable[..., float]
) -> None:
    """Falls with the square of the step, of E alone."""
    compiled = exact(problem)
    unknowns = wiggle_near_ground(compiled)
    d, free = np.zeros(compiled.K * compiled.nc), free_places(compiled)
    d[free] = np.random.default_rng(2).standard_normal(len(free))
    d /= np.linalg.norm(d)
    lam = np.zeros((1, compiled.K, compiled.ma))
    H = dense(compiled, compiled.linearize(compiled.evaluate(unknowns), lam).H)

    def gradient(h: float) -> np.ndarray:
        at = compiled.evaluate(unknowns + h * d.reshape(unknowns.shape))
        return point_of(compiled, compiled.linearize(at, None).b)

    assert remainder_slope(gradient, H @ d[free].ravel(), np.geomspace(3e-4, 1e-5, 4)) > 1.8


def test_members_of_a_batch(every_cost: Callable) -> None:
    """Of each member, with lam, as if it were alone."""
    one = described("hermite", every_cost(STEPS))
    pair = CompiledProblem([one, one.replace(x0=START + 0.01)], like=exact(one))
    at, lam = pair.evaluate(wiggle_near_ground(pair)), multipliers(pair)
    whole, none = (pair.linearize(at, lam, np.full(2, value)).H for value in (True, False))
    some = pair.linearize(at, lam, np.array([False, True])).H
    np.testing.assert_array_equal(some[0], none[0])
    np.testing.assert_array_equal(some[1], whole[1])
    assert np.abs(whole - none).max(axis=(1, 2, 3, 4)).min() > 1e-3


@pytest.mark.parametrize("place", [0, 1])
def test_one_exact_term(place: int) -> None:
    """What it adds is what it adds where all are exact and the others have no weight."""
    terms = [octo.Upright(body="shank"), octo.CenterOfMassVelocity((0.4, 0.0, 0.1))]
    plain = octo.Problem(walker(), steps=STEPS, dt=DT, costs=terms, x0=START)
    one = plain.replace(
        costs=[replace(t, curvature="exact") if k == place else t for k, t in enumerate(terms)]
    )
    alone = plain.replace(
        costs=[t if k == place else replace(t, weight=0.0) for k, t in enumerate(terms)]
    )
    added = []
    for compiled in (CompiledProblem([one]), CompiledProblem([alone], exact=True)):
        at = compiled.evaluate(wiggle_near_ground(compiled))
        lam = np.zeros((1, compiled.K, compiled.ma))
        ways = [compiled.linearize(at, lam, np.array([value])).H for value in (True, False)]
        added.append(ways[0] - ways[1])
    assert np.abs(added[1]).max() > 1e-4
    close(added[0], added[1], 1e-11, np.abs(added[1]).max())


def test_a_step_without_weight_may_have_no_finite_residual() -> None:
    root = octo.CustomCost(
        lambda step, p: ca.sqrt(p["room"] - step.x_next[6]) * step.com[0],
        {"room": np.repeat([2.0, -2.0], STEPS // 2)[:, None]},
        weight=np.repeat([1.0, 0.0], STEPS // 2),
    )
    problem = octo.Problem(walker(), steps=STEPS, dt=DT, costs=[root], x0=START)
    compiled = CompiledProblem([problem], exact=True)
    for each in (compiled, compiled.interpreted()):
        model = each.linearize(each.evaluate(wiggle_near_ground(each)), multipliers(each))
        assert np.isfinite(model.H).all()


class Bounded(octo.CustomCost):
    kind = "bounded"


def test_a_bounded_term_behind_another_one() -> None:
    """With 2c and 2cr for its rows it is a square, whatever stands before it."""
    made = []
    for kind in (octo.CustomCost, Bounded):
        terms = [
            kind(lambda step, p: step.x_next[:3] ** 2, name="plain"),
            octo.Effort(),
            kind(lambda step, p: step.com * step.u[0], name="bent", curvature="exact"),
        ]
        problem = octo.Problem(walker(), steps=STEPS, dt=DT, costs=terms, x0=START)
        compiled = CompiledProblem([problem])
        at = compiled.evaluate(wiggle_near_ground(compiled))
        if kind is Bounded:
            weights = np.full(at.rows.shape, 2.0 / STEPS)
            compiled.set_row_weights(weights, weights * at.rows)
        lam = np.zeros((1, compiled.K, compiled.ma))
        ways = [compiled.linearize(at, lam, np.array([value])).H for value in (True, False)]
        made.append(ways[0] - ways[1])
    assert np.abs(made[0]).max() > 1e-4
    close(made[1], made[0], 1e-11, np.abs(made[0]).max())


def test_problems_without_exact_terms_have_no_text_for_them() -> None:
    terms: list[octo.Cost] = [octo.Posture(), octo.Upright()]
    plain = octo.Problem(walker(), steps=STEPS, dt=DT, costs=terms, x0=START)
    texts = [
        cost_text(CompiledProblem([plain], exact=exact).functions, plain.dynamics)
        for exact in (False, True)
    ]
    assert [f"void {NAME}(" in text for text in texts] == [False, True]
    assert ["#define NS" in text for text in texts] == [False, True]
    straight = plain.replace(costs=[octo.Posture(curvature="exact")])
    assert CompiledProblem([straight]).functions.curvature is None  # it has none


def test_curvature_is_structure() -> None:
    plain = octo.Problem(walker(), steps=STEPS, dt=DT, costs=[octo.Upright()], x0=START)
    curved = plain.replace(costs=[octo.Upright(curvature="exact")])
    with pytest.raises(ProblemError, match=r"Upright\.curvature \('exact'\) of problem 1"):
        CompiledProblem([plain, curved])
    with pytest.raises(
        OctoError, match=r"Upright\.curvature 'full' is not known; valid: exact, gauss"
    ):
        octo.Upright(curvature="full")  # type: ignore[arg-type]


def test_terms_that_get_their_length_keep_what_they_were_given() -> None:
    given = {"curvature": "exact", "loss": octo.Huber(0.1)}
    terms = [replace(term, **given) for term in octo.costs.natural()]
    plain = octo.Problem(octo.gallery.mammal(), steps=STEPS, dt=DT, costs=terms)
    assert {(term.curvature, term.loss) for term in plain.costs} == {tuple(given.values())}


def test_a_solve_finds_the_same_motion_in_fewer_iterations() -> None:
    found = {}
    for curvature in ("gauss_newton", "exact"):
        terms = [
            octo.CenterOfMassVelocity((0.4, 0.0, 0.0)),
            octo.Effort(),
            octo.JointVelocity(loss=octo.Huber(0.5), weight=0.1, curvature=curvature),
        ]
        problem = octo.Problem(octo.gallery.mammal(), steps=30, dt=0.03, costs=terms)
        found[curvature] = octo.solve(problem, passes=1, device="cpu")
    plain, exact = found["gauss_newton"], found["exact"]
    assert plain.status.converged and exact.status.converged
    assert exact.energy == pytest.approx(plain.energy, rel=1e-3)
    assert exact.iterations < plain.iterations
