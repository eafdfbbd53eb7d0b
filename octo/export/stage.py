"""What stands still: the ground as a chequered plane or heights, and the shapes of a world."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from octo.model.figure import Surface, tile
from octo.model.quantities import Array
from octo.model.skins import Skin
from octo.picture import STONE, TILES
from octo.result.trajectory import Trajectory
from octo.world.drawn import drawn
from octo.world.sampled import Heights

MOST_TILES = 10_000  # of a plane; a larger one has larger tiles


def stage(motion: Trajectory) -> list[tuple[str, list[Skin]]]:
    """Names and surfaces, in the world; nothing where a motion has no ground."""
    ground, scale = motion.ground, motion.extent
    if not ground or scale is None:
        return []
    around = np.array([[ground[axis][end] for axis in "xy"] for end in (0, -1)])
    if motion.world is None:
        found = Heights.of(ground)
        assert found is not None
        chequered = found.flat and _tiled(around, scale, found.height)
        return [("ground", chequered or [_heights(found)])]
    parts = []
    for k, one in enumerate(drawn(motion.world.shapes, around)):
        skins = [Skin(Surface(one.vertices, one.faces), STONE)]
        if one.plane is not None and one.plane[2] > 0.0:
            skins = _tiled(around, scale, one.height)
        parts.append((one.name or f"shape_{k}", skins))
    return parts


def _tiled(around: Array, scale: float, height: Callable[[Array], Array]) -> list[Skin]:
    """Squares of a plane in two colours over ``around`` (2, 2) m, the least and the largest x and
    y."""
    edge = tile(scale)
    while np.prod(np.ceil(np.ptp(around, axis=0) / edge)) > MOST_TILES:
        edge *= 2.0
    first, last = np.floor(around[0] / edge).astype(int), np.ceil(around[1] / edge).astype(int)
    cells = np.stack(np.meshgrid(*map(np.arange, first, last), indexing="ij"), -1).reshape(-1, 2)
    corners = edge * (cells[:, None] + [(0, 0), (1, 0), (1, 1), (0, 1)])  # (k, 4, 2) m
    skins = []
    for odd, color in enumerate(TILES):
        own = corners[cells.sum(axis=1) % 2 == odd].reshape(-1, 2)
        faces = np.add.outer(4 * np.arange(len(own) // 4), [(0, 1, 2), (0, 2, 3)]).reshape(-1, 3)
        if len(own):
            skins.append(Skin(Surface(np.column_stack([own, height(own)]), faces), color))
    return skins


def _heights(ground: Heights) -> Skin:
    x, y = np.meshgrid(ground.x, ground.y, indexing="ij")
    index = np.arange(x.size).reshape(x.shape)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = [np.stack(corner, axis=-1).reshape(-1, 3) for corner in ((a, b, c), (a, c, d))]
    vertices = np.stack([x, y, ground.z], axis=-1).reshape(-1, 3)
    return Skin(Surface(vertices, np.concatenate(faces)), TILES[1])
