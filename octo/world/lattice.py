"""A grid of distances as the flat numbers that grid.c looks up.

The spline's coefficients stand in bricks of 8 × 8 × 8; only bricks near the surface are kept. The
spline of a coarse lattice, of four times the cell, is a spline of the fine lattice too: away from
the surface all its coefficients are those, and what stands in bricks passes into it without a
seam. A cell of which a brick is missing is therefore looked up in the coarse lattice. In the same
way there are, around sharp edges, bricks of a lattice of a quarter of the cell. A look-up costs one
spline in all of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from octo.checks import Array
from octo.world import spline
from octo.world.jet import AXES, SIZES
from octo.world.spline import BEYOND, Indices, Mask

BRICK = 8  # coefficients along an edge of a brick
RATIO = 4  # coarse cells in fine ones, and those in cells around edges
PARTS = RATIO**3  # bricks around edges in the place of one
HEAD = 14  # numbers before the table


@dataclass(frozen=True, eq=False)
class Split:
    """What stands around sharp edges, in a lattice of a quarter of the cell.

    Attributes
    ----------
    bricks: (m, 3) of the lattice, those that are divided.
    places: (m, 64) index of each of their parts, −1 where there is none.
    parts: (number, 8, 8, 8) m, coefficients.
    """

    bricks: Indices
    places: Indices
    parts: Array


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
    split: around sharp edges; None where there is nothing of the kind.
    """

    size: Indices
    cell: float
    corner: Array
    places: Indices
    bricks: Array
    coarse: Array | None = None
    split: Split | None = None

    def numbers(self) -> Array:
        """The flat array (size,)."""
        coarse = np.zeros((0, 0, 0)) if self.coarse is None else self.coarse
        samples = np.array(coarse.shape) - 2 * BEYOND
        split = Split(np.empty((0, 3), np.int64), np.empty((0, PARTS), np.int64), np.empty(0))
        split = self.split or split
        second = HEAD + 2 * self.places.size
        first = second + split.places.size
        start = first + coarse.size
        table = np.zeros((*self.places.shape, 2))
        table[..., 0] = _addresses(self.places, start)
        table[(*split.bricks.T, 1)] = second + float(PARTS) * np.arange(len(split.bricks))
        places = _addresses(split.places, start + self.bricks.size)
        head = [*self.size, 1.0 / self.cell, *self.corner, *self.places.shape, *samples, first]
        parts = [head, table, places, coarse, self.bricks, split.parts]
        return np.concatenate([np.asarray(part, dtype=float).ravel() for part in parts])


def _addresses(places: Indices, start: int) -> Array:
    """Where bricks of these indices stand; 0 where there is none."""
    return np.asarray(np.where(places < 0, 0.0, start + float(BRICK**3) * places))


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
    around, weights = np.empty((len(points), 4, 4, 4)), np.empty((3, len(points), 4, 4))
    rest = np.arange(len(points))
    fine = RATIO * (size - 1.0) + 1.0
    levels = (
        (RATIO, fine, _in_parts),
        (1.0, size, _in_bricks),
        (1 / RATIO, own[10:13], _in_coarse),
    )
    for scale, samples, look in levels:
        taps = [spline.weights(scale * images[k][rest], samples[k], inverse) for k in range(3)]
        found, whole = look(own, [first for first, _ in taps])
        around[rest[whole]] = found[whole]
        for axis, (_, weight) in enumerate(taps):
            weights[axis, rest[whole]] = weight[whole]
        rest = rest[~whole]
        if not len(rest):
            break
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


def _bricks(first: list[Indices]) -> tuple[list[Indices], list[Indices]]:
    """Of the 4 × 4 × 4 coefficients from ``first`` on: their bricks, and where they are in them."""
    taps = [index[:, None] + np.arange(4) for index in first]
    shaped = [taps[0][:, :, None, None], taps[1][:, None, :, None], taps[2][:, None, None, :]]
    return [tap // BRICK for tap in shaped], [tap % BRICK for tap in shaped]


def _entries(own: Array, bricks: list[Indices], kind: int) -> Array:
    """Of the table: the places of bricks, or, of kind 1, of the tables of their parts."""
    count = own[7:10].astype(np.int64)
    x, y, z = bricks
    return np.asarray(own[HEAD + 2 * ((x * count[1] + y) * count[2] + z) + kind])


def _coefficients(own: Array, place: Array, within: list[Indices]) -> tuple[Array, Mask]:
    """Coefficients (k, 4, 4, 4) from where they are stored, and (k,) whether all of them are."""
    x, y, z = within
    values = own[place.astype(np.int64) + (x * BRICK + y) * BRICK + z]
    return values, np.asarray((place > 0).all(axis=(1, 2, 3)))


def _in_bricks(own: Array, first: list[Indices]) -> tuple[Array, Mask]:
    bricks, within = _bricks(first)
    return _coefficients(own, _entries(own, bricks, 0), within)


def _in_parts(own: Array, first: list[Indices]) -> tuple[Array, Mask]:
    bricks, within = _bricks(first)
    table = _entries(own, [brick // RATIO for brick in bricks], 1)
    x, y, z = (brick % RATIO for brick in bricks)
    place = own[table.astype(np.int64) + (x * RATIO + y) * RATIO + z]
    return _coefficients(own, np.where(table > 0.0, place, 0.0), within)


def _in_coarse(own: Array, first: list[Indices]) -> tuple[Array, Mask]:
    shape = own[10:13].astype(np.int64) + 2 * BEYOND
    start = int(own[13])
    table = own[start : start + int(np.prod(shape))].reshape(shape)
    x, y, z = (index[:, None] + np.arange(4) for index in first)
    found = table[x[:, :, None, None], y[:, None, :, None], z[:, None, None, :]]
    return np.asarray(found), np.ones(len(found), dtype=bool)
