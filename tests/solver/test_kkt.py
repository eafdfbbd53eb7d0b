"""Cyclic reduction and window elimination agree: solutions, inertia, fixed units, NaN; and the
choice between them."""

from __future__ import annotations

import numpy as np
import pytest

import octo
from octo import native
from octo.errors import ShapeError, UnknownNameError
from octo.solver.blocks import SBT
from octo.solver.cyclic_reduction import CyclicReductionFactor, ReducedSBT
from octo.solver.elimination import EliminationFactor
from octo.solver.kkt import Method, factorize
from octo.solver.options import SqpOptions
from tests.dense import kkt_matrix

needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
SIZES = [(18, 6), (36, 12), (6, 0), (4, 3), (5, 1)]


def fix_last_unit(system) -> None:
    """As a fixed end state does it: H = I, no columns of A, so that the rows of the last unit touch
    earlier ones only."""
    system.A[:, -1, 0] = 0.0
    system.H[:, -1, 1:] = 0.0
    system.H[:, -1, 0] = np.eye(system.nc)


@pytest.mark.parametrize("D", [1, 2, 3, 4, 5, 8, 13])
@pytest.mark.parametrize("B", [1, 7])
def test_reduces_any_block_tridiagonal_matrix(D, B):
    random = np.random.default_rng(D)
    diagonal = random.standard_normal((2, D, B, B))
    matrix = SBT(diagonal + np.swapaxes(diagonal, -1, -2), random.standard_normal((2, D - 1, B, B)))
    dense = np.zeros((2, D * B, D * B))
    for i in range(D):
        own = slice(i * B, (i + 1) * B)
        dense[:, own, own] = matrix.diagonal[:, i]
        if i:
            before = slice((i - 1) * B, i * B)
            dense[:, own, before] = matrix.lower[:, i - 1]
            dense[:, before, own] = np.swapaxes(matrix.lower[:, i - 1], -1, -2)
    rhs = random.standard_normal((2, D, B, 3))
    reduced = ReducedSBT(matrix, expected=B)
    x = reduced.solve(rhs)
    x += reduced.solve(rhs - matrix.times(x))
    np.testing.assert_allclose(matrix.times(x), rhs, atol=1e-11)
    np.testing.assert_array_equal(reduced.negatives, (np.linalg.eigvalsh(dense) < 0).sum(axis=1))


@pytest.mark.parametrize("nc,ma", SIZES)
@pytest.mark.parametrize("K", [1, 2, 3, 8, 13])
def test_cyclic_reduction_against_the_dense_matrix(random_system, nc, ma, K):
    for lowered in (0.0, 4.0, 20.0):
        system = random_system(K, 2, K, nc, ma, lowered=lowered)
        factor = factorize(system.H, system.A, method="cyclic_reduction")
        excess = (np.linalg.eigvalsh(kkt_matrix(system)) < 0).sum(axis=1) - K * ma
        np.testing.assert_array_equal(factor.negative, excess)
        np.testing.assert_array_equal(factor.inertia_ok, excess == 0)
        assert (factor.first_bad[excess == 0] == -1).all()
        _, lam = factor.solve(-system.b, -system.C, tolerance=1e-14, check=True)
        assert lam.shape == (2, K, ma)
        assert factor.residual.max() < (1e-12 if lowered == 0.0 else 1e-9)


@needs_compiler
@pytest.mark.parametrize("nc,ma", SIZES)
@pytest.mark.parametrize("fixed", [False, True])
@pytest.mark.parametrize("lowered", [0.0, 3.0, 20.0])
def test_both_ways_agree(random_system, nc, ma, fixed, lowered):
    for K in (4, 9, 16):
        system = random_system(7 * K, 2, K, nc, ma, lowered=lowered)
        if fixed:
            fix_last_unit(system)
        sigma = 0.01 + np.random.default_rng(0).random((2, K))
        one = factorize(system.H, system.A, sigma, method="elimination", stop=False)
        other = factorize(system.H, system.A, sigma, method="cyclic_reduction")
        np.testing.assert_array_equal(one.negative, other.negative)
        np.testing.assert_array_equal(one.inertia_ok, other.inertia_ok)
        columns = [np.stack([-part, 2 * part], axis=-1) for part in (system.b, system.C)]
        for own, paired in zip(
            one.solve(*columns, tolerance=1e-14),
            other.solve(*columns, tolerance=1e-14),
            strict=True,
        ):
            np.testing.assert_allclose(
                own, paired, atol=1e-9 * max(1.0, np.abs(own).max(initial=0.0))
            )


@needs_compiler
def test_both_ways_on_a_hermite_like_tail(random_system):
    """More rows than variables in a unit pair: the last unit fixed, its rows all on the unit before
    (|u| < n/2)."""
    system = random_system(8, 1, 8, 6, 4)
    fix_last_unit(system)
    solutions = []
    for method in ("elimination", "cyclic_reduction"):
        factor = factorize(system.H, system.A, method=method)
        assert factor.inertia_ok.all()
        solutions.append(factor.solve(-system.b, -system.C, tolerance=1e-14, check=True))
        assert factor.residual.max() < 1e-10
    for own, other in zip(*solutions, strict=True):
        np.testing.assert_allclose(own, other, atol=1e-8 * np.abs(own).max())


@needs_compiler
def test_both_ways_where_pivots_grow():
    """In Hermite, with a small radius, a level of the reduction is left with entries from 1e-8 to
    1e8."""
    problem = octo.Problem(
        octo.gallery.mammal(), steps=40, dt=0.025, costs=octo.costs.paper(), basis="hermite"
    )

    def energies(method: Method):
        options = SqpOptions(linear_solver=method, max_iterations=14)
        return octo.solve(problem, options=options, passes=1, device="cpu").history["energy"]

    np.testing.assert_allclose(energies("cyclic_reduction"), energies("elimination"), rtol=1e-6)


def test_dependent_rows_in_cyclic_reduction(random_system):
    system = random_system(5, 1, 7, 6, 4)
    system.A[:, 4, :, 2] = 3.0 * system.A[:, 4, :, 0]
    consistent = system.constraints_times(np.random.default_rng(0).standard_normal((1, 7, 6)))
    factor = CyclicReductionFactor(system.H, system.A)
    dv, lam = factor.solve(-system.b, consistent, tolerance=1e-14)
    stationarity, feasibility = system.residual(dv, lam, rhs_c=consistent)
    assert factor.inertia_ok.all() and factor.shifted[0] == 1
    assert max(np.abs(stationarity).max(), np.abs(feasibility).max()) < 1e-10


@pytest.mark.parametrize(
    "method", ["cyclic_reduction", pytest.param("elimination", marks=needs_compiler)]
)
def test_a_nan_member_leaves_the_others_bit_identical(random_system, method):
    system = random_system(2, 3, 9, 6, 4)
    expected = factorize(system.H.copy(), system.A, method=method).solve(-system.b, -system.C)
    system.H[1, 4, 0, 0, 0] = np.nan
    factor = factorize(system.H, system.A, method=method)
    np.testing.assert_array_equal(factor.usable, [True, False, True])
    np.testing.assert_array_equal(factor.inertia_ok, [True, False, True])
    for own, other in zip(factor.solve(-system.b, -system.C), expected, strict=True):
        np.testing.assert_array_equal(own[::2], other[::2])
        assert np.isnan(own[1]).all()


@needs_compiler
def test_auto_takes_the_elimination_where_it_can(random_system, monkeypatch):
    system = random_system(0, 1, 3, 4, 3)
    assert isinstance(factorize(system.H, system.A), EliminationFactor)
    monkeypatch.setattr(native, "compiler", lambda: None)
    assert isinstance(factorize(system.H, system.A), CyclicReductionFactor)


def test_wrong_arguments_are_refused(random_system):
    system = random_system(0, 1, 3, 4, 3)
    with pytest.raises(UnknownNameError, match="did you mean"):
        factorize(system.H, system.A, method="eliminate")
    with pytest.raises(ShapeError, match="A has shape"):
        factorize(system.H, system.A[:, :2], method="cyclic_reduction")
    factor = factorize(system.H, system.A, method="cyclic_reduction")
    with pytest.raises(ShapeError, match="rhs_v has shape"):
        factor.solve(system.b[:, :2])
    with pytest.raises(ShapeError, match="rhs_c has shape"):
        factor.solve(system.b, system.C[:, :2])
