"""``octo.load_world``: a file of shapes, of triangles or of heights -> World."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from octo.checks import numbers, positive
from octo.errors import RobotFileError, UsageError, said
from octo.files import is_file
from octo.model.load import dialect
from octo.model.still_shapes import of_mjcf, of_urdf
from octo.world.height_file import read_heights
from octo.world.heights import HeightField
from octo.world.mesh import Mesh
from octo.world.shapes import Shape
from octo.world.world import World

SCENES = (".xml", ".mjcf", ".urdf")
MESHES = (".stl", ".obj", ".glb", ".gltf", ".ply")
HEIGHTS = (".png", ".npy")
ENDINGS = (*SCENES, *MESHES, *HEIGHTS)
# which options the files of an ending have a use for
OPTIONS: dict[str, tuple[str, ...]] = dict.fromkeys(SCENES, ())
OPTIONS |= dict.fromkeys(MESHES, ("cell", "scale")) | dict.fromkeys(HEIGHTS, ("cell", "height"))
log = logging.getLogger("octo")


def load_world(
    path: str | os.PathLike[str],
    *,
    cell: float | None = None,
    height: float | None = None,
    scale: float | None = None,
    position: Iterable[float] = (0.0, 0.0, 0.0),
) -> World:
    """The world of a file: what stands still in an MJCF or a URDF, a mesh, or a map of heights.

    Of an MJCF these are the geoms that collide of the world and of what is fixed to it; robots and
    free bodies in it are no part of the world. A URDF is a world whose root link stands still. What
    is left out is one line of the logger ``octo``, which the command line prints.

    Parameters
    ----------
    path: .xml (MJCF or URDF), .urdf; .stl, .obj, .glb, .gltf or .ply; .png (white is high) or .npy
        (heights, m, of x by y).
    cell: m, from one sample of a map to the next, which a map needs, or of a mesh's distances.
    height: m, of white over black in a picture, which needs it; of a 1 in an array.
    scale: m, of the unit of a mesh file: 0.001 for one in mm.
    position: (3,) m, where the file's origin is put; of a map its middle.

    Raises
    ------
    RobotFileError: no such file, or one that cannot be read. UsageError: an option that the file
        has no use for, or one that it needs.
    """
    if not isinstance(path, (str, os.PathLike)):
        raise UsageError(f"path is {said(path)}, must be a file's path")
    file, place = Path(path), numbers("position", position, (3,))
    suffix = file.suffix.lower()
    if suffix not in ENDINGS:
        raise RobotFileError(f"world file {file} must end in {', '.join(ENDINGS)}")
    if not is_file(file):
        raise RobotFileError(f"world file {file} does not exist")
    given = {"cell": cell, "height": height, "scale": scale}
    options = {name: value for name, value in given.items() if value is not None}
    for name, value in options.items():
        if name not in OPTIONS[suffix]:
            takes = " and ".join(OPTIONS[suffix]) or "no cell, height or scale"
            raise UsageError(f"{name} is given, but a {suffix} file takes {takes}")
        positive(f"{name} of {file.name}", value, "m")
    notes: list[str] = []
    if suffix in HEIGHTS:
        shapes = [_heights(file, **options)]
    elif suffix in MESHES:
        shapes = [_mesh(file, **options)]
    else:
        shapes, notes = of_urdf(file) if dialect(file) == "robot" else of_mjcf(file)
    if notes:
        log.warning("%s: no part of the world: %s", file.name, "; ".join(notes))
    return World([replace(one, position=np.asarray(one.position) + place) for one in shapes])


def _heights(file: Path, cell: float | None = None, height: float | None = None) -> Shape:
    if cell is None:
        raise UsageError(f"{file.name} is a map of heights, and needs cell: m, of its samples")
    if height is None and file.suffix.lower() == ".png":
        raise UsageError(f"{file.name} is a picture, and needs height: m, of white over black")
    heights = read_heights(file) * (1.0 if height is None else height)
    origin = -0.5 * cell * (np.array(heights.shape) - 1.0)
    return HeightField(heights, cell, origin, name=file.stem)


def _mesh(file: Path, cell: float | None = None, scale: float = 1.0) -> Shape:
    return Mesh.from_file(file, cell=cell, scale=scale)
