"""What moves and what it touches: a tree of rigid bodies, checked where it is made."""

from __future__ import annotations

import operator
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from octo.errors import ModelError, said
from octo.model import describe
from octo.model.body import Body, ContactSphere, Joint, floating_base
from octo.model.element import checked
from octo.model.quantities import LARGEST, Array, array, choice, text, tuple_of
from octo.model.solid import Solid
from octo.model.tree import Tree
from octo.shown import Shown, listed

__all__ = ["LARGEST", "Array", "Body", "Character", "ContactSphere", "Joint", "floating_base"]


@dataclass(frozen=True, eq=False, repr=False)
class Character(Tree, Shown):
    """A robot or a character: bodies in tree order (parents first), contact spheres, self-collision
    pairs.

    Attributes
    ----------
    name: what messages and reports call it.
    bodies: parents before children; the configuration x (nx,) lists their joints in this order.
    contacts: spheres; those with ``touches_terrain`` become the contacts of Eq. 6.
    pairs: index pairs into ``contacts`` that repel each other (§4.2).
    base: "floating" when the first moving body has six unactuated coordinates (x, y, z, then the
        rotation chart).
    chart: order of the floating base's three hinges, "zyx" (yaw, pitch, roll; singular at pitch
        ±90°) or "zxy" (yaw, roll, pitch; singular at roll ±90°). The innermost and the outermost
        angle are unbounded.
    default_pose: (nx,) the configuration a start is searched from.
    dropped: sentences naming what the robot's file says and octo does not model.
    poses: further configurations (nx,) by name: the keyframes of the robot's file.
    elements: forces between points of two bodies, or a body and the world (octo.SpringDamper).
    solids: surfaces that spheres of other bodies may touch.
    touches: index pairs into ``contacts`` and ``solids`` that touch each other by the problem's
        contact law.
    objects: names of the bodies that begin a scene's objects (octo.Scene), which come last.
    looks: what the robot's file draws its bodies with; a body without any is guessed.
    """

    def __post_init__(self) -> None:
        self._check_kinds()
        for b, body in enumerate(self.bodies):
            if not -1 <= body.parent < b:
                raise ModelError(
                    f"body {body.name!r}: parent index {body.parent} must be -1 or less than its "
                    f"own index {b}"
                )
        for kind, things in (
            ("bodies", self.bodies),
            ("joints", self.joints),
            ("contacts", self.contacts),
            ("solids", self.solids),
        ):
            names = [thing.name for thing in things]
            if len(set(names)) < len(names):
                twice = next(name for name in names if names.count(name) > 1)
                raise ModelError(
                    f"character {self.name!r}: two {kind} are named {twice!r}, names must differ"
                )
        if self.mass <= 0.0:
            raise ModelError(
                f"character {self.name!r}: total mass is {self.mass}, must be positive"
            )
        self._check_base()
        for contact in self.contacts:
            if not 0 <= contact.body < len(self.bodies):
                raise ModelError(
                    f"contact {contact.name!r}: body index {contact.body} is not in "
                    f"0…{len(self.bodies) - 1}"
                )
        for pair in self.pairs:
            if not all(0 <= k < len(self.contacts) for k in pair) or pair[0] == pair[1]:
                raise ModelError(
                    f"pair {pair}: must be two different indices of the {len(self.contacts)} "
                    "contact spheres"
                )
        self._check_touches()
        self._check_poses()
        self._check_inertia()

    def _check_kinds(self) -> None:
        text("character", self.name)
        which, keep = f"character {self.name!r}", object.__setattr__
        kinds = (("bodies", Body), ("contacts", ContactSphere), ("solids", Solid))
        for field_name, kind in kinds:
            things = tuple_of(f"{which}: {field_name}", getattr(self, field_name), kind)
            keep(self, field_name, things)
        choice(f"{which}: base", self.base, ("floating", "fixed"))
        choice(f"{which}: chart", self.chart, ("zyx", "zxy"))
        ends = {"pairs": "contact spheres", "touches": "a contact sphere and a solid"}
        for name, words in ends.items():
            given = getattr(self, name)
            try:
                keep(self, name, tuple((operator.index(a), operator.index(b)) for a, b in given))
            except (TypeError, ValueError):
                raise ModelError(
                    f"{which}: {name} is {said(given)}, must be pairs of indices of {words}"
                ) from None
        keep(self, "dropped", tuple_of(f"{which}: dropped", self.dropped, str, "sentences"))
        names = [body.name for body in self.bodies]
        keep(self, "elements", checked(which, self.elements, names))

    def _check_touches(self) -> None:
        """Contacts between bodies join a sphere and a solid of two bodies; objects are bodies."""
        for solid in self.solids:
            if not 0 <= solid.body < len(self.bodies):
                raise ModelError(
                    f"solid {solid.name!r}: body index {solid.body} is not in "
                    f"0…{len(self.bodies) - 1}"
                )
        for c, s in self.touches:
            if not (0 <= c < len(self.contacts) and 0 <= s < len(self.solids)):
                raise ModelError(
                    f"touch {(c, s)}: must be an index of the {len(self.contacts)} contact spheres "
                    f"and one of the {len(self.solids)} solids"
                )
            if self.contacts[c].body == self.solids[s].body:
                raise ModelError(
                    f"touch {(c, s)}: contact {self.contacts[c].name!r} and solid "
                    f"{self.solids[s].name!r} are on one body, must be on two"
                )
        objects = tuple_of(f"character {self.name!r}: objects", self.objects, str, "names")
        object.__setattr__(self, "objects", objects)
        for name in objects:
            if self.bodies[self.body_index(name)].parent >= 0:
                raise ModelError(f"object {name!r}: is carried by another body, must be by none")

    def _check_base(self) -> None:
        """A floating base begins with the joints of :func:`floating_base`, where anything moves."""
        if self.base == "fixed" or not self.joints:
            return
        body = self.bodies[self.base_body]
        six = [joint.kind for joint in body.joints[:6] if not joint.actuated]
        if six != 3 * ["slide"] + 3 * ["hinge"]:
            raise ModelError(
                f"character {self.name!r}: base is 'floating', but body {body.name!r}, the first "
                "that moves, does not begin with three slides and three hinges that nothing drives"
            )

    def _check_poses(self) -> None:
        which, keep = f"character {self.name!r}", object.__setattr__
        if not isinstance(self.poses, Mapping):
            raise ModelError(
                f"{which}: poses is {said(self.poses)}, must be configurations by name"
            )
        if self.default_pose is not None:
            keep(
                self, "default_pose", array(f"{which}: default pose", self.default_pose, (self.nx,))
            )
        poses = {n: array(f"{which}: pose {n!r}", x, (self.nx,)) for n, x in self.poses.items()}
        keep(self, "poses", poses)

    def _check_inertia(self) -> None:
        """Every joint must move some inertia (its own armature counts), or FD has no solution."""
        carried = np.array([body.mass for body in self.bodies])
        for b in range(len(self.bodies) - 1, -1, -1):
            if self.bodies[b].parent >= 0:
                carried[self.bodies[b].parent] += carried[b]
        for b, body in enumerate(self.bodies):
            for joint in body.joints:
                if carried[b] <= 0.0 and joint.armature <= 0.0:
                    why = f"the bodies from {body.name!r} on are massless"
                    raise ModelError(f"joint {joint.name!r} moves no mass: {why}")

    def __repr__(self) -> str:
        size = f"{self.nx} coordinates, {self.nu} actuated, {len(self.bodies)} bodies"
        lines = [
            f"{self.name}, {self.base} base: {size}, {self.mass:.4g} kg",
            listed("joints", [joint.name for joint in self.joints]),
            listed("contacts", [contact.name for contact in self.contacts]),
            listed("poses", list(self.poses)),
        ]
        if self.dropped:
            lines.append(f"  {len(self.dropped)} things of its file are not modelled: see .dropped")
        return "\n".join(lines)

    def summary(self) -> str:
        """A table to read: sizes, height and inertia; range, limits and poses of each joint; mass
        and inertia of each body.

        :func:`octo.describe` has the same as numbers.
        """
        return describe.summary(self)
