"""The direction of the line search: the KKT step of Eq. 12 with the smallest regularisation that
makes it one of descent.

The model decides what it is: with exact curvature it is Newton's step, with JᵀJ Gauss and Newton's.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from octo.arrays import Numbers, choose
from octo.solver.acceptance import Mask
from octo.solver.factors import Attempt, Factors
from octo.solver.heuristics import LeapDamping
from octo.solver.options import SqpOptions
from octo.solver.regularisation import Regularisation
from octo.solver.rule import Clock


class KKTDirection:
    """The regularised KKT step. ``damping``: of single units, None where that is switched off."""

    def __init__(
        self, batch: int, units: int, options: SqpOptions, clock: Clock, damping: LeapDamping | None
    ):
        self.options, self.clock, self.damping = options, clock, damping
        self.regularisation = Regularisation(batch, units, options)

    def take(self, members: NDArray[np.intp]) -> None:
        """Keep some members only."""
        self.regularisation.take(members)

    def step(self, factors: Factors) -> tuple[Attempt, Numbers, Mask]:
        """The KKT step, the weights of its factors (batch,), and where there is one."""
        with self.clock("factor"):
            sigma, has = self.regularisation.factorize(factors)
        attempt = 0
        while True:
            with self.clock("solve"):
                step = factors.attempt(None, 1.0, self.options.cap)
            has &= np.isfinite(step.largest)
            again = None
            if self.damping is not None:
                again = self.damping.raised(attempt, step, self.regularisation.local, sigma, has)
            if again is None:
                return step, sigma, has
            with self.clock("factor"):
                weight, factored = self.regularisation.factorize(factors, again)
            sigma, has = choose(again, weight, sigma), choose(again, factored, has)
            attempt += 1
