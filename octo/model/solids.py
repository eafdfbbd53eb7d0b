"""Collision geoms of a robot file -> the solids of its bodies, which spheres of others touch."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from octo.model.contacts import collidable, geom_kind
from octo.model.geom_shapes import SIMPLE
from octo.model.quaternions import rotation_of
from octo.model.robot_file import Carrier, RobotFile, name_of
from octo.model.solid import Solid

KINDS = ("sphere", "box", "capsule", "cylinder")  # that have a closed form


def solids_of(
    source: RobotFile, carriers: Mapping[int, Carrier], notes: list[str]
) -> tuple[Solid, ...]:
    """The solids of all geoms that collide; a geom of another kind is noted."""
    model, found, taken = source.model, list[Solid](), set[str]()
    for g in range(model.ngeom):
        carrier = carriers.get(int(model.geom_bodyid[g]))
        if carrier is None or not collidable(model, g):
            continue
        link, kind = name_of(model, "body", int(model.geom_bodyid[g])), geom_kind(model, g)
        if kind not in KINDS:
            known = ", ".join(KINDS)
            notes.append(f"{kind} of {link}: other bodies go through it, solids are {known}")
            continue
        turn = carrier.rotation @ rotation_of(model.geom_quat[g])
        place = carrier.position + carrier.rotation @ model.geom_pos[g]
        name = str(model.geom(g).name or link)
        while name in taken:
            name = f"{name}_"
        taken.add(name)
        pose = {"position": place, "rotation": turn}
        found.append(Solid(name, carrier.body, SIMPLE[kind](np.array(model.geom_size[g]), pose)))
    return tuple(found)
