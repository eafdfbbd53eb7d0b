"""Rows that are no squares of E: a solver gives each a weight D and a shift d at every iterate."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
import pytest
from walker import START, walker, wiggle_near_ground

import octo
from octo import native
from octo.errors import ProblemError, ShapeError, UnknownNameError, ValueRangeError
from octo.gpu.problem import DeviceProblem
from octo.problem.basis import Hermite
from octo.problem.compiled import CompiledProblem
from octo.reference import nlp
from octo.solver.blocks import KKTBlocks
from tests import emulator
from tests.emulator import EmulatedDevice

STEPS, DT = 12, 0.05
FIELDS = ("H", "A", "b", "C")
pytestmark = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")


def _residual(step, p):
    """Over configurations and torques, of two numbers."""
    return ca.vertcat(0.1 * step.u[0] + step.x_next[4] * step.x[6], p["gain"] * step.u[1] ** 2)


class Bounded(octo.CustomCost):
    kind = "bounded"


def problem(own: type[octo.CustomCost], weight: Any, basis: Any) -> octo.Problem:
    """With terms on both sides of the one that is looked at, which is bounded or a square."""
    term = own(_residual, {"gain": 0.02}, weight=weight, name="own")
    costs = [octo.Posture(weight=0.1), term, octo.Effort(), octo.Slip(length=0.03)]
    return octo.Problem(walker(), steps=STEPS, dt=DT, costs=costs, x0=START, basis=basis)


@pytest.fixture(params=["nodes", Hermite(3)], ids=["nodes", "hermite"])
def pair(request: pytest.FixtureRequest) -> tuple[CompiledProblem, CompiledProblem, np.ndarray]:
    """A batch of two with the square, the same with bounded rows, and the square's coefficient."""
    weights = np.stack([np.linspace(0.0, 2.0, STEPS), np.full(STEPS, 0.7)])
    square = CompiledProblem([problem(octo.CustomCost, w, request.param) for w in weights])
    bounded = CompiledProblem([problem(Bounded, w, request.param) for w in weights])
    return square, bounded, weights / STEPS


def close(found: Any, expected: Any, relative: float = 1e-12) -> None:
    scale = max(1e-12, np.abs(expected).max(initial=0.0))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=relative * scale)


def on_device(compiled: CompiledProblem) -> Any:
    if emulator.compiler() is None:
        pytest.skip("no C++ compiler")
    return DeviceProblem(compiled, EmulatedDevice(32, 1))


BACKENDS: dict[str, Callable[[CompiledProblem], Any]] = {
    "C": lambda compiled: compiled,
    "interpreted": CompiledProblem.interpreted,
    "CUDA": on_device,
}


@pytest.mark.parametrize("exact", [False, True], ids=["gauss_newton", "exact"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_with_two_c_and_two_c_r_it_is_a_square(pair, backend, exact):
    """E has the square no more; the model is that of E with it, curvature of FD included."""
    square, bounded, coefficient = pair
    if exact:
        square, bounded = (CompiledProblem(each.problems, exact=True) for each in (square, bounded))
    unknowns = wiggle_near_ground(square)
    lam = np.random.default_rng(1).standard_normal((2, square.K, square.ma))
    expected, own = square.evaluate(unknowns), BACKENDS[backend](bounded)
    found = own.evaluate(unknowns)
    rows = np.asarray(found.rows)
    assert rows.shape == (2, STEPS, 2)
    close(coefficient * (rows**2).sum(axis=2), expected.terms[:, :, 1])
    close(found.terms[:, :, [0, 2, 3]], expected.terms[:, :, [0, 2, 3]])
    assert not np.asarray(found.terms)[:, :, 1].any()
    weights = np.repeat(2.0 * coefficient[:, :, None], 2, axis=2)
    own.set_row_weights(weights, weights * rows)
    for multipliers in (None, lam):
        model, made = square.linearize(expected, multipliers), own.linearize(found, multipliers)
        for field in FIELDS:
            close(np.asarray(getattr(made, field)), getattr(model, field), 1e-11)


@pytest.mark.parametrize("backend", BACKENDS)
def test_without_a_weight_it_is_not_there(pair, backend):
    """From the start, where nobody gave one, and with a weight of zero."""
    _, bounded, _ = pair
    without = CompiledProblem(
        [p.replace(costs=[c for c in p.costs if c.name != "own"]) for p in bounded.problems]
    )
    unknowns = wiggle_near_ground(without)
    own = BACKENDS[backend](bounded)
    at, lam = own.evaluate(unknowns), np.ones((2, bounded.K, bounded.ma))
    expected = without.linearize(without.evaluate(unknowns), lam)
    close(np.asarray(at.energy), without.evaluate(unknowns).energy)
    for shift in (None, 1.0):
        if shift is not None:
            own.set_row_weights(np.zeros((2, STEPS, 2)), np.full((2, STEPS, 2), shift))
        made = own.linearize(at, lam)
        for field in FIELDS:
            close(np.asarray(getattr(made, field)), getattr(expected, field), 1e-11)


def test_shifts_are_a_slope_of_their_own(pair):
    """b is the gradient of E + Σ d r where d stays as it is."""
    _, bounded, _ = pair
    unknowns, rng = wiggle_near_ground(bounded), np.random.default_rng(4)
    shifts, direction = rng.standard_normal((2, STEPS, 2)), rng.standard_normal(unknowns.shape)
    direction[:, bounded.fixed] = 0.0
    bounded.set_row_weights(np.ones((2, STEPS, 2)), shifts)

    def value(h: float) -> float:
        at = bounded.evaluate(unknowns + h * direction)
        return float(at.energy.sum() + (shifts * at.rows).sum())

    slope = (bounded.linearize(bounded.evaluate(unknowns), None).b * direction).sum()
    left = [abs(value(h) - value(0.0) - h * slope) for h in (1e-3, 1e-4)]
    assert np.log10(left[0] / left[1]) > 1.85


@pytest.mark.parametrize("exact", [False, True], ids=["gauss_newton", "exact"])
@pytest.mark.parametrize("backend", BACKENDS)
def test_multipliers_bend_and_do_not_pull(pair, backend, exact):
    """b has d alone. H has the second derivatives of Σ y r whatever d is: all of them where terms
    are exact, else those of FD, which are all that a row linear in the torques has."""
    _, bounded, _ = pair
    if exact:
        bounded = CompiledProblem(bounded.problems, exact=True)
    unknowns, rng = wiggle_near_ground(bounded), np.random.default_rng(5)
    own, shape = BACKENDS[backend](bounded), (2, STEPS, 2)
    y, direction = rng.standard_normal(shape), rng.standard_normal(unknowns.shape)
    ones, d, lam = np.ones(shape), rng.standard_normal(shape), np.zeros((2, bounded.K, bounded.ma))
    direction[:, bounded.fixed] = 0.0

    def model(at: np.ndarray, shifts: Any, multipliers: Any) -> tuple[np.ndarray, np.ndarray]:
        own.set_row_weights(ones, shifts, multipliers)
        made = own.linearize(own.evaluate(at), lam)
        return np.asarray(made.H), np.asarray(made.b)

    plain, slope = model(unknowns, d, 0.0 * d)
    bent, same = model(unknowns, d, y)
    close(same, slope)
    assert np.abs(bent - plain).max() > 1e-3
    for found, wanted in zip(model(unknowns, d, None), model(unknowns, d, d), strict=True):
        np.testing.assert_array_equal(found, wanted)
    if not exact:  # of a square of a torque FD's curvature is a part
        return
    system = KKTBlocks(bent - plain, np.zeros((2, bounded.K, 3, 0, bounded.nc)), slope, lam)
    product = system.hessian_times(direction)

    def pulled(h: float) -> np.ndarray:
        at = unknowns + h * direction
        return model(at, y, y)[1] - model(at, 0.0 * y, y)[1]

    h = 1e-5
    change = (pulled(h) - pulled(-h)) / (2.0 * h)
    close(np.delete(product, bounded.fixed, axis=1), np.delete(change, bounded.fixed, axis=1), 1e-6)


def test_references_change_and_the_weights_stay(pair):
    _, bounded, _ = pair
    at = bounded.evaluate(wiggle_near_ground(bounded))
    bounded.set_row_weights(np.full((2, STEPS, 2), 3.0), at.rows)
    before = bounded.linearize(at, None)
    bounded.refresh()
    np.testing.assert_array_equal(bounded.linearize(at, None).H, before.H)
    one = bounded.take(np.array([1]))
    np.testing.assert_array_equal(one.linearize(at.take([1]), None).b, before.b[1:])


def test_what_is_refused(pair):
    _, bounded, _ = pair
    good = np.ones((2, STEPS, 2))
    with pytest.raises(ShapeError, match="weights"):
        bounded.set_row_weights(good[:, 1:], good)
    with pytest.raises(ValueRangeError, match="negative"):
        bounded.set_row_weights(-good, good)
    for place, name in enumerate(("weights", "shifts", "multipliers")):
        given = [np.nan * good if place == k else good for k in range(3)]
        with pytest.raises(ValueRangeError, match=f"{name} is not finite at index 0, 0"):
            bounded.set_row_weights(*given)
    described = problem(Bounded, 1.0, "nodes")
    once = partial(octo.solve, passes=1)
    for solve in (octo.solve, once, nlp, partial(octo.mpc.animate, seconds=1.0)):
        with pytest.raises(ProblemError, match="own is a bounded term"):
            solve(described)


def test_kinds_that_a_term_cannot_have():
    """They would be squares of E that nobody asked for."""

    class Neighbours(octo.NeighbourCost):
        kind = "bounded"

    class Sliding(octo.Slip):
        kind = "bounded"

    class Misspelt(octo.Effort):
        kind = "bounded "

    over_controls = Neighbours(lambda c, following, p: following - c)
    for term, basis, why in (
        (over_controls, Hermite(3), "Neighbours is over Hermite controls"),
        (Sliding(), "nodes", "Sliding is over contacts"),
    ):
        described = octo.Problem(
            walker(), steps=STEPS, dt=DT, costs=[octo.Effort(), term], x0=START, basis=basis
        )
        with pytest.raises(ProblemError, match=f"{why}: its kind is 'bounded', must be 'square'"):
            CompiledProblem([described])
    with pytest.raises(UnknownNameError, match=r"Misspelt\.kind 'bounded '"):
        Misspelt()
