"""What every shape has: a pose, numbers, a box around it, and a kind, which is how its φ is looked
up."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field
from functools import cache
from typing import Any, ClassVar, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from octo.checks import Array, instance, numbers, positive
from octo.emit import function_of_numbers, switch
from octo.errors import ShapeError, ValueRangeError
from octo.interrupts import postponed
from octo.world.jet import ORDERS, derivatives

FRACTION = 0.75  # φ outside a shape's box is at least this part of the distance from the box
TURNED = 1e-6  # how far a matrix may be from a rotation, of which it becomes the nearest
Own = TypeVar("Own", bound="Shape")
Numbers = TypeVar("Numbers", bound=NDArray[Any])


@dataclass(frozen=True, eq=False)
class Kind:
    """How φ is looked up in a shape's own frame: said twice, in C and in NumPy.

    Attributes
    ----------
    name: ``text()`` defines ``static void octo_world_NAME(const double *own, const double *point,
        int order, double *jet)``, C that is C++ and CUDA too, of the numbers of a shape and a point
        in its frame.
    jets: the same of the numbers (size,) and of points (k, 3) m: (k, SIZES[order]).
    expression: of a φ in closed form ``expression(own, point) -> φ``, of CasADi's SX; else None.
    """

    name: str
    text: Callable[[], str]
    jets: Callable[[Array, Array, int], Array]
    expression: Callable[[ca.SX, ca.SX], ca.SX] | None = None


def closed_form(name: str, size: int, expression: Callable[[ca.SX, ca.SX], ca.SX]) -> Kind:
    """The kind of a φ that CasADi can write, and differentiate.

    Parameters
    ----------
    size: how many numbers a shape has.
    expression: ``expression(own, point) -> φ`` of its numbers (size,) and a point (3,) in its
        frame.
    """

    @cache
    @postponed()
    def function(order: int) -> ca.Function:
        own, point = ca.SX.sym("own", size), ca.SX.sym("point", 3)
        jet = derivatives(expression(own, point), point, order)
        return ca.Function(f"octo_world_{name}_{order}", [own, point], [jet], {"cse": True})

    def text() -> str:
        functions = [function(order) for order in ORDERS]
        return "\n".join(
            [
                *map(function_of_numbers, functions),
                switch(f"octo_world_{name}_of", functions),
                f"static void octo_world_{name}(const double *own, const double *point, int order, "
                "double *jet) {",
                "  const double *arg[] = {own, point};",
                "  double *res[] = {jet};",
                f"  octo_world_{name}_of(order, arg, res);",
                "}",
            ]
        )

    def jets(own: Array, points: Array, order: int) -> Array:
        columns = np.tile(own[:, None], len(points))
        return np.asarray(function(order)(columns, points.T), dtype=float).T

    return Kind(name, text, jets, expression)


@dataclass(frozen=True, eq=False, kw_only=True)
class Shape:
    """A shape of the world, which its pose puts into place.

    Parameters
    ----------
    position: (3,) m, of its frame in the world.
    rotation: (3, 3) from its frame to the world, or a quaternion wxyz (4,).
    name: by which ``World.moved`` finds it.

    Raises
    ------
    ValueRangeError, ShapeError: a number that is not finite, or not allowed.
    """

    position: ArrayLike = (0.0, 0.0, 0.0)
    rotation: ArrayLike = field(default_factory=lambda: np.eye(3))
    name: str | None = None
    kind: ClassVar[Kind]

    def __post_init__(self) -> None:
        if self.name is not None:
            instance(f"name of a {self.word}", self.name, str, "a text")
        place = numbers(f"position of {self.label}", self.position, (3,))
        object.__setattr__(self, "position", fixed(place))
        object.__setattr__(
            self, "rotation", fixed(rotation_matrix(f"rotation of {self.label}", self.rotation))
        )

    @property
    def word(self) -> str:
        """What messages call the kind."""
        return type(self).__name__

    @property
    def label(self) -> str:
        """What messages call it."""
        return f"{self.word} {self.name!r}" if self.name else f"a {self.word}"

    @property
    def own(self) -> Array:
        """(size,) the numbers that its kind looks φ up in."""
        raise NotImplementedError

    def own_bounds(self) -> Array:
        """(2, 3) m: a box in its frame around all points with φ ≤ 0, infinite where they have no
        end. Outside of it φ is at least FRACTION times the distance from it."""
        raise NotImplementedError

    def bounds(self) -> Array:
        """(2, 3) m: the lowest and the highest corner of such a box along the world's axes."""
        low, high = self.own_bounds()
        rotation, position = np.asarray(self.rotation), np.asarray(self.position)
        if np.isfinite([low, high]).all():
            reach = np.abs(rotation) @ (high - low) / 2.0
            center = position + rotation @ (low + high) / 2.0
            return np.stack([center - reach, center + reach])
        if (rotation == np.eye(3)).all():
            return np.stack([low, high]) + position
        return np.array([[-np.inf] * 3, [np.inf] * 3])

    @property
    def steepest(self) -> float:
        """By how much φ changes on a metre, at most: what is farther away than that is skipped."""
        return 1.0

    def covers(self, points: ArrayLike) -> Array:
        """(k,) whether points (k, 3) m are above or below it: within its box, seen from above."""
        given = places(points)
        low, high = self.bounds()
        inside = (given[:, :2] >= low[:2]) & (given[:, :2] <= high[:2])
        return np.asarray(inside.all(axis=1))

    def moved(self: Own, position: ArrayLike | None, rotation: ArrayLike | None) -> Own:
        """The same shape in another pose; None leaves that part as it is."""
        made = copy(self)  # with the numbers of a map, which may be many, and were checked
        object.__setattr__(made, "position", self.position if position is None else position)
        object.__setattr__(made, "rotation", self.rotation if rotation is None else rotation)
        Shape.__post_init__(made)
        return made


def places(points: ArrayLike) -> Array:
    """Points (k, 3) m, checked."""
    given = numbers("points", points)
    if given.ndim != 2 or given.shape[1] != 3:
        raise ShapeError("points", given.shape, "(k, 3)")
    return given


def keep_lengths(shape: Shape, *names: str) -> None:
    """Keep fields of a shape as positive numbers, in m."""
    for name in names:
        kept = positive(f"{name} of {shape.label}", getattr(shape, name), "m")
        object.__setattr__(shape, name, kept)


def keep_sizes(shape: Shape, name: str) -> None:
    """Keep a field of a shape as three positive numbers, in m."""
    kept = numbers(f"{name} of {shape.label}", getattr(shape, name), (3,))
    for k, one in enumerate(kept):
        positive(f"{name}[{k}] of {shape.label}", float(one), "m")
    object.__setattr__(shape, name, fixed(kept))


def check_rounding(shape: Shape, rounding: float, most: float) -> None:
    """Refuse a rounding that a shape is too small for."""
    if rounding > most:
        raise ValueRangeError(
            f"rounding of {shape.label} is {rounding:g} m, must be at most half of its smallest "
            f"size, {most:g} m"
        )


def fixed(given: Numbers) -> Numbers:
    """A copy that nobody can change."""
    made: Numbers = given.copy()
    made.flags.writeable = False
    return made


def rotation_matrix(field: str, given: ArrayLike) -> Array:
    """The rotation matrix (3, 3) of a matrix or a quaternion wxyz."""
    found = numbers(field, given)
    if found.shape == (4,):
        if not np.linalg.norm(found) > 0.0:
            raise ValueRangeError(f"{field} is a quaternion of length 0, which is none")
        return np.asarray(Rotation.from_quat(np.roll(found, -1)).as_matrix())
    if found.shape != (3, 3):
        raise ShapeError(field, found.shape, "(3, 3) or (4,)")
    off = np.abs(found.T @ found - np.eye(3)).max()
    if not (off <= TURNED and np.linalg.det(found) > 0.0):
        raise ValueRangeError(
            f"{field} is no rotation: its columns must be perpendicular, of length 1 "
            "and right-handed"
        )
    left, _, right = np.linalg.svd(found)
    return found if off == 0.0 else np.asarray(left @ right)
