"""Distances to a closed mesh, by libigl, and the grid of them: made once, kept by content."""

from __future__ import annotations

import hashlib
import logging
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from octo import cache
from octo.checks import Array
from octo.errors import MissingExtraError, RobotFileError
from octo.files import reason
from octo.world.bricks import near_surface
from octo.world.lattice import jets
from octo.world.spline import Indices

LOG = logging.getLogger("octo")
EXTRA = "mesh"
VERSION = 1  # of how grids are made: what was kept by another one is made anew
MARGIN = 10.0  # cells around a mesh: the band of samples, and three more
POINTS = 200_000  # at a time
# of the mesh's surface, where φ should be 0: what is off by more than this is worth a warning
OFF, SHARE = 0.25, 0.01  # cells, of all faces
SHOWN = 20_000  # faces that this is measured at


def _library(name: str, what: str) -> ModuleType:
    try:
        return __import__(name)
    except ImportError:
        raise MissingExtraError(what, EXTRA) from None


def read(path: Path) -> tuple[Array, Indices]:
    """Vertices (n, 3) and faces (m, 3) of a file: STL, OBJ, PLY, GLB and what else trimesh reads;
    the parts of a scene in their places."""
    trimesh = _library("trimesh", f"the mesh file {str(path)!r}")
    try:
        mesh = trimesh.load_mesh(path, process=False)
        return np.array(mesh.vertices, dtype=float), np.array(mesh.faces, dtype=np.int64)
    except OSError as error:
        raise RobotFileError(f"mesh file {str(path)!r} cannot be read: {reason(error)}") from error
    except Exception as error:  # each of its readers raises its own kinds
        why = f"{type(error).__name__}: {error}"
        raise RobotFileError(f"mesh file {str(path)!r} is no mesh: {why}") from error


def wound_alike(vertices: Array, faces: Indices) -> Indices:
    """The faces, those turned around that are wound against their neighbours."""
    trimesh = _library("trimesh", "a mesh whose faces are wound both ways")
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    trimesh.repair.fix_winding(mesh)
    return np.array(mesh.faces, dtype=np.int64)


def volume(vertices: Array, faces: Indices) -> float:
    """m³, negative where the faces are wound with their insides out."""
    a, b, c = vertices[faces.T]
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


@dataclass(frozen=True, eq=False)
class Part:
    """A connected part of a mesh, closed by itself."""

    vertices: Array  # (n, 3) m
    faces: Indices  # (m, 3)
    manifold: bool  # whether each edge borders two faces

    def distance(self, points: Array) -> Array:
        """Signed distances (k,) m of points (k, 3) m."""
        igl = _library("igl", "a mesh as a shape")
        # a winding number costs one and a half times as much; the normals of closed manifolds do
        by = "PSEUDONORMAL" if self.manifold else "WINDING_NUMBER"
        kind = getattr(igl, f"SIGNED_DISTANCE_TYPE_{by}")
        found = igl.signed_distance(points, self.vertices, self.faces, sign_type=kind)[0]
        return np.asarray(found)

    def least(self, points: Array) -> Array:
        """(k,) m: no point of it is nearer, from its box; 0 inside."""
        low, high = self.vertices.min(axis=0), self.vertices.max(axis=0)
        away = np.maximum(np.maximum(low - points, points - high), 0.0)
        return np.asarray(np.linalg.norm(away, axis=1))


def parts_of(vertices: Array, faces: Indices) -> tuple[list[Part], list[Part]]:
    """Solid parts, and cavities in them, all wound with their outsides out."""
    n = len(vertices)
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
    edges = coo_array((np.ones(len(ends)), tuple(ends.T)), shape=(n, n))
    number, label = connected_components(edges, directed=False)
    of_face = label[faces[:, 0]]
    parts = []
    for k in range(number):
        own = faces[of_face == k]
        if len(own):
            used, local = np.unique(own, return_inverse=True)
            parts.append((vertices[used], local.reshape(own.shape).astype(np.int64)))
    volumes = [volume(*part) for part in parts]
    outside_in = sum(volumes) < 0.0
    solid: list[Part] = []
    inverted: list[Part] = []
    for (places, own), size in zip(parts, volumes, strict=True):
        positive = (size < 0.0) == outside_in
        around = own if size >= 0.0 else own[:, ::-1].copy()
        (solid if positive else inverted).append(Part(places, around, _manifold(own)))
    cavities: list[Part] = []
    for part in inverted:  # of parts that stand alone the files' authors mirrored some
        within = any(other.distance(part.vertices[:1])[0] < 0.0 for other in solid)
        (cavities if within else solid).append(part)
    return solid, cavities


def _manifold(faces: Indices) -> bool:
    ends = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return bool((np.unique(ends, axis=0, return_counts=True)[1] == 2).all())


def distances(solid: list[Part], cavities: list[Part]) -> Callable[[Array], Array]:
    """Signed distances (k,) m of points (k, 3) m to the union of solid parts less the cavities:
    exact outside, and inside at least as deep as it is to the nearest face of its part."""

    def few(points: Array) -> Array:
        found = np.full(len(points), np.inf)
        least = np.stack([part.least(points) for part in solid])
        for part, away in zip(solid, least, strict=True):
            near = (away < found) | (away == 0.0)
            if near.any():
                found[near] = np.minimum(found[near], part.distance(points[near]))
        for part in cavities:
            found = np.maximum(found, -part.distance(points))
        return found

    def of(points: Array) -> Array:
        chunks = range(0, max(len(points), 1), POINTS)
        return np.concatenate([few(points[k : k + POINTS]) for k in chunks])

    return of


class Line:
    """How far a mesh's grid is, on a terminal's stderr, rewritten in place."""

    def __init__(self, doing: str) -> None:
        self.doing, self.last = doing, time.perf_counter()

    def __call__(self, share: float) -> None:
        now = time.perf_counter()
        if sys.stderr.isatty() and now - self.last > 0.2:
            self.last = now
            line = f"\r\033[Kocto: {self.doing}: {100.0 * share:.0f} %"
            print(line, end="", file=sys.stderr, flush=True)

    def end(self, said: str) -> None:
        if sys.stderr.isatty():
            print("\r\033[K", end="", file=sys.stderr, flush=True)
        LOG.info("%s: %s", self.doing, said)


def grid(label: str, vertices: Array, faces: Indices, cell: float) -> Array:
    """The numbers (size,) of the grid of a closed mesh, from octo's cache where it was made before.

    Parameters
    ----------
    label: what messages call the mesh.
    vertices: (n, 3) m.
    faces: (m, 3) each wound with its outside out.
    cell: m.
    """
    parts = [np.ascontiguousarray(vertices), np.ascontiguousarray(faces, dtype=np.int64)]
    said = repr((VERSION, cell, vertices.shape, faces.shape)).encode()
    key = hashlib.sha256(b"\0".join([said, *[part.tobytes() for part in parts]])).hexdigest()[:24]

    def make(path: Path) -> None:
        np.save(path, _grid(label, vertices, faces, cell))

    return np.asarray(np.load(cache.path_of(f"mesh-{key}.npy", make)))


def _grid(label: str, vertices: Array, faces: Indices, cell: float) -> Array:
    line = Line(f"distances to {label}, {len(faces)} faces")
    distance = distances(*parts_of(vertices, faces))
    low, high = vertices.min(axis=0) - MARGIN * cell, vertices.max(axis=0) + MARGIN * cell
    made = near_surface(distance, low, high, cell, line)
    own = made.numbers()
    samples = " × ".join(str(n) for n in made.size)
    line.end(f"{samples} samples, cell {cell:g} m, {1e-6 * own.nbytes:.0f} MB")
    shown = faces[:: len(faces) // SHOWN + 1]
    off = np.abs(jets(own, vertices[shown].mean(axis=1), 0)[:, 0]) / cell
    lost = float(np.mean(off > OFF))
    if lost > SHARE:
        LOG.warning(
            "%s: φ is off by more than %g cells (of %g m) at %.0f %% of its faces, by %.2g at most:"
            " what is thinner than two cells is rounded away, a smaller cell keeps it",
            *(label, OFF, cell, 100.0 * lost, off.max()),
        )
    return own
