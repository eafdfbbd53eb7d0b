"""What tests of maps share: differences within cells, and shapes whose distances are known."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from octo import World, shapes
from octo.checks import Array
from octo.world.jet import AXES, SIZES


def within_cells(
    rng: np.random.Generator, low: Array, high: Array, corner: Array, cell: float
) -> Array:
    """Points (500, 3) of a box in the middle of their cells, 0.2 of a cell from its edges."""
    lowest, highest = (np.floor((end - corner) / cell) for end in (low, high))
    place = rng.integers(lowest, highest, (500, 3)) + rng.uniform(0.2, 0.8, (500, 3))
    return np.asarray(corner + cell * place)


def off_by(world: World, points: Array, cell: float) -> float:
    """The largest difference of derivatives from differences, in parts of the largest one of that
    order. Five places are exact for the cubic along an axis of one cell."""
    step = 0.05 * cell
    jets = world.jets(points, 3)
    sizes = [np.abs(jets[:, SIZES[k] : SIZES[k + 1]]).max() for k in range(3)]
    worst = 0.0
    for axis in range(3):
        away = step * np.eye(3)[axis]
        at = [world.jets(points + k * away, 2) for k in (-2.0, -1.0, 1.0, 2.0)]
        slopes = (at[0] - 8.0 * at[1] + 8.0 * at[2] - at[3]) / (12.0 * step)
        for k, axes in enumerate(AXES[: SIZES[2]]):
            found = jets[:, AXES.index(tuple(sorted((*axes, axis))))]
            worst = max(worst, float(np.abs(slopes[:, k] - found).max()) / sizes[len(axes)])
    return worst


def sphere(points: Array) -> Array:
    """The distance (k,) m from a sphere of 0.4 m."""
    return np.asarray(np.linalg.norm(points, axis=1) - 0.4)


def torus(points: Array) -> Array:
    """The same of a torus of 0.4 and 0.15 m."""
    ring = np.linalg.norm(points[:, :2], axis=1) - 0.4
    return np.asarray(np.hypot(ring, points[:, 2]) - 0.15)


def block(points: Array) -> Array:
    """The same of a cube of 0.4 m."""
    away = np.abs(points) - 0.2
    beyond = np.linalg.norm(np.maximum(away, 0.0), axis=1)
    return np.asarray(beyond + np.minimum(away.max(axis=1), 0.0))


RISE, RUN, STEPS, WIDTH = 0.15, 0.3, 20, 3.0  # m, of the stairs of a building


def stairs(steps: int = STEPS, width: float = WIDTH) -> tuple[Array, Array]:
    """Vertices (n, 3) m and faces (m, 3) of closed stairs up along x."""
    profile = [(0.0, 0.0)]
    for k in range(steps):
        profile += [(k * RUN, (k + 1) * RISE), ((k + 1) * RUN, (k + 1) * RISE)]
    profile.append((steps * RUN, 0.0))  # from where all others are seen
    n, (x, z) = len(profile), np.array(profile).T
    vertices = np.concatenate([np.stack([x, np.full(n, y), z], axis=1) for y in (0.0, width)])
    faces = [(n - 1, k + 1, k) for k in range(n - 2)]
    faces += [(2 * n - 1, k + n, k + 1 + n) for k in range(n - 2)]
    for k in range(n):
        after = (k + 1) % n
        faces += [(k, after, k + n), (after, after + n, k + n)]
    return vertices, np.array(faces)


def cube(size: float = 0.4) -> tuple[Array, Array]:
    """Vertices (8, 3) m and faces (12, 3) of a cube around the origin."""
    vertices = size * (np.argwhere(np.ones((2, 2, 2))) - 0.5)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]
    return vertices, np.array(faces)


def maps() -> list[shapes.Shape]:
    """A map of heights and a grid, both turned."""
    heights = 0.05 * np.random.default_rng(0).normal(size=(12, 9))
    values, corner = sampled(sphere, 0.5, 0.05)
    turned = (0.9, 0.1, -0.3, 0.2)  # a quaternion
    return [
        shapes.HeightField(heights, 0.1, (-0.5, -0.4), position=(0.1, 0.0, -0.4), rotation=turned),
        shapes.DistanceGrid(values, 0.05, corner, position=(0.3, -0.2, 0.1), rotation=turned),
    ]


def sampled(distance: Callable[[Array], Array], reach: float, cell: float) -> tuple[Array, Array]:
    """Samples (n, n, n) of a distance over a cube around the origin, and their lowest corner."""
    count = int(round(2.0 * reach / cell)) + 1
    axis = cell * np.arange(count) - reach
    places = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1)
    return distance(places.reshape(-1, 3)).reshape([count] * 3), np.full(3, -reach)
