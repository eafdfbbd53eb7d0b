"""The paper's acceptance (§6.1): a step must reduce the merit Φ = μ/2‖C‖² + E, and end with small
constraints."""

from __future__ import annotations

import numpy as np

from octo.arrays import Numbers
from octo.problem.compiled import Evaluation
from octo.solver.acceptance import Acceptance, Mask, Step

RHO = 0.3  # of Eq. 11, as in Nocedal and Wright (18.36)


class MeritAcceptance(Acceptance):
    """μ follows Eq. 11 with the (1 − ρ) of its source, after the relaxation of C: monotone.

    Parameters
    ----------
    most: of ‖C‖∞, in mg: a step that ends above it is refused unless it reduces ‖C‖∞.
    """

    mu: Numbers  # (batch,)

    def __init__(self, most: float):
        self.most = most

    def start(self, at: Evaluation) -> None:
        self.mu = np.zeros(len(at.energy))

    def merit(self, at: Evaluation) -> Numbers:
        return at.energy + 0.5 * self.mu * at.square

    def accepts(self, at: Evaluation, trial: Evaluation, step: Step) -> Mask:
        """Where nothing is left to do, a step of length zero is taken too."""
        gain = 0.5 * (at.square - step.left(at) ** 2)
        needed = step.predicted / ((1.0 - RHO) * np.maximum(gain, 1e-30))
        self.mu = np.maximum(self.mu, np.where(gain > 1e-30, needed, 0.0))
        lower = (self.merit(trial) < self.merit(at)) | (step.largest == 0.0)
        small = (trial.largest < self.most) | (trial.largest < at.largest)
        return trial.finite & lower & small
