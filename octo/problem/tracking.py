"""Terms that hold a motion near another one: where it is, how fast, and with which torques."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import casadi as ca
import numpy as np

from octo.checks import positive
from octo.model.character import Character
from octo.model.quantities import GRAVITY
from octo.problem.asked import Asked, Motion
from octo.problem.at import Steps
from octo.problem.contact_costs import ContactCost, Slip
from octo.problem.costs import Cost
from octo.problem.joint_costs import Effort, PoseTarget, TorqueLimit

if TYPE_CHECKING:
    from octo.problem.symbols import ContactSymbols, Setting, StepSymbols


@dataclass(frozen=True, eq=False)
class ConfigurationTracking(PoseTarget):
    """The whole configuration (rad and m) against ``target`` (nx,) or (N, nx), by default the
    start, at every step; ``coordinates`` weighs each."""

    at: Steps = field(default="all", kw_only=True)

    def references(self, setting: Setting) -> Mapping[str, Any]:
        target = setting.x0 if self.target is None else self._vector("target", setting.nx)
        return {"target": target, "coordinates": self._roots("coordinates", setting.nx)}

    def scale(self, setting: Setting) -> float:
        return 1.0

    def asked(self, motion: Motion, setting: Setting) -> Asked | None:
        return None


@dataclass(frozen=True, eq=False)
class RateTracking(Cost):
    """The rate of the configuration (rad/s and m/s) against ``rate``: a number, (nx,) or (N, nx);
    ``coordinates`` weighs each."""

    rate: Any = 0.0
    coordinates: Any = 1.0
    weighed_by: ClassVar[str] = "coordinates"

    def references(self, setting: Setting) -> Mapping[str, Any]:
        rate = np.zeros(setting.nx) + np.asarray(self.rate)
        return {"rate": rate, "coordinates": self._roots("coordinates", setting.nx)}

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return p["coordinates"] * ((step.x_next - step.x) / step.dt - p["rate"])


@dataclass(frozen=True, eq=False)
class TorqueTracking(Effort):
    """Torques against ``torque`` (N m or N), a number, (nu,) or (N, nu), in parts of the effort's
    reference."""

    torque: Any = 0.0

    def references(self, setting: Setting) -> Mapping[str, Any]:
        torque = np.zeros(len(setting.actuated)) + np.asarray(self.torque)
        return {"torque": torque, **super().references(setting)}

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return (step.u - p["torque"]) * p["inverse_reference"]


@dataclass(frozen=True, eq=False)
class FootHeightTracking(ContactCost):
    """Height (m) of a foot over the ground against ``height``."""

    height: float = 0.0

    def references(self, setting: Setting) -> Mapping[str, Any]:
        return {"height": self._number("height")}

    def contact_residual(self, contact: ContactSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return contact.height - p["height"]


def tracking(robot: Character, length: float) -> list[Cost]:
    """Terms that hold a robot near a motion at one iteration a call; what they track is set at
    every call.

    Weights are in lengths ℓ, speeds √(gℓ), rates √(g/ℓ) and moments mgℓ. They were tuned in MuJoCo
    on strides of a biped at 0.4 m/s (0.8, 1.0 and 1.2 s) and of a go2 at 1.0 m/s (0.48 and 0.6 s);
    what was tried is in docs/notes/mpc.md.

    Parameters
    ----------
    length: ℓ, m, height of the base over the ground.
    """
    length = positive("length", length, "m")
    speed, rate = GRAVITY * length, GRAVITY / length  # (m/s)², (rad/s)²
    place, moving = np.full(robot.nx, 30.0), np.full(robot.nx, 0.05 / rate)
    first = robot.base_coordinate
    base = slice(first, first + 6)
    place[base] = [5.0 / length**2, 5.0 / length**2, 5.5 / length**2, 4.5, 12.5, 12.5]
    moving[base] = [58.0 / speed, 58.0 / speed, 10.0 / speed, 15.0 / rate, 15.0 / rate, 15.0 / rate]
    return [
        ConfigurationTracking(coordinates=place),
        RateTracking(coordinates=moving),
        TorqueTracking(weight=0.2),
        TorqueLimit(weight=20.0),
        Slip(weight=0.5 / speed, contacts="feet"),
    ]
