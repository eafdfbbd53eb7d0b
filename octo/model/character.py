"""What moves and what it touches: a tree of rigid bodies as frozen dataclasses, checked where they
are made.

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

import math
import operator
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from octo.checks import one_of
from octo.errors import ModelError, said
from octo.shown import Shown, listed

Array = NDArray[np.float64]
LARGEST = 1e12  # SI units, of every quantity but a limit: squares and cubes of it are still numbers
ROUNDED = 1e-3  # by how much the length of an axis may be off, as where a file says 0.707
UNIT = 1e-6  # by how much a rotation or the symmetry of an inertia may be off
INDEFINITE = 1e-6  # of the largest principal moment: how negative rounding makes the smallest
LEAST_MOMENT = 1e-15  # kg m², of moments that are all rounding


def _vector3(values: object = (0.0, 0.0, 0.0)) -> Array:
    return np.asarray(values, dtype=float).reshape(3)


def _text(what: str, value: object) -> None:
    if not isinstance(value, str) or not value:
        raise ModelError(f"{what}: name is {said(value)}, must be a text that is not empty")


def _array(what: str, value: object, shape: tuple[int, ...]) -> Array:
    """A copy of ``value`` as finite numbers of this shape that fit into the arithmetic."""
    try:
        array = np.array(value)
    except ValueError:  # lists of unequal lengths
        array = np.array(None)
    if array.dtype.kind not in "iuf":
        raise ModelError(f"{what} is {said(value)}, must be numbers")
    array = array.astype(float)
    if array.shape != shape:
        raise ModelError(f"{what} has shape {array.shape}, must have {shape}")
    if not (np.abs(array) <= LARGEST).all():
        bad = array[~(np.abs(array) <= LARGEST)].ravel()[0]
        raise ModelError(f"{what} has the entry {bad}, must be finite and at most {LARGEST:.0e}")
    return array


def _quantity(what: str, value: object, rule: str = "finite", *, unlimited: bool = False) -> float:
    """``value`` as a number that is finite; with ``unlimited``, as a limit, which may also be
    infinite. Never NaN."""
    try:
        number = float(operator.pos(value))  # type: ignore[arg-type]  # a text has no sign
    except (TypeError, ValueError):
        raise ModelError(f"{what} is {said(value)}, must be a number") from None
    except OverflowError:
        number = math.inf
    negative = "not negative" in rule and number < 0.0 or "positive" in rule and number <= 0.0
    if math.isnan(number) or negative or (not unlimited and abs(number) > LARGEST):
        large = not negative and math.isfinite(number)
        raise ModelError(
            f"{what} is {number}, must be {f'at most {LARGEST:.0e}' if large else rule}"
        )
    return number


@dataclass(frozen=True, eq=False)
class Joint:
    """One degree of freedom between a body and its parent."""

    name: str
    kind: Literal["hinge", "slide"]
    axis: Array  # (3,) unit vector, body frame
    anchor: Array = field(default_factory=_vector3)  # (3,) m, body frame; a point of the hinge axis
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
        _text("joint", self.name)
        which = f"joint {self.name!r}"
        if not isinstance(self.kind, str) or self.kind not in ("hinge", "slide"):
            raise ModelError(f"{which}: kind is {said(self.kind)}, must be 'hinge' or 'slide'")
        axis = _array(f"{which}: axis", self.axis, (3,))
        length = float(np.linalg.norm(axis))
        if not abs(length - 1.0) <= ROUNDED:
            raise ModelError(f"{which}: axis has length {length:.6g}, must be a unit vector")
        keep = object.__setattr__
        keep(self, "axis", axis / length if abs(length - 1.0) > 1e-12 else axis)
        keep(self, "anchor", _array(f"{which}: anchor", self.anchor, (3,)))
        if not isinstance(self.actuated, (bool, np.bool_)):
            raise ModelError(f"{which}: actuated is {said(self.actuated)}, must be True or False")
        for name in ("reference", "gear", "rest"):
            keep(self, name, _quantity(f"{which}: {name}", getattr(self, name)))
        for name in ("armature", "damping", "stiffness"):
            keep(
                self,
                name,
                _quantity(f"{which}: {name}", getattr(self, name), "finite and not negative"),
            )
        for end in ("lower", "upper"):
            keep(
                self,
                end,
                _quantity(f"{which}: {end} limit", getattr(self, end), "a number", unlimited=True),
            )
        if not self.lower <= self.upper:
            raise ModelError(
                f"{which}: lower limit {self.lower} is above the upper limit {self.upper}"
            )
        if math.isinf(self.lower) and self.lower == self.upper:
            raise ModelError(f"{which}: both limits are {self.lower}, must leave a range")
        keep(
            self,
            "torque_limit",
            _quantity(f"{which}: torque limit", self.torque_limit, "not negative", unlimited=True),
        )
        keep(
            self,
            "velocity_limit",
            _quantity(f"{which}: velocity limit", self.velocity_limit, "positive", unlimited=True),
        )

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
    # (3, 3) kg m² about the com, body axes
    inertia: Array = field(default_factory=lambda: np.zeros((3, 3)))

    def __post_init__(self) -> None:
        _text("body", self.name)
        which, keep = f"body {self.name!r}", object.__setattr__
        if isinstance(self.parent, bool) or not isinstance(self.parent, (int, np.integer)):
            raise ModelError(
                f"{which}: parent is {said(self.parent)}, must be the index of a body, or -1"
            )
        if not isinstance(self.joints, (tuple, list)) or not all(
            isinstance(joint, Joint) for joint in self.joints
        ):
            raise ModelError(f"{which}: joints is {said(self.joints)}, must be a tuple of Joint")
        keep(self, "joints", tuple(self.joints))
        keep(self, "mass", _quantity(f"{which}: mass", self.mass, "finite and not negative"))
        for name, shape in (
            ("position", (3,)),
            ("rotation", (3, 3)),
            ("com", (3,)),
            ("inertia", (3, 3)),
        ):
            words = {"com": "centre of mass"}.get(name, name)
            keep(self, name, _array(f"{which}: {words}", getattr(self, name), shape))
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
        _text("contact", self.name)
        which, keep = f"contact {self.name!r}", object.__setattr__
        if isinstance(self.body, bool) or not isinstance(self.body, (int, np.integer)):
            raise ModelError(f"{which}: body is {said(self.body)}, must be the index of a body")
        keep(self, "position", _array(f"{which}: position", self.position, (3,)))
        keep(self, "radius", _quantity(f"{which}: radius", self.radius, "finite and not negative"))


@dataclass(frozen=True, eq=False, repr=False)
class Character(Shown):
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
        self._check_kinds()
        for b, body in enumerate(self.bodies):
            if not -1 <= body.parent < b:
                raise ModelError(
                    f"body {body.name!r}: parent index {body.parent} must be -1 or less than its "
                    "own "
                    f"index {b}"
                )
        for kind, things in (
            ("bodies", self.bodies),
            ("joints", self.joints),
            ("contacts", self.contacts),
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
                    "contact "
                    "spheres"
                )
        self._check_poses()
        self._check_inertia()

    def _check_kinds(self) -> None:
        _text("character", self.name)
        which, keep = f"character {self.name!r}", object.__setattr__
        for field_name, kind in (("bodies", Body), ("contacts", ContactSphere)):
            things = getattr(self, field_name)
            if not isinstance(things, (tuple, list)) or not all(
                isinstance(thing, kind) for thing in things
            ):
                raise ModelError(
                    f"{which}: {field_name} is {said(things)}, must be a tuple of {kind.__name__}"
                )
            keep(self, field_name, tuple(things))
        if not isinstance(self.base, str) or self.base not in ("floating", "fixed"):
            raise ModelError(f"{which}: base is {said(self.base)}, must be 'floating' or 'fixed'")
        if not isinstance(self.chart, str) or self.chart not in ("zyx", "zxy"):
            raise ModelError(f"{which}: chart is {said(self.chart)}, must be 'zyx' or 'zxy'")
        try:
            keep(
                self, "pairs", tuple((operator.index(a), operator.index(b)) for a, b in self.pairs)
            )
        except (TypeError, ValueError):
            raise ModelError(
                f"{which}: pairs is {said(self.pairs)}, must be pairs of indices of contact spheres"
            ) from None
        if not isinstance(self.dropped, (tuple, list)) or not all(
            isinstance(sentence, str) for sentence in self.dropped
        ):
            raise ModelError(
                f"{which}: dropped is {said(self.dropped)}, must be a tuple of sentences"
            )
        keep(self, "dropped", tuple(self.dropped))

    def _check_base(self) -> None:
        """A floating base begins with the six joints of :func:`floating_base`; a robot that nothing
        moves may have none."""
        if self.base == "fixed" or not self.joints:
            return
        body = self.bodies[self.base_body]
        six = [joint.kind for joint in body.joints[:6] if not joint.actuated]
        if six != 3 * ["slide"] + 3 * ["hinge"]:
            what = (
                f"base is 'floating', but body {body.name!r}, the first that moves, does not begin "
                "with"
            )
            raise ModelError(
                f"character {self.name!r}: {what} three slides and three hinges that nothing drives"
            )

    def _check_poses(self) -> None:
        if not isinstance(self.poses, Mapping):
            raise ModelError(
                f"character {self.name!r}: poses is {said(self.poses)}, must be configurations by "
                "name"
            )
        poses = dict(self.poses)
        if self.default_pose is not None:
            pose = _array(f"character {self.name!r}: default pose", self.default_pose, (self.nx,))
            object.__setattr__(self, "default_pose", pose)
        named = {
            name: _array(f"character {self.name!r}: pose {name!r}", pose, (self.nx,))
            for name, pose in poses.items()
        }
        object.__setattr__(self, "poses", named)

    def _check_inertia(self) -> None:
        """Every joint must move some inertia (its own armature counts), or FD has no solution."""
        carried = np.array([body.mass for body in self.bodies])
        for b in range(len(self.bodies) - 1, -1, -1):
            if self.bodies[b].parent >= 0:
                carried[self.bodies[b].parent] += carried[b]
        for b, body in enumerate(self.bodies):
            for joint in body.joints:
                if carried[b] <= 0.0 and joint.armature <= 0.0:
                    raise ModelError(
                        f"joint {joint.name!r} moves no mass: the bodies from {body.name!r} on are "
                        "massless"
                    )

    def __repr__(self) -> str:
        size = (
            f"{self.nx} coordinates, {self.nu} actuated, {len(self.bodies)} bodies, "
            f"{self.mass:.4g} kg"
        )
        lines = [
            f"{self.name}, {self.base} base: {size}",
            listed("joints", [joint.name for joint in self.joints]),
            listed("contacts", [contact.name for contact in self.contacts]),
            listed("poses", list(self.poses)),
        ]
        dropped = (
            [f"  {len(self.dropped)} things of its file are not modelled: see .dropped"]
            if self.dropped
            else []
        )
        return "\n".join(lines + dropped)

    def summary(self) -> str:
        """A table to read: sizes, height and inertia; range, limits and poses of each joint; mass
        and inertia of each body.

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
        """Indices into x of the actuated degrees of freedom: U of Eq. 7 is the identity's rows at
        these."""
        return np.array([j for j, joint in enumerate(self.joints) if joint.actuated], dtype=np.intp)

    @cached_property
    def unactuated(self) -> NDArray[np.intp]:
        """Indices into x of the unactuated degrees of freedom (the rows U_/ of Eq. 7)."""
        return np.array(
            [j for j, joint in enumerate(self.joints) if not joint.actuated], dtype=np.intp
        )

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
    def own(self) -> NDArray[np.bool_]:
        """(bodies,) whether a body is the robot's, and not the world's.

        The robot is what the floating base carries. On a fixed base it is the trees that are driven
        (or, where none is, that move), with what they stand on: a door beside an arm moves, but its
        weight is not the arm's.
        """
        root: list[int] = []
        for b, body in enumerate(self.bodies):
            root.append(b if body.parent < 0 else root[body.parent])
        if self.base == "floating":
            kept = {root[self.base_body]} if self.bodies else set()
        else:
            moving = {root[b] for b, body in enumerate(self.bodies) if body.joints}
            driven = {
                root[b]
                for b, body in enumerate(self.bodies)
                if any(joint.actuated for joint in body.joints)
            }
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


def floating_base(prefix: str = "base", chart: Literal["zyx", "zxy"] = "zyx") -> tuple[Joint, ...]:
    """The six unactuated joints of a floating base: x, y, z along the world axes, then the chart's
    hinges."""
    axes = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
    angle = {"x": "roll", "y": "pitch", "z": "yaw"}
    slides = tuple(
        Joint(f"{prefix}_{c}", "slide", _vector3(axes[c]), actuated=False) for c in "xyz"
    )
    hinges = tuple(
        Joint(f"{prefix}_{angle[c]}", "hinge", _vector3(axes[c]), actuated=False) for c in chart
    )
    return slides + hinges
