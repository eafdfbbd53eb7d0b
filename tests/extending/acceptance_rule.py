"""An acceptance rule in a file of its own: Armijo's test on the l1 merit φ = E + ρ‖C‖₁ (Nocedal and
Wright, §18.3), with Powell's relaxation of ρ."""

from __future__ import annotations

import numpy as np

import octo

MARGIN = 1.1  # of ρ over the largest multiplier


class L1Merit(octo.Acceptance):
    """A step is taken where φ falls by ``armijo`` of what its slope promises.

    Parameters
    ----------
    armijo: of the promised decrease, in (0, 1).
    """

    rho: np.ndarray  # (batch,)

    def __init__(self, armijo: float = 1e-4):
        self.armijo = armijo

    def start(self, at):
        self.rho = np.zeros(len(at.energy))

    def accepts(self, at, trial, step):
        needed = MARGIN * step.multipliers
        rho = np.maximum(needed, 0.5 * (self.rho + needed))
        slope = step.slope - rho * at.size  # of φ: a full step makes the linearised C zero
        promised = self.armijo * step.length * np.minimum(slope, 0.0)
        change = trial.energy - at.energy + rho * (trial.size - at.size)
        rounding = 1e-12 * (abs(at.energy) + rho * at.size)
        return trial.finite & (change <= promised + rounding)

    def took(self, at, new, step, members):
        needed = MARGIN * step.multipliers
        self.rho = np.where(members, np.maximum(needed, 0.5 * (self.rho + needed)), self.rho)
