"""E and C at steps of some members of a batch."""

from __future__ import annotations

import numpy as np

from octo.arrays import Array, every, like
from octo.problem.block_nlp import BlockNLP
from octo.problem.evaluation import Evaluation
from octo.solver.acceptance import Mask
from octo.solver.backend import Backend
from octo.solver.rule import Clock


class Trials:
    """Where the steps of a line search are evaluated, and how long that takes."""

    def __init__(self, problem: BlockNLP, clock: Clock, backend: Backend):
        self.problem, self.clock, self.backend = problem, clock, backend

    def evaluate(self, at: Evaluation, step: Array, members: Mask) -> Evaluation:
        """The batch at ``at`` + ``step``, zero for all but ``members``: only those need be
        computed."""
        with self.clock("evaluate"):
            if every(members) or self.backend.together(self.problem):
                return self.backend.evaluate(self.problem, at.unknowns + step)
            chosen = np.flatnonzero(members)
            own = like(chosen, step)
            whole = at.take(np.arange(len(members)))
            whole.put(chosen, self.problem.take(chosen).evaluate(at.unknowns[own] + step[own]))
            return whole
