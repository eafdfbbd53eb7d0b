"""A ball and a beam as tetrahedra, from the structured meshes of scikit-fem."""

from __future__ import annotations

import numpy as np

from octo.checks import Array, numbers, positive, whole
from octo.errors import ShapeError, ValueRangeError
from octo.soft.assembly import library
from octo.soft.quadratic import EDGES, TURNED, volumes, with_middles
from octo.soft.tetrahedra import Tetrahedra
from octo.world.spline import Indices

FINEST = 40  # elements along an edge


def ball_mesh(radius: float = 0.2, divisions: int = 6) -> Tetrahedra:
    """A ball, its surface curved: 8·divisions³ elements, 16·divisions² + 2 nodes on the surface.

    Parameters
    ----------
    radius: m.
    divisions: elements along a radius.

    Raises
    ------
    ValueRangeError: a radius that is not positive, or no such number. MissingExtraError: scikit-fem
        is not installed.
    """
    radius, n = positive("radius", radius, "m"), whole("divisions", divisions, 1, FINEST)
    points, corners = _octahedron(n)
    nodes, elements = with_middles(points, corners)
    far = np.abs(nodes).sum(axis=1)
    nodes *= (far / np.maximum(np.linalg.norm(nodes, axis=1), 1e-300))[:, None]
    # edges within the ball are straight
    inside = far < 1.0 - 0.25 / n
    ends = np.zeros((len(nodes), 2), dtype=np.int64)
    ends[elements[:, 4:].ravel()] = elements[:, EDGES].reshape(-1, 2)
    middle = inside & (np.arange(len(nodes)) >= len(points))
    nodes[middle] = nodes[ends[middle]].mean(axis=1)
    return Tetrahedra(radius * nodes, elements, name="ball")


def beam_mesh(
    length: float = 0.6,
    width: float = 0.1,
    height: float = 0.1,
    divisions: tuple[int, int, int] = (16, 2, 2),
) -> Tetrahedra:
    """A beam along x: six elements to a block.

    Parameters
    ----------
    length, width, height: m, along x, y and z.
    divisions: (3,) blocks along them.

    Raises
    ------
    ValueRangeError: a size that is not positive, or no such number. MissingExtraError: scikit-fem
        is not installed.
    """
    sizes = [positive(name, value, "m") for name, value in _named(length, width, height)]
    given = np.atleast_1d(numbers("divisions", divisions))
    if given.shape != (3,):
        raise ShapeError("divisions", given.shape, (3,))
    if (given % 1.0).any() or given.min() < 1 or given.max() > 10 * FINEST:
        shown = ", ".join(f"{n:g}" for n in given)
        allowed = f"whole numbers from 1 to {10 * FINEST}"
        raise ValueRangeError(f"divisions is ({shown}), must be {allowed}")
    grids = [
        np.linspace(-0.5 * size, 0.5 * size, int(n) + 1)
        for size, n in zip(sizes, given, strict=True)
    ]
    points, corners = _blocks(*grids)
    return Tetrahedra(points, _turned(points, corners), name="beam")


def _named(length: float, width: float, height: float) -> list[tuple[str, float]]:
    return [("length", length), ("width", width), ("height", height)]


def _blocks(x: Array, y: Array, z: Array) -> tuple[Array, Indices]:
    """Points (n, 3) and corners (E, 4) of blocks, six tetrahedra each, all cut alike."""
    mesh = library("skfem", "a soft ball or beam").MeshTet.init_tensor(x, y, z)
    return np.array(mesh.p.T), np.array(mesh.t.T, dtype=np.int64)


def _octahedron(n: int) -> tuple[Array, Indices]:
    """|x| + |y| + |z| ≤ 1 in 8n³ tetrahedra.

    Of a cube whose blocks are all cut along one diagonal the part x ≥ y ≥ z is cut without a rest:
    it is made an octant's, and mirrored.
    """
    edge = np.linspace(0.0, 1.0, n + 1)
    points, corners = _blocks(edge, edge, edge)
    x, y, z = points[corners].mean(axis=1).T
    corners = corners[(x > y) & (y > z)]
    x, y, z = points.T
    octant = np.column_stack([x - y, y - z, z])
    signs = np.stack(np.meshgrid([1, -1], [1, -1], [1, -1]), axis=-1).reshape(-1, 3)
    every = np.concatenate([octant * sign for sign in signs])
    cells = np.concatenate([corners + k * len(points) for k in range(len(signs))])
    place, to = np.unique(np.round(n * every).astype(int), axis=0, return_inverse=True)
    used, own = np.unique(to.reshape(-1)[cells], return_inverse=True)
    points, corners = place[used] / n, own.reshape(-1, 4)
    return points, _turned(points, corners)


def _turned(points: Array, corners: Indices) -> Indices:
    """All with positive volumes: scikit-fem winds its own in both ways."""
    inverted = volumes(points, corners) < 0.0
    return np.where(inverted[:, None], corners[:, TURNED[:4]], corners)
