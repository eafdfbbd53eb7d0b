"""St. Venant–Kirchhoff's elasticity of a reduced body: forces that are cubic in its coordinates.

Its strain, E = ½(∇u + ∇uᵀ + ∇uᵀ∇u), is quadratic in z, so that the energy ½∫E : C : E is a Gram
matrix between w = (z, all z_i z_j), made once (Barbič and James 2005 have its tensors).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from octo.checks import Array
from octo.soft.assembly import STIFFNESS_ORDER, library, placed
from octo.soft.material import Material
from octo.soft.tetrahedra import Tetrahedra
from octo.world.spline import Indices

MOST = 40  # modes: the matrix has their number to the fourth power over four entries
HELD = 4e6  # doubles at a time
# of a symmetric matrix: xx, yy, zz and √2 (xy, xz, yz), so that squares sum to its own
ROWS, COLUMNS = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])
PARTS = np.sqrt([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])


def products(r: int) -> tuple[Indices, Indices]:
    """Which two coordinates each product in w is of: (r (r + 1)/2,) each, the first the lower."""
    first, second = np.triu_indices(r)
    return first.astype(np.int64), second.astype(np.int64)


def gram(mesh: Tetrahedra, material: Material, shapes: Array) -> Array:
    """The matrix (m, m), m = r + r (r + 1)/2, of which ½ wᵀ(·)w is the elastic energy (J).

    Parameters
    ----------
    mesh, material: of the full model.
    shapes: (n, r, 3) kg^-½, the modes at the nodes.
    """
    slopes, weights = _slopes(mesh, shapes)
    r = len(slopes)
    first, second = products(r)
    share = np.where(first == second, 0.5, 1.0)[:, None, None, None]
    lame, shear = material.lame
    law = 2.0 * shear * np.eye(6)
    law[:3, :3] += lame
    root = np.linalg.cholesky(law)
    size = r + len(first)
    total = np.zeros((size, size))
    step = max(1, int(HELD / (15 * size)))
    for begin in range(0, len(weights), step):
        own = slopes[..., begin : begin + step]
        turned = np.einsum("icap,icbp->iabp", own[first], own[second])
        strain = np.concatenate([own, share * turned])  # (m, 3, 3, points)
        both = 0.5 * (strain[:, ROWS, COLUMNS] + strain[:, COLUMNS, ROWS])
        every = np.einsum("ck,mcp->mkp", PARTS[:, None] * root, both)
        # one of the weights of that order is negative
        heavy = (every * weights[begin : begin + step]).reshape(size, -1)
        total += heavy @ every.reshape(size, -1).T
    return 0.5 * (total + total.T)


def energy(matrix: Array, z: Array) -> float:
    """J."""
    w = terms(z)
    return float(0.5 * w @ matrix @ w)


def force(matrix: Array, z: Array) -> Array:
    """(…, r) what the energy grows by with each coordinate, J a kg^½ m, of z (…, r)."""
    return np.asarray(np.einsum("...mk,...m->...k", term_slopes(z), terms(z) @ matrix))


def tangent(matrix: Array, z: Array) -> Array:
    """(…, r, r) rad²/s², what ``force`` grows by with each coordinate."""
    slopes = term_slopes(z)
    made = slopes.swapaxes(-1, -2) @ matrix @ slopes
    return np.asarray(made + paired(terms(z) @ matrix, z.shape[-1]))


def curvature(matrix: Array, z: Array, lam: Array) -> Array:
    """∂²(lam·force)/∂z² (…, r, r) of lam (…, r)."""
    count, slopes, along = z.shape[-1], term_slopes(z), term_slopes(lam)
    along[..., :count, :] = 0.0
    both = along.swapaxes(-1, -2) @ matrix @ slopes
    pull = np.einsum("...mk,...k->...m", slopes, lam) @ matrix
    return np.asarray(both + both.swapaxes(-1, -2) + paired(pull, count))


def terms(z: Array) -> Array:
    """w (…, m)."""
    first, second = products(z.shape[-1])
    return np.concatenate([z, z[..., first] * z[..., second]], axis=-1)


def term_slopes(z: Array) -> Array:
    """∂w/∂z (…, m, r)."""
    count = z.shape[-1]
    first, second = products(count)
    made = np.zeros((*z.shape[:-1], count + len(first), count))
    each, own = count + np.arange(len(first)), np.arange(count)
    made[..., own, own] = 1.0
    made[..., each, first] += z[..., second]
    made[..., each, second] += z[..., first]
    return made


def paired(pull: Array, count: int) -> Array:
    """Σ_ij pull_ij ∂²(z_i z_j) (…, r, r) of pull (…, m)."""
    first, second = products(count)
    made = np.zeros((*pull.shape[:-1], count, count))
    made[..., first, second] += pull[..., count:]
    made[..., second, first] += pull[..., count:]
    return made


def _slopes(mesh: Tetrahedra, shapes: Array) -> tuple[Array, Array]:
    """∂φ_a/∂x_b (r, 3, 3, points) of all modes at all points of quadrature, and the volumes
    (points,) m³ that those stand for."""
    skfem = library("skfem", "a soft body")
    shape, order = placed(skfem, mesh)
    basis: Any = skfem.Basis(shape, skfem.ElementTetP2(), intorder=STIFFNESS_ORDER)
    weights = np.asarray(basis.dx).ravel()
    made = np.empty((shapes.shape[1], 3, 3, len(weights)))
    for k in range(len(made)):
        for a in range(3):
            made[k, a] = basis.interpolate(shapes[order, k, a]).grad.reshape(3, -1)
    return made, weights
