"""What stands still in a robot file -> shapes of a World: its ground, its furniture, its maps."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from octo.errors import OctoError, RobotFileError
from octo.model import mjcf, urdf, xml_file
from octo.model.contacts import collidable, geom_kind
from octo.model.figure import hull_of
from octo.model.geom_shapes import SIMPLE
from octo.model.robot_file import import_mujoco, name_of, quiet_compiler
from octo.world.drawn import everywhere, triangles
from octo.world.shapes import Ground, HeightField, Mesh, Shape
from octo.world.world import World

BURIED, BASE = (
    1e-3,
    0.1,
)  # m, of a map's edge over a plane, and of a solid map below its lowest sample
SQUARE = 1e-3  # how far the sides of a cell of a map may differ, relative to the shorter one
Shapes = tuple[list[Shape], list[str]]


def of_mjcf(path: Path) -> Shapes:
    """The shapes of an MJCF, and what of it is left out, in words."""
    notes: list[str] = []
    xml_file.check(path)
    _, model = mjcf.compiled(path, notes)
    return _shapes(path, model, notes)


def of_urdf(path: Path) -> Shapes:
    """The same of a URDF, whose root link stands still."""
    prepared = urdf.prepare(path, world=True)
    with quiet_compiler():
        model = urdf.compile_prepared(prepared)
    return _shapes(path, model, [f"mesh {mesh}: {why}" for mesh, why in prepared.unusable])


def _shapes(path: Path, model: Any, notes: list[str]) -> Shapes:
    """The shapes of all geoms that stand still and collide.

    Raises
    ------
    RobotFileError: there is none.
    """
    mujoco = import_mujoco()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    found: list[Shape] = []
    lost: Counter[str] = Counter()
    moving = set()
    for g in range(model.ngeom):
        body = int(model.geom_bodyid[g])
        if not _stands(model, body):
            moving.add(name_of(model, "body", int(model.body_rootid[body])))
        elif not collidable(model, g):
            lost["geoms that collide with nothing"] += 1
        else:
            place, turn = np.array(data.geom_xpos[g]), np.array(data.geom_xmat[g]).reshape(3, 3)
            name = model.geom(g).name or f"{name_of(model, 'body', body)} {geom_kind(model, g)}"
            found += _shape(model, g, {"name": name, "position": place, "rotation": turn}, lost)
    notes += [f"{what}: {count}" for what, count in lost.items()]
    notes += [f"what moves ({', '.join(sorted(moving))})"] if moving else []
    if not found:
        raise RobotFileError(f"{path.name}: nothing in it stands still and collides: no world")
    planes = [shape for shape in found if isinstance(shape, Ground)]
    return _numbered([_ended(shape, planes) for shape in found]), notes


def _stands(model: Any, b: int) -> bool:
    """Whether body ``b`` is the world's: a part of it, or of what has no joint at all."""
    tree = model.body_rootid == model.body_rootid[b]
    return bool(b == 0 or not model.body_dofnum[tree].any())


def _shape(model: Any, g: int, own: dict[str, Any], lost: Counter[str]) -> list[Shape]:
    """The shape of geom ``g``; none, and counted, where octo has none like it."""
    kind, size = geom_kind(model, g), np.array(model.geom_size[g], dtype=float)
    if kind in SIMPLE:
        return [SIMPLE[kind](size, own)]
    number = int(model.geom_dataid[g])
    if kind == "hfield":
        return [_heights(model, number, own)]
    if kind == "mesh":
        return [_mesh(model, number, own, lost)]
    lost[f"geoms of kind {kind}, which octo has no shape for"] += 1
    return []


def _heights(model: Any, h: int, own: dict[str, Any]) -> HeightField:
    """The map of MuJoCo's hfield ``h``; one whose cells are not square is sampled anew, as fine as
    their shorter side, between the samples as MuJoCo's triangles are, in straight lines."""
    rows, columns, first = model.hfield_nrow[h], model.hfield_ncol[h], model.hfield_adr[h]
    half_x, half_y, top, _ = model.hfield_size[h]
    samples = model.hfield_data[first : first + rows * columns].reshape(rows, columns).T
    heights = np.asarray(samples, dtype=float) * top
    x, y = np.linspace(-half_x, half_x, columns), np.linspace(-half_y, half_y, rows)
    cell = min(x[1] - x[0], y[1] - y[0])
    if max(x[1] - x[0], y[1] - y[0]) > (1.0 + SQUARE) * cell:
        finer = [np.arange(-half, half + 1e-9 * cell, cell) for half in (half_x, half_y)]
        there = np.stack(np.meshgrid(*finer, indexing="ij"), axis=-1)
        heights = RegularGridInterpolator((x, y), heights)(
            np.clip(there, [x[0], y[0]], [x[-1], y[-1]])
        )
    return HeightField(heights, float(cell), (-half_x, -half_y), **own)


def _ended(shape: Shape, planes: list[Ground]) -> Shape:
    """A map that a plane lies under as a solid that ends where it does: a HeightField goes on
    beyond its edge, and would bury the plane."""
    if not isinstance(shape, HeightField):
        return shape
    vertices, faces = triangles(shape, everywhere([shape]))
    border = _border(np.shape(shape.heights))
    if not any((World([plane]).distance(vertices[border]) > BURIED).any() for plane in planes):
        return shape
    own = (vertices - np.asarray(shape.position)) @ np.asarray(shape.rotation)
    low = own * (1.0, 1.0, 0.0)
    low[:, 2] = own[:, 2].min() - BASE
    a, b, under = border, np.roll(border, -1), len(own)
    walls = [np.stack([a, a + under, b + under], axis=1), np.stack([a, b + under, b], axis=1)]
    whole = np.concatenate([faces, faces[:, ::-1] + under, *walls])
    pose: dict[str, Any] = {"position": shape.position, "rotation": shape.rotation}
    return Mesh(np.concatenate([own, low]), whole, name=shape.name, **pose)


def _border(size: tuple[int, ...]) -> NDArray[np.intp]:
    """Indices of the samples around a map, in a closed line, as seen from above to the left."""
    index = np.arange(np.prod(size)).reshape(size)
    sides = [index[:-1, 0], index[-1, :-1], index[:0:-1, -1], index[0, :0:-1]]
    return np.concatenate(sides)


def _mesh(model: Any, m: int, own: dict[str, Any], lost: Counter[str]) -> Mesh:
    """Mesh ``m`` as it is; where it is not closed its hull, which MuJoCo takes of all meshes."""
    vertices, faces = (
        np.array(getattr(model, f"mesh_{what}")[first : first + count])
        for what, first, count in (
            ("vert", model.mesh_vertadr[m], model.mesh_vertnum[m]),
            ("face", model.mesh_faceadr[m], model.mesh_facenum[m]),
        )
    )
    try:
        return Mesh(vertices.astype(float), faces, **own)
    except OctoError:
        lost["meshes that are not closed, of which the hull is taken"] += 1
        closed = hull_of(vertices.astype(float))
        return Mesh(closed.vertices, closed.faces, **own)


def _numbered(shapes: list[Shape]) -> list[Shape]:
    """With the number of each of several of one name behind it."""
    count = Counter(shape.name for shape in shapes)
    seen: Counter[str | None] = Counter()
    made = []
    for shape in shapes:
        seen[shape.name] += 1
        many = count[shape.name] > 1
        made.append(replace(shape, name=f"{shape.name} {seen[shape.name]}") if many else shape)
    return made
