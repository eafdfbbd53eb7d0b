"""St. Venant–Kirchhoff's reduced elasticity beside the full model's, and its derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from octo import soft
from octo.errors import ShapeError, UnknownNameError, ValueRangeError
from octo.soft import stvk
from octo.soft.quadratic import derivatives

pytest.importorskip("skfem")


@pytest.fixture(scope="module")
def model() -> soft.Model:
    return soft.Model(soft.beam_mesh(0.6, 0.12, 0.1, (4, 1, 1)), 1e5, 0.4, 250.0)


def full_energy(model: soft.Model, moved: np.ndarray) -> float:
    """½∫E : C : E (J) of displacements (n, 3), the slopes by the elements' own shape functions."""
    at, weight = np.polynomial.legendre.leggauss(5)
    at, weight = 0.5 * (at + 1.0), 0.5 * weight
    u, v, w = (grid.ravel() for grid in np.meshgrid(at, at, at, indexing="ij"))
    weights = np.einsum("i,j,k->ijk", weight, weight, weight).ravel() * (1 - u) ** 2 * (1 - v)
    slopes = derivatives(np.column_stack([u, v * (1 - u), w * (1 - u) * (1 - v)]))
    lame, shear = model.material.lame
    total = 0.0
    for cell in model.mesh.cells:
        frame = np.einsum("kna,nb->kba", slopes, model.nodes[cell])  # ∂x/∂ξ
        slope = np.einsum("kna,nb->kba", slopes, moved[cell]) @ np.linalg.inv(frame)
        back = slope.transpose(0, 2, 1)
        strain = 0.5 * (slope + back + back @ slope)
        trace = np.trace(strain, axis1=1, axis2=2)
        density = 0.5 * lame * trace**2 + shear * np.square(strain).sum(axis=(1, 2))
        total += float(density @ (weights * np.linalg.det(frame)))
    return total


def reduced(model: soft.Model, r: int = 5) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    values, shapes = model.modes(r)
    return values, shapes, stvk.gram(model.mesh, model.material, shapes)


def test_energy_is_that_of_the_full_model(model: soft.Model) -> None:
    _, shapes, matrix = reduced(model)
    for seed in range(3):
        z = 0.05 * np.random.default_rng(seed).standard_normal(5)
        expected = full_energy(model, np.einsum("nrk,r->nk", shapes, z))
        assert stvk.energy(matrix, z) == pytest.approx(expected, rel=1e-10)


def test_the_energy_of_a_turn_is_none(model: soft.Model) -> None:
    """What the oracle is for: a linear strain would see one."""
    turned = model.nodes @ (Rotation.from_rotvec([0.3, -0.5, 0.2]).as_matrix().T - np.eye(3))
    linear = 0.5 * turned.ravel() @ (model.stiffness @ turned.ravel())
    assert abs(full_energy(model, turned)) < 1e-12 * linear


def test_small_motions_are_linear(model: soft.Model) -> None:
    values, _, matrix = reduced(model)
    np.testing.assert_allclose(matrix[:5, :5], np.diag(values), atol=1e-9 * values[-1])
    np.testing.assert_allclose(
        stvk.tangent(matrix, np.zeros(5)), np.diag(values), atol=1e-9 * values[-1]
    )


def test_derivatives_by_taylor_slopes(model: soft.Model) -> None:
    """What is left of V − V₀ − f·h − ½hᵀKh falls with the third power of the step."""
    _, _, matrix = reduced(model)
    random = np.random.default_rng(0)
    z, way = 0.1 * random.standard_normal(5), random.standard_normal(5)
    here = stvk.energy(matrix, z)
    slope, bend = stvk.force(matrix, z) @ way, way @ stvk.tangent(matrix, z) @ way
    steps = 0.02 * 0.5 ** np.arange(5)
    left = [
        abs(stvk.energy(matrix, z + h * way) - here - h * slope - 0.5 * h**2 * bend) for h in steps
    ]
    orders = np.log2(np.array(left[:-1]) / left[1:])
    assert (np.abs(orders - 3.0) < 0.1).all()


def test_a_body_has_either_law() -> None:
    linear, other = (soft.ball(divisions=2, modes=4, elasticity=law) for law in ("linear", "stvk"))
    assert linear.stvk is None and other.stvk is not None and other.stvk.shape == (14, 14)
    z = np.array([0.1, -0.05, 0.02, 0.04])
    assert linear.energy(z) == pytest.approx(0.5 * z @ (np.diag(linear.stiffness) * z))
    np.testing.assert_allclose(linear.elastic_force(z), linear.stiffness @ z)
    np.testing.assert_array_equal(linear.elastic_tangent(z), linear.stiffness)
    model = soft.Model(soft.ball_mesh(0.2, 2), 1e4, 0.4, 250.0)
    full = full_energy(model, np.einsum("nrk,r->nk", model.modes(4)[1], z))
    # scikit-fem's order 4 beside 5 points an axis, on curved elements
    assert other.energy(z) == pytest.approx(full, rel=1e-3)
    step = 1e-6
    for k, axis in enumerate(np.eye(4)):
        ahead, behind = z + step * axis, z - step * axis
        slope = (other.energy(ahead) - other.energy(behind)) / (2.0 * step)
        assert other.elastic_force(z)[k] == pytest.approx(slope, rel=1e-6)
        bend = (other.elastic_force(ahead) - other.elastic_force(behind)) / (2.0 * step)
        np.testing.assert_allclose(other.elastic_tangent(z)[k], bend, rtol=1e-6, atol=1e-3)


def test_it_is_checked() -> None:
    with pytest.raises(UnknownNameError, match="elasticity 'cubic' is not known; valid: linear, s"):
        soft.ball(divisions=2, elasticity="cubic")
    with pytest.raises(ValueRangeError, match="modes is 41, must be at most 40"):
        soft.ball(divisions=2, modes=41, elasticity="stvk")
    with pytest.raises(ShapeError, match="z has shape"):
        soft.ball(divisions=2, modes=3).energy([1.0])
