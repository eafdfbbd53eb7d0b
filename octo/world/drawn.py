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
from octo.world.nets import zero_surface
from octo.world.shapes import (
    Box,
    Capsule,
    Cylinder,
    DistanceGrid,
    Ground,
    HeightField,
    Mesh,
    Shape,
    Sphere,
)

Faces = NDArray[np.intp]
AROUND = 48  # corners of a circle
STEEP = 0.2  # of a plane's normal along z, below which it is a wall
SPACING, MOST_HEIGHTS = 0.025, 400  # m, and samples along x and y, of heights for shadows
SLOPE = 0.1  # of φ squared, at least, where a vertex is moved to φ = 0
SHARP = 0.8  # cosine of the angle between two faces from which on their edge is a crease
MOST_SAMPLES = 200_000  # of a map; a larger one is drawn in every second row, or fourth, …
MOST_VALUES = 4_000_000  # of a grid of distances, likewise
MARGIN = 1.0  # m, of what has no end around what has one


@dataclass(frozen=True, eq=False)
class Drawn:
    """Triangles of one shape in the world, outward side counter-clockwise.

    Attributes
    ----------
    name: of the shape, None where it has none. vertices: (v, 3) m.
    faces: (f, 3) indices into vertices. smooth: it is round, its edges are those of the drawing.
    plane: (4,) of a plane, which has no end: its normal n and d, n · p = d m.
    """

    name: str | None
    vertices: Array
    faces: Faces
    smooth: bool = False
    plane: Array | None = None

    def height(self, places: Array) -> Array:
        """(k,) m, of the plane at places (k, 2) m."""
        assert self.plane is not None
        return np.asarray((self.plane[3] - places @ self.plane[:2]) / self.plane[2])


def drawn(shapes: Sequence[Shape], around: Array) -> list[Drawn]:
    """Of each shape; of what reaches beyond ``around`` (2, 2) m, the least and the largest x and y,
    and has no end or many samples, the part within."""
    made = []
    for shape in shapes:
        vertices, faces = triangles(shape, around)
        if len(faces):
            smooth = isinstance(shape, (Sphere, Capsule))
            plane = _plane(shape) if isinstance(shape, Ground) else None
            made.append(Drawn(shape.name, vertices, faces, smooth, plane))
    return made


def creases(vertices: Array, faces: Faces) -> tuple[Array, Array]:
    """Edges at which a surface turns sharply: their ends (k, 2, 3) m, and the unit normals
    (k, 2, 3) of the two faces that meet there."""
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-15)
    edges = np.sort(np.concatenate([faces[:, pair] for pair in ([0, 1], [1, 2], [2, 0])]), axis=1)
    of_face = np.tile(np.arange(len(faces)), 3)
    order = np.lexsort(edges.T)
    same = (np.diff(edges[order], axis=0) == 0).all(axis=1)  # shared by two faces
    first, second = order[:-1][same], order[1:][same]
    pairs = np.stack([normal[of_face[first]], normal[of_face[second]]], axis=1)
    sharp = np.sum(pairs[:, 0] * pairs[:, 1], axis=1) < SHARP
    return vertices[edges[first[sharp]]], pairs[sharp]


def everywhere(shapes: Sequence[Shape]) -> Array:
    """(2, 2) m: the least and the largest x and y of all shapes that end somewhere, with a margin
    for those that do not."""
    boxes = [_map_bounds(one) if isinstance(one, HeightField) else one.bounds() for one in shapes]
    levels = np.array([box[:, :2] for box in boxes])
    known = levels[np.isfinite(levels).all(axis=(1, 2))]
    if not len(known):
        known = np.zeros((1, 1, 2))
    return np.stack([known.min(axis=(0, 1)) - MARGIN, known.max(axis=(0, 1)) + MARGIN])


def _map_bounds(shape: HeightField) -> Array:
    """(2, 3) m around the samples of a map."""
    corner, cell = _lattice(shape)
    far = corner + cell * (np.array(np.shape(shape.heights)) - 1.0)
    ends = np.array([(x, y, 0.0) for x in (corner[0], far[0]) for y in (corner[1], far[1])])
    placed = _placed(shape, ends)
    return np.stack([placed.min(axis=0), placed.max(axis=0)])


def sampled(below: Callable[[Array], Array], low: Array, high: Array) -> dict[str, Array]:
    """Heights z (a, b) m over x (a,) and y (b,) of what is met first from above, for shadows,
    between the corners ``low`` and ``high`` (3,) m of a motion and 3 m more in height; ``below`` is
    a world's."""
    counts = np.clip(np.ceil((high - low)[:2] / SPACING), 2, MOST_HEIGHTS).astype(int)
    x, y = (np.linspace(low[k], high[k], counts[k]) for k in (0, 1))
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    z = below(np.column_stack([grid, np.full(len(grid), float(high[2]) + 3.0)]))
    return {"x": x, "y": y, "z": np.maximum(z, low[2] - 3.0).reshape(len(x), len(y))}


@singledispatch
def triangles(shape: Shape, around: Array) -> tuple[Array, Faces]:
    """Vertices (v, 3) m in the world and faces (f, 3) of one shape."""
    raise NotImplementedError(type(shape).__name__)


@triangles.register
def _ground(shape: Ground, around: Array) -> tuple[Array, Faces]:
    """A square of the plane: over ``around``, or as wide where it is steep."""
    plane = _plane(shape)
    n, place = plane[:3], plane[3] * plane[:3]
    corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    level = np.take_along_axis(around, corners, axis=0)  # (4, 2) m
    if abs(n[2]) > STEEP:
        z = (plane[3] - level @ n[:2]) / n[2]
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


def _plane(shape: Ground) -> Array:
    """(4,) its unit normal n and d, n · p = d m."""
    *normal, height = shape.own
    n = np.asarray(shape.rotation) @ normal
    return np.append(n, n @ _placed(shape, np.array([[0.0, 0.0, height]]))[0])


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
    index[[0, -1]] = index[[0, -1], :1]  # a point
    faces = _quads(index, np.roll(index, -1, axis=1))
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    return np.concatenate([rings, height], axis=-1).reshape(-1, 3), faces


def _quads(a: Faces, b: Faces) -> Faces:
    """Two triangles of each cell of a grid, whose corners in the next column are ``b``."""
    low, right, top, high = a[:-1], b[:-1], b[1:], a[1:]
    pairs = [np.stack(corner, axis=-1) for corner in ((low, right, top), (low, top, high))]
    return np.concatenate(pairs).reshape(-1, 3)


@triangles.register
def _heights(shape: HeightField, around: Array) -> tuple[Array, Faces]:
    """The samples, in straight lines; of a map that is smoothed what it is there."""
    heights, corner, cell = shape.scale * np.asarray(shape.heights), *_lattice(shape)
    ends = np.array([(x, y, 0.0) for x in around[:, 0] for y in around[:, 1]])
    there = (ends - np.asarray(shape.position)) @ np.asarray(shape.rotation)
    cells = (there[:, :2] - corner) / cell
    first = np.maximum(np.floor(cells.min(axis=0)), 0.0).astype(int)
    last = np.minimum(np.ceil(cells.max(axis=0)), np.array(heights.shape) - 1.0).astype(int)
    if (last <= first).any():
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.intp)
    every = 1
    while np.prod((last - first) // every + 1) > MOST_SAMPLES:
        every *= 2
    rows, columns = (np.unique([*range(a, b, every), b]) for a, b in zip(first, last, strict=True))
    x, y = np.meshgrid(corner[0] + cell * rows, corner[1] + cell * columns, indexing="ij")
    points = np.stack([x, y, np.zeros(x.shape)], axis=-1).reshape(-1, 3)
    if shape.smooth:
        points[:, 2] = -shape.kind.jets(shape.own, points, 0)[:, 0]
    else:
        points[:, 2] = heights[np.ix_(rows, columns)].ravel()
    index = np.arange(x.size).reshape(x.shape)
    return _placed(shape, points), _quads(index[:, :-1], index[:, 1:])[:, ::-1]


@triangles.register
def _grid(shape: DistanceGrid, around: Array) -> tuple[Array, Faces]:
    values, corner, cell = np.asarray(shape.values), *_lattice(shape)
    every = 1
    while values[::every, ::every, ::every].size > MOST_VALUES:
        every += 1
    vertices, faces = zero_surface(values[::every, ::every, ::every])
    vertices = corner + cell * every * vertices
    for _ in range(2):  # to where the spline is 0, but no farther than a cell
        jets = shape.kind.jets(shape.own, vertices, 1)
        slope = jets[:, 1:] / np.maximum(np.sum(jets[:, 1:] ** 2, axis=1, keepdims=True), SLOPE)
        vertices -= np.clip(jets[:, :1] * slope, -cell, cell)
    return _placed(shape, vertices), faces


@triangles.register
def _mesh(shape: Mesh, around: Array) -> tuple[Array, Faces]:
    return _placed(shape, shape.scale * np.asarray(shape.vertices)), np.asarray(shape.faces)


def _lattice(shape: HeightField | DistanceGrid) -> tuple[Array, float]:
    """Where the first sample is, and how far it is to the next, m in the shape's frame."""
    return shape.scale * np.asarray(shape.origin, dtype=float), shape.scale * shape.cell


def _placed(shape: Shape, vertices: Array) -> Array:
    """Vertices (v, 3) m of a shape's frame, in the world."""
    return np.asarray(vertices @ np.asarray(shape.rotation).T + np.asarray(shape.position))
