"""What a controller plans on in a world: its ground as one smooth map of heights."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from octo.errors import ValueRangeError
from octo.model.quantities import Array
from octo.world.drawn import everywhere
from octo.world.shapes import Ground, HeightField
from octo.world.world import World

WIDTH = 0.25  # of ℓ, standard deviation of the weights of a mean height: docs/notes/mpc.md
FINE = 0.25  # of that width, between two samples; as much as the width where the world is wide
COARSE = 4  # samples, between two places from which the ground beside them is looked for
STEP = 1.0  # of ℓ, over the ground beside it from which the ground of a place is looked for
ENDLESS = 20.0  # m, of a slope without an end around what has one
MOST = 1_000_000  # samples


def smooth_ground(world: World, place: Array, length: float) -> World:
    """A world's ground as a map of mean heights, on which edges are ramps; a world of planes as it
    is.

    The ground is what can be walked on from ``place``: at each place the first surface below the
    height that is ℓ over the ground beside it. What hangs higher is no ground.

    Parameters
    ----------
    world: all its shapes. Beyond them the ground goes on level.
    place: (3,) m, of the robot's base. length: ℓ, m, its height over the ground.

    Raises
    ------
    ValueRangeError: the world is too wide for a map.
    """
    if all(isinstance(shape, Ground) for shape in world.shapes):
        return world
    width = WIDTH * length
    low, high = _extent(world, place)
    cell = max(FINE * width, float(np.sqrt((high - low).prod() / MOST)))
    count = np.ceil((high - low) / cell).astype(int) + 1
    if cell > width:
        wide = " x ".join(f"{size:.3g}" for size in high - low)
        raise ValueRangeError(
            f"the world is {wide} m wide, a controller has a map of at most "
            f"{np.sqrt(MOST) * width:.0f} m square: cut it to where the robot walks"
        )
    heights = _heights(world, low, count, cell, (place, STEP * length))
    smooth = ndimage.gaussian_filter(heights, width / cell, mode="nearest")
    return World([HeightField(smooth, cell, low, smooth=True, name="smooth ground")])


def _extent(world: World, place: Array) -> tuple[Array, Array]:
    """The lowest and the highest (2,) m of what a map shows."""
    found = np.stack([everywhere(world.shapes), np.tile(place[:2], (2, 1))])
    margin = 0.0
    for shape in world.shapes:
        if isinstance(shape, Ground) and not np.isfinite(shape.bounds()[1, 2]):
            margin = ENDLESS
    return found.min(axis=(0, 1)) - margin, found.max(axis=(0, 1)) + margin


def _heights(
    world: World, low: Array, count: NDArray[np.intp], cell: float, start: tuple[Array, float]
) -> Array:
    """Heights (nx, ny) m at samples from ``low`` (2,) m on; ``start``: a place (3,) m over the
    ground, and how much higher than the ground beside it a place is looked at from, m."""
    place, step = start
    coarse = ndimage.maximum_filter(_levels(world, low, count, cell, start), size=3)
    index = np.indices(tuple(count)).reshape(2, -1).T
    near = np.minimum((index + COARSE // 2) // COARSE, np.array(coarse.shape) - 1)
    tops = coarse[near[:, 0], near[:, 1]] + step
    heights = world.below(np.column_stack([low + cell * index, tops]))
    there = np.isfinite(heights)
    # where there is nothing a step would be into the deep
    heights[~there] = heights[there].min(initial=float(place[2])) - step
    return heights.reshape(tuple(count))


def _levels(
    world: World, low: Array, count: NDArray[np.intp], cell: float, start: tuple[Array, float]
) -> Array:
    """The same at every fourth sample, from the place of the start on outwards: a height that has
    nothing below it is that of its neighbour."""
    place, step = start
    wide = COARSE * cell
    shape = tuple((count - 1) // COARSE + 1)
    level = np.full(shape, -np.inf)
    at = np.clip(np.rint((place[:2] - low) / wide).astype(int), 0, np.array(shape) - 1)
    below = float(world.below(place[None])[0])
    level[tuple(at)] = below if np.isfinite(below) else place[2]
    while np.isinf(level).any():
        around = ndimage.maximum_filter(level, size=3)
        fresh = np.isinf(level) & np.isfinite(around)
        highest = around[fresh]
        places = np.column_stack([low + wide * np.argwhere(fresh), highest + step])
        found = world.below(places)
        level[fresh] = np.where(np.isfinite(found), found, highest)
    return level
