"""Bodies in tree order, and what follows from that order alone: the coordinates, who moves whom,
masses and limits.

Every degree of freedom is a one-coordinate joint (hinge or slide), so the configuration x of the
paper is the concatenation of the joint coordinates in tree order. A floating base is a body with
three slides along the world axes and three hinges; a ball joint is three hinges. The pose of a body
is

    T_b = T_parent(b) · (position, rotation) · Π_joints (displacement of the joint by x_j −
    reference_j)

with hinges turning about ``axis`` through ``anchor``, both in the body's frame at that point of the
product (the convention of MuJoCo).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from octo.checks import one_of
from octo.model.body import Body, ContactSphere, Joint
from octo.model.element import Element
from octo.model.look import Look
from octo.model.quantities import Array
from octo.model.solid import Solid


@dataclass(frozen=True, eq=False, repr=False)
class Tree:
    """The data of a :class:`octo.Character`, which says what each field is, and checks it."""

    name: str
    bodies: tuple[Body, ...]
    contacts: tuple[ContactSphere, ...] = ()
    pairs: tuple[tuple[int, int], ...] = ()
    base: Literal["floating", "fixed"] = "floating"
    chart: Literal["zyx", "zxy"] = "zyx"
    default_pose: Array | None = None
    dropped: tuple[str, ...] = ()
    poses: Mapping[str, Array] = field(default_factory=dict)
    elements: tuple[Element, ...] = ()
    solids: tuple[Solid, ...] = ()
    touches: tuple[tuple[int, int], ...] = ()
    objects: tuple[str, ...] = ()
    looks: tuple[Look, ...] = ()

    @cached_property
    def joints(self) -> tuple[Joint, ...]:
        """The degrees of freedom in the order of x."""
        return tuple(joint for body in self.bodies for joint in body.joints)

    @property
    def start_pose(self) -> Array:
        """(nx,) a new array: the default pose; zeros where there is none."""
        pose = self.default_pose
        return np.zeros(self.nx) if pose is None else np.array(pose, dtype=float)

    @property
    def nx(self) -> int:
        return len(self.joints)

    @property
    def nu(self) -> int:
        return len(self.actuated)

    @cached_property
    def actuated(self) -> NDArray[np.intp]:
        """Indices into x of the actuated degrees of freedom: U of Eq. 7 is the identity's rows at
        these."""
        return np.array([j for j, joint in enumerate(self.joints) if joint.actuated], dtype=np.intp)

    @cached_property
    def unactuated(self) -> NDArray[np.intp]:
        """Indices into x of the unactuated degrees of freedom (the rows U_/ of Eq. 7)."""
        return np.setdiff1d(np.arange(self.nx), self.actuated).astype(np.intp)

    @cached_property
    def first_joint(self) -> NDArray[np.intp]:
        """(bodies,) index into x of each body's first joint (where it would be, for a welded
        body)."""
        counts = [len(body.joints) for body in self.bodies]
        return np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.intp)

    @cached_property
    def path(self) -> tuple[tuple[int, ...], ...]:
        """For each body, the degrees of freedom that move it, root first."""
        paths: list[tuple[int, ...]] = []
        for b, body in enumerate(self.bodies):
            inherited = paths[body.parent] if body.parent >= 0 else ()
            first = int(self.first_joint[b])
            paths.append(inherited + tuple(range(first, first + len(body.joints))))
        return tuple(paths)

    @cached_property
    def terrain_contacts(self) -> tuple[int, ...]:
        """Indices of the contact spheres that touch the terrain."""
        return tuple(k for k, contact in enumerate(self.contacts) if contact.touches_terrain)

    @cached_property
    def of_objects(self) -> NDArray[np.bool_]:
        """(bodies,) whether a body is one of a scene's objects, or what such a one carries."""
        inside: list[bool] = []
        for body in self.bodies:
            carried = body.parent >= 0 and inside[body.parent]
            inside.append(carried or body.name in self.objects)
        return np.array(inside, dtype=bool)

    @cached_property
    def own_contacts(self) -> tuple[int, ...]:
        """Those of ``terrain_contacts`` that are the robot's: an object's corner is no foot."""
        return tuple(k for k in self.terrain_contacts if not self.of_objects[self.contacts[k].body])

    @cached_property
    def loose(self) -> NDArray[np.intp]:
        """Indices into x of the objects' coordinates."""
        moved = [self.of_objects[b] for b, body in enumerate(self.bodies) for _ in body.joints]
        return np.flatnonzero(moved).astype(np.intp)

    @cached_property
    def roots(self) -> tuple[int, ...]:
        """(bodies,) the first body of the tree that each is in."""
        root: list[int] = []
        for b, body in enumerate(self.bodies):
            root.append(b if body.parent < 0 else root[body.parent])
        return tuple(root)

    @cached_property
    def own(self) -> NDArray[np.bool_]:
        """(bodies,) whether a body is the robot's, and neither an object nor the world's.

        The robot is what the floating base carries. On a fixed base it is the trees that are driven
        (or, where none is, that move), with what they stand on: a door beside an arm moves, but its
        weight is not the arm's.
        """
        root = self.roots
        if self.base == "floating":
            kept = {root[self.base_body]} if self.bodies else set()
        else:
            moving = {
                root[b]
                for b, body in enumerate(self.bodies)
                if body.joints and not self.of_objects[b]
            }
            moved = [(b, joint) for b, body in enumerate(self.bodies) for joint in body.joints]
            driven = {root[b] for b, joint in moved if joint.actuated}
            kept = driven or moving or set(root)
        return np.array([one in kept for one in root], dtype=bool)

    @cached_property
    def masses(self) -> Array:
        """(bodies,) kg; zero of what is world and not robot."""
        return np.array([body.mass for body in self.bodies]) * self.own

    @cached_property
    def mass(self) -> float:
        """kg, all bodies of the robot."""
        return float(sum(self.masses))

    @property
    def base_body(self) -> int:
        """Index of the floating base (0 for a fixed base)."""
        for b, body in enumerate(self.bodies):
            if body.joints:
                return b if self.base == "floating" else 0
        return 0

    @property
    def base_coordinate(self) -> int:
        """Where the coordinates of the base begin in a configuration; of a floating one x, y, z
        first."""
        return int(self.first_joint[self.base_body])

    @cached_property
    def lower(self) -> Array:
        return np.array([joint.lower for joint in self.joints])

    @cached_property
    def upper(self) -> Array:
        return np.array([joint.upper for joint in self.joints])

    @cached_property
    def torque_limit(self) -> Array:
        """(nu,) N m or N."""
        return np.array([self.joints[j].torque_limit for j in self.actuated])

    @cached_property
    def velocity_limit(self) -> Array:
        """(nx,) rad/s or m/s, infinite where a coordinate has none."""
        return np.array([joint.velocity_limit for joint in self.joints])

    def body_index(self, name: str) -> int:
        return _index("body", name, [body.name for body in self.bodies])

    def joint_index(self, name: str) -> int:
        return _index("joint", name, [joint.name for joint in self.joints])

    def contact_index(self, name: str) -> int:
        return _index("contact", name, [contact.name for contact in self.contacts])


def _index(kind: str, name: str, names: list[str]) -> int:
    return names.index(one_of(kind, name, names))
