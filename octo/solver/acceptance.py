"""What decides whether a step is taken: the one class to write for a rule of your own.

    class Descent(octo.Acceptance):
        def accepts(self, at, trial, step):
            return trial.energy + 10.0 * trial.size < at.energy + 10.0 * at.size

    octo.solve(problem, options=octo.SqpOptions(acceptance=Descent()))

The line search asks it of shorter and shorter steps until it says yes, the trust region of one step
in each iteration. Every number it sees is NumPy's, over the batch, wherever the solve runs: of the
Evaluations ``at`` and ``trial`` the ``energy`` E, ``size`` ‖C‖₁, ``largest`` ‖C‖∞, ``square`` ‖C‖₂²
and ``finite``, each (batch,).
tests/extending/acceptance_rule.py is a whole one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from copy import deepcopy
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from octo.arrays import Array, Numbers, host, largest
from octo.problem.evaluation import Evaluation

Mask = NDArray[np.bool_]
NEAR = 1e-4  # of max(1, ‖C‖₁ at the start): Wächter and Biegler 2006, §3.3


@dataclass(eq=False)
class Step:
    """A step along the direction Δ of Eq. 12, or a correction of it, or the step Δ of a trust
    region.

    length: (batch,) of Δ in (0, 1]. slope: (batch,) bᵀΔ, the slope of E along Δ. largest: (batch,)
    ‖Δ‖∞. model: of a trust region what its model says of Δ, ½ΔᵀHΔ + bᵀΔ and ‖AΔ + C‖₂.
    """

    length: Numbers
    slope: Numbers
    largest: Numbers
    _multipliers: Array
    model: tuple[Numbers, Numbers] | None = None

    @property
    def predicted(self) -> Numbers:
        """(batch,) by how much E changes: as the model says, along a line by its slope alone."""
        return self.length * self.slope if self.model is None else self.model[0]

    def left(self, at: Evaluation) -> Numbers:
        """(batch,) ‖C‖₂ that the linearised constraints leave: a whole step along a line none."""
        return (1.0 - self.length) * np.sqrt(at.square) if self.model is None else self.model[1]

    @cached_property
    def multipliers(self) -> Numbers:
        """(batch,) ‖lam‖∞ of Eq. 12: an l1 merit needs a penalty above it. Copied from a device
        when it is asked for."""
        return host(largest(self._multipliers))


class Acceptance(ABC):
    """A rule that accepts steps, over a batch. ``accepts`` is all that it must say.

    What a rule remembers of its members are NumPy arrays with a leading batch axis, made in
    ``start``: ``take`` keeps those of the members that are still at work.
    """

    near: Numbers  # (batch,) ‖C‖₁ below which an iterate counts as almost feasible

    def started(self, at: Evaluation) -> Self:
        """A rule of its own for one solve that begins at ``at``."""
        own = deepcopy(self)
        own.near = NEAR * np.maximum(1.0, at.size)
        own.start(at)
        return own

    def start(self, at: Evaluation) -> None:  # noqa: B027
        """Make the arrays that the rule remembers; by default none."""

    @abstractmethod
    def accepts(self, at: Evaluation, trial: Evaluation, step: Step) -> Mask:
        """(batch,) bool, where the step from ``at`` to ``trial`` is taken. Must be false where the
        trial is not finite."""

    def took(self, at: Evaluation, new: Evaluation, step: Step, members: Mask) -> None:  # noqa: B027
        """Learn that ``members`` (batch,) bool moved from ``at`` to ``new``; by default nothing."""

    def merit(self, at: Evaluation) -> Numbers:
        """(batch,) what should fall, for the history of a trust region; by default E."""
        return at.energy

    def restored(self, members: NDArray[np.intp]) -> None:  # noqa: B027
        """Forget what stands in the way of some members, whose constraints were restored without
        regard to E; by default nothing."""

    def take(self, members: NDArray[np.intp]) -> None:
        """Keep some members of the batch only."""
        batch = len(self.near)
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray) and value.ndim and len(value) == batch:
                setattr(self, name, value[members])
