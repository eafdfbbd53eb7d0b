"""The terms of E (§5, Eqs. 17 and 18): one small class per term; it says its residual, CasADi says
its derivative.

    E = Σ_terms weight/scale · mean over the steps of |residual|²        (steps="last": the last
    step alone)

Weights and references are run-time numbers, constant or one row per step: changing them recompiles
nothing. A new term is a subclass of :class:`Cost` with a residual, its references and, if its size
is physical, a scale.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo.checks import instance, number, numbers, one_of, owned, positive, shares, vectors
from octo.errors import ProblemError, ShapeError
from octo.problem.asked import Asked, Motion

if TYPE_CHECKING:
    from octo.problem.symbols import Setting, StepSymbols

Array = NDArray[np.float64]
Steps = Literal["all", "last"]
FREE = 1e6  # rad or m, in place of a limit that is none
# added to a squared sine: its root has derivatives also at zero; the angle changes by less than
# 1e-16
SMALL_SINE = 1e-16
FLOOR = 0.1**2  # of every scale, so that a target of zero stays defined


@dataclass(frozen=True, eq=False, kw_only=True)
class Cost:
    """A term of E.

    Parameters
    ----------
    weight: a number, or one per step (N,).
    steps: "all", or "last" for the last step alone.
    name: what reports and ``Controller.update`` call it; by default the class's name.
    """

    weight: float | Array = 1.0
    steps: Steps = "all"
    name: str = ""

    def __post_init__(self) -> None:
        for each in fields(self):  # the caller's arrays, lists and dicts stay the caller's
            object.__setattr__(self, each.name, owned(getattr(self, each.name)))
        kind = type(self).__name__
        for name in ("name", *(("body",) if getattr(self, "body", None) is not None else ())):
            instance(f"{kind}.{name}", getattr(self, name), str, "a text")
        one_of(f"{self.label}.steps", self.steps, ("all", "last"))

    @property
    def label(self) -> str:
        """The name the term goes by in reports and in ``Problem.update``."""
        return self.name or type(self).__name__

    def references(self, setting: Setting) -> Mapping[str, Any]:
        """Run-time numbers by name, each (size,) or (N, size)."""
        del setting
        return {}

    def scale(self, setting: Setting) -> float:
        """The fixed number E's term is divided by."""
        del setting
        return 1.0

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        """The residual of one time step, from its symbols and this term's references."""
        raise NotImplementedError(type(self).__name__)

    def asked(self, motion: Motion, setting: Setting) -> Asked | None:
        """What the term asks of a motion as a whole, and what came of it; None of a term that asks
        for nothing special."""
        del motion, setting
        return None


@dataclass(frozen=True, eq=False, kw_only=True)
class SizedCost(Cost):
    """A term of a list that no length was given to: the Problem that gets it puts ``make(length,
    times)`` in its place.

    ``weight`` is over the weight that the term has there.
    """

    make: Callable[[float, Array], Cost]

    def sized(self, length: float, times: Array) -> Cost:
        """The term of a robot of ``length`` ℓ (m), at ``times`` (N,) s."""
        made = self.make(length, times)
        weight = (
            made.weight
            if np.all(np.equal(self.weight, 1.0))
            else np.multiply(made.weight, self.weight)
        )
        return replace(
            made, weight=weight, name=made.name if self.name == made.label else self.name
        )


def _each(field: str, values: Any, count: int) -> Array:
    """One number for each of ``count`` coordinates, or one for all; or a row of them per step."""
    array = numbers(field, values)
    if array.ndim > 2 or (array.ndim and array.shape[-1] != count):
        raise ShapeError(field, array.shape, f"(), ({count},) or (N, {count})")
    return np.broadcast_to(array, (count,)) if array.ndim == 0 else array


def _margin(term: Cost, value: Any) -> dict[str, Array]:
    return {"margin": np.array([number(f"{term.label}.margin", value)])}


def _last_row(values: Any) -> Array:
    return np.atleast_2d(np.asarray(values, dtype=float))[-1]


@dataclass(frozen=True, eq=False)
class CenterOfMassVelocity(Cost):
    """Eq. 17: the velocity of the centre of mass (m/s) against ``velocity`` (3,) or (N, 3)."""

    velocity: Any = (0.0, 0.0, 0.0)

    def references(self, setting: Setting) -> Mapping[str, Any]:
        return {"velocity": vectors(f"{self.label}.velocity", self.velocity, 3)}

    def scale(self, setting: Setting) -> float:
        return max(
            float(
                np.mean(np.sum(np.atleast_2d(np.asarray(self.velocity, dtype=float)) ** 2, axis=-1))
            ),
            FLOOR,
        )

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
    steps: Steps = field(default="last", kw_only=True)

    def references(self, setting: Setting) -> Mapping[str, Any]:
        return {"target": vectors(f"{self.label}.target", self.target, 3)}

    def scale(self, setting: Setting) -> float:
        return max(float(np.sum((_last_row(self.target) - setting.com) ** 2)), FLOOR)

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return step.com - p["target"]

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
        return {"target": setting.com + vectors(f"{self.label}.displacement", self.displacement, 3)}

    def scale(self, setting: Setting) -> float:
        return max(float(np.sum(_last_row(self.displacement) ** 2)), FLOOR)

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

    def references(self, setting: Setting) -> Mapping[str, Any]:
        angles = vectors(f"{self.label}.roll_pitch_yaw", self.roll_pitch_yaw, 3)
        return {
            "roll_pitch_yaw": angles,
            "axes": np.sqrt(shares(f"{self.label}.axes", self.axes, 3)),
        }

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        error = _rpy(p["roll_pitch_yaw"]).T @ step.pose(self.body)[0]
        return p["axes"] * rotation_vector(error)


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


@dataclass(frozen=True, eq=False)
class BaseAngularVelocity(Cost):
    """World angular velocity of a body (rad/s) against ``velocity`` (3,) or (N, 3); ``axes`` weighs
    x, y, z."""

    velocity: Any = (0.0, 0.0, 0.0)
    axes: Any = (1.0, 1.0, 1.0)
    body: str | None = None

    def references(self, setting: Setting) -> Mapping[str, Any]:
        velocity = vectors(f"{self.label}.velocity", self.velocity, 3)
        return {"velocity": velocity, "axes": np.sqrt(shares(f"{self.label}.axes", self.axes, 3))}

    def scale(self, setting: Setting) -> float:
        return max(
            float(
                np.mean(np.sum(np.atleast_2d(np.asarray(self.velocity, dtype=float)) ** 2, axis=-1))
            ),
            FLOOR,
        )

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        turned = step.pose(self.body)[0] @ step.pose_before(self.body)[0].T
        return p["axes"] * (_vee(turned) / step.dt - p["velocity"])

    def asked(self, motion: Motion, setting: Setting) -> Asked | None:
        chosen = np.broadcast_to(_last_row(self.axes), (3,)) > 0.0
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

    def references(self, setting: Setting) -> Mapping[str, Any]:
        point, target = (
            vectors(f"{self.label}.{name}", getattr(self, name), 3) for name in ("point", "target")
        )
        return {
            "point": point,
            "target": target,
            "axes": np.sqrt(shares(f"{self.label}.axes", self.axes, 3)),
        }

    def scale(self, setting: Setting) -> float:
        start = setting.point(self.body, _last_row(self.point))
        chosen = np.broadcast_to(_last_row(self.axes), (3,)) > 0.0
        return max(float(np.sum((_last_row(self.target) - start)[chosen] ** 2)), FLOOR)

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        rotation, position = step.pose(self.body)
        return p["axes"] * (rotation @ p["point"] + position - p["target"])

    def asked(self, motion: Motion, setting: Setting) -> Asked | None:
        chosen, point = np.broadcast_to(_last_row(self.axes), (3,)) > 0.0, motion.row(self.point)
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

    def references(self, setting: Setting) -> Mapping[str, Any]:
        point, velocity = (
            vectors(f"{self.label}.{name}", getattr(self, name), 3)
            for name in ("point", "velocity")
        )
        return {
            "point": point,
            "velocity": velocity,
            "axes": np.sqrt(shares(f"{self.label}.axes", self.axes, 3)),
        }

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        rotation, position = step.pose(self.body)
        rotation_before, position_before = step.pose_before(self.body)
        moved = (rotation - rotation_before) @ p["point"] + position - position_before
        return p["axes"] * (moved / step.dt - p["velocity"])


@dataclass(frozen=True, eq=False)
class Posture(Cost):
    """Actuated joints (rad or m) against ``reference`` (nx,), by default the start; ``joints``
    weighs each (nu,)."""

    reference: Any = None
    joints: Any = 1.0

    def references(self, setting: Setting) -> Mapping[str, Any]:
        reference = (
            setting.x0
            if self.reference is None
            else vectors(f"{self.label}.reference", self.reference, setting.nx)
        )
        weights = shares(f"{self.label}.joints", self.joints, len(setting.actuated))
        return {"reference": reference[..., setting.actuated], "joints": np.sqrt(weights)}

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return p["joints"] * (step.joints(step.x_next) - p["reference"])


@dataclass(frozen=True, eq=False)
class JointVelocity(Cost):
    """Velocity of the actuated joints (rad/s or m/s) against ``velocity``: a number, (nu,) or (N,
    nu)."""

    velocity: Any = 0.0

    def references(self, setting: Setting) -> Mapping[str, Any]:
        return {"velocity": _each(f"{self.label}.velocity", self.velocity, len(setting.actuated))}

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return step.joints(step.x_next - step.x) / step.dt - p["velocity"]


@dataclass(frozen=True, eq=False)
class JointAcceleration(Cost):
    """Acceleration of the actuated joints (rad/s² or m/s²)."""

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return step.joints(step.x_next - 2 * step.x + step.x_prev) / step.dt**2


@dataclass(frozen=True, eq=False)
class Effort(Cost):
    """E_reg of §8: (weight/N) Σ (u/u_reference)². The default reference is 0.4·mg·ℓ, ℓ the base
    height at the start."""

    weight: float | Array = field(default=0.02, kw_only=True)
    reference: float | None = None  # N m

    def references(self, setting: Setting) -> Mapping[str, Any]:
        reference = (
            setting.torque_reference
            if self.reference is None
            else positive(f"{self.label}.reference", self.reference)
        )
        return {"inverse_reference": np.array([1.0 / reference])}

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return step.u * p["inverse_reference"]


@dataclass(frozen=True, eq=False)
class TorqueLimit(Cost):
    """Squared hinge on |u|/limit − ``margin``, over the joints that have a limit."""

    margin: float = 1.0

    def references(self, setting: Setting) -> Mapping[str, Any]:
        limits = setting.torque_limit
        return {
            "inverse_limit": np.where(np.isfinite(limits), 1.0 / limits, 0.0),
            **_margin(self, self.margin),
        }

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return ca.fmax(0, ca.fabs(step.u) * p["inverse_limit"] - p["margin"])


@dataclass(frozen=True, eq=False)
class JointLimit(Cost):
    """Squared hinge on the joints' limits (rad or m), which begins ``margin`` inside them."""

    margin: float = 0.02

    def references(self, setting: Setting) -> Mapping[str, Any]:
        robot = setting.character
        if robot is None:
            raise ProblemError(
                f"{self.label} is asked of user-written dynamics, which have no joint limits"
            )
        lower, upper = robot.lower[robot.actuated], robot.upper[robot.actuated]
        margin = _margin(self, self.margin)["margin"]
        inside = np.minimum(
            margin, 0.25 * np.where(np.isfinite(upper - lower), upper - lower, np.inf)
        )
        return {
            "lower": np.where(np.isfinite(lower), lower + inside, -FREE),
            "upper": np.where(np.isfinite(upper), upper - inside, FREE),
        }

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        q = step.joints(step.x_next)
        return ca.fmax(0, q - p["upper"]) + ca.fmax(0, p["lower"] - q)


@dataclass(frozen=True, eq=False)
class JointSpeedLimit(Cost):
    """Squared hinge on |q̇|/limit − ``margin``, over the joints whose speed has a limit,
    ``otherwise`` (rad/s) for the others."""

    margin: float = 0.9
    otherwise: float = np.inf

    def references(self, setting: Setting) -> Mapping[str, Any]:
        robot = setting.character
        limit = (
            np.full(len(setting.actuated), np.inf)
            if robot is None
            else robot.velocity_limit[robot.actuated]
        )
        limit = np.where(np.isfinite(limit), limit, self.otherwise)
        return {
            "inverse_limit": np.where(np.isfinite(limit), 1.0 / limit, 0.0),
            **_margin(self, self.margin),
        }

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        speed = ca.fabs(step.joints(step.x_next - step.x)) / step.dt
        return ca.fmax(0, speed * p["inverse_limit"] - p["margin"])


@dataclass(frozen=True, eq=False)
class PoseTarget(Cost):
    """The whole configuration against ``target`` (nx,), at the last step or at every step."""

    target: Any = None
    steps: Steps = field(default="last", kw_only=True)
    coordinates: Any = 1.0  # weight of each coordinate

    def references(self, setting: Setting) -> Mapping[str, Any]:
        if self.target is None:
            raise ProblemError(
                f"{self.label}.target is missing: give a configuration ({setting.nx},)"
            )
        weights = np.sqrt(shares(f"{self.label}.coordinates", self.coordinates, setting.nx))
        return {
            "target": vectors(f"{self.label}.target", self.target, setting.nx),
            "coordinates": weights,
        }

    def scale(self, setting: Setting) -> float:
        return max(float(np.sum((_last_row(self.target) - setting.x0) ** 2)), FLOOR)

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return p["coordinates"] * (step.x_next - p["target"])

    def asked(self, motion: Motion, setting: Setting) -> Asked | None:
        chosen = np.broadcast_to(_last_row(self.coordinates), (setting.nx,)) > 0.0
        found, wanted = motion.x[motion.last][chosen], motion.row(self.target)[chosen]
        way = float(np.linalg.norm(wanted - setting.x0[chosen]))
        return Asked.of(self.label, "the configuration gets to", found, wanted, "rad and m", way)


@dataclass(frozen=True, eq=False)
class CustomCost(Cost):
    """Any residual over (x_next, x, x_prev, u, p) written in CasADi.

    ``function(step, p) -> SX`` gets a :class:`~octo.problem.symbols.StepSymbols` and the references
    below by name.
    """

    function: Callable[[StepSymbols, Mapping[str, ca.SX]], ca.SX] | None = None
    values: Mapping[str, Any] = field(default_factory=dict)
    fixed_scale: float = 1.0

    def references(self, setting: Setting) -> Mapping[str, Any]:
        return self.values

    def scale(self, setting: Setting) -> float:
        return self.fixed_scale

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        if self.function is None:
            raise ProblemError(
                f"{self.label}.function is missing: give function(step, p) -> casadi.SX"
            )
        return self.function(step, p)


@dataclass(frozen=True, eq=False)
class NeighbourCost(Cost):
    """A residual over neighbouring controls, ``function(c, c_next, p) -> SX`` (DESIGN: the pattern
    does not change).

    In the nodes basis c_i = (x_i, x_i − x_{i−1}); in the Hermite basis c_k = (x_k, τ ẋ_k), c_0
    included.
    """

    function: Callable[[ca.SX, ca.SX, Mapping[str, ca.SX]], ca.SX] | None = None
    values: Mapping[str, Any] = field(default_factory=dict)
    fixed_scale: float = 1.0

    def references(self, setting: Setting) -> Mapping[str, Any]:
        return self.values

    def scale(self, setting: Setting) -> float:
        return self.fixed_scale

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        """In the nodes basis the two controls are made of one step's three configurations."""
        before = ca.vertcat(step.x, step.x - step.x_prev)
        return self.between(before, ca.vertcat(step.x_next, step.x_next - step.x), p)

    def between(self, control: ca.SX, control_next: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
        if self.function is None:
            raise ProblemError(
                f"{self.label}.function is missing: give function(c, c_next, p) -> casadi.SX"
            )
        return self.function(control, control_next, p)


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


def _vee(rotation: ca.SX) -> ca.SX:
    """sin(angle)·axis of a rotation matrix."""
    return 0.5 * ca.vertcat(
        rotation[2, 1] - rotation[1, 2],
        rotation[0, 2] - rotation[2, 0],
        rotation[1, 0] - rotation[0, 1],
    )


def _rpy(angles: ca.SX) -> ca.SX:
    """Rz(yaw) Ry(pitch) Rx(roll)."""
    (cr, cp, cy), (sr, sp, sy) = [[f(angles[k]) for k in range(3)] for f in (ca.cos, ca.sin)]
    rows: Sequence[Any] = (
        ca.horzcat(cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        ca.horzcat(sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        ca.horzcat(-sp, cp * sr, cp * cr),
    )
    return ca.vertcat(*rows)
