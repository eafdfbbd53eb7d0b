"""What the gallery's characters are made of: links, hinges, spheres; left and right."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from octo.model.body import Body, ContactSphere, Joint, floating_base, joined
from octo.model.character import Character
from octo.model.feet import bottoms
from octo.model.quantities import Array

AXES = dict(zip("xyz", np.eye(3), strict=True))
SIDES = (("left", 1.0), ("right", -1.0))  # y points left


@dataclass(frozen=True)
class Hinge:
    """A hinge of the gallery: its axis, its range, and where it stands in the default pose."""

    name: str
    axis: str  # "x", "y" or "z" of the body's frame
    lower: float  # rad
    upper: float  # rad
    default: float  # rad
    torque: float  # N m

    def mirrored(self, side: float) -> Hinge:
        """The same hinge on the other side of the x–z plane when ``side`` is -1: turns about x and
        z change sign."""
        if side > 0 or self.axis == "y":
            return self
        return replace(self, lower=-self.upper, upper=-self.lower, default=-self.default)

    def joint(self, link: str) -> Joint:
        limits: dict[str, Any] = {"lower": self.lower, "upper": self.upper}
        limits["torque_limit"] = self.torque
        return Joint(f"{link}_{self.name}", "hinge", AXES[self.axis], **limits)


@dataclass
class Builder:
    """Collects bodies, spheres and pairs; every link has the same density."""

    name: str
    bodies: list[Body] = field(default_factory=list)
    contacts: list[ContactSphere] = field(default_factory=list)
    pairs: list[tuple[str, str]] = field(default_factory=list)
    default: list[float] = field(default_factory=list)

    def base(
        self, name: str, start: Sequence[float], end: Sequence[float], radius: float, *more: tuple
    ) -> int:
        """The floating base: a capsule and ``more`` capsules (start, end, radius) rigidly joined to
        it."""
        self.default += [0.0] * 6
        return self._add(Body(name, -1, floating_base()), [(start, end, radius), *more])

    def link(
        self,
        name: str,
        parent: int,
        position: Sequence[float],
        hinges: Sequence[Hinge],
        end: Sequence[float],
        radius: float,
        *more: tuple,
        start: Sequence[float] = (0.0, 0.0, 0.0),
        turn: float = 0.0,
    ) -> int:
        """A capsule from ``start`` to ``end`` (m, own frame) that hangs on ``parent`` at
        ``position`` by ``hinges``.

        ``turn`` (rad) turns the link's frame about the parent's z axis.
        """
        cos, sin = math.cos(turn), math.sin(turn)
        rotation = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        joints = tuple(h.joint(name) for h in hinges)
        self.default += [h.default for h in hinges]
        body = Body(name, parent, joints, np.asarray(position, dtype=float), rotation)
        return self._add(body, [(start, end, radius), *more])

    def sphere(self, name: str, body: int, position: Sequence[float], radius: float) -> None:
        self.contacts.append(ContactSphere(name, body, np.asarray(position, dtype=float), radius))

    def finish(self, mass: float, feet: Sequence[str]) -> Character:
        """Give all links the density that makes the total ``mass`` (kg); number the spheres called
        ``feet`` first."""
        density = mass / sum(body.mass for body in self.bodies)
        bodies = tuple(
            replace(b, mass=density * b.mass, inertia=density * b.inertia) for b in self.bodies
        )
        names = [*feet, *(c.name for c in self.contacts if c.name not in feet)]
        by_name = {contact.name: contact for contact in self.contacts}
        contacts = tuple(by_name[name] for name in names)
        pairs = tuple((names.index(a), names.index(b)) for a, b in self.pairs)
        pose = np.array(self.default)
        character = Character(self.name, bodies, contacts, pairs, default_pose=pose)
        pose[2] -= np.min(bottoms(character, pose))  # the lowest sphere touches z = 0
        return replace(character, default_pose=pose)

    def _add(self, body: Body, capsules: Sequence[tuple]) -> int:
        volume, com, inertia = joined([capsule(*own) for own in capsules])
        self.bodies.append(replace(body, mass=volume, com=com, inertia=inertia))
        return len(self.bodies) - 1


def capsule(
    start: Sequence[float], end: Sequence[float], radius: float
) -> tuple[float, Array, Array]:
    """Volume (m³), centroid (3,) m and inertia (3, 3) m⁵ about it, at unit density, of a
    capsule."""
    a, b = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    length = float(np.linalg.norm(b - a))
    axis = (b - a) / length if length > 0.0 else AXES["z"]
    cylinder, ball = math.pi * radius**2 * length, 4.0 / 3.0 * math.pi * radius**3
    along = cylinder * radius**2 / 2 + ball * 2 * radius**2 / 5
    # Two half balls whose centroids lie 3/8 radius outside the cylinder's ends.
    of_ends = 2 * radius**2 / 5 + length**2 / 4 + 3 * length * radius / 8
    across = cylinder * (radius**2 / 4 + length**2 / 12) + ball * of_ends
    outer = np.outer(axis, axis)
    return cylinder + ball, (a + b) / 2, along * outer + across * (np.eye(3) - outer)
