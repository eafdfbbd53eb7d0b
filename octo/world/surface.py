"""The surface of a closed mesh, and the distance from it, by libigl.

A mesh of many parts, as stairs of boxes, has faces inside, which are no surface: parts that overlap
or touch are united by manifold3d. Faces are of one part where they are bounded by an edge that no
others share; around an edge of four and more faces, where solids touch, those are of one part that
have the inside between them.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from octo.checks import Array
from octo.errors import MissingExtraError
from octo.world.spline import Indices

EXTRA = "mesh"
# of the largest part's longest edge: that parts which touch, as exactly as numbers do, overlap
GROWN = 1e-6
TURN = 2**22  # parts of a turn: two faces in the same one lie on each other


def library(name: str, what: str) -> Any:
    """A library of the extra, which ``what`` needs."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise MissingExtraError(what, EXTRA) from None


@dataclass(frozen=True, eq=False)
class Surface:
    """Closed: vertices (n, 3) m, and faces (m, 3) that are wound with the outside out."""

    vertices: Array
    faces: Indices

    @cached_property
    def manifold(self) -> bool:
        """Whether each edge borders two faces."""
        return bool((np.bincount(edges_of(self.faces)[1]) == 2).all())

    def distance(self, points: Array) -> Array:
        """Signed distances (k,) m of points (k, 3) m."""
        igl = library("igl", "a mesh as a shape")
        # a winding number costs one and a half times as much; the normals of closed manifolds do
        by = "PSEUDONORMAL" if self.manifold else "WINDING_NUMBER"
        kind = getattr(igl, f"SIGNED_DISTANCE_TYPE_{by}")
        return np.asarray(igl.signed_distance(points, self.vertices, self.faces, sign_type=kind)[0])

    def grown(self, way: float) -> Surface:
        """The same with its vertices ``way`` m farther out."""
        a, b, c = self.vertices[self.faces.T]
        normals = np.zeros_like(self.vertices)
        for corner in self.faces.T:
            np.add.at(normals, corner, np.cross(b - a, c - a))
        normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
        return Surface(self.vertices + way * normals, self.faces)

    def sharp(self, turn: float, apart: float) -> Array:
        """Points (k, 3) m along its edges, ``apart`` m from one another or less, at which the
        normals of faces differ by more than ``turn``."""
        edges, which, _ = edges_of(self.faces)
        a, b, c = self.vertices[self.faces.T]
        normals = np.cross(b - a, c - a)
        areas = np.linalg.norm(normals, axis=1)
        normals /= np.maximum(areas, 1e-300)[:, None]
        face = np.repeat(np.arange(len(self.faces)), 3)
        number = np.maximum(np.bincount(which, areas[face] > 0.0), 1.0)
        mean = [np.bincount(which, normals[face, axis]) / number for axis in range(3)]
        start, end = self.vertices[edges[np.square(mean).sum(axis=0) < 1.0 - 0.25 * turn**2].T]
        pieces = np.ceil(np.linalg.norm(end - start, axis=1) / apart).astype(np.int64)
        k = np.repeat(np.arange(len(pieces)), pieces + 1)
        step = np.arange(len(k)) - np.repeat(np.cumsum(pieces + 1) - pieces - 1, pieces + 1)
        return np.asarray(start[k] + (step / np.maximum(pieces[k], 1))[:, None] * (end - start)[k])

    def thin(self, width: float) -> float:
        """How much of it are walls thinner than ``width`` m, 0 to 1."""
        igl = library("igl", "a mesh as a shape")
        a, b, c = self.vertices[self.faces.T]
        normals = np.cross(b - a, c - a)
        areas = np.linalg.norm(normals, axis=1)
        normals /= np.maximum(areas, 1e-300)[:, None]
        within = (a + b + c) / 3.0 - 0.5 * width * normals
        nearest = igl.point_mesh_squared_distance(within, self.vertices, self.faces)[1]
        opposite = np.einsum("ij,ij->i", normals[nearest], normals) < -0.5
        return float(areas[opposite].sum() / areas.sum())


def surface_of(vertices: Array, faces: Indices) -> Surface:
    """The surface of a closed mesh whose faces are wound alike, in either way.

    Parts that overlap are united, and those within others that are wound the other way are
    cavities.
    """
    parts = _parts(vertices, faces)
    sizes = np.array([volume(part.vertices, part.faces) for part in parts])
    outward = (sizes >= 0.0) == (sizes.sum() >= 0.0)
    made = [
        part if size >= 0.0 else Surface(part.vertices, np.ascontiguousarray(part.faces[:, ::-1]))
        for part, size in zip(parts, sizes, strict=True)
    ]
    if len(made) == 1:
        return made[0]
    solid = [part for part, out in zip(made, outward, strict=True) if out]
    cavities: list[Surface] = []
    for part, out in zip(made, outward, strict=True):
        if out:
            continue
        # one that stands alone is a solid, as mirroring leaves it
        within = any(other.distance(part.vertices[:1])[0] < 0.0 for other in solid)
        (cavities if within else solid).append(part)
    united = _united(solid, cavities)
    if united is None:
        inside_out = sizes.sum() < 0.0
        united = Surface(vertices, np.ascontiguousarray(faces[:, ::-1] if inside_out else faces))
    return united


def _parts(vertices: Array, faces: Indices) -> list[Surface]:
    pairs = _neighbours(vertices, faces)
    graph = coo_array((np.ones(len(pairs)), tuple(pairs.T)), shape=[len(faces)] * 2)
    number, label = connected_components(graph, directed=False)
    made = []
    for k in range(number):
        used, own = np.unique(faces[label == k], return_inverse=True)
        made.append(Surface(vertices[used], own.reshape(-1, 3).astype(np.int64)))
    return made


def _united(solid: list[Surface], cavities: list[Surface]) -> Surface | None:
    """The union of solids less the cavities; None where one of them touches itself."""
    if not all(part.manifold for part in (*solid, *cavities)):
        return None
    manifold3d = library("manifold3d", "a mesh of many parts as a shape")

    def union(parts: list[Surface], grown: float) -> Any:
        given = [
            manifold3d.Mesh64(part.grown(grown).vertices, part.faces.astype(np.uint64))
            for part in parts
        ]
        return manifold3d.Manifold.batch_boolean(
            [manifold3d.Manifold(one) for one in given], manifold3d.OpType.Add
        )

    made = union(solid, GROWN * max(float(np.ptp(part.vertices, axis=0).max()) for part in solid))
    if cavities:
        made -= union(cavities, 0.0)
    if made.status() != manifold3d.Error.NoError or made.is_empty():
        return None
    mesh = made.to_mesh64()
    vertices = np.array(mesh.vert_properties, dtype=float)[:, :3]
    return Surface(vertices, np.array(mesh.tri_verts, dtype=np.int64))


def volume(vertices: Array, faces: Indices) -> float:
    """m³, negative where the faces are wound with their insides out."""
    a, b, c = vertices[faces.T]
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def wound_alike(faces: Indices) -> Indices:
    """The faces, those turned around that are wound against their neighbours."""
    igl = library("igl", "a mesh whose faces are wound both ways")
    return np.array(igl.bfs_orient(faces)[0], dtype=np.int64)


def edges_of(faces: Indices) -> tuple[Indices, Indices, Indices]:
    """The edges (n, 2) of faces, lower vertex first; which one each side of each face is, (3 m,);
    and whether it goes up (1) or down (−1) there."""
    ends = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    way = np.where(ends[:, 0] < ends[:, 1], 1, -1)
    edges, which = np.unique(np.sort(ends, axis=1), axis=0, return_inverse=True)
    return edges, which.reshape(-1), way


def _neighbours(vertices: Array, faces: Indices) -> Indices:
    """Pairs (k, 2) of faces of one part."""
    edges, which, way = edges_of(faces)
    order = np.argsort(which, kind="stable")
    count = np.bincount(which)
    first = np.cumsum(count) - count
    simple = first[count == 2]
    pairs = [np.stack([order[simple], order[simple + 1]], axis=1) // 3]
    for k in np.flatnonzero(count > 2):
        sides = order[first[k] : first[k] + count[k]]
        pairs.append(_around(vertices, edges[k], faces[sides // 3], way[sides], sides // 3))
    return np.concatenate(pairs)


def _around(
    vertices: Array, edge: Indices, faces: Indices, way: Indices, number: Indices
) -> Indices:
    """Pairs of the faces around an edge with the inside between them."""
    start, end = vertices[edge]
    axis = (end - start) / np.linalg.norm(end - start)
    third = vertices[faces[~np.isin(faces, edge)]] - start
    first = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    angle = np.arctan2(third @ np.cross(axis, first), third @ first)
    angle = np.round(angle * (TURN / (2.0 * np.pi))) % TURN
    # a face whose side goes down has the inside ahead, one that goes up has it behind
    order = np.lexsort([-way, angle])
    depth = np.cumsum(-way[order])
    order = np.roll(order, -1 - int(np.argmin(depth)))
    open_faces: list[int] = []
    pairs = []
    for k in order:
        if way[k] < 0:
            open_faces.append(int(number[k]))
        else:
            pairs.append((open_faces.pop(), int(number[k])))
    return np.array(pairs)
