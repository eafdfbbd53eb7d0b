"""Tetrahedra of a file: of meshio's formats, or of a closed surface that is filled with them."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from octo.checks import Array, positive
from octo.errors import MissingExtraError, ModelError, RobotFileError, UsageError
from octo.files import is_file, reason
from octo.soft.assembly import library
from octo.soft.tetrahedra import SIZES, Tetrahedra
from octo.world.build import read
from octo.world.closed import closed
from octo.world.spline import Indices
from octo.world.surface import edges_of
from octo.world.units import check_size

SURFACES = (".stl", ".obj", ".ply", ".glb", ".gltf", ".off")  # read by trimesh
SOLIDS = (".msh", ".vtk", ".vtu", ".mesh", ".bdf", ".nas", ".inp", ".med", ".xdmf")  # by meshio
ENDINGS = (*SOLIDS, *SURFACES)
# which of meshio's readers, in this order, where an ending is of several
KINDS: dict[str, tuple[str | None, ...]] = {".msh": ("gmsh", "ansys")}
ALONG = 8  # elements along the longest edge of a surface that is filled, where none is asked for
QUALITY = 1.5  # most radius of an element's sphere to its shortest edge


def tetrahedra_of(
    path: Path, scale: float = 1.0, edge: float | None = None, name: str | None = None
) -> Tetrahedra:
    """The tetrahedra of a file; its surface filled with them where it has none.

    Parameters
    ----------
    path: one of ENDINGS, or what else meshio reads.
    scale: metres of what the file is in.
    edge: m, of the elements that a surface is filled with; an eighth of its longest edge without
        one.
    name: the file's without one.
    """
    name = path.stem if name is None else name
    if not is_file(path):
        raise RobotFileError(f"mesh file {str(path)!r} is not there")
    if path.suffix.lower() in SURFACES:
        vertices, faces = read(path)
    else:
        points, cells = _of_meshio(path)
        whole = [np.asarray(block) for kind, block in cells if kind in ("tetra", "tetra10")]
        flat = [np.asarray(block) for kind, block in cells if kind == "triangle"]
        if whole:
            if edge is not None:
                raise UsageError(f"edge is given, but {path.name} has tetrahedra already")
            if len({block.shape[1] for block in whole}) > 1:
                whole = [block[:, :4] for block in whole]
            return Tetrahedra(points, np.concatenate(whole), scale, name)
        if not flat:
            kinds = ", ".join(sorted({kind for kind, _ in cells})) or "nothing"
            raise RobotFileError(
                f"mesh file {str(path)!r} has {kinds}, must have tetrahedra, or the triangles of a "
                "closed surface"
            )
        vertices, faces = points, np.concatenate(flat).astype(np.int64)
    return filled(vertices, faces, scale, edge, name)


def filled(
    vertices: Array, faces: Indices, scale: float, edge: float | None, name: str
) -> Tetrahedra:
    """A closed surface filled with tetrahedra by TetGen.

    Parameters
    ----------
    vertices: (n, 3), ``scale`` m each.
    faces: (m, 3).
    edge: m, about, of the elements; None: an eighth of the longest edge.
    """
    label = f"mesh {name!r}"
    scale = positive(f"scale of {label}", scale)
    vertices, faces = closed(vertices, faces, label, scale, "close it")
    _check_one(label, faces)
    vertices = scale * vertices
    spans = np.ptp(vertices, axis=0)
    check_size(label, spans, scale, SIZES)
    longest = float(spans.max())
    edge = longest / ALONG if edge is None else positive("edge", edge, "m")
    try:
        tetgen = library("tetgen", "")
    except MissingExtraError:
        raise MissingExtraError(f"filling the surface {name!r} with tetrahedra", "mesher") from None
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            points, elements = tetgen.TetGen(vertices, faces.astype(np.int32)).tetrahedralize(
                order=1,
                minratio=QUALITY,
                fixedvolume=True,
                maxvolume=edge**3 / (6.0 * np.sqrt(2.0)),  # m³, of a regular one
            )[:2]
    except Exception as error:  # RuntimeError, and others of its own
        raise ModelError(
            f"{label} cannot be filled with tetrahedra: {reason(error)}; does it cut itself?"
        ) from error
    return Tetrahedra(np.asarray(points), np.asarray(elements), name=name)


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


def _of_meshio(path: Path) -> tuple[Array, list[tuple[str, Any]]]:
    """Points (n, 3) and (kind, numbers) of each block of cells."""
    meshio = library("meshio", f"the mesh file {str(path)!r}")
    heard, mesh, why = io.StringIO(), None, ""
    for kind in KINDS.get(path.suffix.lower(), (None,)):
        try:  # it prints, and ends the process, where it cannot read
            with contextlib.redirect_stdout(heard), contextlib.redirect_stderr(heard):
                mesh = meshio.read(path, kind)
            break
        except OSError as error:
            raise RobotFileError(
                f"mesh file {str(path)!r} cannot be read: {reason(error)}"
            ) from error
        except (Exception, SystemExit) as error:  # each of its readers raises its own kinds
            why = why or heard.getvalue().strip() or f"{type(error).__name__}: {error}"
    if mesh is None:
        raise RobotFileError(f"mesh file {str(path)!r} is no mesh: {why}")
    points = np.array(mesh.points, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3:
        raise RobotFileError(f"mesh file {str(path)!r} is not of three dimensions")
    return points, [(block.type, block.data) for block in mesh.cells]
