"""The surfaces of bodies that the spheres of other bodies touch, as signed distances in CasADi.

Each kind is one expression φ(point, size), positive outside, of a point (3,) m in the solid's own
frame and of its four numbers (m), which are run-time data of the stages: a box of another size
runs the same code.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from octo.checks import one_of
from octo.errors import ModelError, said
from octo.model.body import UNIT
from octo.model.quantities import Array, array, quantity, text, vector3

TINY = 1e-9  # m, keeps the derivatives of norms finite at zero
SIZES = 4  # numbers of a solid


def _sphere(point: ca.SX, size: ca.SX) -> ca.SX:
    return ca.sqrt(ca.sumsqr(point) + TINY**2) - size[0]


def _rounded(q: ca.SX, rounding: ca.SX) -> ca.SX:
    """φ of what lies ``q`` (k,) m beyond each of k pairs of faces drawn in by ``rounding``.

    The norm of fourth powers has three continuous derivatives where a face ends and is exact over
    faces; outside of edges and corners φ is less than the distance, by a quarter at most.
    """
    outside = ca.sqrt(ca.sqrt(ca.sumsqr(ca.fmax(q, 0.0) ** 2) + TINY**4))
    return outside + ca.fmin(ca.mmax(q), 0.0) - rounding


def _box(point: ca.SX, size: ca.SX) -> ca.SX:
    return _rounded(ca.fabs(point) - size[:3] + size[3], size[3])


def _capsule(point: ca.SX, size: ca.SX) -> ca.SX:
    along = ca.fmin(ca.fmax(point[2], -size[1]), size[1])
    return _sphere(ca.vertcat(point[:2], point[2] - along), size)


def _cylinder(point: ca.SX, size: ca.SX) -> ca.SX:
    radius = ca.sqrt(ca.sumsqr(point[:2]) + TINY**2)
    faces = ca.vertcat(radius - size[0], ca.fabs(point[2]) - size[1])
    return _rounded(faces + size[2], size[2])


# what ``size`` holds: the names of its numbers, in order, m
NUMBERS: Mapping[str, tuple[str, ...]] = {
    "sphere": ("radius",),
    "box": ("half_x", "half_y", "half_z", "rounding"),
    "capsule": ("radius", "half_length"),
    "cylinder": ("radius", "half_length", "rounding"),
}
DISTANCES: Mapping[str, Callable[[ca.SX, ca.SX], ca.SX]] = {
    "sphere": _sphere,
    "box": _box,
    "capsule": _capsule,
    "cylinder": _cylinder,
}


@dataclass(frozen=True, eq=False)
class Solid:
    """The surface of a body that spheres of other bodies may touch.

    kind: "sphere", "box", "capsule" or "cylinder"; the axis of the last two is z. size: m, as
    ``NUMBERS`` says: halves of a box's edges and its rounding; radius and half of the length of a
    capsule (between the centres of its ends) and of a cylinder, which has a rounding too.
    """

    name: str
    body: int
    kind: str
    size: tuple[float, ...]
    position: Array = field(default_factory=vector3)  # (3,) m, body frame
    rotation: Array = field(default_factory=lambda: np.eye(3))  # (3, 3), its axes in the body's

    def __post_init__(self) -> None:
        text("solid", self.name)
        which, keep = f"solid {self.name!r}", object.__setattr__
        one_of(f"kind of {which}", self.kind, tuple(NUMBERS))
        if isinstance(self.body, bool) or not isinstance(self.body, (int, np.integer)):
            raise ModelError(f"{which}: body is {said(self.body)}, must be the index of a body")
        names = NUMBERS[self.kind]
        try:
            given = tuple(self.size)
        except TypeError:
            given = ()
        if len(given) != len(names):
            raise ModelError(f"{which}: size is {said(self.size)}, must be {', '.join(names)}")
        size = [
            quantity(f"{which}: {name}", value, "finite and not negative")
            for name, value in zip(names, given, strict=True)
        ]
        keep(self, "size", tuple(size))
        if names[-1] == "rounding" and not 0.0 < size[-1] <= min(size[:-1]):
            raise ModelError(
                f"{which}: rounding is {size[-1]} m, must be positive and at most the least half "
                f"size, {min(size[:-1])} m"
            )
        keep(self, "position", array(f"{which}: position", self.position, (3,)))
        keep(self, "rotation", array(f"{which}: rotation", self.rotation, (3, 3)))
        off = float(np.abs(self.rotation @ self.rotation.T - np.eye(3)).max())
        if off > UNIT or np.linalg.det(self.rotation) < 0.0:
            raise ModelError(f"{which}: rotation is none (off by {off:.2g})")

    @property
    def numbers(self) -> Array:
        """(16,) rotation row by row, position (m), and size (m) filled up with zeros."""
        size = np.zeros(SIZES)
        size[: len(self.size)] = self.size
        return np.concatenate([np.ravel(self.rotation), self.position, size])


def distance(kind: str, point: ca.SX, rotation: ca.SX, position: ca.SX, size: ca.SX) -> ca.SX:
    """Signed distance (m) of ``point`` (3,) m from a solid at a pose (rotation, position) in the
    same frame."""
    return DISTANCES[kind](rotation.T @ (point - position), size)
