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
from octo.solver.acceptance import NEAR, Acceptance, Mask, Step

Pair = tuple[Numbers, Numbers]
GAMMA_C, GAMMA_E = 1e-5, 1e-8  # by how much a step must beat an entry
ARMIJO = 1e-4
SWITCH_C, SWITCH_E = 1.1, 2.3  # exponents of the switching condition (19)
C_LARGE = 1e4  # of max(1, ‖C‖₁ at the start)
CAPACITY = 256  # entries kept of each member; the oldest are forgotten


class Filter:
    """Entries (batch, CAPACITY) of ‖C‖₁ and E."""

    def __init__(self, violation: Numbers):
        batch = len(violation)
        scale = np.maximum(1.0, violation)
        self.small, self.large = NEAR * scale, C_LARGE * scale
        self.violation = np.full((batch, CAPACITY), np.inf)
        self.energy = np.full((batch, CAPACITY), np.inf)
        self.count = np.zeros(batch, dtype=int)

    def take(self, members: NDArray[np.intp]) -> Filter:
        """The filter of some members."""
        part = object.__new__(Filter)
        for name, value in self.__dict__.items():
            setattr(part, name, value[members])
        return part

    def descends(self, slope: Numbers, length: Numbers, violation: Numbers) -> Mask:
        """(batch,) where E's slope along the step is steep enough against ‖C‖₁ that E must decrease
        (switching condition)."""
        return length * np.maximum(-slope, 0.0) ** SWITCH_E > violation**SWITCH_C

    def accepts(self, at: Pair, trial: Pair, slope: Numbers, length: Numbers) -> Mask:
        """(batch,) where a step of ``length`` from (‖C‖₁, E) ``at`` to ``trial`` is taken, never to
        one that is not finite.

        ``slope`` is bᵀΔ.
        """
        (violation, energy), (new_violation, new_energy) = at, trial
        blocked = (new_violation[:, None] >= self.violation) & (new_energy[:, None] >= self.energy)
        free = np.isfinite(new_energy) & (new_violation <= self.large) & ~blocked.any(axis=1)
        either = (new_violation <= (1.0 - GAMMA_C) * violation) | (
            new_energy <= energy - GAMMA_E * violation
        )
        near = violation <= self.small
        if some(near):
            must_descend = near & self.descends(slope, length, violation)
            either = np.where(must_descend, new_energy <= energy + ARMIJO * length * slope, either)
        return free & either

    def add(self, violation: Numbers, energy: Numbers, members: Mask) -> None:
        """Make the iterates (‖C‖₁, E) of ``members`` (batch,) bool entries, a little better than
        they are."""
        chosen = members.nonzero()[0]
        if len(chosen):
            place, violation = self.count[chosen] % CAPACITY, violation[chosen]
            self.violation[chosen, place] = (1.0 - GAMMA_C) * violation
            self.energy[chosen, place] = energy[chosen] - GAMMA_E * violation
            self.count[chosen] += 1

    def clear(self, members: NDArray[np.intp]) -> None:
        """Forget the entries of some members."""
        self.violation[members], self.energy[members] = float("inf"), float("inf")


class FilterAcceptance(Acceptance):
    """The default: a step is taken where the filter takes it."""

    filter: Filter

    def start(self, at: Evaluation) -> None:
        self.filter = Filter(at.size)

    def accepts(self, at: Evaluation, trial: Evaluation, step: Step) -> Mask:
        here, there = (at.size, at.energy), (trial.size, trial.energy)
        return self.filter.accepts(here, there, step.slope, step.length)

    def took(self, at: Evaluation, new: Evaluation, step: Step, members: Mask) -> None:
        """Iterates that were left for the sake of their constraints become entries."""
        descends = members & self.filter.descends(step.slope, step.length, at.size)
        if some(descends):
            descends &= new.energy <= at.energy + ARMIJO * step.length * step.slope
        self.filter.add(at.size, at.energy, members & ~descends)

    def restored(self, members: NDArray[np.intp]) -> None:
        self.filter.clear(members)

    def take(self, members: NDArray[np.intp]) -> None:
        super().take(members)
        self.filter = self.filter.take(members)
