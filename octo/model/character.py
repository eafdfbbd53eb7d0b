"""What moves and what it touches: a tree of rigid bodies as frozen dataclasses.

Every degree of freedom is a one-coordinate joint (hinge or slide), so the configuration x of the paper is the
concatenation of the joint coordinates in tree order. A floating base is a body with three slides along the world axes
and three hinges; a ball joint is three hinges. The pose of a body is

    T_b = T_parent(b) · (position, rotation) · Π_joints (displacement of the joint by x_j − reference_j)

with hinges turning about ``axis`` through ``anchor``, both in the body's frame at that point of the product
(the convention of MuJoCo).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from octo.errors import ModelError, UnknownNameError
from octo.shown import Shown, listed

Array = NDArray[np.float64]


def _vector3(values: object = (0.0, 0.0, 0.0)) -> Array:
    return np.asarray(values, dtype=float).reshape(3)


@dataclass(frozen=True, eq=False)
class Joint:
    """One degree of freedom between a body and its parent."""

    name: str
    kind: Literal["hinge", "slide"]
    axis: Array  # (3,) unit vector, body frame
    anchor: Array = field(default_factory=_vector3)  # (3,) m, body frame; a point of the hinge axis
    lower: float = -math.inf  # rad or m
    upper: float = math.inf  # rad or m
    reference: float = 0.0  # rad or m; the coordinate at which the displacement is zero (MuJoCo's qpos0)
    actuated: bool = True
    torque_limit: float = math.inf  # N m or N, of |u|
    velocity_limit: float = math.inf  # rad/s or m/s, of |dq/dt|
    gear: float = 1.0  # joint torque per unit of the actuator's control
    armature: float = 0.0  # kg m² or kg, inertia of the rotor seen at the joint
    damping: float = 0.0  # N m s/rad or N s/m
    stiffness: float = 0.0  # N m/rad or N/m
    rest: float = 0.0  # rad or m; the coordinate at which the spring is relaxed

    @property
    def limited(self) -> bool:
        return math.isfinite(self.lower) or math.isfinite(self.upper)


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body, its place on its parent and the joints between the two."""

    name: str
    parent: int  # index of the parent body, -1 for the world
    joints: tuple[Joint, ...] = ()  # outermost first; empty: welded to the parent
    position: Array = field(default_factory=_vector3)  # (3,) m, in the parent's frame
    rotation: Array = field(default_factory=lambda: np.eye(3))  # (3, 3), body frame to parent frame
    mass: float = 0.0  # kg
    com: Array = field(default_factory=_vector3)  # (3,) m, body frame
    inertia: Array = field(default_factory=lambda: np.zeros((3, 3)))  # (3, 3) kg m² about the com, body axes


@dataclass(frozen=True, eq=False)
class ContactSphere:
    """A sphere carried by a body: it touches the terrain, and other spheres where a pair says so."""

    name: str
    body: int
    position: Array  # (3,) m, body frame
    radius: float  # m
    touches_terrain: bool = True


@dataclass(frozen=True, eq=False, repr=False)
class Character(Shown):
    """A robot or a character: bodies in tree order (parents first), contact spheres, self-collision pairs.

    Attributes
    ----------
    bodies: parents before children; the configuration x (nx,) lists their joints in this order.
    contacts: spheres; those with ``touches_terrain`` become the contacts of Eq. 6.
    pairs: index pairs into ``contacts`` that repel each other (§4.2).
    base: "floating" when the first moving body has six unactuated coordinates (x, y, z, then the rotation chart).
    chart: order of the floating base's three hinges, "zyx" (yaw, pitch, roll; singular at pitch ±90°) or
        "zxy" (yaw, roll, pitch; singular at roll ±90°). The innermost and the outermost angle are unbounded.
    default_pose: (nx,) the configuration a start is searched from.
    dropped: sentences naming what the robot's file says and octo does not model.
    poses: further configurations (nx,) by name: the keyframes of the robot's file.
    """

    name: str
    bodies: tuple[Body, ...]
    contacts: tuple[ContactSphere, ...] = ()
    pairs: tuple[tuple[int, int], ...] = ()
    base: Literal["floating", "fixed"] = "floating"
    chart: Literal["zyx", "zxy"] = "zyx"
    default_pose: Array | None = None
    dropped: tuple[str, ...] = ()
    poses: Mapping[str, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for b, body in enumerate(self.bodies):
            if not -1 <= body.parent < b:
                raise ModelError(f"body {body.name!r}: parent index {body.parent} must be -1 or less than its own index {b}")
            if not (math.isfinite(body.mass) and body.mass >= 0.0):
                raise ModelError(f"body {body.name!r}: mass is {body.mass}, must be finite and not negative")
            if not (np.isfinite(body.inertia).all() and np.isfinite(body.com).all()):
                raise ModelError(f"body {body.name!r}: inertia or centre of mass is not finite")
        if self.mass <= 0.0:
            raise ModelError(f"character {self.name!r}: total mass is {self.mass}, must be positive")
        for contact in self.contacts:
            if not 0 <= contact.body < len(self.bodies):
                raise ModelError(f"contact {contact.name!r}: body index {contact.body} is not in 0…{len(self.bodies) - 1}")
            if not contact.radius >= 0.0:
                raise ModelError(f"contact {contact.name!r}: radius is {contact.radius}, must not be negative")
        for pair in self.pairs:
            if not all(0 <= k < len(self.contacts) for k in pair) or pair[0] == pair[1]:
                raise ModelError(f"pair {pair}: must be two different indices of the {len(self.contacts)} contact spheres")
        for joint in self.joints:
            if not joint.lower <= joint.upper:
                raise ModelError(f"joint {joint.name!r}: lower limit {joint.lower} is above the upper limit {joint.upper}")
            if not joint.velocity_limit > 0.0:
                raise ModelError(f"joint {joint.name!r}: velocity limit is {joint.velocity_limit}, must be positive")
        self._check_inertia()

    def _check_inertia(self) -> None:
        """Every joint must move some inertia (its own armature counts), or FD has no solution."""
        carried = np.array([body.mass for body in self.bodies])
        for b in range(len(self.bodies) - 1, -1, -1):
            if self.bodies[b].parent >= 0:
                carried[self.bodies[b].parent] += carried[b]
        for b, body in enumerate(self.bodies):
            for joint in body.joints:
                if carried[b] <= 0.0 and joint.armature <= 0.0:
                    raise ModelError(f"joint {joint.name!r} moves no mass: the bodies from {body.name!r} on are massless")

    def __repr__(self) -> str:
        size = f"{self.nx} coordinates, {self.nu} actuated, {len(self.bodies)} bodies, {self.mass:.4g} kg"
        lines = [
            f"{self.name}, {self.base} base: {size}",
            listed("joints", [joint.name for joint in self.joints]),
            listed("contacts", [contact.name for contact in self.contacts]),
            listed("poses", list(self.poses)),
        ]
        dropped = [f"  {len(self.dropped)} things of its file are not modelled: see .dropped"] if self.dropped else []
        return "\n".join(lines + dropped)

    def summary(self) -> str:
        """A table to read: sizes, height and inertia; range, limits and poses of each joint; mass and inertia of each body.

        :func:`octo.describe` has the same as numbers.
        """
        from octo.model.describe import summary  # which needs this module

        return summary(self)

    @cached_property
    def joints(self) -> tuple[Joint, ...]:
        """The degrees of freedom in the order of x."""
        return tuple(joint for body in self.bodies for joint in body.joints)

    @property
    def nx(self) -> int:
        return len(self.joints)

    @property
    def nu(self) -> int:
        return len(self.actuated)

    @cached_property
    def actuated(self) -> NDArray[np.intp]:
        """Indices into x of the actuated degrees of freedom: U of Eq. 7 is the identity's rows at these."""
        return np.array([j for j, joint in enumerate(self.joints) if joint.actuated], dtype=np.intp)

    @cached_property
    def unactuated(self) -> NDArray[np.intp]:
        """Indices into x of the unactuated degrees of freedom (the rows U_/ of Eq. 7)."""
        return np.array([j for j, joint in enumerate(self.joints) if not joint.actuated], dtype=np.intp)

    @cached_property
    def first_joint(self) -> NDArray[np.intp]:
        """(bodies,) index into x of each body's first joint (where it would be, for a welded body)."""
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

    @property
    def mass(self) -> float:
        """kg, all bodies."""
        return float(sum(body.mass for body in self.bodies))

    @property
    def base_body(self) -> int:
        """Index of the floating base (0 for a fixed base)."""
        for b, body in enumerate(self.bodies):
            if body.joints:
                return b if self.base == "floating" else 0
        return 0

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
    if name not in names:
        raise UnknownNameError(kind, name, names)
    return names.index(name)


def floating_base(prefix: str = "base", chart: Literal["zyx", "zxy"] = "zyx") -> tuple[Joint, ...]:
    """The six unactuated joints of a floating base: x, y, z along the world axes, then the chart's hinges."""
    axes = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
    angle = {"x": "roll", "y": "pitch", "z": "yaw"}
    slides = tuple(Joint(f"{prefix}_{c}", "slide", _vector3(axes[c]), actuated=False) for c in "xyz")
    hinges = tuple(Joint(f"{prefix}_{angle[c]}", "hinge", _vector3(axes[c]), actuated=False) for c in chart)
    return slides + hinges
