"""Things to push, to climb and to open: free rigid bodies without motors, for an octo.Scene.

Each is a Character of one body that carries spheres, which touch the ground and other bodies, and
a solid, which spheres of other bodies touch.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from octo.checks import flag, number, numbers, positive
from octo.errors import ValueRangeError
from octo.model.body import Body, ContactSphere, Joint, floating_base
from octo.model.character import Character
from octo.model.chart import angles_of, least_singular_chart
from octo.model.element import DryFriction, Element
from octo.model.quantities import Array
from octo.model.solid import Solid
from octo.world.shape import rotation_matrix
from octo.world.shapes import Box, Capsule, Cylinder, Sphere

ROUNDING = 0.1  # of the shortest edge: how much edges and corners are rounded by default …
MOST_ROUNDING = 0.01  # m, … at most
RIM = 8  # spheres around each end of a cylinder
UNTURNED = (1.0, 0.0, 0.0, 0.0)


def box(
    size: Sequence[float],
    mass: float,
    position: Sequence[float] = (0.0, 0.0, 0.0),
    rotation: Sequence[float] | Array = UNTURNED,
    *,
    name: str = "box",
    rounding: float | None = None,
) -> Character:
    """A solid box: a sphere in each of its rounded corners, and its faces.

    Parameters
    ----------
    size: (3,) m, whole edges.
    mass: kg.
    position: (3,) m, of its centre.
    rotation: (3, 3), or a quaternion (4,) with its real part first.
    name: of the box and its body.
    rounding: m, radius of edges and corners; by default a tenth of the shortest edge, at most 1 cm.
    """
    (x, y, z), inertia = _cuboid(name, size, mass)
    radius = _rounding(name, rounding, min(x, y, z))
    signs = np.array([(a, b, c) for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)])
    corners = signs * (0.5 * np.array([x, y, z]) - radius)
    solid = Solid(name, 0, Box((x, y, z), radius))
    return _free(name, mass, inertia, corners, radius, solid, position, rotation)


def ball(
    radius: float,
    mass: float,
    position: Sequence[float] = (0.0, 0.0, 0.0),
    *,
    name: str = "ball",
    hollow: bool = False,
) -> Character:
    """A ball.

    Parameters
    ----------
    radius: m.
    mass: kg.
    position: (3,) m, of its centre.
    name: of the ball and its body.
    hollow: a shell rather than solid: ⅔ m r² in place of ⅖ m r².
    """
    mass, radius = positive(f"{name}: mass", mass, "kg"), positive(f"{name}: radius", radius, "m")
    inertia = (2.0 / 3.0 if flag(f"{name}: hollow", hollow) else 0.4) * mass * radius**2 * np.eye(3)
    solid = Solid(name, 0, Sphere(radius))
    return _free(name, mass, inertia, np.zeros((1, 3)), radius, solid, position, UNTURNED)


def cylinder(
    radius: float,
    length: float,
    mass: float,
    position: Sequence[float] = (0.0, 0.0, 0.0),
    rotation: Sequence[float] | Array = UNTURNED,
    *,
    name: str = "cylinder",
    rounding: float | None = None,
) -> Character:
    """A solid cylinder about its own z axis: eight spheres around each of its rounded rims, so that
    it stands; lying down it rolls over these.

    Parameters
    ----------
    radius: m.
    length: m, from end to end.
    mass: kg.
    position: (3,) m, of its centre.
    rotation: (3, 3), or a quaternion (4,) with its real part first.
    name: of the cylinder and its body.
    rounding: m, of the rims; by default a tenth of the shorter of length and diameter, at most
        1 cm.
    """
    mass, radius = positive(f"{name}: mass", mass, "kg"), positive(f"{name}: radius", radius, "m")
    length = positive(f"{name}: length", length, "m")
    across = mass * (3.0 * radius**2 + length**2) / 12.0
    inertia = np.diag([across, across, 0.5 * mass * radius**2])
    rim = _rounding(name, rounding, min(2.0 * radius, length))
    turns = 2.0 * np.pi * np.arange(RIM) / RIM
    ring = (radius - rim) * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    ends = [np.column_stack([ring, np.full(RIM, s * (0.5 * length - rim))]) for s in (-1.0, 1.0)]
    solid = Solid(name, 0, Cylinder(radius, length, rim))
    return _free(name, mass, inertia, np.concatenate(ends), rim, solid, position, rotation)


def capsule(
    radius: float,
    length: float,
    mass: float,
    position: Sequence[float] = (0.0, 0.0, 0.0),
    rotation: Sequence[float] | Array = UNTURNED,
    *,
    name: str = "capsule",
) -> Character:
    """A solid capsule about its own z axis: a sphere at each end, and its side.

    Parameters
    ----------
    radius: m.
    length: m, between the centres of its ends.
    mass: kg.
    position: (3,) m, of its centre.
    rotation: (3, 3), or a quaternion (4,) with its real part first.
    name: of the capsule and its body.
    """
    mass, radius = positive(f"{name}: mass", mass, "kg"), positive(f"{name}: radius", radius, "m")
    length = positive(f"{name}: length", length, "m")
    # of a cylinder and of the two halves of a ball, by their share of the volume
    tube = mass * length / (length + 4.0 / 3.0 * radius)
    cap = mass - tube
    along = 0.5 * tube * radius**2 + 0.4 * cap * radius**2
    across = tube * (3.0 * radius**2 + length**2) / 12.0
    across += cap * (0.4 * radius**2 + 0.25 * length**2 + 0.375 * radius * length)
    ends = np.array([[0.0, 0.0, -0.5 * length], [0.0, 0.0, 0.5 * length]])
    solid = Solid(name, 0, Capsule(radius, length))
    inertia = np.diag([across, across, along])
    return _free(name, mass, inertia, ends, radius, solid, position, rotation)


def door(
    size: Sequence[float] = (0.8, 0.04, 2.0),
    mass: float = 15.0,
    position: Sequence[float] = (0.0, 0.0, 0.0),
    rotation: Sequence[float] | Array = UNTURNED,
    *,
    name: str = "door",
    lower: float = -1.6,
    upper: float = 1.6,
    friction: float = 0.0,
    damping: float = 0.0,
    stiffness: float = 0.0,
    armature: float = 0.0,
) -> Character:
    """A board hinged to the world about its own vertical edge, closed at 0.

    Parameters
    ----------
    size: (3,) m: width from the hinge along the door's x axis, thickness, height.
    mass: kg.
    position: (3,) m, of the lower end of the hinge.
    rotation: (3, 3), or a quaternion (4,) with its real part first, of the closed door.
    name: of the door and its body.
    lower, upper: rad, how far it opens to either side.
    friction: N m, dry, of the hinge: an octo.DryFriction at the other edge.
    damping: N m s/rad, of the hinge.
    stiffness: N m/rad, of a spring that closes it.
    armature: kg m², of what turns with the hinge.
    """
    (x, y, z), inertia = _cuboid(name, size, mass)
    given = {"lower": lower, "upper": upper, "damping": damping, "stiffness": stiffness}
    given["armature"] = armature
    values: dict[str, Any] = {key: number(f"{name}: {key}", v) for key, v in given.items()}
    up = np.array([0.0, 0.0, 1.0])
    hinge = Joint(f"{name}_hinge", "hinge", up, actuated=False, **values)
    middle, place = np.array([0.5 * x, 0.0, 0.5 * z]), numbers(f"{name}: position", position, (3,))
    body = Body(name, -1, (hinge,), place, _turned(name, rotation), mass, middle, inertia)
    shape = Box((x, y, z), _rounding(name, None, min(x, y, z)), position=middle)
    limit, edge, elements = number(f"{name}: friction", friction), (x, 0.0, 0.0), list[Element]()
    if limit != 0.0:
        elements.append(DryFriction(None, tuple(place), name, edge, limit / x))
    return Character(
        name,
        (body,),
        base="fixed",
        default_pose=np.zeros(1),
        solids=(Solid(name, 0, shape),),
        elements=tuple(elements),
    )


def _cuboid(name: str, size: Sequence[float], mass: float) -> tuple[tuple[float, ...], Array]:
    """Edges (3,) m and inertia (3, 3) kg m² of a solid box, checked."""
    edges = numbers(f"{name}: size", size, (3,))
    if not (edges > 0.0).all():
        raise ValueRangeError(f"{name}: size is {edges.tolist()} m, must be positive")
    x, y, z = edges.tolist()
    squares = np.diag([y**2 + z**2, x**2 + z**2, x**2 + y**2])
    return (x, y, z), positive(f"{name}: mass", mass, "kg") / 12.0 * squares


def _turned(name: str, rotation: Sequence[float] | Array) -> Array:
    """(3, 3) of a rotation given so, or as a quaternion (4,) with its real part first."""
    return rotation_matrix(f"{name}: rotation", rotation)


def _rounding(name: str, given: float | None, shortest: float) -> float:
    if given is None:
        return min(ROUNDING * shortest, MOST_ROUNDING)
    rounding = positive(f"{name}: rounding", given, "m")
    if rounding > 0.5 * shortest:
        raise ValueRangeError(
            f"{name}: rounding is {rounding} m, must be at most half of the shortest edge, "
            f"{0.5 * shortest:g} m"
        )
    return rounding


def _free(
    name: str,
    mass: float,
    inertia: Array,
    centers: Array,
    radius: float,
    solid: Solid,
    position: Sequence[float],
    rotation: Sequence[float] | Array,
) -> Character:
    """A free body with spheres of one radius at ``centers`` (k, 3) m."""
    place, turn = numbers(f"{name}: position", position, (3,)), _turned(name, rotation)
    chart = least_singular_chart(turn)
    body = Body(name, -1, floating_base(name, chart), mass=mass, inertia=inertia)
    spheres = tuple(
        ContactSphere(name if len(centers) == 1 else f"{name}_{k}", 0, center, radius)
        for k, center in enumerate(centers)
    )
    pose = np.concatenate([place, angles_of(turn, chart, np.zeros(3))])
    return Character(name, (body,), spheres, chart=chart, default_pose=pose, solids=(solid,))
