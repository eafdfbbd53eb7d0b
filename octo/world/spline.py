"""Cubic B-splines on a lattice of samples: C², through every sample, of plain numbers.

The ends are natural, no curvature across an edge, so that a spline goes on as a straight line there
and stays C². Beyond the edge a place has an image, which tends to one cell from the edge: what is
evaluated at images is smooth everywhere, and what it was at the edge far away. spline.c is the same
in C; the functions here are for machines without a compiler.
"""

from __future__ import annotations

from importlib import resources

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded

from octo.checks import Array

Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]
BEYOND = 2  # coefficients of a lattice beyond each of its edges


def coefficients(samples: Array) -> Array:
    """Coefficients (n + 4, ...) of the spline through samples (n, ...), n ≥ 2, over all axes."""
    for axis in range(samples.ndim):
        rows = np.moveaxis(samples, axis, 0)
        samples = np.moveaxis(extended(_inner(rows)), 0, axis)
    return np.ascontiguousarray(samples)


def _inner(samples: Array) -> Array:
    """Coefficients (n, ...) at the samples, along the first axis."""
    n = len(samples)
    bands = np.zeros((3, n))
    bands[0, 2:] = bands[2, :-2] = 1.0 / 6.0
    bands[1, 1:-1] = 2.0 / 3.0
    bands[1, [0, -1]] = 1.0  # an end without curvature: its coefficient is its sample
    return np.asarray(solve_banded((1, 1), bands, samples.reshape(n, -1))).reshape(samples.shape)


def extended(inner: Array) -> Array:
    """Coefficients (n + 4, ...) of (n, ...), which go on in straight lines along the first axis."""
    low, high = inner[0] - inner[1], inner[-1] - inner[-2]
    before = [inner[0] + k * low for k in range(BEYOND, 0, -1)]
    after = [inner[-1] + k * high for k in range(1, BEYOND + 1)]
    return np.concatenate([before, inner, after])


def images(places: Array, size: float) -> Array:
    """Images of places (k,), in cells from the first of ``size`` samples, and their first three
    derivatives: (k, 4)."""
    last = size - 1.0
    side = np.where(places > last, 1.0, np.where(places < 0.0, -1.0, 0.0))
    beyond = np.minimum(np.where(side > 0.0, places - last, -places), 1e30)
    beyond = np.where(side == 0.0, 0.0, beyond)
    inverse = 1.0 / (1.0 + beyond**3)
    root = np.cbrt(inverse)
    square = root * inverse**2
    moved = np.where(side > 0.0, last, 0.0) + side * beyond * root
    return np.stack(
        [
            np.where(side == 0.0, places, moved),
            root * inverse,
            -4.0 * side * beyond**2 * square,
            (28.0 * beyond**3 * inverse - 8.0) * beyond * square,
        ],
        axis=1,
    )


def weights(image: Array, size: float, inverse: float) -> tuple[Indices, Array]:
    """Where the first of the four coefficients around each image is stored, (k,), and their
    weights with three derivatives each, (k, 4, 4).

    Parameters
    ----------
    image: (k, 4), of cells.
    size: samples of the lattice.
    inverse: 1/m, what the derivatives of images are multiplied by: cells in a metre.
    """
    at = np.nan_to_num(image[:, 0], nan=-1.0)
    cell = np.clip(np.floor(at), -1, size - 1).astype(np.int64)
    t = image[:, 0] - cell
    s, one = 1.0 - t, np.ones_like(t)
    basis = np.stack(
        [
            np.stack([s**3 / 6.0, -0.5 * s * s, s, -one], axis=1),
            np.stack(
                [
                    (0.5 * t - 1.0) * t * t + 2.0 / 3.0,
                    (1.5 * t - 2.0) * t,
                    3.0 * t - 2.0,
                    3.0 * one,
                ],
                axis=1,
            ),
            np.stack(
                [(0.5 * s - 1.0) * s * s + 2.0 / 3.0, (2.0 - 1.5 * s) * s, 3.0 * s - 2.0, -3 * one],
                axis=1,
            ),
            np.stack([t**3 / 6.0, 0.5 * t * t, t, one], axis=1),
        ],
        axis=1,
    )
    first, second, third = ((image[:, d] * inverse**d)[:, None] for d in (1, 2, 3))
    chained = [
        basis[:, :, 0],
        basis[:, :, 1] * first,
        basis[:, :, 2] * first**2 + basis[:, :, 1] * second,
        basis[:, :, 3] * first**3 + 3.0 * basis[:, :, 2] * first * second + basis[:, :, 1] * third,
    ]
    return cell + 1, np.stack(chained, axis=2)


def text(name: str) -> str:
    """C text of the look-ups of a file of this folder, after that of the splines."""
    folder = resources.files("octo.world")
    return "\n".join((folder / file).read_text(encoding="utf-8") for file in ("spline.c", name))
