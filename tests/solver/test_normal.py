"""AAᵀ factored: the normal step, projections and multipliers against the dense pseudo-inverse, on
both ways."""

from __future__ import annotations

import numpy as np
import pytest

from octo import native
from octo.errors import ShapeError
from octo.solver.normal import NormalFactor

COMPILED = [False] if native.compiler() is None else [True, False]


@pytest.mark.parametrize("compiled", COMPILED)
@pytest.mark.parametrize("nc,ma", [(18, 6), (36, 12), (4, 3), (5, 1), (6, 0)])
@pytest.mark.parametrize("K", [1, 2, 3, 6])
def test_against_the_dense_pseudo_inverse(random_system, split, compiled, nc, ma, K):
    system = random_system(K, 2, K, nc, ma)
    factor = NormalFactor(system.A, compiled=compiled)
    _, A = split(system)
    inverse = np.linalg.pinv(A)
    step = factor.least_norm(-system.C)
    np.testing.assert_allclose(
        step.reshape(2, -1), -(inverse @ system.C.reshape(2, -1, 1))[..., 0], atol=1e-10
    )
    np.testing.assert_allclose(system.constraints_times(step), -system.C, atol=1e-11)
    lam = factor.multipliers(system.b)
    turned = np.swapaxes(inverse, -1, -2)
    np.testing.assert_allclose(
        lam.reshape(2, -1), -(turned @ system.b.reshape(2, -1, 1))[..., 0], atol=1e-10
    )
    left = factor.project(np.stack([system.b, 2 * system.b], axis=-1))
    np.testing.assert_allclose(system.constraints_times(left), 0.0, atol=1e-10)
    np.testing.assert_allclose(
        left[..., 0], system.b + system.constraints_transposed_times(lam), atol=1e-10
    )
    assert not factor.dropped.any()


@pytest.mark.parametrize("compiled", COMPILED)
@pytest.mark.parametrize("kind", ["empty unit", "zero row", "repeated", "later unit"])
def test_dependent_rows_are_dropped(random_system, split, compiled, kind):
    K, nc, ma = 6, 6, 4
    system = random_system(1, 1, K, nc, ma)
    if kind == "empty unit":
        system.A[:, 2] = 0.0
    elif kind == "zero row":
        system.A[:, K - 1, :, 1] = 0.0
    elif kind == "repeated":
        system.A[:, 3, :, 2] = -2e4 * system.A[:, 3, :, 0]
    else:  # the last unit's row repeats one that lies two units back
        system.A[:, K - 1, :, 0] = 0.0
        system.A[:, K - 3, 1:, 0] = 0.0
        system.A[:, K - 1, 2, 0] = system.A[:, K - 3, 0, 0]
    factor = NormalFactor(system.A, compiled=compiled)
    _, (A,) = split(system)
    assert factor.dropped[0] == K * ma - np.linalg.matrix_rank(A, tol=1e-8)
    inverse = np.linalg.pinv(A, rcond=1e-10)
    left = system.b[0].ravel() - inverse @ (A @ system.b[0].ravel())
    np.testing.assert_allclose(factor.project(system.b).ravel(), left, atol=1e-9)
    consistent = system.constraints_times(system.b)
    np.testing.assert_allclose(
        system.constraints_times(factor.least_norm(consistent)), consistent, rtol=1e-9, atol=1e-9
    )


@pytest.mark.parametrize("compiled", COMPILED)
def test_a_nan_member_leaves_the_others_bit_identical(random_system, compiled):
    system = random_system(1, 3, 5, 6, 4)
    expected = NormalFactor(system.A.copy(), compiled=compiled).least_norm(system.C)
    system.A[1, 3, 0, 0, 0] = np.nan
    factor = NormalFactor(system.A, threads=2, compiled=compiled)
    found = factor.least_norm(system.C)
    np.testing.assert_array_equal(factor.dropped, [0, -1, 0])
    np.testing.assert_array_equal(found[::2], expected[::2])
    assert np.isnan(factor.solve(system.C)[1]).all()


@pytest.mark.parametrize("compiled", COMPILED)
def test_refinement_recovers_what_squaring_loses(random_system, split, compiled):
    """AAᵀ of rows at an angle of 1e-5 has condition 1e10."""
    system = random_system(1, 1, 6, 18, 6)
    system.A[:, :, :, 1] = system.A[:, :, :, 0] + 1e-5 * system.A[:, :, :, 1]
    factor = NormalFactor(system.A, compiled=compiled)
    consistent = system.constraints_times(system.b)
    expected = np.linalg.pinv(split(system)[1][0]) @ consistent.ravel()
    errors = [
        np.abs(factor.least_norm(consistent, refine=steps).ravel() - expected).max()
        for steps in (0, 1)
    ]
    assert errors[1] < 1e-8 and errors[1] < 1e-2 * errors[0]


def test_wrong_shapes_are_refused(random_system):
    system = random_system(0, 1, 3, 4, 3)
    with pytest.raises(ShapeError, match="A has shape"):
        NormalFactor(system.A[0])
    with pytest.raises(ShapeError, match="rhs has shape"):
        NormalFactor(system.A).solve(system.C[:, :2])
