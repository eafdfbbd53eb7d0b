"""The pieces of the costs put together: the values and derivatives that they are cut from, by
CasADi's own machine."""

from __future__ import annotations

import bisect

import casadi as ca
import numpy as np
import pytest

import octo
from octo.gpu import pieces
from octo.gpu.pieces import Pieces
from octo.gpu.program import contact_numbers
from octo.problem.compiled import CompiledProblem


def values_of(cut, inputs, sizes):
    out = [np.full(size, np.nan) for size in sizes]
    for k, (function, at) in enumerate(zip(cut.functions, cut.at, strict=True)):
        value = function(*inputs).full().ravel()
        out[bisect.bisect(cut.ends, k)][at : at + len(value)] = value
    return out


@pytest.mark.parametrize("live", [3, pieces.LIVE])
def test_all_entries_are_written_and_right(compiled, monkeypatch, live):
    monkeypatch.setattr(pieces, "LIVE", live)
    functions = compiled("nodes").functions
    cut = Pieces.of(functions)
    random = np.random.default_rng(0)
    given = [random.standard_normal(functions.state.numel_in(k)) for k in range(6)]
    sines = [
        f(given[k][element] + more) for k, element, more in cut.angles for f in (np.sin, np.cos)
    ]
    r, jac = values_of(cut.state, [*given, sines], (functions.state.numel_out(0), len(cut.rows)))
    dense = np.zeros(functions.state_sparsity.shape)
    dense[cut.rows, cut.columns] = jac
    wanted, nonzeros = functions.state_jac(*given)
    np.testing.assert_allclose(r, wanted.full().ravel(), atol=1e-12)
    expected = ca.DM(functions.state_sparsity, nonzeros).full()
    np.testing.assert_allclose(dense, expected, atol=1e-12 * np.abs(expected).max())
    columns = np.diff(cut.columns >= 3 * compiled("nodes").n)
    assert columns.sum() == 1, "derivatives with respect to the torques come last"
    own = functions.contact
    given = [random.standard_normal(own.exact.numel_in(k)) for k in range(7)]
    sizes = (own.value.numel_out(0), *[contact_numbers(functions)] * 3)
    value, slopes, model, exact = values_of(cut.contact, given, sizes)
    size, factors = own.factors.size, own.factors
    parts = (ca.vec(ca.densify(factors.slopes).T), factors.bend, factors.model, factors.exact)
    expected = [
        f.full().ravel() for f in ca.Function("factors", factors.inputs, list(parts))(*given)
    ]
    square = 18 * size + 216
    found = (value, slopes[: 18 * size], exact[18 * size : square], model[square:], exact[square:])
    for one, other in zip(found, (own.value(*given[:6]).full().ravel(), *expected), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12 * max(1.0, np.abs(other).max()))
    assert (len(cut.functions) > 40) == (live == 3)


def test_sines_and_cosines_stand_once():
    """A coordinate plus a number, one of q and a product: the product alone is left in the
    pieces."""

    def residual(step, p):
        return ca.vertcat(
            ca.sin(step.x[6] - 0.3) * ca.cos(step.x_next[7]),
            ca.sin(p["angle"] + 0.1),
            ca.cos(2.0 * step.x_prev[8]),
        )

    robot = octo.gallery.chain()
    terms = [octo.costs.CustomCost(residual, {"angle": 0.4}), octo.costs.Effort()]
    functions = CompiledProblem([octo.Problem(robot, steps=4, dt=0.05, costs=terms)]).functions
    cut = Pieces.of(functions)
    place = functions.references.places[0]["angle"].start
    assert set(cut.angles) == {(1, 6, -0.3), (0, 7, 0.0), (5, place, 0.1)}
    left = [f.instruction_id(k) for f in cut.state.functions for k in range(f.n_instructions())]
    assert left.count(ca.OP_COS) == 1 and left.count(ca.OP_SIN) == 1  # the value and its derivative
