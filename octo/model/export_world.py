"""A World as geoms of an MJCF, so that MuJoCo has the same ground."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from functools import singledispatch
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from scipy.spatial import ConvexHull

from octo.checks import Array
from octo.model.quaternions import quaternions
from octo.world.drawn import Faces, everywhere, triangles
from octo.world.shapes import Box, Capsule, Cylinder, Ground, HeightField, Shape, Sphere
from octo.world.surface import volume
from octo.world.world import World

BASE = 0.1  # m, that a map goes on below its lowest sample: MuJoCo's is a solid
LEAST_RELIEF = 1e-3  # m, of a map: MuJoCo refuses one without height
CONVEX = 1e-3  # of its hull's volume, that a mesh may lack to be taken for convex
SKIN = 5e-4  # m, radius of the triangles of a mesh that is not


@dataclass(frozen=True)
class Place:
    """Where a shape is written, and what all geoms have."""

    top: Element
    parent: Element
    name: str
    look: dict[str, str] = field(default_factory=dict)  # collision and friction


def add_world(
    top: Element, parent: Element, world: World, look: dict[str, str], taken: Collection[str]
) -> None:
    """Add the shapes of ``world`` to the body ``parent`` of the file ``top``.

    MuJoCo's boxes and cylinders have sharp edges. A mesh that is not convex becomes a rigid
    ``flex``, whose triangles collide one by one: of other meshes MuJoCo takes the hull.

    Parameters
    ----------
    look: what all geoms have: collision and friction. taken: names that geoms of the file have.
    """
    names = set(taken)
    for k, shape in enumerate(world.shapes):
        name = shape.name or f"world{k}"
        while name in names:
            name = f"_{name}"
        names.add(name)
        _add(shape, Place(top, parent, name, look))


@singledispatch
def _add(shape: Shape, place: Place) -> None:
    """Any shape by its triangles."""
    vertices, faces = triangles(shape, everywhere([shape]))
    hull = ConvexHull(vertices)
    if hull.volume - volume(vertices, faces) > CONVEX * hull.volume:
        _add_flex(vertices, faces, place)
        return
    own = {"name": place.name, "vertex": spelled(vertices.ravel())}
    SubElement(_section(place.top, "asset"), "mesh", own)
    geom = {"name": place.name, "type": "mesh", "mesh": place.name}
    SubElement(place.parent, "geom", geom | place.look)


def _add_flex(vertices: Array, faces: Faces, place: Place) -> None:
    numbers = {"vertex": spelled(vertices.ravel()), "element": " ".join(map(str, faces.ravel()))}
    own = {"name": place.name, "dim": "2", "body": "world", "radius": spelled(SKIN)}
    flex = SubElement(_section(place.top, "deformable"), "flex", own | numbers)
    SubElement(flex, "contact", {"selfcollide": "none"} | place.look)


@_add.register
def _ground(shape: Ground, place: Place) -> None:
    *normal, height = shape.own
    turned = np.asarray(shape.rotation)
    origin = np.asarray(shape.position) + turned @ [0.0, 0.0, height]
    axes = _axes(turned @ normal)
    _geom(place, {"type": "plane", "size": "0 0 0.1"}, origin, axes)


@_add.register
def _sphere(shape: Sphere, place: Place) -> None:
    _posed(shape, place, {"type": "sphere", "size": spelled([shape.radius])})


@_add.register
def _box(shape: Box, place: Place) -> None:
    _posed(shape, place, {"type": "box", "size": spelled(0.5 * np.asarray(shape.size))})


@_add.register
def _capsule(shape: Capsule, place: Place) -> None:
    _posed(shape, place, {"type": "capsule", "size": spelled([shape.radius, 0.5 * shape.length])})


@_add.register
def _cylinder(shape: Cylinder, place: Place) -> None:
    _posed(shape, place, {"type": "cylinder", "size": spelled([shape.radius, 0.5 * shape.length])})


@_add.register
def _heights(shape: HeightField, place: Place) -> None:
    heights, low = np.asarray(shape.heights), float(np.min(shape.heights))
    relief = max(float(np.ptp(heights)), LEAST_RELIEF)
    half = 0.5 * shape.cell * (np.array(heights.shape) - 1.0)
    # the first row of the text is that of the largest y
    own = {"nrow": str(heights.shape[1]), "ncol": str(heights.shape[0])}
    own |= {
        "size": spelled([*half, relief, BASE]),
        "elevation": spelled((heights.T[::-1] - low).ravel()),
    }
    SubElement(_section(place.top, "asset"), "hfield", {"name": place.name} | own)
    middle = np.append(np.asarray(shape.origin) + half, low)
    origin = np.asarray(shape.position) + np.asarray(shape.rotation) @ middle
    _geom(place, {"type": "hfield", "hfield": place.name}, origin, np.asarray(shape.rotation))


def _posed(shape: Shape, place: Place, own: dict[str, str]) -> None:
    _geom(place, own, np.asarray(shape.position), np.asarray(shape.rotation))


def _geom(place: Place, own: dict[str, str], origin: Array, rotation: Array) -> None:
    pose = {"pos": spelled(origin), "quat": spelled(quaternions(rotation[None])[0])}
    SubElement(place.parent, "geom", {"name": place.name} | own | pose | place.look)


def _axes(normal: Array) -> Array:
    """(3, 3): axes of which the third is ``normal``."""
    other = np.eye(3)[np.argmin(np.abs(normal))]
    along = np.cross(other, normal)
    along /= np.linalg.norm(along)
    return np.stack([along, np.cross(normal, along), normal], axis=1)


def _section(top: Element, tag: str) -> Element:
    """The section ``tag`` of a file, which is made where it has none."""
    found = top.find(tag)
    return SubElement(top, tag) if found is None else found


def spelled(values: object) -> str:
    """Numbers as an MJCF has them."""
    return " ".join(f"{v:.12g}" for v in np.atleast_1d(np.asarray(values, dtype=float)))
