"""Block cyclic reduction by the kernels: solutions, inertia against eigenvalues, dependent rows,
projections, NaN."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
import strict

from octo.errors import ShapeError
from octo.gpu.factor import DeviceFactor
from octo.gpu.linear import DeviceBlocks, Linear
from octo.gpu.normal import DeviceNormal
from octo.gpu.problem import DeviceProblem
from octo.solver.blocks import KKTBlocks
from octo.solver.border import Border, BorderedFactor
from octo.solver.normal import NormalFactor
from tests.dense import kkt_matrix
from tests.emulator import EmulatedDevice

SIZES = [(18, 6), (5, 1), (4, 3), (6, 0)]


@pytest.mark.parametrize(("nc", "ma"), SIZES)
@pytest.mark.parametrize("K", [1, 2, 3, 8, 13])
def test_solutions_and_inertia_against_the_dense_matrix(random_system, device, nc, ma, K):
    for threads, lowered in ((1, 0.0), (5, 4.0), (1, 20.0)):
        system = random_system(K, 2, K, nc, ma, lowered=lowered)
        factor = DeviceFactor(Linear(device(threads), nc, ma), system.H, system.A, None)
        excess = (np.linalg.eigvalsh(kkt_matrix(system)) < 0).sum(axis=1) - K * ma
        np.testing.assert_array_equal(factor.negative, excess)
        np.testing.assert_array_equal(factor.inertia_ok, excess == 0)
        columns = [np.stack([-part, 2.0 * part], axis=-1) for part in (system.b, system.C)]
        dv, lam = factor.solve(*columns, tolerance=1e-14, check=True)
        stationarity, feasibility = system.residual(dv, lam, None, *columns)
        scale = max(1.0, np.abs(dv).max(), np.abs(lam).max(initial=0.0))
        assert max(np.abs(stationarity).max(), np.abs(feasibility).max(initial=0.0)) < 1e-11 * scale


@pytest.mark.parametrize(("nc", "ma"), SIZES)
def test_border_columns_beside_the_kernels(random_system, nc, ma):
    """Three columns, the last one a row's: the whole matrix's solution and inertia; with arrays as
    strict as CuPy's."""
    batch, K, w, random = 2, 9, 3, np.random.default_rng(4)
    system = random_system(nc, batch, K, nc, ma)
    sigma = 0.01 + random.random((batch, K))
    over_rows, corner = random.standard_normal((batch, K, ma, w)), np.diag([90.0, -900.0, 0.0])
    over_rows[..., -1] = 0.0
    border = Border(
        random.standard_normal((batch, K, nc, w)),
        over_rows,
        np.stack([np.abs(corner), corner]),
        random.standard_normal((batch, w)),
        np.zeros((batch, 1)),
    )
    linear = Linear(EmulatedDevice(5, xp=strict), nc, ma)
    there = [strict.array(part) for part in (system.H, system.A, system.b, system.C, sigma)]
    blocks, own = DeviceBlocks(*there[:4], linear), DeviceFactor(linear, *there[:2], there[4])
    columns = Border(*(strict.array(getattr(border, field.name)) for field in fields(border)))
    factor = BorderedFactor(own, blocks, there[4], columns)
    parts = (border.over_variables, border.over_rows)
    B = np.concatenate([part.reshape(batch, K * part.shape[2], w) for part in parts], axis=1)
    D = border.corner + sigma.min(axis=1)[:, None, None] * np.diag([1.0, 1.0, 0.0])
    dense = np.block([[kkt_matrix(system, sigma), B], [np.swapaxes(B, 1, 2), D]])
    excess = (np.linalg.eigvalsh(dense) < 0).sum(axis=1) - K * ma - 1
    np.testing.assert_array_equal(factor.negative.get(), excess)
    np.testing.assert_array_equal(factor.inertia_ok.get(), excess == 0)
    assert excess[1] > 0
    rhs = -np.concatenate([part.reshape(batch, -1) for part in (system.b, system.C)], axis=1)
    rhs = np.concatenate([rhs, -border.residual], axis=1)
    expected = np.linalg.solve(dense, rhs[..., None])[..., 0]
    found = factor.solve(-there[2], -there[3], -columns.residual)
    flat = np.concatenate([part.get().reshape(batch, -1) for part in found], axis=1)
    np.testing.assert_allclose(flat, expected, atol=1e-8 * np.abs(expected).max())


def test_any_number_of_threads_gives_the_same_bits(random_system, device):
    system = random_system(7, 2, 9, 18, 6, lowered=4.0)
    sigma = 0.01 + np.random.default_rng(0).random((2, 9))
    found = []
    for threads in (1, 5, 32, 96):
        factor = DeviceFactor(Linear(device(threads), 18, 6), system.H, system.A, sigma)
        found.append((*factor.solve(-system.b, -system.C), factor.negative))
    for other in found[1:]:
        for one, two in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(one, two)


def test_blocks_that_do_not_fit_into_shared_memory(random_system):
    system = random_system(3, 1, 5, 36, 12, lowered=4.0)
    small = EmulatedDevice(5)
    small.shared_limit = 48 * 1024
    factors = [
        DeviceFactor(Linear(gpu, 36, 12), system.H, system.A, None)
        for gpu in (small, EmulatedDevice(5))
    ]
    for one, other in zip(*(factor.solve(-system.b, -system.C) for factor in factors), strict=True):
        np.testing.assert_array_equal(one, other)


def test_blocks_of_more_than_one_tile(random_system, device):
    system = random_system(3, 1, 5, 36, 12, lowered=3.0)
    factor = DeviceFactor(Linear(device(1), 36, 12), system.H, system.A, None)
    assert factor.negative[0] == (np.linalg.eigvalsh(kkt_matrix(system)) < 0).sum() - 60
    factor.solve(-system.b, -system.C, tolerance=1e-14, check=True)
    assert factor.residual.max() < 1e-11


def test_a_fixed_last_unit_and_dependent_rows(random_system, device):
    system = random_system(5, 1, 7, 6, 4)
    system.A[:, -1, 0] = 0.0
    system.H[:, -1, 1:] = 0.0
    system.H[:, -1, 0] = np.eye(6)
    system.A[:, 4, :, 2] = 3.0 * system.A[:, 4, :, 0]
    consistent = system.constraints_times(np.random.default_rng(0).standard_normal((1, 7, 6)))
    factor = DeviceFactor(Linear(device(1), 6, 4), system.H, system.A, None)
    dv, lam = factor.solve(-system.b, consistent, tolerance=1e-14)
    stationarity, feasibility = system.residual(dv, lam, rhs_c=consistent)
    assert factor.inertia_ok.all() and factor.shifted[0] == 1
    assert max(np.abs(stationarity).max(), np.abs(feasibility).max()) < 1e-10
    normal, other = DeviceNormal(Linear(device(1), 6, 4), system.A), NormalFactor(system.A)
    assert normal.dropped[0] == other.dropped[0] == 1
    np.testing.assert_allclose(
        normal.least_norm(consistent), other.least_norm(consistent), atol=1e-10
    )


@pytest.mark.parametrize("kind", ["even", "odd", "turning"])
def test_the_matrix_of_a_cycle(cycle, wiggle, device, kind):
    """The first rows are empty, and of an odd number of steps half of the last ones: eigenvalues
    that are 0 count as negative."""
    problem, gpu = cycle(kind), device(5)
    linear = Linear(gpu, problem.nc, problem.ma)
    other = DeviceProblem(problem, gpu)
    unknowns = wiggle(problem)
    lam = 0.1 * np.random.default_rng(0).standard_normal((problem.batch, problem.K, problem.ma))
    # contacts curve so much that 1e3 is too little
    plain = gpu.array(np.zeros(problem.batch), np.int32)
    model = other.linearize(other.evaluate(gpu.array(unknowns)), lam, plain)
    system = KKTBlocks(model.H, model.A, model.b, model.C)
    empty = problem.ma + (0 if kind == "even" else problem.m)
    for weight, right in ((1e3, True), (0.0, False)):
        sigma = np.full((problem.batch, problem.K), weight)
        factor = DeviceFactor(linear, system.H, system.A, sigma)
        values = np.linalg.eigvalsh(kkt_matrix(system, sigma))
        assert ((np.abs(values) < 1e-7).sum(axis=1) == empty).all() and (
            factor.shifted == empty
        ).all()
        np.testing.assert_array_equal(
            factor.negative, (values < 1e-7).sum(axis=1) - problem.K * problem.ma
        )
        assert (factor.inertia_ok == right).all()
        dv, multipliers = factor.solve(-system.b, -system.C, tolerance=1e-12, check=True)
        stationarity, feasibility = system.residual(dv, multipliers, sigma)
        assert np.abs(stationarity).max() < 1e-10 * np.abs(system.b).max()
        assert np.abs(feasibility).max() < 1e-10 * np.abs(system.C).max()
    normal, expected = DeviceNormal(linear, system.A), NormalFactor(system.A)
    assert (normal.dropped == empty).all() and (expected.dropped == empty).all()
    np.testing.assert_allclose(
        normal.project(system.b), expected.project(system.b), atol=1e-10 * np.abs(system.b).max()
    )


def test_a_nan_member_leaves_the_others_bit_identical(random_system, device):
    system, linear = random_system(2, 3, 9, 6, 4), Linear(device(5), 6, 4)
    expected = DeviceFactor(linear, system.H.copy(), system.A, None).solve(-system.b, -system.C)
    system.H[1, 4, 0, 0, 0] = np.nan
    factor = DeviceFactor(linear, system.H, system.A, None)
    np.testing.assert_array_equal(factor.usable, [True, False, True])
    np.testing.assert_array_equal(factor.inertia_ok, [True, False, True])
    for own, other in zip(factor.solve(-system.b, -system.C), expected, strict=True):
        np.testing.assert_array_equal(own[::2], other[::2])
        assert np.isnan(own[1]).all()


@pytest.mark.parametrize(("nc", "ma"), SIZES)
def test_projections(random_system, device, nc, ma):
    system, linear = random_system(4, 2, 9, nc, ma), Linear(device(5), nc, ma)
    normal, other = DeviceNormal(linear, system.A), NormalFactor(system.A)
    for name, rhs in (("least_norm", system.C), ("project", system.b), ("solve", system.C)):
        expected = getattr(other, name)(rhs)
        np.testing.assert_allclose(
            getattr(normal, name)(rhs),
            expected,
            atol=1e-10 * max(1.0, np.abs(expected).max(initial=0.0)),
        )


def test_products(random_system, device):
    system, linear = random_system(4, 2, 9, 5, 2), Linear(device(5), 5, 2)
    blocks = DeviceBlocks(system.H, system.A, system.b, system.C, linear)
    v, lam = system.b, system.C
    np.testing.assert_allclose(blocks.hessian_times(v), system.hessian_times(v), atol=1e-12)
    np.testing.assert_allclose(blocks.constraints_times(v), system.constraints_times(v), atol=1e-12)
    np.testing.assert_allclose(
        blocks.constraints_transposed_times(lam),
        system.constraints_transposed_times(lam),
        atol=1e-12,
    )


def test_wrong_shapes_are_refused(random_system, device):
    system = random_system(0, 1, 3, 4, 3)
    factor = DeviceFactor(Linear(device(1), 4, 3), system.H, system.A, None)
    with pytest.raises(ShapeError, match="rhs_v has shape"):
        factor.solve(system.b[:, :2])
    with pytest.raises(ShapeError, match="rhs_c has shape"):
        factor.solve(system.b, system.C[:, :2])
