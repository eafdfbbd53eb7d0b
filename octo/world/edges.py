"""Around sharp edges the distance has kinks: there its grid has samples at a quarter of the cell.

A spline through samples rounds a kink, by up to a quarter of their distance where two planes meet
at a right angle and a third of it where three do. Outside of an inner edge and inside of an outer
one the kink leaves the edge and goes on. It is kept as sharp as a quarter of the cell makes it
where |φ| ≤ KEPT cells, less from there on, and as it was beyond LEFT cells: coefficients around
edges are those of the grid's own spline plus corrections, as those of the grid are of the coarse
one's (bricks.py).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from octo.checks import Array
from octo.world.bricks import (
    WIDTH,
    WITHIN,
    Band,
    Distance,
    Progress,
    chunks,
    corrections,
    keys,
    of_around,
    of_coarse,
    refinement,
    stored_of,
    values_of,
)
from octo.world.lattice import BRICK, PARTS, RATIO, Lattice, Split
from octo.world.spline import BEYOND, Indices, Mask

KEPT, LEFT = 1.0, 2.0  # cells of |φ|
NEAR = 3.5  # cells from an edge: a kink at a right angle is 2.8 away where |φ| is LEFT
KINK = 0.05  # cells between coefficient and sample, from which on a kink is looked for
BESIDE = 1.0  # cells, along each axis, from such a sample
OFF = 0.05  # cells between spline and distance, from which on the spline is corrected
EXACT = 1e-4  # of what is corrected
CORNERS = np.argwhere(np.ones((2, 2, 2)))


def around_edges(
    made: Lattice, band: Band, distance: Distance, edges: Array, progress: Progress
) -> Lattice:
    """A grid and what it has around sharp edges.

    Parameters
    ----------
    made, band: of near_surface.
    distance: of which they were made.
    edges: (k, 3) m, points along the sharp edges, no farther apart than a cell.
    """
    kinks, parts = _near_kinks(made, band, edges)
    if not len(parts):
        return made
    count = RATIO * np.array(made.places.shape)
    own, kinked = _Around(made, parts), _Around(made, parts, kinks)
    core, active, residual = [], [], []
    for k, chunk in enumerate(chunks(parts)):
        asked = of_around(kinked.of(chunk), _beside()) > 0.0
        off = _off(made, distance, chunk, asked, of_around(own.of(chunk), values_of()))
        wanted = np.abs(off) > OFF * made.cell
        some = wanted.any(axis=(1, 2, 3))
        core.append(chunk[some])
        active.append(wanted[some])
        residual.append(np.where(wanted, off, 0.0)[some])
        progress(min(1.0, (k + 1) * len(chunk) / len(parts)))
    bricks, mask = np.concatenate(core), np.concatenate(active)
    if not len(bricks):
        return made
    stored = stored_of(bricks, mask, count)
    own = _Around(made, stored)
    found = np.concatenate([of_around(own.of(one), refinement()) for one in chunks(stored)])
    at = np.searchsorted(keys(stored, count), keys(bricks, count))
    found[at] += corrections(np.concatenate(residual), mask, bricks, count, EXACT)
    return replace(made, split=_split(stored, found))


def _near_kinks(made: Lattice, band: Band, edges: Array) -> tuple[Array, Indices]:
    """At which samples of the grid's bricks (m, 8, 8, 8) there is a kink, near an edge: 1.0; and
    the parts (n, 3), in order, around them."""
    places = made.places[tuple(band.bricks.T)]
    far = np.abs(band.values) > (LEFT + 0.5) * made.cell
    own = made.bricks[places]
    brick, *within = np.nonzero(band.active & ~far & (np.abs(own - band.values) > KINK * made.cell))
    samples = BRICK * band.bricks[brick] + WITHIN[np.stack(within, axis=1)]
    where = made.corner + made.cell * samples
    away = cKDTree(edges).query(where, distance_upper_bound=NEAR * made.cell)[0]
    near = np.isfinite(away)
    kinks = np.zeros(made.bricks.shape)
    kinks[(places[brick[near]], *(axis[near] for axis in within))] = 1.0
    first = (2 * samples[near] + 3) // 4 - 1  # of the two along each axis
    return kinks, _once((first[:, None] + CORNERS).reshape(-1, 3), made, RATIO)


def _once(bricks: Indices, made: Lattice, ratio: int = 1) -> Indices:
    """Bricks (n, 3), or parts where ``ratio`` is RATIO, in order."""
    count = ratio * np.array(made.places.shape)
    return np.asarray(bricks[np.unique(keys(bricks, count), return_index=True)[1]])


def _beside() -> Array:
    """(8, 6): 1 where a sample of a part is beside one of the grid, along one axis."""
    apart = np.abs(WITHIN[:, None] / RATIO - (np.arange(WIDTH) - BEYOND))
    return np.asarray(apart <= BESIDE, dtype=float)


def _off(made: Lattice, distance: Distance, parts: Indices, asked: Mask, through: Array) -> Array:
    """(n, 8, 8, 8) m, by how much the spline is to be corrected at samples of parts that are
    ``asked`` for, where it is ``through`` m; at others 0."""
    cell = made.cell
    asked = asked & (np.abs(through) < (LEFT + 0.5) * cell)
    grid = np.stack(np.meshgrid(WITHIN, WITHIN, WITHIN, indexing="ij"), axis=-1)
    index = (BRICK * parts[:, None, None, None, :] + grid)[asked]
    true = distance(made.corner + cell / RATIO * index)
    share = np.clip((LEFT - np.abs(true) / cell) / (LEFT - KEPT), 0.0, 1.0)
    off = np.zeros(through.shape)
    off[asked] = share**2 * (3.0 - 2.0 * share) * (true - through[asked])
    return off


class _Around:
    """What stands at a grid's samples, around parts: its coefficients, elsewhere of the coarse
    lattice; or other ``numbers`` (m, 8, 8, 8) of its bricks, elsewhere 0."""

    def __init__(self, made: Lattice, parts: Indices, numbers: Array | None = None):
        ends = 2 * parts, 2 * parts + WIDTH - 1
        each = np.concatenate([np.where(corner, ends[1], ends[0]) // BRICK for corner in CORNERS])
        bricks = _once(each, made)
        missing = bricks[made.places[tuple(bricks.T)] < 0]
        assert made.coarse is not None
        coarse = of_coarse(made.coarse, missing, refinement())
        self.places = made.places.copy()
        self.places[tuple(missing.T)] = len(made.bricks) + np.arange(len(missing))
        own = [made.bricks, coarse] if numbers is None else [numbers, 0.0 * coarse]
        self.numbers = np.concatenate(own)

    def of(self, parts: Indices) -> Array:
        """(n, 6, 6, 6)"""
        taps = [2 * parts[:, k, None] + np.arange(WIDTH) for k in range(3)]
        x, y, z = taps[0][:, :, None, None], taps[1][:, None, :, None], taps[2][:, None, None, :]
        brick = self.places[x // BRICK, y // BRICK, z // BRICK]
        return np.asarray(self.numbers[brick, x % BRICK, y % BRICK, z % BRICK])


def _split(parts: Indices, coefficients: Array) -> Split:
    parent, inner = parts // RATIO, parts % RATIO
    bricks, of = np.unique(parent, axis=0, return_inverse=True)
    places = np.full((len(bricks), PARTS), -1)
    x, y, z = inner.T
    places[of.reshape(-1), (x * RATIO + y) * RATIO + z] = np.arange(len(parts))
    return Split(bricks, places, coefficients)
