"""Border columns against dense algebra: solutions, inertia by eigenvalues, singular complements,
and the regularisation that makes the whole definite."""

from __future__ import annotations

import numpy as np
import pytest

from octo import native
from octo.errors import ShapeError
from octo.solver import elimination
from octo.solver.blocks import KKTBlocks
from octo.solver.border import Border, BorderedFactor, factorize
from octo.solver.factors import HostFactors
from octo.solver.line_search import KKTDirection
from octo.solver.options import SqpOptions
from octo.solver.regularisation import FLOOR, GROW
from octo.solver.rule import Clock
from tests.dense import kkt_matrix

COMPILER = native.compiler() is not None
METHODS = [("cyclic_reduction", 1), *([("elimination", 1), ("elimination", 2)] if COMPILER else [])]
SIZES = [(6, 4), (5, 1), (4, 0)]  # nc, ma
BATCH, K = 3, 12


def bordered(system: KKTBlocks, unknowns: int, rows: int, corner: float = 3.0) -> Border:
    """Random columns; D = corner·I and a little more on the unknowns, zero on the rows."""
    random = np.random.default_rng(unknowns + 10 * rows)
    batch, w = system.batch, unknowns + rows
    over_variables = random.standard_normal((batch, system.units, system.nc, w))
    over_rows = random.standard_normal((batch, system.units, system.ma, w))
    over_rows[..., unknowns:] = 0.0
    D = random.standard_normal((batch, w, w))
    D = D + np.swapaxes(D, 1, 2) + corner * np.eye(w)
    D[:, unknowns:, unknowns:] = 0.0
    return Border(
        over_variables, over_rows, D, random.standard_normal((batch, w)), np.zeros((batch, rows))
    )


def dense(system: KKTBlocks, border: Border, sigma: np.ndarray | None = None) -> np.ndarray:
    """(batch, K(nc+ma) + w, …) all variables, all multipliers, the border."""
    parts = (border.over_variables, border.over_rows)
    B = np.concatenate(
        [part.reshape(len(part), part.shape[1] * part.shape[2], border.width) for part in parts],
        axis=1,
    )
    D = border.corner.copy()
    if sigma is not None:
        own = np.arange(border.unknowns)
        D[:, own, own] += sigma.min(axis=1)[:, None]
    return np.block([[kkt_matrix(system, sigma), B], [np.swapaxes(B, 1, 2), D]])


def joined(*parts: np.ndarray) -> np.ndarray:
    """(batch, size) of the parts of a vector."""
    return np.concatenate([part.reshape(len(part), -1) for part in parts], axis=1)


def excess(system: KKTBlocks, border: Border, sigma: np.ndarray | None = None) -> np.ndarray:
    """(batch,) eigenvalues below zero beyond one for each row."""
    values = np.linalg.eigvalsh(dense(system, border, sigma))
    return (values < 0.0).sum(axis=1) - system.units * system.ma - border.rows


@pytest.mark.parametrize("method,threads", METHODS)
@pytest.mark.parametrize("nc,ma", SIZES)
@pytest.mark.parametrize("unknowns,rows", [(1, 0), (3, 0), (0, 1), (2, 2)])
def test_against_the_dense_matrix(
    monkeypatch, random_system, method, threads, nc, ma, unknowns, rows
):
    """Definite and indefinite members of one batch; two threads a problem."""
    monkeypatch.setattr(elimination, "SHARED_WORK", 0)
    wrong = right = 0
    for lowered, corner in ((0.0, 500.0), (0.0, -50.0), (3.0, 500.0), (20.0, 0.0)):
        system = random_system(K, BATCH, K, nc, ma, lowered=lowered)
        border = bordered(system, unknowns, rows, corner)
        sigma = 0.01 + np.random.default_rng(0).random((BATCH, K))
        factor = factorize(
            *(system.H, system.A, border, sigma), method=method, stop=False, threads=threads * BATCH
        )
        expected = excess(system, border, sigma)
        np.testing.assert_array_equal(factor.negative, expected)
        np.testing.assert_array_equal(factor.inertia_ok, expected == 0)
        assert factor.usable.all()
        wrong, right = wrong + int((expected > 0).sum()), right + int((expected == 0).sum())
        found = joined(
            *factor.solve(-system.b, -system.C, -border.residual, tolerance=1e-14, check=True)
        )
        rhs = -joined(system.b, system.C, border.residual)
        solution = np.linalg.solve(dense(system, border, sigma), rhs[..., None])[..., 0]
        scale = np.abs(solution).max(axis=1, keepdims=True)
        np.testing.assert_allclose(found / scale, solution / scale, rtol=0.0, atol=1e-9)
        assert factor.residual.shape == (BATCH, 1) and factor.residual.max() < 1e-10
    assert right and (wrong or not unknowns)


@pytest.mark.parametrize("method,threads", METHODS)
def test_several_right_hand_sides(random_system, method, threads):
    system = random_system(1, BATCH, K, 6, 4)
    border = bordered(system, 2, 1, 500.0)
    factor = factorize(system.H, system.A, border, method=method, threads=threads * BATCH)
    columns = [np.stack([part, -3.0 * part], axis=-1) for part in (system.b, system.C)]
    shared = np.stack([border.residual, -3.0 * border.residual], axis=-1)
    both = factor.solve(*columns, shared, tolerance=1e-14)
    single = factor.solve(system.b, system.C, border.residual, tolerance=1e-14)
    for two, one in zip(both, single, strict=True):
        np.testing.assert_allclose(two[..., 0], one, atol=1e-9)
        np.testing.assert_allclose(two[..., 1], -3.0 * one, atol=1e-9)


@pytest.mark.parametrize("method,threads", METHODS)
def test_a_shared_row_mends_what_is_indefinite_without_it(random_system, method, threads):
    """Σ_k v_k along the one direction of negative curvature is held: T has an eigenvalue too many,
    S one too few, and the whole is right."""
    system = random_system(4, 1, K, 4, 0)
    values, vectors = np.linalg.eigh(kkt_matrix(system))
    direction = vectors[:, :, 0].reshape(1, K, 4)
    shift = values[0, 0] + 0.5 * (values[0, 1] - values[0, 0])
    system.H[:, :, 0, np.arange(4), np.arange(4)] -= shift
    zero = np.zeros((1, K, 0, 1))
    border = Border(
        direction[..., None], zero, np.zeros((1, 1, 1)), np.ones((1, 1)), np.zeros((1, 1))
    )
    factor = factorize(system.H, system.A, border, method=method, threads=threads)
    assert excess(system, border)[0] == 0 and factor.inertia_ok.all()
    dv, _, z = factor.solve(-system.b, None, -border.residual)
    np.testing.assert_allclose((direction * dv).sum(), -1.0, atol=1e-9)
    rhs = -joined(system.b, border.residual)
    np.testing.assert_allclose(
        joined(dv, z), np.linalg.solve(dense(system, border), rhs[..., None])[..., 0], atol=1e-7
    )


@pytest.mark.parametrize("method,threads", METHODS)
def test_a_singular_complement_is_not_usable(random_system, method, threads):
    """Of three members the middle one has D = Bᵀ T⁻¹ B: its matrix is singular, and the others do
    not notice."""
    system = random_system(2, BATCH, K, 6, 4)
    border = bordered(system, 2, 0, 500.0)
    plain = factorize(system.H, system.A, border, method=method, threads=threads)
    B = joined(border.over_variables[1:2, ..., 0], border.over_rows[1:2, ..., 0])[0]
    border.corner[1] = np.diag([B @ np.linalg.solve(kkt_matrix(system)[1], B), 500.0])
    border.over_variables[1, ..., 1] = border.over_rows[1, ..., 1] = 0.0
    factor = factorize(system.H, system.A, border, method=method, threads=threads)
    np.testing.assert_array_equal(factor.usable, [True, False, True])
    np.testing.assert_array_equal(factor.inertia_ok, [True, False, True])
    assert factor.negative[1] == 1
    rhs = (-system.b, -system.C, -border.residual)
    for own, before in zip(factor.solve(*rhs), plain.solve(*rhs), strict=True):
        np.testing.assert_array_equal(own[::2], before[::2])
        assert np.isnan(own[1]).all()


@pytest.mark.parametrize("method,threads", METHODS)
def test_without_columns_it_is_the_factor_itself(random_system, method, threads):
    system = random_system(3, BATCH, K, 6, 4, lowered=3.0)
    border = bordered(system, 0, 0)
    factor = factorize(system.H, system.A, border, method=method, stop=False, threads=threads)
    assert isinstance(factor, BorderedFactor)
    np.testing.assert_array_equal(factor.negative, excess(system, border))
    dv, lam, z = factor.solve(-system.b, -system.C, tolerance=1e-13)
    assert z.shape == (BATCH, 0)
    rhs = -joined(system.b, system.C)
    expected = np.linalg.solve(kkt_matrix(system), rhs[..., None])[..., 0]
    np.testing.assert_allclose(joined(dv, lam), expected, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("method,threads", METHODS)
def test_a_nan_member_leaves_the_others(random_system, method, threads):
    system = random_system(5, BATCH, K, 6, 4)
    border = bordered(system, 2, 1, 500.0)
    rhs = (-system.b, -system.C, -border.residual)
    plain = factorize(system.H, system.A, border, method=method, threads=threads).solve(*rhs)
    border.over_variables[0, 3, 1, 1] = np.nan
    H = system.H.copy()
    H[1, 4, 0, 0, 0] = np.nan
    factor = factorize(H, system.A, border, method=method, threads=threads)
    np.testing.assert_array_equal(factor.inertia_ok, [False, False, True])
    for own, before in zip(factor.solve(*rhs), plain, strict=True):
        np.testing.assert_array_equal(own[2], before[2])
        assert np.isnan(own[:2]).all()


def test_wrong_shapes_are_refused(random_system):
    system = random_system(6, BATCH, K, 6, 4)
    border = bordered(system, 2, 1)
    with pytest.raises(ShapeError, match="over_rows of the border has shape"):
        factorize(system.H, system.A[:, :, :, :3], border)
    factor = factorize(system.H, system.A, border)
    with pytest.raises(ShapeError, match="rhs_border has shape"):
        factor.solve(system.b, system.C, border.residual[:, :2])


@pytest.mark.parametrize("method", [name for name, threads in METHODS if threads == 1])
@pytest.mark.parametrize("unknowns,rows", [(2, 0), (1, 1)])
def test_the_direction_is_that_of_the_whole(random_system, method, unknowns, rows):
    """Member 0 is definite, member 1 within its units only, member 2 nowhere: the weight is raised
    until the whole has the right inertia, and no further than by one factor."""
    options = SqpOptions(linear_solver=method, heuristics=())
    system = random_system(8, BATCH, K, 6, 4)
    system.H[2, :, 0, np.arange(6), np.arange(6)] -= 4.0
    border = bordered(system, unknowns, rows, 500.0)
    border.corner[1, 0, 0] = -5000.0
    border.lam[:] = np.random.default_rng(5).standard_normal((BATCH, rows))
    lam = np.random.default_rng(6).standard_normal((BATCH, K, 4))
    factors = HostFactors(system, lam, options, 1, border)
    direction = KKTDirection(BATCH, K, options, Clock(), None)
    step, sigma, has = direction.step(factors)
    assert has.all() and sigma[0] == 0.0 and (sigma[1:] > 0.0).all()
    weight = np.repeat(sigma[:, None] + FLOOR, K, axis=1)
    np.testing.assert_array_equal(excess(system, border, weight), 0)
    lower = weight / GROW
    assert (excess(system, border, lower)[1:] > 0).all()
    found = joined(step.delta, step.multipliers, step.shared)
    rhs = -joined(system.b, system.C, border.residual)
    matrix = dense(system, border, weight)
    np.testing.assert_allclose(
        (matrix @ found[..., None])[..., 0], rhs, atol=1e-8 * np.abs(found).max()
    )
    _, dual, slope = step.numbers
    shared = np.concatenate([np.zeros((BATCH, unknowns)), border.lam], axis=1)
    here = joined(np.zeros_like(system.b), lam, shared)
    gradient = joined(system.b, np.zeros_like(lam), border.residual)
    lagrange = gradient + (dense(system, border) @ here[..., None])[..., 0]
    free = np.r_[0 : K * 6, K * 10 : K * 10 + unknowns]
    np.testing.assert_allclose(dual, np.abs(lagrange[:, free]).max(axis=1))
    np.testing.assert_allclose(slope, (gradient * found)[:, free].sum(axis=1))


def test_members_that_are_factored_apart(random_system):
    system = random_system(9, BATCH, K, 6, 4)
    border = bordered(system, 2, 1, 500.0)
    options = SqpOptions(linear_solver="cyclic_reduction")
    rhs = (-system.b, -system.C, -border.residual)
    factors = HostFactors(system, np.zeros_like(system.C), options, 1, border)
    weight = np.ones((BATCH, K))
    assert factors.add(np.array([True, False, False]), weight)[0]
    assert factors.add(np.array([False, False, True]), weight)[2]
    together = factorize(system.H, system.A, border, weight, method="cyclic_reduction")
    for own, other in zip(factors.solve(*rhs), together.solve(*rhs), strict=True):
        np.testing.assert_allclose(own[::2], other[::2], atol=1e-12)
        assert np.isnan(own[1]).all()
