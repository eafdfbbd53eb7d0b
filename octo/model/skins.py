"""What is drawn of a character: what its file draws, read when it is needed, and for what has
nothing of the kind the guess of :mod:`octo.model.figure`."""

from __future__ import annotations

import importlib
import logging
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from octo.errors import OctoError
from octo.files import reason
from octo.model.character import Character
from octo.model.figure import Faces, Solid, Surface, ball, hull, hull_of, surfaces
from octo.model.look import Look
from octo.model.quantities import Array

LOG = logging.getLogger("octo")
COLORED = (".dae", ".glb", ".gltf")  # files whose own colours are drawn
SHARP = np.radians(40.0)  # between two faces, from which on the edge between them is drawn sharp
AROUND = 32  # sides of a cylinder
CARE = 3  # of 0 to 10, where 0 is slow and good: at 7 whole parts of thin robots were lost
READ: dict[str, str] = {}  # files that cannot be drawn, and why


@dataclass(frozen=True)
class Skin:
    """One surface of a body; ``color`` (3,) from 0 to 1, or None where its file has none."""

    surface: Surface
    color: Array | None = None


def skins(
    character: Character, visuals: bool = True, most: int = 4000, fineness: int = 2
) -> list[list[Skin]]:
    """By body, what is drawn of it.

    Parameters
    ----------
    visuals: draw what the robot's file draws; False: what octo computes with, from the contact
        spheres and the inertia of each body. So are bodies that hang together with none that the
        file draws, and those whose files cannot be read, which is warned of once.
    most: triangles of each mesh, about; meshes of more are simplified.
    fineness: of the shapes that octo computes with, as of :func:`octo.model.figure.surfaces`.
    """
    drawn: list[list[Skin]] = [[] for _ in character.bodies]
    for look in character.looks if visuals else ():
        drawn[look.body] += _drawn(look, most)
    roots = character.roots
    known = {roots[b] for b, own in enumerate(drawn) if own}
    if len(known) == len(set(roots)):
        return drawn
    for b, surface in enumerate(surfaces(character, fineness)):
        if roots[b] not in known and surface is not None:
            drawn[b] = [Skin(surface)]
    return drawn


def _drawn(look: Look, most: int) -> list[Skin]:
    """In the frame of the body."""
    if look.kind != "mesh":
        color = None if look.color is None else look.color[:3]
        return [Skin(_placed(_simple(look), look), color)]
    if look.file not in READ:
        try:
            return [_on_body(part, look) for part in _read(look.file, most)]
        except Exception as error:  # each of trimesh's readers raises its own kinds
            READ[look.file] = _why(error)
            LOG.warning("visual mesh %s is not drawn: %s", Path(look.file).name, READ[look.file])
    return []


def _on_body(part: Skin, look: Look) -> Skin:
    """A part of a look's mesh; of a file without colours in that of the look."""
    color = part.color
    if look.color is not None and Path(look.file).suffix.lower() not in COLORED:
        color = look.color[:3]
    return Skin(_placed(_scaled(part.surface, look.size), look), color)


def _why(error: Exception) -> str:
    if isinstance(error, ImportError):
        return f"it needs the extra 'view' ({error})"
    if isinstance(error, OSError):
        return reason(error)
    return str(error) if isinstance(error, OctoError) else f"{type(error).__name__}: {error}"


@lru_cache(maxsize=256)
def _read(file: str, most: int) -> list[Skin]:
    """The parts of a mesh file in their places, in its own units."""
    trimesh: Any = importlib.import_module("trimesh")
    scene = trimesh.load_scene(file)
    parts: list[Any] = [part for part in scene.dump() if len(getattr(part, "faces", ()))]
    total = sum(len(part.faces) for part in parts)
    skins = []
    for part in parts:
        if Path(file).suffix.lower() == ".dae" and "units" in part.metadata:
            part.units = part.metadata["units"]
            part.convert_units("meters")
        part.merge_vertices(merge_tex=True, merge_norm=True)
        material = getattr(part.visual, "material", part.visual)  # or colours of vertices
        color = np.asarray(material.main_color[:3], dtype=float) / 255.0
        share = most / total
        if share < 1.0:
            part = _simplified(part, max(16, int(share * len(part.faces))))
        smooth = trimesh.graph.smooth_shade(part, angle=SHARP)
        faces: Faces = np.asarray(smooth.faces, dtype=np.intp)
        skins.append(Skin(Surface(np.asarray(smooth.vertices, dtype=float), faces), color))
    return skins


def _simplified(part: Any, most: int) -> Any:
    if len(part.faces) <= most:
        return part
    return part.simplify_quadric_decimation(face_count=most, aggression=CARE)


def _scaled(surface: Surface, scale: Array) -> Surface:
    """By factors along the axes; a mirror image has its faces turned."""
    faces = surface.faces[:, ::-1] if np.prod(scale) < 0.0 else surface.faces
    return Surface(surface.vertices * scale, faces)


def _placed(surface: Surface, look: Look) -> Surface:
    return Surface(surface.vertices @ look.rotation.T + look.position, surface.faces)


def _simple(look: Look) -> Surface:
    """In its own frame."""
    first, second = float(look.size[0]), float(look.size[1])
    ends = np.array([[0.0, 0.0, -second], [0.0, 0.0, second]])
    if look.kind == "sphere":
        return ball(np.zeros(3), first)
    if look.kind == "capsule":
        return hull(Solid(ends, np.full(2, first)))
    if look.kind == "cylinder":
        turn = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
        rim = first * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(AROUND)])
        return hull_of(np.concatenate([rim + end for end in ends]))
    if look.kind == "box":
        signs = np.array([(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)])
        return hull_of(signs * look.size)
    surface = ball(np.zeros(3), 1.0)
    return Surface(surface.vertices * look.size, surface.faces)
