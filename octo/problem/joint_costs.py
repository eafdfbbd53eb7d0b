"""Terms over joints: posture, velocities, efforts, limits, and the whole configuration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import casadi as ca
import numpy as np

from octo.checks import Array, for_each
from octo.errors import ProblemError
from octo.problem import scales
from octo.problem.asked import Asked, Motion
from octo.problem.at import Steps
from octo.problem.constraints import Constraint
from octo.problem.costs import Cost, StepPairCost, last_row, mean_square
from octo.problem.limits import PLACE, JointLimits, JointSpeedLimits, TorqueLimits, in_words
from octo.problem.terms import Curvature, Row

if TYPE_CHECKING:
    from octo.problem.symbols import Setting, StepSymbols

FREE = 1e6  # rad or m, in place of a limit that is none
# of the reference, where the power of a joint changes its sign: with a third of it most strides
# stalled
POWER_ROUNDING = 3e-2
QUICK = 0.1  # s, in which a torque may change by the effort's reference


def _inverse_limit(limit: Array) -> Array:
    """Zero where there is none."""
    return np.where(np.isfinite(limit), 1.0 / limit, 0.0)


@dataclass(frozen=True, eq=False)
class Posture(Cost):
    """Actuated joints (rad or m) against ``reference`` (nx,), by default the start; ``joints``
    weighs each (nu,)."""

    reference: Any = None
    joints: Any = 1.0
    weighed_by: ClassVar[str] = "joints"

    def references(self, setting: Setting) -> Mapping[str, Any]:
        given = self.reference is not None
        reference = self._vector("reference", setting.nx) if given else setting.x0
        joints = self._roots("joints", len(setting.actuated))
        return {"reference": reference[..., setting.actuated], "joints": joints}

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return p["joints"] * (step.joints(step.x_next) - p["reference"])


@dataclass(frozen=True, eq=False)
class JointVelocity(Cost):
    """Velocity of the actuated joints (rad/s or m/s) against ``velocity``: a number, (nu,) or (N,
    nu)."""

    velocity: Any = 0.0

    def references(self, setting: Setting) -> Mapping[str, Any]:
        return {
            "velocity": for_each(f"{self.label}.velocity", self.velocity, len(setting.actuated))
        }

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
        if self.reference is None:
            return {"inverse_reference": np.array([1.0 / setting.torque_reference])}
        return {"inverse_reference": self._inverse("reference")}

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return step.u * p["inverse_reference"]


@dataclass(frozen=True, eq=False)
class JointPower(Cost):
    """Work that the joints do and that is done on them: the mean of Σ|u q̇| over ``reference``, each
    joint's rounded off at ``POWER_ROUNDING`` of it. With mg·v as the reference of a walk at v m/s
    it is the cost of transport."""

    curvature: Curvature = field(default="exact", kw_only=True)
    reference: float | None = None  # W, by default mg√(gℓ)

    def references(self, setting: Setting) -> Mapping[str, Any]:
        if self.reference is not None:
            return {"inverse_reference": self._inverse("reference", "W")}
        if setting.character is None:
            raise ProblemError(
                f"{self.label}.reference is missing: user-written dynamics have no weight, give W"
            )
        usual = scales.power(setting.character, scales.length(setting.character, setting.x0))
        return {"inverse_reference": np.array([1.0 / usual])}

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        turned = step.joints(step.x_next - step.x)
        power = step.u * turned / step.dt * p["inverse_reference"]
        return ca.sqrt(ca.sqrt(power**2 + POWER_ROUNDING**2))


@dataclass(frozen=True, eq=False)
class TorqueRate(StepPairCost):
    """Rate of the torques (N m/s or N/s), (u_i − u_{i−1})/dt over ``reference``, by default the
    effort's in 0.1 s: for plans whose torques a motor or a low-level controller has to follow."""

    weight: float | Array = field(default=0.02, kw_only=True)
    reference: float | None = None  # N m/s

    def references(self, setting: Setting) -> Mapping[str, Any]:
        if self.reference is None:
            return {"inverse_reference": np.array([QUICK / setting.torque_reference])}
        return {"inverse_reference": self._inverse("reference", "N m/s")}

    def pair_residual(
        self, step: StepSymbols, before: StepSymbols, p: Mapping[str, ca.SX]
    ) -> ca.SX:
        return (step.u - before.u) / step.dt * p["inverse_reference"]


@dataclass(frozen=True, eq=False)
class TorqueLimit(Cost):
    """Squared hinge on |u|/limit − ``margin``, over the joints that have a limit."""

    margin: float = 1.0

    def references(self, setting: Setting) -> Mapping[str, Any]:
        return {
            "inverse_limit": _inverse_limit(setting.torque_limit),
            "margin": self._number("margin"),
        }

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return ca.fmax(0, ca.fabs(step.u) * p["inverse_limit"] - p["margin"])

    def hard(self) -> Constraint:
        return TorqueLimits(None, self.margin, **self._kept())


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
        margin = self._number("margin")
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

    def hard(self) -> Constraint:
        return JointLimits(self.margin, **self._kept())


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
        return {"inverse_limit": _inverse_limit(limit), "margin": self._number("margin")}

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        speed = ca.fabs(step.joints(step.x_next - step.x)) / step.dt
        return ca.fmax(0, speed * p["inverse_limit"] - p["margin"])

    def hard(self) -> Constraint:
        return JointSpeedLimits(None, self.margin, self.otherwise, **self._kept())


@dataclass(frozen=True, eq=False)
class PoseTarget(Cost):
    """The whole configuration against ``target`` (nx,), at the last step or at every step."""

    target: Any = None
    at: Steps = field(default="last", kw_only=True)
    coordinates: Any = 1.0  # weight of each coordinate
    weighed_by: ClassVar[str] = "coordinates"

    def references(self, setting: Setting) -> Mapping[str, Any]:
        if self.target is None:
            raise ProblemError(
                f"{self.label}.target is missing: give a configuration ({setting.nx},)"
            )
        return {
            "target": self._vector("target", setting.nx),
            "coordinates": self._roots("coordinates", setting.nx),
        }

    def scale(self, setting: Setting) -> float:
        return mean_square(last_row(self.target) - setting.x0)

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return p["coordinates"] * (step.x_next - p["target"])

    def rows(self, setting: Setting) -> Sequence[Row]:
        words = [in_words(setting.character, j, PLACE) for j in range(setting.nx)]
        return [Row(f"{name} − target", unit) for name, unit in words]

    def asked(self, motion: Motion, setting: Setting) -> Asked | None:
        chosen = np.broadcast_to(last_row(self.coordinates), (setting.nx,)) > 0.0
        found, wanted = motion.x[motion.last][chosen], motion.row(self.target)[chosen]
        way = float(np.linalg.norm(wanted - setting.x0[chosen]))
        return Asked.of(self.label, "the configuration gets to", found, wanted, "rad and m", way)
