"""A grid of distances as the flat numbers that grid.c looks up.

The spline's coefficients stand in bricks of 8 × 8 × 8; only bricks near the surface are kept. The
spline of a coarse lattice, of four times the cell, is a spline of the fine lattice too: away from
the surface all its coefficients are those, and what stands in bricks passes into it without a
seam. A cell of which a brick is missing is therefore looked up in the coarse lattice, and a look-up
costs one spline either way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from octo.checks import Array
from octo.world import spline
from octo.world.jet import AXES, SIZES
from octo.world.spline import BEYOND, Indices, Mask

BRICK = 8  # coefficients along an edge of a brick
RATIO = 4  # coarse cells in fine ones
HEAD = 14  # numbers before the table


@dataclass(frozen=True, eq=False)
class Lattice:
    """The parts of a grid's numbers.

    Attributes
    ----------
    size: (3,) samples of the fine lattice.
    cell: m.
    corner: (3,) m, of the first sample.
    places: (bx, by, bz) index of a brick, −1 where there is none; coefficient k of an axis is in
        brick k // 8.
    bricks: (number, 8, 8, 8) m, coefficients.
    coarse: (cx + 4, cy + 4, cz + 4) m, coefficients of the coarse lattice; None where no brick is
        missing.
    """

    size: Indices
    cell: float
    corner: Array
    places: Indices
    bricks: Array
    coarse: Array | None = None

    def numbers(self) -> Array:
        """The flat array (size,)."""
        coarse = np.zeros((0, 0, 0)) if self.coarse is None else self.coarse
        samples = np.array(coarse.shape) - 2 * BEYOND
        first = HEAD + self.places.size
        start = first + coarse.size
        table = np.where(self.places < 0, 0.0, start + float(BRICK**3) * self.places)
        head = [*self.size, 1.0 / self.cell, *self.corner, *self.places.shape, *samples, first]
        parts = [head, table.ravel(), coarse.ravel(), self.bricks.ravel()]
        return np.concatenate([np.asarray(part, dtype=float) for part in parts])


def bricks_of(size: Indices) -> Indices:
    """How many bricks hold the coefficients of a lattice, along each axis."""
    return -(-(size + 2 * BEYOND) // BRICK)


def dense(values: Array, cell: float, corner: Array) -> Lattice:
    """The grid of samples (nx, ny, nz) m, with all bricks."""
    table = spline.coefficients(values)
    size = np.array(values.shape)
    count = bricks_of(size)
    table = np.pad(table, [(0, BRICK * n - m) for n, m in zip(count, table.shape, strict=True)])
    split = table.reshape([k for n in count for k in (n, BRICK)])
    bricks = split.transpose(0, 2, 4, 1, 3, 5).reshape(-1, BRICK, BRICK, BRICK)
    return Lattice(size, cell, corner, np.arange(len(bricks)).reshape(count), bricks)


def jets(own: Array, points: Array, order: int) -> Array:
    """Jets (k, SIZES[order]) of a grid's numbers at points (k, 3) m of its frame."""
    size, inverse, corner = own[:3], own[3], own[4:7]
    places = (points - corner) * inverse
    images = [spline.images(places[:, axis], size[axis]) for axis in range(3)]
    found = [spline.weights(images[axis], size[axis], inverse) for axis in range(3)]
    around, whole = _in_bricks(own, [index for index, _ in found])
    weights = [weight for _, weight in found]
    if not whole.all():
        rest = ~whole
        scaled = [image[rest] / RATIO for image in images]
        coarse = [spline.weights(scaled[k], own[10 + k], inverse) for k in range(3)]
        around[rest] = _in_coarse(own, [index for index, _ in coarse])
        for weight, (_, other) in zip(weights, coarse, strict=True):
            weight[rest] = other
    table = np.einsum("kabc,kaf,kbe,kcd->kfed", around, *weights, optimize=True)
    powers = [tuple(axes.count(axis) for axis in range(3)) for axes in AXES[: SIZES[order]]]
    jet = np.stack([table[:, f, e, d] for f, e, d in powers], axis=1)
    for axis in range(3):  # outside: and how far the point is from its image
        u, image = places[:, axis], images[axis]
        side = np.where(u < 0.0, -1.0, np.where(u > size[axis] - 1.0, 1.0, 0.0))
        away = [u - image[:, 0], 1.0 - image[:, 1], -image[:, 2], -image[:, 3]]
        for d in range(order + 1):
            k = AXES.index((axis,) * d)
            jet[:, k] += side * away[d] * inverse ** (d - 1)
    return jet


def _in_bricks(own: Array, first: list[Indices]) -> tuple[Array, Mask]:
    """Coefficients (k, 4, 4, 4) from where they are stored, and (k,) whether all of them are."""
    count = own[7:10].astype(np.int64)
    taps = [index[:, None] + np.arange(4) for index in first]
    x, y, z = (tap // BRICK for tap in taps)
    x, y = x[:, :, None, None], y[:, None, :, None]
    place = own[HEAD + (x * count[1] + y) * count[2] + z[:, None, None, :]].astype(np.int64)
    x, y, z = (tap % BRICK for tap in taps)
    x, y = x[:, :, None, None], y[:, None, :, None]
    values = own[place + (x * BRICK + y) * BRICK + z[:, None, None, :]]
    return values, np.asarray((place > 0).all(axis=(1, 2, 3)))


def _in_coarse(own: Array, first: list[Indices]) -> Array:
    shape = own[10:13].astype(np.int64) + 2 * BEYOND
    start = int(own[13])
    table = own[start : start + int(np.prod(shape))].reshape(shape)
    x, y, z = (index[:, None] + np.arange(4) for index in first)
    return np.asarray(table[x[:, :, None, None], y[:, None, :, None], z[:, None, None, :]])
