"""Levenberg's and Marquardt's step for soft constraints (§8.4): (H + λ I) Δ = −b, λ by its gain.

λ falls by as much as the model was right and grows faster and faster where it was not (Nielsen
1999; Nocedal and Wright 2006, §10.3). In radians and metres the unit matrix is a fair scale.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from octo.arrays import Array, choose, every, host, inner, largest, some
from octo.problem.block_nlp import BlockNLP
from octo.problem.evaluation import Evaluation, Model
from octo.solver.backend import CPU, Backend
from octo.solver.options import SqpOptions
from octo.solver.rule import Clock, Move
from octo.solver.search import Trials

FIRST = 1e-3  # of the largest entry of H's diagonal: λ to begin with
LEAST, MOST = 1e-12, 1e12
TAKEN = 1e-4  # of what the model promises: a step with less is refused


class LevenbergMarquardt:
    """The rule of SqpOptions(step="levenberg_marquardt")."""

    def __init__(
        self,
        problem: BlockNLP,
        at: Evaluation,
        options: SqpOptions,
        clock: Clock,
        backend: Backend = CPU,
    ):
        self.options, self.trials = options, Trials(problem, clock, backend)
        self.damping = np.full(problem.batch, np.nan)
        self.growth = np.full(problem.batch, 2.0)
        self.factorizations = np.zeros(problem.batch, dtype=np.intp)

    def anew(self, members: NDArray[np.intp]) -> None:
        """Nothing moves members but their own steps."""

    def take(self, members: NDArray[np.intp], problem: BlockNLP) -> None:
        """Keep some members only, those of ``problem``."""
        self.trials.problem = problem
        self.damping, self.growth = self.damping[members], self.growth[members]
        self.factorizations = self.factorizations[members]

    def move(self, at: Evaluation, lam: Array, model: Model, iteration: int) -> Move:
        """One iteration."""
        clock, backend, problem = self.trials.clock, self.trials.backend, self.trials.problem
        units = np.ones((1, problem.K))
        if np.isnan(self.damping).any():
            diagonal = np.diagonal(host(model.H)[:, :, 0], axis1=2, axis2=3)
            first = np.maximum(FIRST * np.abs(diagonal).max(axis=(1, 2)), LEAST)
            self.damping = np.where(np.isnan(self.damping), first, self.damping)
        everyone = np.ones(len(self.damping), dtype=bool)
        factors = backend.factors(problem, model, at, lam, self.options)
        with clock("factor"):
            has = factors.add(everyone, self.damping[:, None] * units)
        with clock("solve"):
            attempt = factors.attempt(None, 1.0, np.inf)
            delta = choose(has, attempt.delta, 0.0) if not every(has) else attempt.delta
            dual, slope = host(largest(model.b)), host(inner(model.b, delta))
            square, moved = host(inner(delta, delta)), host(largest(delta))
        converged = (dual <= self.options.dual_tolerance) & (moved <= self.options.step_tolerance)
        pending = has & ~converged
        trial = at
        if some(pending):
            trial = self.trials.evaluate(at, choose(pending, delta, 0.0), pending)
        promised = 0.5 * (self.damping * square - slope)  # −bᵀΔ − ½ΔᵀHΔ
        with np.errstate(invalid="ignore", over="ignore"):
            gain = (at.energy - trial.energy) / np.maximum(promised, 1e-300)
        accepted = pending & trial.finite & (gain > TAKEN)
        self.factorizations = self.factorizations + 1
        used = self.damping
        self._learn(accepted, pending | ~has, np.where(accepted, gain, 0.0))
        return Move(
            at=at.replaced(accepted, trial),
            lam=lam,
            accepted=accepted,
            failed=~converged & (self.damping > MOST),
            dual=dual,
            step=moved,
            taken=np.where(accepted, moved, 0.0),
            ratio=gain,
            radius=np.inf,
            sigma=used,
            factorizations=self.factorizations,
            converged=converged,
        )

    def _learn(
        self, accepted: NDArray[np.bool_], tried: NDArray[np.bool_], gain: NDArray[np.float64]
    ) -> None:
        """λ after a step that was taken, or was not."""
        falling = np.maximum(1.0 / 3.0, 1.0 - (2.0 * np.minimum(gain, 1.0) - 1.0) ** 3)
        factor = np.where(accepted, falling, np.where(tried, self.growth, 1.0))
        self.damping = np.maximum(self.damping * factor, LEAST)
        grown = np.where(tried, 2.0 * self.growth, self.growth)
        self.growth = np.where(accepted, 2.0, grown)
