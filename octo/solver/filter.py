"""The filter of a line search (Fletcher and Leyffer; constants of Wächter and Biegler 2006, §2.3):
batched.

A step is refused when an entry (‖C‖₁, E) is better than it in both. An iterate becomes an entry
when the step from it was taken for its constraints and not for a sufficient decrease of E.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from octo.arrays import Numbers, some
from octo.problem.evaluation import Evaluation
from octo.solver.acceptance import Acceptance, Mask, Step

GAMMA_C, GAMMA_E = 1e-5, 1e-8  # by how much a step must beat an entry
ARMIJO = 1e-4
SWITCH_C, SWITCH_E = 1.1, 2.3  # exponents of the switching condition (19)
C_LARGE = 1e4  # of max(1, ‖C‖₁ at the start)
# of E: what a comparison of two of them may be off by. Without it a step of 1e-11 at the end, which
# E does not feel any more, was cut down, and its multipliers with it: a tenth of 40 motions in
# minimum time stalled at their optimum
ROUNDING = 10.0 * np.finfo(float).eps
CAPACITY = 256  # entries kept of each member; the oldest are forgotten


class FilterAcceptance(Acceptance):
    """The default: a step is taken where no entry is better in both, and it is worth it.

    Attributes
    ----------
    violation, energy: (batch, CAPACITY) ‖C‖₁ and E of the entries, ``count`` (batch,) so far.
    """

    def start(self, at: Evaluation) -> None:
        batch = len(at.size)
        self.far = C_LARGE * np.maximum(1.0, at.size)
        self.violation = np.full((batch, CAPACITY), np.inf)
        self.energy = np.full((batch, CAPACITY), np.inf)
        self.count = np.zeros(batch, dtype=int)

    def descends(self, step: Step, violation: Numbers) -> Mask:
        """(batch,) where E's slope along the step is steep enough against ‖C‖₁ that E must decrease
        (switching condition)."""
        return step.length * np.maximum(-step.slope, 0.0) ** SWITCH_E > violation**SWITCH_C

    def accepts(self, at: Evaluation, trial: Evaluation, step: Step) -> Mask:
        """(batch,) where the step is taken, never to a trial that is not finite."""
        violation, energy, new_violation, new_energy = at.size, at.energy, trial.size, trial.energy
        blocked = (new_violation[:, None] >= self.violation) & (new_energy[:, None] >= self.energy)
        free = np.isfinite(new_energy) & (new_violation <= self.far) & ~blocked.any(axis=1)
        most = energy + ROUNDING * np.abs(energy)
        either = (new_violation <= (1.0 - GAMMA_C) * violation) | (
            new_energy <= most - GAMMA_E * violation
        )
        near = violation <= self.near
        if some(near):
            must_descend = near & self.descends(step, violation)
            enough = new_energy <= most + ARMIJO * step.length * step.slope
            either = np.where(must_descend, enough, either)
        return free & either

    def took(self, at: Evaluation, new: Evaluation, step: Step, members: Mask) -> None:
        """Iterates that were left for the sake of their constraints become entries."""
        descends = members & self.descends(step, at.size)
        if some(descends):
            descends &= new.energy <= at.energy + ARMIJO * step.length * step.slope
        self.add(at, members & ~descends)

    def add(self, at: Evaluation, members: Mask) -> None:
        """Make the iterates of ``members`` (batch,) bool entries, a little better than they are."""
        chosen = members.nonzero()[0]
        if len(chosen):
            place, violation = self.count[chosen] % CAPACITY, at.size[chosen]
            self.violation[chosen, place] = (1.0 - GAMMA_C) * violation
            self.energy[chosen, place] = at.energy[chosen] - GAMMA_E * violation
            self.count[chosen] += 1

    def restored(self, members: NDArray[np.intp]) -> None:
        self.violation[members], self.energy[members] = np.inf, np.inf
