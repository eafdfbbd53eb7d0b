"""Grids of distances that are computed: each sample near the surface, every fourth one elsewhere.

The coefficients near the surface are those of the coarse lattice's spline plus corrections, which
are zero outside of the band |φ| ≤ BAND cells. So the spline passes through every sample of the band
and into the coarse one without a seam.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

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


def near_surface(
    distance: Distance, low: Array, high: Array, cell: float, progress: Progress
) -> Lattice:
    """The grid of a signed distance over at least the box from ``low`` to ``high``, (3,) m.

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
    stored = np.argwhere(_stored(core, active, count))
    places = _places(stored, count)
    bricks = np.concatenate([_of_coarse(coarse, one, _refinement()) for one in _chunks(stored)])
    of_coarse = np.concatenate([_of_coarse(coarse, one, _values()) for one in _chunks(core)])
    residual = np.where(active, values - of_coarse, 0.0)
    bricks[places[tuple(core.T)]] += _corrections(residual, active, _neighbours(core, count))
    return Lattice(size, cell, low, places, bricks, coarse)


def _chunks(bricks: Indices) -> Iterator[Indices]:
    yield from (bricks[k : k + CHUNK] for k in range(0, max(len(bricks), 1), CHUNK))


def _places(bricks: Indices, count: Indices) -> Indices:
    places = np.full(tuple(count), -1)
    places[tuple(bricks.T)] = np.arange(len(bricks))
    return places


def _sampled(
    distance: Distance, bricks: Indices, coarse: Array, low: Array, cell: float, progress: Progress
) -> tuple[Indices, Mask, Array]:
    """Of the bricks those with samples in the band: their places (n, 3), and of their samples
    (n, 8, 8, 8) which ones are in it, and their distances. ``coarse``: samples."""
    size = RATIO * (np.array(coarse.shape) - 1) + 1
    grid = np.stack(np.meshgrid(WITHIN, WITHIN, WITHIN, indexing="ij"), axis=-1)
    core, active, values = [], [], []
    for k, chunk in enumerate(_chunks(bricks)):
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


def _stored(core: Indices, active: Mask, count: Indices) -> Mask:
    """(bx, by, bz) which bricks have a coefficient in one cell with an active one."""
    kept = np.zeros(tuple(count), dtype=bool)
    part = {-1: slice(0, REACH), 0: slice(None), 1: slice(BRICK - REACH, None)}
    for step in AROUND:
        x, y, z = (part[int(k)] for k in step)
        to = core[active[:, x, y, z].any(axis=(1, 2, 3))] + step
        to = to[((to >= 0) & (to < count)).all(axis=1)]
        kept[tuple(to.T)] = True
    return kept


def _refinement() -> Array:
    """(8, 6): coefficients of the fine lattice from those of the coarse one, along one axis."""
    box = np.ones(RATIO)
    mask = np.convolve(np.convolve(box, box), np.convolve(box, box)) / RATIO**3
    apart = WITHIN[:, None] - RATIO * (np.arange(WIDTH) - BEYOND) + len(mask) // 2
    inside = (apart >= 0) & (apart < len(mask))
    return np.where(inside, mask[np.clip(apart, 0, len(mask) - 1)], 0.0)


def _values() -> Array:
    """(8, 6): what the coarse spline is at the samples of the fine lattice, along one axis."""
    apart = np.abs(WITHIN[:, None] / RATIO - (np.arange(WIDTH) - BEYOND))
    near = 2.0 / 3.0 + (0.5 * apart - 1.0) * apart**2
    return np.where(apart < 1.0, near, np.maximum(2.0 - apart, 0.0) ** 3 / 6.0)


def _of_coarse(coarse: Array, bricks: Indices, matrix: Array) -> Array:
    """(n, 8, 8, 8) of bricks (n, 3) from the coarse coefficients, by a matrix along each axis."""
    last = np.array(coarse.shape) - 1  # beyond it no sample needs one
    x, y, z = (np.minimum(2 * bricks[:, k, None] + np.arange(WIDTH), last[k]) for k in range(3))
    around = coarse[x[:, :, None, None], y[:, None, :, None], z[:, None, None, :]]
    for _ in range(3):  # the axis that was last comes first
        around = np.moveaxis(around @ matrix.T, -1, 1)
    return np.ascontiguousarray(around)


def _neighbours(core: Indices, count: Indices) -> Indices:
    """(27, n) places of the bricks around each one; a brick that is not there has the place n."""
    places = np.pad(_places(core, count), 1, constant_values=-1)
    found = np.stack([places[tuple((core + 1 + step).T)] for step in AROUND])
    return np.where(found < 0, len(core), found)


def _corrections(residual: Array, active: Mask, near: Indices) -> Array:
    """Active coefficients (n, 8, 8, 8) of a spline that is ``residual`` at the active samples, by
    conjugate gradients: the matrix is symmetric, its condition at most 27."""
    found = np.zeros_like(residual)
    direction = np.concatenate([residual, np.zeros((1, *residual.shape[1:]))])
    rest, left = residual.copy(), float(np.vdot(residual, residual))
    goal = EXACT**2 * left
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
    for chunk in _chunks(near.T):
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
