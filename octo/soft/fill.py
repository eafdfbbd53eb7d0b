"""A closed surface filled with tetrahedra, by TetGen."""

from __future__ import annotations

import contextlib
import importlib
import io
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from octo.checks import Array, positive
from octo.errors import MissingExtraError, ModelError
from octo.files import reason
from octo.soft.tetrahedra import SIZES, Tetrahedra
from octo.world.closed import closed
from octo.world.spline import Indices
from octo.world.surface import edges_of, volume
from octo.world.units import check_size

LOG = logging.getLogger("octo")
ALONG = 6  # elements along the longest edge, where none is asked for
QUALITY = 1.5  # most radius of an element's sphere to its shortest edge
FEWEST = 600  # triangles of a surface that is thinned: 1,200 points
SKIPPED = ("_skipped.node", "_skipped.face")
CARE = 3  # of fast-simplification's levels, 0 to 10 from slow to careless: ends in no slivers


def filled(
    vertices: Array, faces: Indices, scale: float, edge: float | None, name: str
) -> Tetrahedra:
    """A closed surface filled with tetrahedra.

    A surface of many small triangles is made of fewer first, which is warned of.

    Parameters
    ----------
    vertices: (n, 3), ``scale`` m each.
    faces: (m, 3).
    edge: m, about, of the elements; None: a sixth of the longest edge.
    name: what messages call it.

    Raises
    ------
    ModelError: it is open, more than one piece, or cuts itself. MissingExtraError: the extra
    ``mesher`` is not installed.
    """
    label = f"mesh {name!r}"
    scale = positive(f"scale of {label}", scale)
    vertices, faces = closed(vertices, faces, label, scale, "close it")
    _check_one(label, faces)
    vertices = scale * vertices
    spans = np.ptp(vertices, axis=0)
    check_size(label, spans, scale, SIZES)
    edge = float(spans.max()) / ALONG if edge is None else positive("edge", edge, "m")
    tetgen = _library("tetgen", name)
    vertices, faces = _thinned(label, vertices, faces, edge, name)
    fine = np.sqrt(_area(vertices, faces) / len(faces)) < edge
    try:
        with contextlib.redirect_stdout(io.StringIO()), _nothing_left():
            points, elements = tetgen.TetGen(vertices, faces.astype(np.int32)).tetrahedralize(
                order=1,
                minratio=QUALITY,
                nobisect=bool(fine),  # its triangles are small enough as they are
                fixedvolume=True,
                maxvolume=edge**3 / (6.0 * np.sqrt(2.0)),  # m³, of a regular one
            )[:2]
    except Exception as error:  # RuntimeError, and others of its own
        raise ModelError(
            f"{label} cannot be filled with tetrahedra: {reason(error)}; does it cut itself?"
        ) from error
    return Tetrahedra(np.asarray(points), np.asarray(elements), name=name)


@contextlib.contextmanager
def _nothing_left() -> Iterator[None]:
    """Where TetGen fails it leaves what it skipped in the working folder: not here."""
    files = [Path(name) for name in SKIPPED]
    before = [file.exists() for file in files]
    try:
        yield
    finally:
        for file in (one for one, there in zip(files, before, strict=True) if not there):
            file.unlink(missing_ok=True)


def _library(module: str, name: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError:
        what = f"filling the surface {name!r} with tetrahedra"
        raise MissingExtraError(what, "mesher") from None


def _area(vertices: Array, faces: Indices) -> float:
    a, b, c = vertices[faces.T]
    return 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


def _thinned(
    label: str, vertices: Array, faces: Indices, edge: float, name: str
) -> tuple[Array, Indices]:
    """The surface in triangles about as large as the elements, where it has twice as many."""
    regular = 4.0 / np.sqrt(3.0) * _area(vertices, faces)  # m², over edge²: how many there are
    most = max(FEWEST, round(regular / edge**2))
    if len(faces) <= 2 * most:
        return vertices, faces
    fewer = _library("fast_simplification", name).simplify(
        vertices, faces.astype(np.int32), target_count=most, agg=CARE
    )
    points, triangles = closed(
        np.asarray(fewer[0], dtype=float),
        np.asarray(fewer[1], dtype=np.int64),
        *(f"{label}, thinned to {most} triangles,", 1.0, "remesh it"),
    )
    lost = 1.0 - abs(volume(points, triangles) / volume(vertices, faces))
    twice = np.sqrt(regular / (2.0 * len(triangles)))
    LOG.warning(
        "%s: its surface of %d triangles is made of %d, which takes %.2g %% of its volume; edge = "
        "%.2g m keeps twice as many",
        *(label, len(faces), len(triangles), 100.0 * lost, twice),
    )
    return points, triangles


def _check_one(label: str, faces: Indices) -> None:
    """Refuse a surface of more than one piece."""
    ends = edges_of(faces)[0]
    graph = coo_array((np.ones(len(ends)), tuple(ends.T)), shape=[int(faces.max()) + 1] * 2)
    pieces = connected_components(graph, directed=False)[0]
    if pieces > 1:
        raise ModelError(
            f"{label} is {pieces} pieces, closed surfaces that share no vertex: a body is one "
            "piece, and one with a hollow must come as tetrahedra"
        )
