"""Terms over two steps in a row: how fast torques change, and how fast power does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

import octo

Step = octo.costs.StepSymbols


@dataclass(frozen=True, eq=False)
class TorqueChange(octo.StepPairCost):
    """(u_i − u_{i−1})/dt of every motor over ``rate`` (N m/s)."""

    rate: float = 100.0

    def references(self, setting: octo.costs.Setting) -> Mapping[str, Any]:
        return {"rate": np.array([self.rate])}

    def pair_residual(self, step: Step, before: Step, p: Mapping[str, ca.SX]) -> ca.SX:
        return (step.u - before.u) / (step.dt * p["rate"])


@dataclass(frozen=True, eq=False)
class PowerChange(TorqueChange):
    """The same of the motors' power, over ``rate`` (W/s): it looks at all four nodes."""

    def pair_residual(self, step: Step, before: Step, p: Mapping[str, ca.SX]) -> ca.SX:
        power = [s.u * s.joints(s.x_next - s.x) / s.dt for s in (step, before)]
        return (power[0] - power[1]) / (step.dt * p["rate"])
