"""Window elimination against dense linear algebra: solutions, inertia, the first bad unit,
dependent rows, NaN."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import null_space

from octo import native
from octo.errors import ShapeError
from octo.solver import elimination
from octo.solver.elimination import factorize
from tests.dense import kkt_matrix

pytestmark = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")

# Nodes, Hermite, fixed base, cart-pole, odd sizes
SIZES = [(18, 6), (36, 12), (6, 0), (4, 3), (5, 1)]
UNITS = [1, 2, 3, 4, 9]


def reduced_eigenvalues(H: np.ndarray, A: np.ndarray) -> np.ndarray:
    """Eigenvalues of the Hessian on the null space of the constraints."""
    basis = null_space(A, rcond=1e-10) if A.size else np.eye(len(H))
    return np.linalg.eigvalsh(basis.T @ H @ basis)


def relative_residual(system, dv, lam, sigma=None) -> float:
    size = max(np.abs(system.b).max(), np.abs(system.C).max(initial=0.0))
    return (
        max(float(np.abs(part).max(initial=0.0)) for part in system.residual(dv, lam, sigma)) / size
    )


@pytest.mark.parametrize("nc,ma", SIZES)
@pytest.mark.parametrize("K", UNITS)
def test_solves_the_dense_system(random_system, nc, ma, K):
    system = random_system(K, 2, K, nc, ma)
    factor = factorize(system.H, system.A)
    dv, lam = factor.solve(-system.b, -system.C, tolerance=1e-14)
    rhs = np.concatenate([-system.b.reshape(2, -1), -system.C.reshape(2, -1)], axis=1)
    dense = np.linalg.solve(kkt_matrix(system), rhs[..., None])[..., 0]
    found = np.concatenate([dv.reshape(2, -1), lam.reshape(2, -1)], axis=1)
    scale = np.abs(dense).max()
    assert factor.inertia_ok.all() and not factor.dependent.any()
    np.testing.assert_allclose(found, dense, atol=1e-9 * scale)
    assert relative_residual(system, dv, lam) < 1e-12


@pytest.mark.parametrize("nc,ma", SIZES)
@pytest.mark.parametrize("lowered", [1.5, 4.0, 20.0])
def test_inertia_is_that_of_the_dense_matrix(random_system, split, nc, ma, lowered):
    for K in UNITS:
        system = random_system(10 + K, 2, K, nc, ma, lowered=lowered)
        counted = factorize(system.H, system.A, stop=False)
        stopped = factorize(system.H, system.A)
        H, A = split(system)
        for m, matrix in enumerate(kkt_matrix(system)):
            excess = int((np.linalg.eigvalsh(matrix) < 0).sum()) - K * ma
            definite = bool((reduced_eigenvalues(H[m], A[m]) > 0).all())
            assert counted.negative[m] == excess
            assert counted.inertia_ok[m] == stopped.inertia_ok[m] == definite
        dv, lam = counted.solve(-system.b, -system.C, tolerance=1e-14)
        assert relative_residual(system, dv, lam) < 1e-9


@pytest.mark.parametrize("rows_touch", [(0, 1, 2), (1, 2), (2,)])
def test_first_bad_is_the_last_unit_that_cannot_be_left_free(random_system, split, rows_touch):
    """Unit k is bad when the Hessian is indefinite on {A v = 0, v_j = 0 for j < k} and definite for
    every k above."""
    K, nc, ma = 6, 6, 4
    for seed in range(6):
        system = random_system(seed, 1, K, nc, ma, lowered=2.5, rows_touch=rows_touch)
        (H,), (A,) = split(system)
        expected = -1
        for k in range(K):
            free = slice(k * nc, None)
            if not (reduced_eigenvalues(H[free, free], A[:, free]) > 0).all():
                expected = k
        assert factorize(system.H, system.A).first_bad[0] == expected
        assert factorize(system.H, system.A, stop=False).first_bad[0] == expected


@pytest.mark.parametrize("nc,ma,rank", [(18, 6, 3), (4, 3, 1), (6, 4, 0)])
def test_structurally_singular_first_rows(random_system, nc, ma, rank):
    """The rows of the first units may touch fewer variables than they are many, when later units
    make up for it."""
    system = random_system(3, 2, 8, nc, ma)
    system.A[:, 7, 0] = 0.0  # the rows of the last unit touch earlier ones only
    system.A[:, 6, 0, :, rank:] = 0.0
    factor = factorize(system.H, system.A)
    dv, lam = factor.solve(-system.b, -system.C, tolerance=1e-14)
    assert not factor.dependent.any() and factor.inertia_ok.all()
    assert relative_residual(system, dv, lam) < 1e-11


@pytest.mark.parametrize("kind", ["zero", "repeated", "combined"])
def test_dependent_rows_are_counted_and_harmless(random_system, split, kind):
    K, nc, ma = 7, 6, 4
    system = random_system(5, 1, K, nc, ma)
    if kind == "zero":
        system.A[:, 0, :, 1] = 0.0
    elif kind == "repeated":
        system.A[:, 4, :, 2] = 3.0 * system.A[:, 4, :, 0]
    else:  # a row of unit 5 is a combination of rows of units 3 and 4
        system.A[:, 5, :, 0] = 0.0
        system.A[:, 3:5, 1:, 0] = 0.0
        system.A[:, 3:5, 2, 0] = 0.0
        system.A[:, 5, 1, 0] = 2.0 * system.A[:, 4, 0, 0]
        system.A[:, 5, 2, 0] = -system.A[:, 3, 0, 0]
    consistent = system.constraints_times(np.random.default_rng(0).standard_normal((1, K, nc)))
    factor = factorize(system.H, system.A)
    _, (A,) = split(system)
    assert factor.dependent[0] == K * ma - np.linalg.matrix_rank(A) == 1
    assert factor.inertia_ok.all()
    dv, lam = factor.solve(-system.b, consistent, tolerance=1e-14)
    stationarity, feasibility = system.residual(dv, lam, rhs_c=consistent)
    assert max(np.abs(stationarity).max(), np.abs(feasibility).max()) < 1e-10


def test_rank_deficient_chain_of_fixed_units(random_system):
    """A fixed last unit (H = I, no columns of A), and more rows than variables in a pair of units,
    as in Hermite."""
    system = random_system(8, 1, 6, 6, 4)
    system.A[:, 5, 0] = 0.0
    system.H[:, 5, 1:] = 0.0
    system.H[:, 5, 0] = np.eye(6)
    factor = factorize(system.H, system.A)
    dv, lam = factor.solve(-system.b, -system.C, tolerance=1e-14)
    assert factor.inertia_ok.all() and relative_residual(system, dv, lam) < 1e-11
    np.testing.assert_allclose(dv[:, 5], -system.b[:, 5], atol=1e-12)


@pytest.mark.parametrize("poisoned", ["H", "A", "sigma"])
@pytest.mark.parametrize("threads", [1, 2])
def test_a_nan_member_leaves_the_others_bit_identical(random_system, poisoned, threads):
    system = random_system(2, 3, 9, 18, 6)
    sigma = np.full((3, 9), 0.1)
    clean = factorize(system.H, system.A, sigma.copy(), threads=threads)
    expected = clean.solve(-system.b, -system.C)
    {"H": system.H, "A": system.A, "sigma": sigma}[poisoned][1, 4] = np.nan
    factor = factorize(system.H, system.A, sigma, threads=threads)
    found = factor.solve(-system.b, -system.C)
    np.testing.assert_array_equal(factor.usable, [True, False, True])
    np.testing.assert_array_equal(factor.inertia_ok, [True, False, True])
    assert factor.first_bad[1] == 4 or poisoned == "A"
    for own, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(own[::2], other[::2])
        assert np.isnan(own[1]).all()


@pytest.mark.parametrize("nc,ma", [*SIZES, (6, 4)])
@pytest.mark.parametrize("K", [8, 9, 13])
@pytest.mark.parametrize("lowered", [0.0, 4.0])
def test_two_threads_from_both_ends_agree_with_one(random_system, monkeypatch, nc, ma, K, lowered):
    monkeypatch.setattr(elimination, "SHARED_WORK", 0)
    system = random_system(K, 2, K, nc, ma, lowered=lowered)
    system.A[1, K - 1, 0] = 0.0  # rows of a fixed end are carried on to the middle
    columns = [np.stack([-part, 2 * part], axis=-1) for part in (system.b, system.C)]
    one = factorize(system.H, system.A, 0.1, stop=False)
    both = factorize(system.H, system.A, 0.1, stop=False, threads=4)
    np.testing.assert_array_equal(one.negative, both.negative)
    np.testing.assert_array_equal(
        one.inertia_ok, factorize(system.H, system.A, 0.1, threads=4).inertia_ok
    )
    np.testing.assert_array_equal(one.first_bad < 0, both.first_bad < 0)
    np.testing.assert_array_equal(one.dependent, both.dependent)
    for own, other in zip(
        one.solve(*columns, tolerance=1e-14),
        both.solve(*columns, tolerance=1e-14, check=True),
        strict=True,
    ):
        np.testing.assert_allclose(own, other, atol=1e-9 * max(1.0, np.abs(own).max(initial=0.0)))
    assert both.residual.max() < 1e-9
    again = factorize(system.H, system.A, 0.1, stop=False, threads=4)
    np.testing.assert_array_equal(both.solve(*columns)[0], again.solve(*columns)[0])


def test_dependent_rows_and_nan_with_two_threads(random_system, monkeypatch):
    monkeypatch.setattr(elimination, "SHARED_WORK", 0)
    system = random_system(5, 1, 12, 6, 4)
    for k in (1, 6, 11):
        system.A[:, k, :, 2] = 3.0 * system.A[:, k, :, 0]
    consistent = system.constraints_times(np.random.default_rng(0).standard_normal((1, 12, 6)))
    factor = factorize(system.H, system.A, threads=2)
    dv, lam = factor.solve(-system.b, consistent, tolerance=1e-14)
    assert factor.dependent[0] == 3 and factor.inertia_ok.all()
    assert max(np.abs(part).max() for part in system.residual(dv, lam, rhs_c=consistent)) < 1e-10
    for k in (0, 5, 11):
        system.H[0, k, 0, 1, 1] = np.nan
        factor = factorize(system.H, system.A, threads=2)
        assert not factor.usable.any() and np.isnan(factor.solve(system.b)[0]).all()
        system.H[0, k, 0, 1, 1] = 1.0


def test_a_nan_right_hand_side_stays_in_its_member(random_system):
    system = random_system(2, 2, 5, 6, 4)
    factor = factorize(system.H, system.A)
    expected = factor.solve(-system.b, -system.C)
    system.b[0, 2, 1] = np.nan
    found = factor.solve(-system.b, -system.C)
    assert np.isnan(found[0][0]).any()
    np.testing.assert_array_equal(found[0][1], expected[0][1])


@pytest.mark.parametrize("shape", [(), (2,), (2, 5), (2, 5, 4)])
def test_every_shape_of_sigma(random_system, shape):
    system = random_system(1, 2, 5, 4, 3)
    sigma = 0.5 + np.random.default_rng(0).random(shape)
    dv, lam = factorize(system.H, system.A, sigma).solve(-system.b, -system.C, tolerance=0.0)
    assert relative_residual(system, dv, lam, sigma) < 1e-13


def test_columns_are_solved_like_single_right_hand_sides(random_system):
    system = random_system(1, 2, 5, 18, 6)
    factor = factorize(system.H, system.A, 0.1)
    columns_v = np.stack([system.b, 2 * system.b], -1)
    columns_c = np.stack([system.C, 0 * system.C], -1)
    dv, lam = factor.solve(columns_v, columns_c, tolerance=0.0, check=True)
    assert factor.residual.shape == (2, 2) and (factor.residual < 1e-13).all()
    for c in range(2):
        own_v, own_lam = factor.solve(columns_v[..., c], columns_c[..., c], tolerance=0.0)
        np.testing.assert_allclose(dv[..., c], own_v, atol=1e-13)
        np.testing.assert_allclose(lam[..., c], own_lam, atol=1e-12)
    zero, _ = factor.solve(system.b)
    np.testing.assert_allclose(zero, factor.solve(system.b, 0 * system.C)[0], atol=1e-14)


def test_badly_scaled_rows_and_weak_hessian(random_system):
    """Rows of forces beside rows of moments, and a Hessian that is small beside them."""
    system = random_system(4, 1, 12, 18, 6)
    system.A[:, :, :, ::2] *= 1e5
    system.C[:, :, ::2] *= 1e5
    system.H[:] *= 1e-6
    system.b[:] *= 1e-6
    factor = factorize(system.H, system.A)
    dv, lam = factor.solve(-system.b, -system.C, tolerance=1e-14)
    stationarity, feasibility = system.residual(dv, lam)
    assert factor.inertia_ok.all()
    assert np.abs(stationarity).max() < 1e-18 and np.abs(feasibility).max() < 1e-9


def test_wrong_shapes_are_refused(random_system):
    system = random_system(0, 1, 3, 4, 3)
    with pytest.raises(ShapeError, match="H has shape"):
        factorize(system.H[0], system.A)
    with pytest.raises(ShapeError, match="A has shape"):
        factorize(system.H, system.A[:, :2])
    with pytest.raises(ShapeError, match="sigma has shape"):
        factorize(system.H, system.A, np.ones((1, 2)))
    with pytest.raises(ShapeError, match="rhs_v has shape"):
        factorize(system.H, system.A).solve(system.b[:, :2])
