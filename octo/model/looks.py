"""What a robot's file draws its bodies with: meshes and simple shapes, their places and colours.

Only the names of mesh files are kept, so that a Character stays small; :mod:`octo.model.skins`
reads them when something is drawn.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from scipy.spatial.transform import Rotation

from octo.checks import numbers
from octo.errors import OctoError
from octo.model import urdf_elements as elements
from octo.model.look import KINDS, Look
from octo.model.quantities import Array
from octo.model.quaternions import rotation_of
from octo.model.robot_file import Carrier, import_mujoco

SHOWN = 3  # groups of geoms that MuJoCo's viewer shows


def carried(own: Mapping[int, Iterable[Look]], carriers: Mapping[int, Carrier]) -> tuple[Look, ...]:
    """The looks of MuJoCo's bodies on the bodies of the character that carry them."""
    return tuple(
        _on(look, carriers[b]) for b, looks in own.items() if b in carriers for look in looks
    )


def _on(look: Look, carrier: Carrier) -> Look:
    """In the frame of the body that carries its own one."""
    place = carrier.position + carrier.rotation @ look.position
    turn = carrier.rotation @ look.rotation
    return replace(look, body=carrier.body, position=place, rotation=turn)


def of_mjcf(model: Any) -> dict[int, list[Look]]:
    """By MuJoCo's body, what MuJoCo's viewer shows: the geoms of its groups 0 to 2 that are not
    transparent."""
    mujoco = import_mujoco()
    names = {getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}"): kind for kind in KINDS}
    found: dict[int, list[Look]] = {}
    for g in range(model.ngeom):
        kind, color = names.get(int(model.geom_type[g])), _color(model, g)
        if kind is None or model.geom_group[g] >= SHOWN or color[3] == 0.0:
            continue
        turn, place = rotation_of(model.geom_quat[g]), np.array(model.geom_pos[g])
        size, file = np.array(model.geom_size[g]), ""
        if kind == "mesh":
            m = int(model.geom_dataid[g])
            file, size = _file(model, m), np.array(model.mesh_scale[m])
            if not file:
                continue
            # MuJoCo moves a mesh into the frame of its inertia
            turn = turn @ rotation_of(model.mesh_quat[m]).T
            place = place - turn @ model.mesh_pos[m]
        look = Look(0, kind, size, place, turn, color, file)
        found.setdefault(int(model.geom_bodyid[g]), []).append(look)
    return found


def _color(model: Any, g: int) -> Array:
    material = int(model.geom_matid[g])
    plain = (model.geom_rgba[g] == (0.5, 0.5, 0.5, 1.0)).all()  # what MuJoCo gives one without any
    rgba = model.mat_rgba[material] if material >= 0 and plain else model.geom_rgba[g]
    return np.array(rgba, dtype=float)


def _file(model: Any, m: int) -> str:
    """The file of MuJoCo's mesh ``m``; empty where its vertices are written in the model."""
    first = int(model.mesh_pathadr[m])
    name = bytes(model.paths[first:]).split(b"\0")[0].decode() if first >= 0 else ""
    return str(Path(name).resolve()) if name else ""


def of_urdf(tree: Element, find: Any) -> dict[str, list[Look]]:
    """By link, its <visual> elements; what is not legal in them is left out, for nothing moves
    differently without it.

    Parameters
    ----------
    find: gives the path of a mesh as it is written in the file, or None.
    """
    materials = {str(one.get("name")): one for one in tree.findall("material")}
    found: dict[str, list[Look]] = {}
    for link in tree.findall("link"):
        looks = [look for one in link.findall("visual") for look in _visual(one, materials, find)]
        found[str(link.get("name"))] = looks
    return found


def _visual(visual: Element, materials: Mapping[str, Element], find: Any) -> Iterator[Look]:
    shape = next(iter(visual.findall("geometry/*")), None)
    if shape is None:
        return
    try:
        turn = Rotation.from_euler("xyz", _numbers(visual, "origin", "rpy", "0 0 0")).as_matrix()
        size, file = _size(shape), ""
        if shape.tag == "mesh":
            path = find(shape.get("filename", ""))
            file = "" if path is None else str(path.resolve())
        place = _numbers(visual, "origin", "xyz", "0 0 0")
        yield Look(0, str(shape.tag), size, place, turn, _material(visual, materials), file)
    except (OctoError, ValueError):
        return


def _numbers(element: Element, child: str, key: str, default: str) -> Array:
    """(3,) of an attribute."""
    values = [float(word) for word in elements.attribute(element, child, key, default).split()]
    return numbers(key, values, (3,))


def _size(shape: Element) -> Array:
    """(3,) as Look has it."""
    if shape.tag == "box":
        return 0.5 * np.array([float(word) for word in shape.get("size", "").split()])
    if shape.tag == "mesh":
        return np.array([float(word) for word in shape.get("scale", "1 1 1").split()])
    radius, length = float(shape.get("radius", "nan")), float(shape.get("length", "0"))
    return np.array([radius, 0.5 * length, 0.0])


def _material(visual: Element, materials: Mapping[str, Element]) -> Array | None:
    """(4,) the colour of a <visual>: its own, or that of the file's material of its name."""
    own = visual.find("material")
    if own is None:
        return None
    named = own if own.find("color") is not None else materials.get(str(own.get("name")))
    color = None if named is None else named.find("color")
    if color is None:
        return None
    return np.array([float(word) for word in color.get("rgba", "").split()])
