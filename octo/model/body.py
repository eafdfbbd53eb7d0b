"""The parts of a character: joints, the bodies between them, and the spheres that bodies carry."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from octo.errors import ModelError, said
from octo.model.quantities import Array, array, choice, quantity, text, tuple_of, vector3

ROUNDED = 1e-3  # by how much the length of an axis may be off, as where a file says 0.707
UNIT = 1e-6  # by how much a rotation or the symmetry of an inertia may be off
INDEFINITE = 1e-6  # of the largest principal moment: how negative rounding makes the smallest
LEAST_MOMENT = 1e-15  # kg m², of moments that are all rounding


@dataclass(frozen=True, eq=False)
class Joint:
    """One degree of freedom between a body and its parent."""

    name: str
    kind: Literal["hinge", "slide"]
    axis: Array  # (3,) unit vector, body frame
    anchor: Array = field(default_factory=vector3)  # (3,) m, body frame; a point of the hinge axis
    lower: float = -math.inf  # rad or m
    upper: float = math.inf  # rad or m
    # rad or m; the coordinate at which the displacement is zero (MuJoCo's qpos0)
    reference: float = 0.0
    actuated: bool = True
    torque_limit: float = math.inf  # N m or N, of |u|
    velocity_limit: float = math.inf  # rad/s or m/s, of |dq/dt|
    gear: float = 1.0  # joint torque per unit of the actuator's control
    armature: float = 0.0  # kg m² or kg, inertia of the rotor seen at the joint
    damping: float = 0.0  # N m s/rad or N s/m
    stiffness: float = 0.0  # N m/rad or N/m
    rest: float = 0.0  # rad or m; the coordinate at which the spring is relaxed

    def __post_init__(self) -> None:
        text("joint", self.name)
        which = f"joint {self.name!r}"
        choice(f"{which}: kind", self.kind, ("hinge", "slide"))
        axis = array(f"{which}: axis", self.axis, (3,))
        length = float(np.linalg.norm(axis))
        if not abs(length - 1.0) <= ROUNDED:
            raise ModelError(f"{which}: axis has length {length:.6g}, must be a unit vector")
        keep = object.__setattr__
        keep(self, "axis", axis / length if abs(length - 1.0) > 1e-12 else axis)
        keep(self, "anchor", array(f"{which}: anchor", self.anchor, (3,)))
        if not isinstance(self.actuated, (bool, np.bool_)):
            raise ModelError(f"{which}: actuated is {said(self.actuated)}, must be True or False")
        for name in ("reference", "gear", "rest"):
            keep(self, name, quantity(f"{which}: {name}", getattr(self, name)))
        for name in ("armature", "damping", "stiffness"):
            value = quantity(f"{which}: {name}", getattr(self, name), "finite and not negative")
            keep(self, name, value)
        limits = {"lower": "a number", "upper": "a number"}
        limits |= {"torque_limit": "not negative", "velocity_limit": "positive"}
        for name, rule in limits.items():
            what = f"{which}: {name.removesuffix('_limit')} limit"
            keep(self, name, quantity(what, getattr(self, name), rule, unlimited=True))
        if not self.lower <= self.upper:
            raise ModelError(
                f"{which}: lower limit {self.lower} is above the upper limit {self.upper}"
            )
        if math.isinf(self.lower) and self.lower == self.upper:
            raise ModelError(f"{which}: both limits are {self.lower}, must leave a range")

    @property
    def limited(self) -> bool:
        return math.isfinite(self.lower) or math.isfinite(self.upper)


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body, its place on its parent and the joints between the two."""

    name: str
    parent: int  # index of the parent body, -1 for the world
    joints: tuple[Joint, ...] = ()  # outermost first; empty: welded to the parent
    position: Array = field(default_factory=vector3)  # (3,) m, in the parent's frame
    rotation: Array = field(default_factory=lambda: np.eye(3))  # (3, 3), body frame to parent frame
    mass: float = 0.0  # kg
    com: Array = field(default_factory=vector3)  # (3,) m, body frame
    # (3, 3) kg m² about the com, body axes
    inertia: Array = field(default_factory=lambda: np.zeros((3, 3)))

    def __post_init__(self) -> None:
        text("body", self.name)
        which, keep = f"body {self.name!r}", object.__setattr__
        if isinstance(self.parent, bool) or not isinstance(self.parent, (int, np.integer)):
            raise ModelError(
                f"{which}: parent is {said(self.parent)}, must be the index of a body, or -1"
            )
        keep(self, "joints", tuple_of(f"{which}: joints", self.joints, Joint))
        keep(self, "mass", quantity(f"{which}: mass", self.mass, "finite and not negative"))
        shapes = {"position": (3,), "rotation": (3, 3), "com": (3,), "inertia": (3, 3)}
        for name, shape in shapes.items():
            words = {"com": "centre of mass"}.get(name, name)
            keep(self, name, array(f"{which}: {words}", getattr(self, name), shape))
        off = float(np.abs(self.rotation @ self.rotation.T - np.eye(3)).max())
        if off > UNIT or np.linalg.det(self.rotation) < 0.0:
            raise ModelError(
                f"{which}: rotation is none (off by {off:.2g}), must have orthogonal unit axes, "
                "right-handed"
            )
        skew = float(np.abs(self.inertia - self.inertia.T).max())
        if skew > UNIT * np.abs(self.inertia).max():
            raise ModelError(
                f"{which}: inertia is not symmetric (off by {skew:.2g} kg m²), must be"
            )
        small, middle, large = np.linalg.eigvalsh(self.inertia)
        if small < -INDEFINITE * max(large, 0.0) - LEAST_MOMENT:
            moments = f"{small:.3g}, {middle:.3g}, {large:.3g} kg m²"
            raise ModelError(
                f"{which}: inertia has the principal moments {moments}, must have none that is "
                "negative"
            )


@dataclass(frozen=True, eq=False)
class ContactSphere:
    """A sphere carried by a body: it touches the terrain, and other spheres where a pair says
    so."""

    name: str
    body: int
    position: Array  # (3,) m, body frame
    radius: float  # m
    touches_terrain: bool = True

    def __post_init__(self) -> None:
        text("contact", self.name)
        which, keep = f"contact {self.name!r}", object.__setattr__
        if isinstance(self.body, bool) or not isinstance(self.body, (int, np.integer)):
            raise ModelError(f"{which}: body is {said(self.body)}, must be the index of a body")
        keep(self, "position", array(f"{which}: position", self.position, (3,)))
        keep(self, "radius", quantity(f"{which}: radius", self.radius, "finite and not negative"))


def joined(parts: Sequence[tuple[float, Array, Array]]) -> tuple[float, Array, Array]:
    """Mass, centre of mass (3,) and inertia (3, 3) about it of parts, the same three each in common
    axes, that are one rigid body."""
    mass = sum(m for m, _, _ in parts)
    com = sum((m * c for m, c, _ in parts), np.zeros(3))
    com = com / mass if mass > 0.0 else np.zeros(3)
    inertia = np.zeros((3, 3))
    for m, c, own in parts:
        r = c - com
        inertia += own + m * (r @ r * np.eye(3) - np.outer(r, r))
    return mass, com, inertia


def floating_base(prefix: str = "base", chart: Literal["zyx", "zxy"] = "zyx") -> tuple[Joint, ...]:
    """The six unactuated joints of a floating base: x, y, z along the world axes, then the chart's
    hinges."""
    axes = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
    angle = {"x": "roll", "y": "pitch", "z": "yaw"}
    slides = tuple(Joint(f"{prefix}_{c}", "slide", vector3(axes[c]), actuated=False) for c in "xyz")
    hinges = tuple(
        Joint(f"{prefix}_{angle[c]}", "hinge", vector3(axes[c]), actuated=False) for c in chart
    )
    return slides + hinges
