"""Ground, spheres, boxes, capsules and cylinders in closed form: φ in a shape's own frame.

φ is C³ outside, on the surface and inside down to the rounding, which edges need for that: they are
rounded by the 4-norm, (Σ max(q_k, 0)⁴)^¼, whose third derivatives do not jump where a face begins,
as those of a distance do. φ vanishes on the surface and ∇φ is normal to it. Outside of edges and
corners φ is shorter than the distance, never longer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from octo.checks import Array, number
from octo.errors import ValueRangeError
from octo.world.shape import Kind, Shape, check_rounding, closed_form, keep_lengths, keep_sizes

# m²: within 1e-9 m of a centre or an axis, where a distance has no slope, derivatives stay finite
ROUND = 1e-18
INNER = 1e-48  # of (q/rounding)⁴, which nothing is divided by where it is less
SEAM = 0.25  # of a capsule's radius: half the length over which its side becomes its cap


def _length(*parts: ca.SX) -> ca.SX:
    return ca.sqrt(sum((part * part for part in parts), start=ca.SX(ROUND)))


def _rounded(q: Sequence[ca.SX], rounding: ca.SX) -> ca.SX:
    """φ of what is within all q_k = ``rounding``, whose edges are rounded.

    Where no two q are positive, that is the largest one: so written, faces are flat to the last
    digit, and the norm has a slope wherever it is asked.
    """
    parts = [ca.fmax(one, 0.0) / rounding for one in q]
    fourth = sum((part**4 for part in parts), start=ca.SX(0.0))
    positive = sum((one > 0.0 for one in q), start=ca.SX(0.0))
    edge = ca.logic_and(positive > 1.0, fourth > INNER)
    highest = q[0]
    for one in q[1:]:
        highest = ca.fmax(highest, one)
    norm = rounding * ca.sqrt(ca.sqrt(ca.if_else(edge, fourth, 1.0)))
    return ca.if_else(edge, norm, highest) - rounding


def _ground(own: ca.SX, point: ca.SX) -> ca.SX:
    """own: normal (3,), height m."""
    return own[0] * point[0] + own[1] * point[1] + own[2] * (point[2] - own[3])


def _sphere(own: ca.SX, point: ca.SX) -> ca.SX:
    """own: radius m."""
    return _length(point[0], point[1], point[2]) - own[0]


def _box(own: ca.SX, point: ca.SX) -> ca.SX:
    """own: half sizes without the rounding (3,) m, rounding m."""
    return _rounded([ca.fabs(point[k]) - own[k] for k in range(3)], own[3])


def _capsule(own: ca.SX, point: ca.SX) -> ca.SX:
    """own: radius, half length, half length of the seam m.

    Beyond the end of the axis a distance is from that end: max(|z| − length/2, 0), whose kink a
    kernel (15/16)(1 − t²)² smooths over ± the seam, to C³.
    """
    beyond = (ca.fabs(point[2]) - own[1]) / own[2]
    t = ca.fmin(ca.fmax(beyond, -1.0), 1.0)
    smooth = 15.0 / 16.0 * (t**2 / 2.0 - t**4 / 6.0 + t**6 / 30.0) + t / 2.0 + 5.0 / 32.0
    return _length(point[0], point[1], own[2] * (smooth + ca.fmax(beyond - 1.0, 0.0))) - own[0]


def _cylinder(own: ca.SX, point: ca.SX) -> ca.SX:
    """own: radius and half length without the rounding, rounding m."""
    sides = [_length(point[0], point[1]) - own[0], ca.fabs(point[2]) - own[1]]
    return _rounded(sides, own[2])


@dataclass(frozen=True, eq=False)
class Ground(Shape):
    """All below a plane through (0, 0, height) of its frame: what ``octo.Plane`` is among shapes.

    Parameters
    ----------
    slope: rad, between −π/2 and π/2, of the plane. direction: rad from the x axis, in which it
        rises. height: m.
    """

    slope: float = 0.0
    direction: float = 0.0
    height: float = 0.0
    kind: ClassVar[Kind] = closed_form("ground", 4, _ground)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("slope", "direction", "height"):
            object.__setattr__(self, name, number(f"{name} of {self.label}", getattr(self, name)))
        if not abs(self.slope) < np.pi / 2:
            raise ValueRangeError(
                f"slope of {self.label} is {self.slope} rad, must be between -π/2 and π/2"
            )

    @property
    def own(self) -> Array:
        level, up = -np.sin(self.slope), np.cos(self.slope)
        across = level * np.cos(self.direction), level * np.sin(self.direction)
        return np.array([*across, up, self.height])

    def own_bounds(self) -> Array:
        top = self.height if self.slope == 0.0 else np.inf
        return np.array([[-np.inf] * 3, [np.inf, np.inf, top]])


@dataclass(frozen=True, eq=False)
class Sphere(Shape):
    """A ball.

    Parameters
    ----------
    radius: m.
    """

    radius: float
    kind: ClassVar[Kind] = closed_form("sphere", 1, _sphere)

    def __post_init__(self) -> None:
        super().__post_init__()
        keep_lengths(self, "radius")

    @property
    def own(self) -> Array:
        return np.array([self.radius])

    def own_bounds(self) -> Array:
        return self.radius * np.array([[-1.0] * 3, [1.0] * 3])


@dataclass(frozen=True, eq=False)
class Box(Shape):
    """A box with its centre at the origin of its frame, and rounded edges.

    With q_k = |p_k| − size_k/2 + rounding, φ = (Σ max(q_k, 0)⁴)^¼ − rounding, and in the innermost
    part max q_k − rounding. Faces are flat up to ``rounding`` before an edge. Outside of a face φ
    is the distance; outside of an edge at least 84 % of it, of a corner 76 %.

    Parameters
    ----------
    size: (3,) m, its edges along x, y and z. rounding: m, of its edges, at most half of the
        smallest one.
    """

    size: ArrayLike
    rounding: float = 0.01
    kind: ClassVar[Kind] = closed_form("box", 4, _box)

    def __post_init__(self) -> None:
        super().__post_init__()
        keep_sizes(self, "size")
        keep_lengths(self, "rounding")
        check_rounding(self, self.rounding, np.min(self.size) / 2.0)

    @property
    def own(self) -> Array:
        return np.array([*(np.asarray(self.size) / 2.0 - self.rounding), self.rounding])

    def own_bounds(self) -> Array:
        half = np.asarray(self.size) / 2.0
        return np.stack([-half, half])


@dataclass(frozen=True, eq=False)
class Capsule(Shape):
    """A cylinder along z with a half ball on each end.

    φ is the distance but within radius/4 of the seams of side and caps, where curvature has to rise
    from one to the other: there it is longer by at most 0.08 % of the radius.

    Parameters
    ----------
    radius: m. length: m, between the centres of the half balls.
    """

    radius: float
    length: float
    kind: ClassVar[Kind] = closed_form("capsule", 3, _capsule)

    def __post_init__(self) -> None:
        super().__post_init__()
        keep_lengths(self, "radius", "length")

    @property
    def own(self) -> Array:
        half = self.length / 2.0
        return np.array([self.radius, half, min(SEAM * self.radius, half)])

    def own_bounds(self) -> Array:
        half = np.array([self.radius, self.radius, self.length / 2.0 + self.radius])
        return np.stack([-half, half])


@dataclass(frozen=True, eq=False)
class Cylinder(Shape):
    """A cylinder along z with rounded rims.

    φ as that of a ``Box``, of |(x, y)| and |z|: outside of a rim at least 84 % of the distance.

    Parameters
    ----------
    radius: m. length: m, along z. rounding: m, of its rims, at most the radius and half of the
        length.
    """

    radius: float
    length: float
    rounding: float = 0.01
    kind: ClassVar[Kind] = closed_form("cylinder", 3, _cylinder)

    def __post_init__(self) -> None:
        super().__post_init__()
        keep_lengths(self, "radius", "length", "rounding")
        check_rounding(self, self.rounding, min(self.radius, self.length / 2.0))

    @property
    def own(self) -> Array:
        inner = self.radius - self.rounding, self.length / 2.0 - self.rounding
        return np.array([*inner, self.rounding])

    def own_bounds(self) -> Array:
        half = np.array([self.radius, self.radius, self.length / 2.0])
        return np.stack([-half, half])
