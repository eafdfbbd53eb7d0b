"""Forces between points of two bodies, each a class that a user can write: one function gives the
force, CasADi its derivatives.

An element is part of a :class:`~octo.model.character.Character` (``elements``). Its ``parameters``
are run-time parameters of the dynamics, named after the element's place in that tuple:
``spring0.stiffness``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from octo.checks import number, numbers, one_of
from octo.errors import ModelError, said
from octo.model.quantities import tuple_of

Point = tuple[float, float, float]
FARTHEST = 1e6  # m, of a point from its body
# m, added in squares to the length of a spring: the direction is singular where its points are one
SHORTEST = 1e-4


@dataclass(frozen=True)
class Element:
    """A force f (3,) N on the point ``point_b`` of a body, and -f on ``point_a`` of another.

    A new element is a frozen dataclass with this one as its base, whose further fields are numbers
    (its parameters) and which defines :meth:`force`. Everything else, the wrenches on both links
    and their first and second derivatives, is made from that function.

    Attributes
    ----------
    body_a, body_b: names of two bodies; None is the world, for one of them.
    point_a, point_b: (3,) m, in the body's frame (world: in the world's).
    prefix: what its parameters are named by: ``element0.stiffness``.
    """

    body_a: str | None
    point_a: Point
    body_b: str | None
    point_b: Point

    prefix: ClassVar[str] = "element"

    def __post_init__(self) -> None:
        which = f"element {type(self).__name__}"
        if not self.prefix.isidentifier():
            raise ModelError(f"{which}: prefix is {said(self.prefix)}, must be one word")
        for name in ("body_a", "body_b"):
            body = getattr(self, name)
            if body is not None and not isinstance(body, str):
                raise ModelError(
                    f"{which}: {name} is {said(body)}, must be the name of a body, or None for the "
                    "world"
                )
        if self.body_a == self.body_b:
            raise ModelError(
                f"{which}: body_a and body_b are both {said(self.body_a)}, must be different bodies"
            )
        for name in ("point_a", "point_b"):
            point = numbers(f"{which}: {name}", getattr(self, name), (3,))
            if np.abs(point).max() > FARTHEST:
                raise ModelError(
                    f"{which}: {name} is {said(getattr(self, name))}, must be within "
                    f"{FARTHEST:.0e} m"
                )
            object.__setattr__(self, name, tuple(point.tolist()))
        for name, value in self.parameters.items():
            number(f"{which}: {name}", value)

    @property
    def parameters(self) -> Mapping[str, float]:
        """Names and defaults of its run-time parameters: its own fields."""
        own = dataclasses.fields(self)[len(dataclasses.fields(Element)) :]
        return {field.name: getattr(self, field.name) for field in own}

    def force(
        self, p_a: ca.SX, v_a: ca.SX, p_b: ca.SX, v_b: ca.SX, p: Mapping[str, ca.SX]
    ) -> ca.SX:
        """Force (3,) N on the point of body b, world axes; the opposite acts on that of body a.

        Parameters
        ----------
        p_a, p_b: (3,) m, world, of x_next.
        v_a, v_b: (3,) m/s, (P_next - P)/dt of the same material point.
        p: its parameters by name.
        """
        raise ModelError(f"element {type(self).__name__} defines no force, must do")

    @property
    def tendon(self) -> Mapping[str, float] | None:
        """Attributes of the spatial tendon between its points that is the same in MuJoCo; None:
        there is none."""
        return None


@dataclass(frozen=True)
class SpringDamper(Element):
    """f = -[stiffness·(l - rest_length) + damping·dl/dt] along the line from point a to point b.

    ``octo.SpringDamper("trunk", (0, 0, 0), None, (0, 0, 1), stiffness=200, damping=5)`` hangs the
    trunk's origin on a point 1 m above the ground. l is √(distance² + (0.1 mm)²).
    """

    stiffness: float = 0.0  # N/m
    damping: float = 0.0  # N s/m
    rest_length: float = 0.0  # m

    prefix: ClassVar[str] = "spring"

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, value in self.parameters.items():
            if value < 0.0:
                raise ModelError(f"element SpringDamper: {name} is {value}, must not be negative")

    def force(
        self, p_a: ca.SX, v_a: ca.SX, p_b: ca.SX, v_b: ca.SX, p: Mapping[str, ca.SX]
    ) -> ca.SX:
        apart = p_b - p_a
        length = ca.sqrt(ca.dot(apart, apart) + SHORTEST**2)
        rate = ca.dot(apart, v_b - v_a) / length
        tension = p["stiffness"] * (length - p["rest_length"]) + p["damping"] * rate
        return -tension * apart / length

    @property
    def tendon(self) -> Mapping[str, float]:
        own = {"stiffness": self.stiffness, "damping": self.damping}
        return own | {"springlength": self.rest_length}


@dataclass(frozen=True)
class DryFriction(Element):
    """f = -limit·v/√(|v|² + creep²), against the velocity v of point b relative to point a.

    Of a hinge it is a torque: on a point r m beside the axis, ``limit`` N are limit·r N m. Between
    two bodies it is meant for points that stay together. Nothing sticks: below the limit v is a
    part of ``creep``.
    """

    limit: float = 0.0  # N
    creep: float = 0.01  # m/s, the speed at which 0.7 of the limit acts

    prefix: ClassVar[str] = "friction"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.limit < 0.0 or self.creep <= 0.0:
            raise ModelError(
                f"element DryFriction: limit is {self.limit} N, must not be negative, and creep "
                f"{self.creep} m/s, must be positive"
            )

    def force(
        self, p_a: ca.SX, v_a: ca.SX, p_b: ca.SX, v_b: ca.SX, p: Mapping[str, ca.SX]
    ) -> ca.SX:
        v = v_b - v_a
        return -p["limit"] * v / ca.sqrt(ca.dot(v, v) + p["creep"] ** 2)


def named(elements: Iterable[Element]) -> Iterator[tuple[str, Element]]:
    """Each element and what its parameters are named by: its prefix and its place."""
    return ((f"{element.prefix}{k}", element) for k, element in enumerate(elements))


def names_of(elements: Iterable[Element]) -> tuple[str, ...]:
    return tuple(name for name, _ in named(elements))


def parameters_of(elements: Iterable[Element]) -> dict[str, float]:
    """Names and defaults of the run-time parameters of all, in order."""
    return {
        f"{name}.{key}": float(value)
        for name, element in named(elements)
        for key, value in element.parameters.items()
    }


def with_parameters(
    elements: tuple[Element, ...], values: Mapping[str, float]
) -> tuple[Element, ...]:
    """The elements with ``values`` of their parameters (``spring0.stiffness``) as their numbers;
    other names are passed over."""
    made = []
    for name, element in named(elements):
        given: dict[str, Any] = {
            field.name: float(values[f"{name}.{field.name}"])
            for field in dataclasses.fields(element)
            if f"{name}.{field.name}" in values
        }
        made.append(dataclasses.replace(element, **given) if given else element)
    return tuple(made)


def missing(elements: Iterable[Element], names: Iterable[str]) -> list[str]:
    """Of parameters by these names those elements (``spring0``) that are not among ``elements``."""
    known = {*names_of(elements), "contact", "terrain"}
    prefixes = dict.fromkeys(name.split(".")[0] for name in names if "." in name)
    return [prefix for prefix in prefixes if prefix not in known]


def tied_to_the_world(elements: Iterable[Element], moving: Collection[str]) -> list[str]:
    """Names of the elements one of whose points is on none of the bodies that move."""
    return [name for name, e in named(elements) if not {e.body_a, e.body_b} <= {*moving}]


def checked(which: str, elements: Any, bodies: Iterable[str]) -> tuple[Element, ...]:
    """``elements`` of a robot with these bodies.

    Raises
    ------
    ModelError: they are none. UnknownNameError: no such body.
    """
    found, valid = tuple_of(f"{which}: elements", elements, Element, "octo.Element"), tuple(bodies)
    for element in found:
        for body in (element.body_a, element.body_b):
            if body is not None:
                one_of("body", body, valid)
    return found
