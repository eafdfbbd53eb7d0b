"""Grids of distances that are computed: each sample near the surface, every fourth one elsewhere.

The coefficients near the surface are those of the coarse lattice's spline plus corrections, which
are zero outside of the band |φ| ≤ BAND cells. So the spline passes through every sample of the band
and into the coarse one without a seam. Around sharp edges it is corrected once more (edges.py).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from octo.checks import Array
from octo.world import spline
from octo.world.lattice import BRICK, RATIO, Lattice
from octo.world.spline import BEYOND, Indices, Mask

Distance = Callable[[Array], Array]  # of points (k, 3) m, (k,) m
Progress = Callable[[float], None]  # told which part is done, 0 to 1
BAND = 4.0  # cells; at the surface the spline feels a sample at this distance by half a percent
REACH = 3  # samples: two coefficients of one cell are so far apart, at most
WIDTH = 6  # coarse coefficients along an axis that those of a brick are made of
EXACT = 1e-13  # of the residual of the corrections, to begin with
CHUNK = 1000  # bricks at a time: 4 MB of samples
# cells from the coarse sample that stands for a brick to its others, and from each to a coarse one
FARTHEST, NEXT = 5.0 * np.sqrt(3.0), 2.0 * np.sqrt(3.0)
WITHIN = np.arange(BRICK) - BEYOND  # samples of a brick, from the one at its first coarse sample
# the 27 directions to the bricks around one, itself among them
AROUND = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class Band:
    """Of bricks (n, 3) with samples in the band: (n, 8, 8, 8) which ones are in it, and their
    distances, m."""

    bricks: Indices
    active: Mask
    values: Array


def near_surface(
    distance: Distance, low: Array, high: Array, cell: float, progress: Progress
) -> tuple[Lattice, Band]:
    """The grid of a signed distance over at least the box from ``low`` to ``high``, (3,) m, and the
    samples that it was made of.

    ``distance`` must not change by more than the way between two points.
    """
    count = np.maximum(np.ceil((high - low) / (BRICK * cell) - 1e-6).astype(np.int64), 1) + 1
    size = BRICK * (count - 1) + 1  # then each brick has a coarse sample
    axes = [low[k] + RATIO * cell * np.arange(2 * count[k] - 1) for k in range(3)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    samples = distance(nodes.reshape(-1, 3)).reshape(nodes.shape[:3])
    coarse = spline.coefficients(samples)
    candidates = np.argwhere(np.abs(samples[::2, ::2, ::2]) <= (BAND + FARTHEST) * cell)
    core, active, values = _sampled(distance, candidates, samples, low, cell, progress)
    stored = stored_of(core, active, count)
    places = np.full(tuple(count), -1)
    places[tuple(stored.T)] = np.arange(len(stored))
    bricks = np.concatenate([of_coarse(coarse, one, refinement()) for one in chunks(stored)])
    through = np.concatenate([of_coarse(coarse, one, values_of()) for one in chunks(core)])
    residual = np.where(active, values - through, 0.0)
    bricks[places[tuple(core.T)]] += corrections(residual, active, core, count)
    return Lattice(size, cell, low, places, bricks, coarse), Band(core, active, values)


def chunks(bricks: Indices) -> Iterator[Indices]:
    yield from (bricks[k : k + CHUNK] for k in range(0, max(len(bricks), 1), CHUNK))


def _sampled(
    distance: Distance, bricks: Indices, coarse: Array, low: Array, cell: float, progress: Progress
) -> tuple[Indices, Mask, Array]:
    """Of the bricks those with samples in the band: their places (n, 3), and of their samples
    (n, 8, 8, 8) which ones are in it, and their distances. ``coarse``: samples."""
    size = RATIO * (np.array(coarse.shape) - 1) + 1
    grid = np.stack(np.meshgrid(WITHIN, WITHIN, WITHIN, indexing="ij"), axis=-1)
    core, active, values = [], [], []
    for k, chunk in enumerate(chunks(bricks)):
        index = BRICK * chunk[:, None, None, None, :] + grid
        # the spline stays natural at the edges of the lattice
        inner = ((index >= REACH) & (index < size - REACH)).all(axis=-1)
        at = np.clip(np.rint(index / RATIO).astype(np.int64), 0, np.array(coarse.shape) - 1)
        asked = inner & (np.abs(coarse[tuple(np.moveaxis(at, -1, 0))]) <= (BAND + NEXT) * cell)
        found = np.zeros(asked.shape)
        found[asked] = distance(low + cell * index[asked])
        near = asked & (np.abs(found) <= BAND * cell)
        some = near.any(axis=(1, 2, 3))
        core.append(chunk[some])
        active.append(near[some])
        values.append(found[some])
        progress(min(1.0, (k + 1) * CHUNK / max(len(bricks), 1)))
    return np.concatenate(core), np.concatenate(active), np.concatenate(values)


def keys(bricks: Indices, count: Indices) -> Indices:
    """One number (n,) of each brick (n, 3), in the order of the rows; next to the lattice too."""
    x, y, z = (bricks + 1).T
    return np.asarray((x * (count[1] + 2) + y) * (count[2] + 2) + z)


def stored_of(core: Indices, active: Mask, count: Indices) -> Indices:
    """The bricks (n, 3), in order, that have a coefficient in one cell with an active one."""
    part = {-1: slice(0, REACH), 0: slice(None), 1: slice(BRICK - REACH, None)}
    found = []
    for step in AROUND:
        x, y, z = (part[int(k)] for k in step)
        to = core[active[:, x, y, z].any(axis=(1, 2, 3))] + step
        found.append(to[((to >= 0) & (to < count)).all(axis=1)])
    each = np.concatenate(found)
    return each[np.unique(keys(each, count), return_index=True)[1]]


def refinement() -> Array:
    """(8, 6): coefficients of the fine lattice from those of the coarse one, along one axis."""
    box = np.ones(RATIO)
    mask = np.convolve(np.convolve(box, box), np.convolve(box, box)) / RATIO**3
    apart = WITHIN[:, None] - RATIO * (np.arange(WIDTH) - BEYOND) + len(mask) // 2
    inside = (apart >= 0) & (apart < len(mask))
    return np.where(inside, mask[np.clip(apart, 0, len(mask) - 1)], 0.0)


def values_of() -> Array:
    """(8, 6): what the coarse spline is at the samples of the fine lattice, along one axis."""
    apart = np.abs(WITHIN[:, None] / RATIO - (np.arange(WIDTH) - BEYOND))
    near = 2.0 / 3.0 + (0.5 * apart - 1.0) * apart**2
    return np.where(apart < 1.0, near, np.maximum(2.0 - apart, 0.0) ** 3 / 6.0)


def of_coarse(coarse: Array, bricks: Indices, matrix: Array) -> Array:
    """(n, 8, 8, 8) of bricks (n, 3) from the coarse coefficients, by a matrix along each axis."""
    last = np.array(coarse.shape) - 1  # beyond it no sample needs one
    x, y, z = (np.minimum(2 * bricks[:, k, None] + np.arange(WIDTH), last[k]) for k in range(3))
    return of_around(coarse[x[:, :, None, None], y[:, None, :, None], z[:, None, None, :]], matrix)


def of_around(around: Array, matrix: Array) -> Array:
    """(n, 8, 8, 8) of the coarse coefficients (n, 6, 6, 6) around each brick, in the same way."""
    for _ in range(3):  # the axis that was last comes first
        around = np.moveaxis(around @ matrix.T, -1, 1)
    return np.ascontiguousarray(around)


def _neighbours(core: Indices, count: Indices) -> Indices:
    """(27, n) places of the bricks around each one, which are in order; a brick that is not there
    has the place n."""
    own = keys(core, count)
    found = []
    for step in AROUND:
        wanted = keys(core + step, count)
        at = np.minimum(np.searchsorted(own, wanted), len(own) - 1)
        found.append(np.where(own[at] == wanted, at, len(own)))
    return np.stack(found)


def corrections(
    residual: Array, active: Mask, core: Indices, count: Indices, exact: float = EXACT
) -> Array:
    """Active coefficients (n, 8, 8, 8) of a spline that is ``residual`` at the active samples of
    bricks (n, 3), by conjugate gradients: the matrix is symmetric, its condition at most 27."""
    near = _neighbours(core, count)
    found = np.zeros_like(residual)
    direction = np.concatenate([residual, np.zeros((1, *residual.shape[1:]))])
    rest, left = residual.copy(), float(np.vdot(residual, residual))
    goal = exact**2 * left
    while left > goal:
        product = _at_samples(direction, near) * active
        step = left / float(np.vdot(direction[:-1], product))
        found += step * direction[:-1]
        rest -= step * product
        before, left = left, float(np.vdot(rest, rest))
        direction[:-1] *= left / before
        direction[:-1] += rest
    return found


def _at_samples(coefficients: Array, near: Indices) -> Array:
    """(n, 8, 8, 8) a spline at the samples of bricks; coefficients (n + 1, 8, 8, 8), the last ones
    0."""
    to = {-1: slice(0, 1), 0: slice(1, -1), 1: slice(-1, None)}
    source = {-1: slice(-1, None), 0: slice(None), 1: slice(0, 1)}
    found = []
    for chunk in chunks(near.T):
        around = np.empty((len(chunk), *[BRICK + 2] * 3))
        for step, places in zip(AROUND, chunk.T, strict=True):
            x, y, z = map(int, step)
            part = coefficients[:, source[x], source[y], source[z]]
            around[:, to[x], to[y], to[z]] = part[places]
        for axis in (1, 2, 3):
            rows = np.moveaxis(around, axis, 0)
            around = np.moveaxis((rows[:-2] + rows[2:]) / 6.0 + rows[1:-1] * (2.0 / 3.0), 0, axis)
        found.append(around)
    return np.concatenate(found)
