"""A step along a line, shortened until an acceptance takes it; each member of a batch by itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from octo.arrays import Array, Numbers, choose, every, like, scaled, some
from octo.problem.block_nlp import BlockNLP
from octo.problem.evaluation import Evaluation
from octo.solver.acceptance import Acceptance, Mask, Step
from octo.solver.backend import Backend
from octo.solver.bounds import Bounds
from octo.solver.rule import Clock


class Trials:
    """Where the steps of a line search are evaluated, and how long that takes. bounds: of rows
    that have some."""

    def __init__(
        self, problem: BlockNLP, clock: Clock, backend: Backend, bounds: Bounds | None = None
    ):
        self.problem, self.clock, self.backend = problem, clock, backend
        self.bounds = Bounds() if bounds is None else bounds

    def evaluate(
        self, at: Evaluation, step: Array, members: Mask, length: Numbers | float = 1.0
    ) -> Evaluation:
        """The batch at ``at`` + ``step``, zero for all but ``members``: only those need be
        computed. length: (batch,) of Δ, for the slacks of rows with bounds."""
        with self.clock("evaluate"):
            if every(members) or self.backend.together(self.problem):
                trial = self.backend.evaluate(self.problem, at.unknowns + step)
            else:
                chosen = np.flatnonzero(members)
                own = like(chosen, step)
                trial = at.take(np.arange(len(members)))
                trial.put(chosen, self.problem.take(chosen).evaluate(at.unknowns[own] + step[own]))
            return self.bounds.tried(at, trial, length)


# of the first trial, ‖·‖∞ of its step, the step and where it was refused: where it was mended,
# and trial and ‖·‖∞ with that
Mender = Callable[[Evaluation, Numbers, Step, Mask], tuple[Mask, Evaluation, Numbers]]


@dataclass(frozen=True, eq=False)
class Line:
    """Where the line goes: Δ (batch, K, nc), the multipliers of Eq. 12, of Δ ‖·‖∞ and bᵀΔ (batch,),
    0 where it does not, and the first length's trial. model: of ``Step``. most: the longest length,
    (batch,)"""

    delta: Array
    multipliers: Array
    largest: Numbers
    slope: Numbers
    first: Evaluation | None
    model: tuple[Numbers, Numbers] | None = None
    most: Numbers | float = 1.0


@dataclass(frozen=True, eq=False)
class Found:
    """What a search took: where it took anything (batch,), the lengths, the evaluations there, ‖·‖∞
    of the steps, and which of them were mended."""

    accepted: Mask
    length: Numbers
    at: Evaluation
    moved: Numbers
    mended: Mask


def search(
    trials: Trials,
    acceptance: Acceptance,
    at: Evaluation,
    line: Line,
    pending: Mask,
    tries: int,
    cap: float = np.inf,
    mend: Mender | None = None,
) -> Found:
    """Halve the length, at first that of a step of ‖·‖∞ ``cap`` or 1, until the step is accepted.

    pending: (batch,) the members at work. tries: how many lengths. mend: what is done about steps
    that are refused at first.
    """
    batch = len(pending)
    length = np.minimum(line.most, cap / np.maximum(line.largest, 1e-300))
    accepted, mended = np.zeros(batch, dtype=bool), np.zeros(batch, dtype=bool)
    taken, result = np.zeros(batch), at
    step = Step(length, line.slope, line.largest, line.multipliers, line.model)
    for attempt in range(tries):
        if not some(pending):
            break
        moved = length * line.largest
        if attempt == 0 and line.first is not None:
            trial = trials.bounds.tried(at, line.first, length)
        else:
            change = choose(pending, scaled(length, line.delta), 0.0)
            trial = trials.evaluate(at, change, pending, length)
        good = pending & acceptance.accepts(at, trial, step)
        if attempt == 0 and mend is not None:
            mended, trial, moved = mend(trial, moved, step, pending & ~good)
            good |= mended
        result, taken = result.replaced(good, trial), choose(good, moved, taken)
        accepted |= good
        pending = pending & ~good
        length[pending] *= 0.5
    acceptance.took(at, result, step, accepted)
    return Found(accepted, length, result, taken, mended)
