"""The grid of distances to a closed mesh: made once, kept by content; and meshes of files."""

from __future__ import annotations

import hashlib
import logging
import sys
import time
from pathlib import Path

import numpy as np

from octo import cache
from octo.checks import Array
from octo.errors import RobotFileError
from octo.files import reason
from octo.world.bricks import near_surface
from octo.world.edges import around_edges
from octo.world.lattice import RATIO
from octo.world.spline import Indices
from octo.world.surface import Surface, library, surface_of

LOG = logging.getLogger("octo")
VERSION = 2  # of how grids are made: what was kept by another one is made anew
MARGIN = 10.0  # cells around a mesh: the band of samples, and three more
PER_EDGE, SHARP = 9000.0, 2000.0  # doubles
TURN = 0.5  # between the normals of faces at a sharp edge: an angle of 29°
THIN, SHARE = 1.5, 0.01  # cells of a wall, and of the surface that such walls are worth a warning


def read(path: Path) -> tuple[Array, Indices]:
    """Vertices (n, 3) and faces (m, 3) of a file: STL, OBJ, PLY, GLB and what else trimesh reads;
    the parts of a scene in their places."""
    trimesh = library("trimesh", f"the mesh file {str(path)!r}")
    if not path.is_file():
        raise RobotFileError(f"mesh file {str(path)!r} is not there")
    try:
        mesh = trimesh.load_mesh(path, process=False)
        vertices = np.array(mesh.vertices, dtype=float)
        faces = np.array(mesh.faces, dtype=np.int64)
    except OSError as error:
        raise RobotFileError(f"mesh file {str(path)!r} cannot be read: {reason(error)}") from error
    except Exception as error:  # each of its readers raises its own kinds
        why = f"{type(error).__name__}: {error}"
        raise RobotFileError(f"mesh file {str(path)!r} is no mesh: {why}") from error
    if not len(faces):
        raise RobotFileError(f"mesh file {str(path)!r} is no mesh: it has no triangles")
    return vertices, faces


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


def doubles_for(vertices: Array, faces: Indices, cell: float) -> float:
    """About how many numbers the grid of a mesh is made in: 10 to a coarse sample, to a square of a
    cell on the surface 22 coefficients and 4 as many while they are found, and in the same way
    PER_EDGE to a cell along a sharp edge, but no more than all of the surface would take."""
    coarse = np.prod((np.ptp(vertices, axis=0) / cell + 2.0 * MARGIN) / RATIO)
    a, b, c = vertices[faces.T]
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / cell**2
    edges = PER_EDGE * len(Surface(vertices, faces).sharp(TURN, cell))
    return float(10.0 * coarse + 110.0 * area + min(edges, SHARP * area))


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

    # a world has a copy: the file's pages need no memory of their own
    return np.asarray(np.load(cache.path_of(f"mesh-{key}.npy", make), mmap_mode="r"))


def _grid(label: str, vertices: Array, faces: Indices, cell: float) -> Array:
    line = Line(f"distances to {label}, {len(faces)} faces")
    surface = surface_of(vertices, faces)
    low, high = vertices.min(axis=0) - MARGIN * cell, vertices.max(axis=0) + MARGIN * cell
    made, band = near_surface(surface.distance, low, high, cell, lambda part: line(0.5 * part))
    edges = surface.sharp(TURN, cell)
    if len(edges):
        made = around_edges(
            made, band, surface.distance, edges, lambda part: line(0.5 + 0.5 * part)
        )
    own = made.numbers()
    samples = " × ".join(str(n) for n in made.size)
    line.end(f"{samples} samples, cell {cell:g} m, {1e-6 * own.nbytes:.0f} MB")
    thin = surface.thin(THIN * cell)
    if thin > SHARE:
        LOG.warning(
            "%s: %.0f %% of its surface are walls thinner than %g cells of %g m, which are thinned "
            "or lost; a smaller cell keeps them",
            *(label, 100.0 * thin, THIN, cell),
        )
    return own
