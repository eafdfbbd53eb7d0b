"""Factor the KKT matrix with the smallest weight sigma that gives it the right inertia.

An exact Hessian is indefinite. The weight is raised until the matrix has as many negative
eigenvalues as constraints and no more (Wächter and Biegler 2006, Algorithm IC), and remembered: the
next iteration tries a third of it.
"""

from __future__ import annotations

import numpy as np

from octo.arrays import Numbers, choose, some
from octo.solver.factors import Factors
from octo.solver.options import SqpOptions

FLOOR = 1e-12  # always added: units that no term sees would leave zero pivots
SHRINK, GROW = 1.0 / 3.0, 8.0
LARGEST = 1e12
FORGET = 1.0 / 3.0  # of the weights of single units, from iteration to iteration


class Regularisation:
    """The weight of each member (batch,), remembered between iterations."""

    def __init__(self, batch: int, units: int, options: SqpOptions):
        self.options = options
        self.last = np.zeros(batch)  # the last one that was needed, 0 before any was
        self.factorizations = np.zeros(batch, dtype=int)
        self.local = np.zeros((batch, units))  # weights of single units, on top

    def take(self, members: Numbers) -> None:
        """Keep some members only."""
        self.last = self.last[members]
        self.factorizations = self.factorizations[members]
        self.local = self.local[members]

    def forget(self) -> None:
        """Lower the weights of single units."""
        self.local *= FORGET

    def factorize(self, factors: Factors, again: Numbers | None = None) -> tuple[Numbers, Numbers]:
        """Fills ``factors``: the weights used (batch,), and where there is a factor (batch,) bool.

        again (batch,) bool: factor these members only, weight 0 for the others, whose factors stay;
        None: all.
        """
        batch = len(self.last)
        sigma, pending = np.zeros(batch), np.ones(batch, dtype=bool)
        if again is None:
            factors.clear()
        else:
            pending &= again
        first = np.maximum(self.options.first_sigma, SHRINK * self.last)
        while some(pending):
            good = factors.add(pending, (sigma + FLOOR)[:, None] + self.local)
            self.factorizations = self.factorizations + pending
            pending = pending ^ good
            if some(pending):
                sigma = choose(pending, np.maximum(first, GROW * sigma), sigma)
                pending &= sigma <= LARGEST
        self.last = choose(sigma > 0.0, sigma, self.last)
        return sigma, sigma <= LARGEST
