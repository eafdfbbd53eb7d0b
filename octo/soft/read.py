"""Tetrahedra of a file: of meshio's formats, or of a closed surface that is filled with them."""

from __future__ import annotations

import contextlib
import io
import os
from pathlib import Path
from typing import Any

import numpy as np

from octo.checks import Array
from octo.errors import RobotFileError, UsageError, said
from octo.files import is_file, reason
from octo.soft.assembly import library
from octo.soft.fill import filled
from octo.soft.tetrahedra import Tetrahedra
from octo.world.build import read
from octo.world.spline import Indices

SURFACES = (".stl", ".obj", ".ply", ".glb", ".gltf", ".off")  # read by trimesh
SOLIDS = (".msh", ".vtk", ".vtu", ".mesh", ".bdf", ".nas", ".inp", ".med", ".xdmf")  # by meshio
ENDINGS = (*SOLIDS, *SURFACES)
OTHERS = ("hexahedron", "wedge", "pyramid", "tetra14", "tetra20", "tetra35")  # kinds of elements
# which of meshio's readers, in this order, where an ending is of several
KINDS: dict[str, tuple[str | None, ...]] = {".msh": ("gmsh", "ansys")}


def load_mesh(
    path: str | os.PathLike[str],
    *,
    scale: float = 1.0,
    edge: float | None = None,
    name: str | None = None,
) -> Tetrahedra:
    """The tetrahedra of a file; where it has a closed surface only, that is filled with them.

    Parameters
    ----------
    path: .msh, .vtk and what else meshio reads; .stl, .obj, .ply, .glb or .off.
    scale: metres of what the file is in: 0.001 for millimetres.
    edge: m, of the elements that a surface is filled with; a sixth of its longest edge without
        one.
    name: the file's without one.

    Raises
    ------
    RobotFileError: a file that is missing, or no mesh. ModelError: a mesh that is open, inverted,
        flat or more than one piece. ValueRangeError: a size that only other units explain.
        MissingExtraError: the extra ``soft``, or ``mesher`` for a surface, is not installed.
    """
    if not isinstance(path, (str, os.PathLike)):
        raise UsageError(f"path is {said(path)}, must be a file's path")
    file = Path(path)
    name = file.stem if name is None else name
    if not is_file(file):
        raise RobotFileError(f"mesh file {str(file)!r} is not there")
    if file.suffix.lower() in SURFACES:
        return filled(*read(file), scale, edge, name)
    points, cells = _of_meshio(file)
    solid = _blocks(cells, "tetra", "tetra10")
    others = sorted({kind for kind, _ in cells if kind.startswith(OTHERS)})
    flat = _blocks(cells, "triangle")
    if others or not (solid or flat):
        has = ", ".join(others or sorted({kind for kind, _ in cells})) or "nothing"
        raise RobotFileError(
            f"mesh file {str(file)!r} has {has}, must have tetrahedra of 4 or 10 nodes, or the "
            "triangles of a closed surface"
        )
    if not solid:
        return filled(points, np.concatenate(flat), scale, edge, name)
    if edge is not None:
        raise UsageError(f"edge is given, but {file.name} has tetrahedra already")
    if len({block.shape[1] for block in solid}) > 1:
        solid = [block[:, :4] for block in solid]
    return Tetrahedra(points, np.concatenate(solid), scale, name)


def _blocks(cells: list[tuple[str, Any]], *kinds: str) -> list[Indices]:
    return [np.asarray(block, dtype=np.int64) for kind, block in cells if kind in kinds]


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
