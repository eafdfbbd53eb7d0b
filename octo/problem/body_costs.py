"""Terms over bodies: the centre of mass, orientations, points (Eqs. 17 and 18)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import casadi as ca
import numpy as np

from octo.checks import numbers
from octo.dynamics.forms import axial
from octo.errors import ShapeError
from octo.problem.asked import Asked, Motion
from octo.problem.at import Steps
from octo.problem.costs import Cost, last_row, mean_square
from octo.problem.terms import Row

if TYPE_CHECKING:
    from octo.problem.symbols import Setting, StepSymbols

# added to a squared sine: its root has derivatives also at zero; the angle changes by less than
# 1e-16
SMALL_SINE = 1e-16


@dataclass(frozen=True, eq=False)
class CenterOfMassVelocity(Cost):
    """Eq. 17: the velocity of the centre of mass (m/s) against ``velocity`` (3,) or (N, 3)."""

    velocity: Any = (0.0, 0.0, 0.0)

    def references(self, setting: Setting) -> Mapping[str, Any]:
        return {"velocity": self._vector("velocity", 3)}

    def scale(self, setting: Setting) -> float:
        return mean_square(self.velocity)

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return step.com_velocity - p["velocity"]

    def asked(self, motion: Motion, setting: Setting) -> Asked | None:
        wanted = motion.mean(np.asarray(self.velocity, dtype=float))
        if not wanted.any():  # that nothing moves is no goal
            return None
        axes = 3 if wanted[2] else 2  # how far a walk rises is the ground's affair
        found = motion.mean(np.diff(motion.com, axis=0) / motion.dt)
        return Asked.of(
            self.label, "the centre of mass moves at", found[:axes], wanted[:axes], "m/s"
        )


@dataclass(frozen=True, eq=False)
class CenterOfMassPosition(Cost):
    """Eq. 18: the centre of mass (m) against ``target`` (3,), at the last step or at every step."""

    target: Any = (0.0, 0.0, 0.0)
    at: Steps = field(default="last", kw_only=True)

    def references(self, setting: Setting) -> Mapping[str, Any]:
        return {"target": self._vector("target", 3)}

    def scale(self, setting: Setting) -> float:
        return mean_square(last_row(self.target) - setting.com)

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return step.com - p["target"]

    def rows(self, setting: Setting) -> Sequence[Row]:
        return [Row(f"{axis} of the centre of mass − target", "m") for axis in "xyz"]

    def asked(self, motion: Motion, setting: Setting) -> Asked | None:
        found, wanted = motion.com[motion.last], motion.row(self.target)
        way = float(np.linalg.norm(wanted - setting.com))
        return Asked.of(self.label, "the centre of mass gets to", found, wanted, "m", way)


@dataclass(frozen=True, eq=False)
class CenterOfMassDisplacement(Cost):
    """The centre of mass (m) against where it is at the start, moved by ``displacement`` (3,) or
    (N, 3)."""

    displacement: Any = (0.0, 0.0, 0.0)

    def references(self, setting: Setting) -> Mapping[str, Any]:
        return {"target": setting.com + self._vector("displacement", 3)}

    def scale(self, setting: Setting) -> float:
        return mean_square(last_row(self.displacement))

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return step.com - p["target"]

    def asked(self, motion: Motion, setting: Setting) -> Asked | None:
        moved = motion.com[motion.last] - setting.com
        return Asked.of(
            self.label, "the centre of mass is moved by", moved, motion.row(self.displacement), "m"
        )


@dataclass(frozen=True, eq=False)
class BaseOrientation(Cost):
    """Rotation of a body against ``roll_pitch_yaw`` (3,) rad; ``axes`` weighs the error about the
    reference's x, y, z.

    The residual is the rotation vector of R_referenceᵀ R, its axis times its angle of at most π: it
    does not wind up with yaw, and pulls back from everywhere, upside down too.
    """

    roll_pitch_yaw: Any = (0.0, 0.0, 0.0)
    axes: Any = (1.0, 1.0, 1.0)
    body: str | None = None
    weighed_by: ClassVar[str] = "axes"

    def references(self, setting: Setting) -> Mapping[str, Any]:
        return {"roll_pitch_yaw": self._vector("roll_pitch_yaw", 3), "axes": self._roots("axes", 3)}

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        error = _rpy(p["roll_pitch_yaw"]).T @ step.pose(self.body)[0]
        return p["axes"] * rotation_vector(error)

    def rows(self, setting: Setting) -> Sequence[Row]:
        who = Motion.called(self.body)
        return [Row(f"rotation of {who} about {axis} − target", "rad") for axis in "xyz"]


@dataclass(frozen=True, eq=False)
class Upright(Cost):
    """Tilt of a body, whatever its yaw: up in the body's axes against what it is in ``pose`` (nx,),
    by default the start."""

    pose: Any = None
    body: str | None = None

    def references(self, setting: Setting) -> Mapping[str, Any]:
        return {
            "up": setting.up(
                self.body,
                setting.x0 if self.pose is None else numbers(f"{self.label}.pose", self.pose),
            )
        }

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return step.pose(self.body)[0][2, :].T - p["up"]


@dataclass(frozen=True, eq=False)
class BaseHeight(Cost):
    """Height (m, world z) of a body's origin against ``height``, by default where it starts."""

    height: Any = None
    body: str | None = None

    def references(self, setting: Setting) -> Mapping[str, Any]:
        if self.height is None:
            return {"height": setting.point(self.body, np.zeros(3))[2:]}
        height = numbers(f"{self.label}.height", self.height)
        if height.ndim > 1:
            raise ShapeError(f"{self.label}.height", height.shape, "() or (N,)")
        return {"height": height[..., None]}

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return step.pose(self.body)[1][2] - p["height"]

    def rows(self, setting: Setting) -> Sequence[Row]:
        return [Row(f"height of {Motion.called(self.body)} − target", "m")]


@dataclass(frozen=True, eq=False)
class BaseAngularVelocity(Cost):
    """World angular velocity of a body (rad/s) against ``velocity`` (3,) or (N, 3); ``axes`` weighs
    x, y, z."""

    velocity: Any = (0.0, 0.0, 0.0)
    axes: Any = (1.0, 1.0, 1.0)
    body: str | None = None
    weighed_by: ClassVar[str] = "axes"

    def references(self, setting: Setting) -> Mapping[str, Any]:
        return {"velocity": self._vector("velocity", 3), "axes": self._roots("axes", 3)}

    def scale(self, setting: Setting) -> float:
        return mean_square(self.velocity)

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        turned = step.pose(self.body)[0] @ step.pose_before(self.body)[0].T
        sine = 0.5 * axial(turned)  # times the axis
        return p["axes"] * (sine / step.dt - p["velocity"])

    def asked(self, motion: Motion, setting: Setting) -> Asked | None:
        chosen = np.broadcast_to(last_row(self.axes), (3,)) > 0.0
        wanted = motion.mean(np.asarray(self.velocity, dtype=float))[chosen]
        if not wanted.any():
            return None
        rotation = motion.pose(self.body)[0]
        turned = rotation[1:] @ rotation[:-1].swapaxes(1, 2)
        vector = 0.5 * np.stack(
            [turned[:, a, b] - turned[:, b, a] for a, b in ((2, 1), (0, 2), (1, 0))], axis=1
        )
        found = motion.mean(vector / motion.dt)[chosen]
        return Asked.of(self.label, f"{motion.called(self.body)} turns at", found, wanted, "rad/s")


@dataclass(frozen=True, eq=False)
class PointPosition(Cost):
    """``point`` (3,) of a body (m, body frame) against a world ``target`` (3,); ``axes`` weighs x,
    y, z."""

    body: str | None = None
    point: Any = (0.0, 0.0, 0.0)
    target: Any = (0.0, 0.0, 0.0)
    axes: Any = (1.0, 1.0, 1.0)
    weighed_by: ClassVar[str] = "axes"

    def references(self, setting: Setting) -> Mapping[str, Any]:
        vectors = {name: self._vector(name, 3) for name in ("point", "target")}
        return {**vectors, "axes": self._roots("axes", 3)}

    def scale(self, setting: Setting) -> float:
        start = setting.point(self.body, last_row(self.point))
        chosen = np.broadcast_to(last_row(self.axes), (3,)) > 0.0
        return mean_square((last_row(self.target) - start)[chosen])

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        rotation, position = step.pose(self.body)
        return p["axes"] * (rotation @ p["point"] + position - p["target"])

    def rows(self, setting: Setting) -> Sequence[Row]:
        return [Row(f"{axis} of {Motion.called(self.body)} − target", "m") for axis in "xyz"]

    def asked(self, motion: Motion, setting: Setting) -> Asked | None:
        chosen, point = np.broadcast_to(last_row(self.axes), (3,)) > 0.0, motion.row(self.point)
        rotation, position = (part[motion.last] for part in motion.pose(self.body))
        found, wanted = (rotation @ point + position)[chosen], motion.row(self.target)[chosen]
        way = float(np.linalg.norm(wanted - setting.point(self.body, point)[chosen]))
        return Asked.of(
            self.label, f"the point of {motion.called(self.body)} gets to", found, wanted, "m", way
        )


@dataclass(frozen=True, eq=False)
class PointVelocity(Cost):
    """World velocity (m/s) of ``point`` (3,) of a body (m, body frame) against ``velocity`` (3,);
    ``axes`` weighs x, y, z."""

    body: str | None = None
    point: Any = (0.0, 0.0, 0.0)
    velocity: Any = (0.0, 0.0, 0.0)
    axes: Any = (1.0, 1.0, 1.0)
    weighed_by: ClassVar[str] = "axes"

    def references(self, setting: Setting) -> Mapping[str, Any]:
        vectors = {name: self._vector(name, 3) for name in ("point", "velocity")}
        return {**vectors, "axes": self._roots("axes", 3)}

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        rotation, position = step.pose(self.body)
        rotation_before, position_before = step.pose_before(self.body)
        moved = (rotation - rotation_before) @ p["point"] + position - position_before
        return p["axes"] * (moved / step.dt - p["velocity"])


def rotation_vector(rotation: ca.SX) -> ca.SX:
    """(3,) axis times angle, in [0, π], of a rotation matrix (3, 3).

    From its quaternion q, as that of :func:`octo.model.quaternions.quaternions`: each column of 4 q
    qᵀ is made of sums of entries of R, and a long one is taken, so that nothing is divided by zero
    at any angle. Half a turn about an axis is half a turn about its opposite: there, and only
    there, the vector jumps.
    """
    R = rotation
    trace = R[0, 0] + R[1, 1] + R[2, 2]
    wx, wy, wz = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    xy, xz, yz = R[0, 1] + R[1, 0], R[0, 2] + R[2, 0], R[1, 2] + R[2, 1]
    of_w = ca.vertcat(1.0 + trace, wx, wy, wz)
    of_x = ca.vertcat(wx, 1.0 - trace + 2.0 * R[0, 0], xy, xz)
    of_y = ca.vertcat(wy, xy, 1.0 - trace + 2.0 * R[1, 1], yz)
    of_z = ca.vertcat(wz, xz, yz, 1.0 - trace + 2.0 * R[2, 2])
    x_longest = ca.logic_and(R[0, 0] >= R[1, 1], R[0, 0] >= R[2, 2])
    column = ca.if_else(
        trace > 0.0, of_w, ca.if_else(x_longest, of_x, ca.if_else(R[1, 1] >= R[2, 2], of_y, of_z))
    )
    column *= ca.if_else(column[0] < 0.0, -1.0, 1.0) / ca.sqrt(ca.sumsqr(column))
    real, imaginary = column[0], column[1:]
    sine = ca.sqrt(ca.sumsqr(imaginary) + SMALL_SINE)  # of half the angle
    return 2.0 * ca.atan2(sine, real) / sine * imaginary


def _rpy(angles: ca.SX) -> ca.SX:
    """Rz(yaw) Ry(pitch) Rx(roll)."""
    (cr, cp, cy), (sr, sp, sy) = [[f(angles[k]) for k in range(3)] for f in (ca.cos, ca.sin)]
    rows: Sequence[Any] = (
        ca.horzcat(cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        ca.horzcat(sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        ca.horzcat(-sp, cp * sr, cp * cr),
    )
    return ca.vertcat(*rows)
