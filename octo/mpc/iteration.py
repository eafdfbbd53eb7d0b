"""One step of a plan, or several that each improve it; the regularisation learns from both."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from octo.solver.receding import RecedingHorizon
from octo.solver.receding_bounds import NoBounds
from octo.solver.receding_interpreted import InterpretedHorizon

CAP = (0.2, 0.1)  # rad and m, largest change of a coordinate in one iteration
# of sigma, after a step that could not be taken and after one that could
HARDER, EASIER = 10.0, 3.0
HARDEST = 1e3
SHORTER = 5  # halvings of a step that does not improve the merit
PENALTY = 2.0  # of the l1 norm of C, over its largest multiplier


class Iteration:
    """Gauss-Newton steps (with ``exact``: Newton's) of a horizon from its nodes.

    Attributes
    ----------
    bounds: what keeps rows between theirs.
    sigma: the smallest regularisation weight; the horizon's own grows where steps fail and comes
        back where they do not.
    """

    def __init__(
        self,
        horizon: RecedingHorizon | InterpretedHorizon,
        hinge: NDArray[np.bool_],
        sigma: float,
        exact: bool,
        bounds: NoBounds,
    ):
        self.horizon, self.sigma, self.exact, self.bounds = horizon, sigma, exact, bounds
        self._inverse_cap = np.where(hinge, 1.0 / CAP[0], 1.0 / CAP[1])
        self._before = np.empty_like(horizon.step)
        self._usable, self._penalty = True, 0.0

    def forget(self) -> None:
        self.horizon.sigma[0], self._penalty = self.sigma, 0.0
        self.horizon.guess[:] = 0.0
        self.bounds.forget()

    def prepare(self) -> None:
        """What does not depend on the measurement."""
        self.bounds.weigh(self.horizon)
        self._usable = self.horizon.prepare(self.exact)

    def learn(self, good: bool) -> None:
        sigma = self.horizon.sigma
        sigma[0] = max(self.sigma, sigma[0] / EASIER) if good else min(HARDER * sigma[0], HARDEST)

    def whole(self) -> bool:
        """Take the step, shortened to the cap; False where there is none."""
        length = self._solve()
        if length == 0.0:
            return False
        self.horizon.nodes[2:] += length * self.horizon.step
        self._take_multipliers(length)
        self.horizon.evaluate()
        self.bounds.learn(self.horizon, length)
        return True

    def better(self) -> bool:
        """Take the step, or the largest half, quarter … of it that lowers the merit; False where
        none does.

        The nodes must be evaluated.
        """
        horizon = self.horizon
        length = self._solve()
        if length == 0.0:
            return False
        self._penalty = max(self._penalty, PENALTY * float(np.abs(horizon.lam).max(initial=0.0)))
        here = self._merit()
        self._before[:] = horizon.nodes[2:]
        for _ in range(SHORTER):
            np.multiply(horizon.step, length, out=horizon.nodes[2:])
            horizon.nodes[2:] += self._before
            horizon.evaluate()
            if self._merit() < here:
                self._take_multipliers(length)
                self.bounds.learn(horizon, length)
                return True
            length *= 0.5
        horizon.nodes[2:] = self._before
        horizon.evaluate()
        return False

    def _solve(self) -> float:
        """The step, and how much of it the cap allows; 0 where there is none."""
        self.bounds.weigh_first(self.horizon)
        if not self.horizon.feedback(self.exact, self._usable):
            return 0.0
        length = 1.0 / max(1.0, float((np.abs(self.horizon.step) * self._inverse_cap).max()))
        return length if np.isfinite(length) else 0.0

    def _take_multipliers(self, length: float) -> None:
        if self.exact:
            guess = self.horizon.guess[2:]
            guess += length * (self.horizon.lam - guess)

    def _merit(self) -> float:
        value = self.horizon.energy + self.bounds.price(self.horizon)
        value += self._penalty * float(np.abs(self.horizon.C).sum())
        return value if np.isfinite(value) else np.inf
