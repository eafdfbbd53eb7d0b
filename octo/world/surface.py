"""What a world looks like: triangles of each shape, as fine as the shape itself.

A box is a box and a map is its samples, so that a step of 4 cm is drawn as a step. Planes have no
end: they are drawn where the picture is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import singledispatch

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array
from octo.world.shapes import Box, Capsule, Cylinder, Ground, Shape, Sphere

Faces = NDArray[np.intp]
AROUND = 48  # corners of a circle
STEEP = 0.2  # of a plane's normal along z, below which it is a wall
NEAR, MOST_STEPS = 1e-4, 100  # m, and how often: when a way down has arrived
MARGIN = 1.0  # m, of what has no end around what has one


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles of one shape in the world, outward side counter-clockwise.

    Attributes
    ----------
    name: of the shape, None where it has none. vertices: (v, 3) m.
    faces: (f, 3) indices into vertices. smooth: it is round, its edges are those of the drawing.
    """

    name: str | None
    vertices: Array
    faces: Faces
    smooth: bool = False


def surfaces(shapes: Sequence[Shape], around: Array) -> list[Surface]:
    """Of each shape; of what reaches beyond ``around`` (2, 2) m, the least and the largest x and y,
    and has no end or many samples, the part within."""
    made = []
    for shape in shapes:
        vertices, faces = triangles(shape, around)
        if len(faces):
            smooth = isinstance(shape, (Sphere, Capsule))
            made.append(Surface(shape.name, vertices, faces, smooth))
    return made


def everywhere(shapes: Sequence[Shape]) -> Array:
    """(2, 2) m: the least and the largest x and y of all shapes that end somewhere, with a margin
    for those that do not."""
    boxes = np.array([shape.bounds()[:, :2] for shape in shapes])
    known = boxes[np.isfinite(boxes).all(axis=(1, 2))]
    low, high = known.min(axis=(0, 1)), known.max(axis=(0, 1))
    return np.stack([low - MARGIN, high + MARGIN])


def from_above(
    distance: Callable[[Array], Array], x: Array, y: Array, bottom: float, top: float
) -> Array:
    """Heights (a, b) m of what is met on the way down from ``top`` over x (a,) and y (b,) m, at
    least ``bottom``.

    φ falls by no more than the way down: a step as long as φ is never too far.

    Parameters
    ----------
    distance: φ (k,) m at points (k, 3) m.
    """
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    z = np.full(len(grid), top)
    left = np.arange(len(grid))
    for _ in range(MOST_STEPS):
        z[left] -= (phi := distance(np.column_stack([grid[left], z[left]])))
        left = left[(phi > NEAR) & (z[left] > bottom)]
        if not left.size:
            break
    return np.maximum(z, bottom).reshape(len(x), len(y))


@singledispatch
def triangles(shape: Shape, around: Array) -> tuple[Array, Faces]:
    """Vertices (v, 3) m in the world and faces (f, 3) of one shape."""
    raise NotImplementedError(type(shape).__name__)


@triangles.register
def _ground(shape: Ground, around: Array) -> tuple[Array, Faces]:
    """A square of the plane: over ``around``, or as wide where it is steep."""
    *normal, height = shape.own
    n, place = (
        np.asarray(shape.rotation) @ normal,
        _placed(shape, np.array([[0.0, 0.0, height]]))[0],
    )
    corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    level = np.take_along_axis(around, corners, axis=0)  # (4, 2) m
    if abs(n[2]) > STEEP:
        z = place[2] - (level - place[:2]) @ n[:2] / n[2]
        vertices = np.column_stack([level, z])
    else:
        across = np.cross(n, [0.0, 0.0, 1.0])
        across /= np.linalg.norm(across)
        up, half = np.cross(across, n), 0.5 * float(np.ptp(around, axis=0).max())
        middle = np.append(around.mean(axis=0), place[2])
        middle -= n * ((middle - place) @ n)
        vertices = middle + half * (
            (2 * corners[:, :1] - 1) * across + (2 * corners[:, 1:] - 1) * up
        )
    faces = np.array([(0, 1, 2), (0, 2, 3)])
    outward = np.cross(vertices[1] - vertices[0], vertices[2] - vertices[0]) @ n > 0.0
    return vertices, faces if outward else faces[:, ::-1]


@triangles.register
def _box(shape: Box, around: Array) -> tuple[Array, Faces]:
    signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [corners for a, b, c, d in sides for corners in ((a, b, c), (a, c, d))]
    return _placed(shape, 0.5 * signs * np.asarray(shape.size)), np.array(faces)


@triangles.register
def _sphere(shape: Sphere, around: Array) -> tuple[Array, Faces]:
    vertices, faces = _turned(*_arc(shape.radius, 0.0))
    return _placed(shape, vertices), faces


@triangles.register
def _capsule(shape: Capsule, around: Array) -> tuple[Array, Faces]:
    vertices, faces = _turned(*_arc(shape.radius, 0.5 * shape.length))
    return _placed(shape, vertices), faces


@triangles.register
def _cylinder(shape: Cylinder, around: Array) -> tuple[Array, Faces]:
    half = 0.5 * shape.length
    r, z = np.array([0.0, shape.radius, shape.radius, 0.0]), np.array([-half, -half, half, half])
    vertices, faces = _turned(r, z)
    return _placed(shape, vertices), faces


def _arc(radius: float, half: float) -> tuple[Array, Array]:
    """Outline r, z (k,) m of a capsule along z, from its lower to its upper end."""
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, AROUND // 2)  # an even number: none at z = 0
    return radius * np.cos(angle), radius * np.sin(angle) + half * np.sign(angle)


def _turned(r: Array, z: Array) -> tuple[Array, Faces]:
    """The outline r, z (k,) m, which begins and ends on the z axis, turned about it."""
    turn = 2.0 * np.pi * np.arange(AROUND) / AROUND
    rings = np.stack([np.outer(r, np.cos(turn)), np.outer(r, np.sin(turn))], axis=-1)
    height = np.broadcast_to(z[:, None, None], (len(z), AROUND, 1))
    index = np.arange(len(r) * AROUND).reshape(len(r), AROUND)
    faces = _quads(index, np.roll(index, -1, axis=1))
    return np.concatenate([rings, height], axis=-1).reshape(-1, 3), faces


def _quads(a: Faces, b: Faces) -> Faces:
    """Two triangles of each cell of a grid, whose corners in the next column are ``b``."""
    low, right, top, high = a[:-1], b[:-1], b[1:], a[1:]
    pairs = [np.stack(corner, axis=-1) for corner in ((low, right, top), (low, top, high))]
    return np.concatenate(pairs).reshape(-1, 3)


def _placed(shape: Shape, vertices: Array) -> Array:
    """Vertices (v, 3) m of a shape's frame, in the world."""
    return np.asarray(vertices @ np.asarray(shape.rotation).T + np.asarray(shape.position))
