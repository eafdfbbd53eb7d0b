"""The default step: a direction, shortened until an acceptance takes it.

The direction is the regularised KKT step, Newton's where the model is exact and Gauss and Newton's
where it is JᵀJ; the acceptance is a filter (filter.py) or the user's, the lengths are in search.py,
and what is done beside is in heuristics.py. Wächter and Biegler 2006, on the block factors of
Eq. 12.
"""

from __future__ import annotations

from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from octo.arrays import Array, Numbers, choose, like, scaled, some
from octo.problem.block_nlp import BlockNLP
from octo.problem.evaluation import Evaluation, Model
from octo.solver.acceptance import Mask, Step
from octo.solver.backend import CPU, Backend
from octo.solver.bounds import Bounds, Moved
from octo.solver.factors import Attempt, Factors
from octo.solver.filter import FilterAcceptance
from octo.solver.heuristics import (
    Extrapolation,
    FeasibilityStep,
    LeapDamping,
    LocalDamping,
    Restoration,
    SecondOrderCorrection,
)
from octo.solver.options import SqpOptions
from octo.solver.regularisation import Regularisation
from octo.solver.rule import Clock, Move
from octo.solver.search import Line, Trials, search

T = TypeVar("T")
HALVINGS = 12


class KKTDirection:
    """The KKT step of Eq. 12 with the smallest regularisation that makes it one of descent.

    ``damping``: of single units, None where that is switched off.
    """

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


class LineSearch:
    """The rule of SqpOptions(step="line_search")."""

    def __init__(
        self,
        problem: BlockNLP,
        at: Evaluation,
        options: SqpOptions,
        clock: Clock,
        backend: Backend = CPU,
        bounds: Bounds | None = None,
    ):
        self.options, self.clock, self.backend = options, clock, backend
        self.bounds = Bounds() if bounds is None else bounds
        self.trials = Trials(problem, clock, backend, self.bounds)
        self.acceptance = (options.acceptance or FilterAcceptance()).started(at)

        def chosen(name: str, heuristic: T) -> T | None:
            return heuristic if name in options.heuristics else None

        batch = problem.batch
        self.direction = KKTDirection(
            batch, problem.K, options, clock, chosen("leap_damping", LeapDamping())
        )
        self.damping = chosen("local_damping", LocalDamping())
        self.extrapolation = chosen("extrapolation", Extrapolation())
        self.feasibility = chosen("feasibility_step", FeasibilityStep(batch, options))
        self.correction = chosen("second_order_correction", SecondOrderCorrection())
        self.restoration = chosen("restoration", Restoration(batch, options))

    def anew(self, members: NDArray[np.intp]) -> None:
        """Forget the filter and the weights of some members, which were moved."""
        self.acceptance.restored(members)
        self.direction.regularisation.local[members] = 0.0
        self.direction.regularisation.last[members] = 0.0

    def take(self, members: NDArray[np.intp], problem: BlockNLP) -> None:
        """Keep some members only, those of ``problem``."""
        self.trials.problem = problem
        self.acceptance.take(members)
        self.direction.take(members)
        self.bounds.take(members)
        for heuristic in (self.feasibility, self.restoration):
            if heuristic is not None:
                heuristic.take(members)

    def move(self, at: Evaluation, lam: Array, model: Model, iteration: int) -> Move:
        """One iteration."""
        problem = self.trials.problem
        at, model, dual = self.bounds.aimed(problem, at, lam, model, self.backend.blocks)
        if dual is not None:
            self.acceptance.restored(self.bounds.lowered)
        factors = self.backend.factors(problem, model, at, lam, self.options)
        attempt, sigma, has = self.direction.step(factors)
        slope = attempt.numbers[2]
        dual = attempt.numbers[1] if dual is None else dual
        o, full = self.options, choose(has, attempt.largest, np.inf)
        feasible, level = at.largest <= o.tolerance, dual <= o.dual_tolerance
        converged = feasible & level & (full <= o.step_tolerance) & self.bounds.ended
        delta, first, most = attempt.delta, attempt.trial, full
        polish = np.zeros(len(full), dtype=bool)
        if self.feasibility is not None:
            polish = self.feasibility.wanted(feasible, level, full)
            if some(polish):
                with self.clock("solve"):
                    pull = self.bounds.pull(self.trials.problem, at, model)
                    own = (pull, polish, has, delta)
                    delta, slope, most = self.feasibility.step(factors, model, *own)
                first = None
        pending = has & ~converged
        size, slope = choose(pending, most, 0.0), choose(pending, slope, 0.0)
        longest, slope = self.bounds.shortened(problem, at, model, delta, slope)
        first = None if np.less(longest, 1.0).any() else first
        line = Line(delta, attempt.multipliers, size, slope, first, most=longest)
        mend = partial(self._mended, at, model, factors)
        found = search(self.trials, self.acceptance, at, line, pending, HALVINGS, o.cap, mend)
        length, whole = found.length, found.accepted & ~polish
        growing = whole & ~found.mended & (sigma > 0.0) & (length == 1.0)
        if self.extrapolation is not None:
            near = self.acceptance.near
            found = self.extrapolation.further(self.trials, at, line, near, found, growing)
        lam = choose(whole, lam + scaled(length, attempt.multipliers - lam), lam)
        lost = ~(found.accepted | converged)
        after, lam, failed = self._restore(found.at, lam, lost)
        after = self.bounds.moved(at, after, Moved(length, found.accepted, lost, polish, sigma))
        if self.feasibility is not None:
            self.feasibility.learn(at, after)
        return Move(
            at=after,
            lam=lam,
            accepted=~converged,
            failed=failed,
            dual=dual,
            step=full,
            taken=found.moved,
            ratio=length,
            radius=o.cap,
            sigma=sigma,
            factorizations=self.direction.regularisation.factorizations,
            converged=converged,
        )

    def _mended(
        self,
        at: Evaluation,
        model: Model,
        factors: Factors,
        trial: Evaluation,
        moved: Numbers,
        step: Step,
        refused: Mask,
    ) -> tuple[Mask, Evaluation, Numbers]:
        """Of first trials that were refused: single units are to blame, corrections may help."""
        worse = refused & trial.finite & (trial.size >= at.size)
        mended, first = np.zeros(len(refused), dtype=bool), trial
        if self.correction is not None and some(worse):
            mended, trial, moved = self.correction.corrected(
                self.trials, self.acceptance, model, factors, at, trial, moved, step, worse
            )
        if self.damping is not None:
            self.damping.learn(
                self.direction.regularisation, at, first, self.bounds.blamed(refused, mended)
            )
        else:
            self.direction.regularisation.forget()
        return mended, trial, moved

    def _restore(self, at: Evaluation, lam: Array, failed: Mask) -> tuple[Evaluation, Array, Mask]:
        """``at``, ``lam`` and the members that are lost, once the constraints of ``failed`` members
        are restored."""
        if self.restoration is None or not some(failed):
            return at, lam, failed
        at, lam = at.copy(), lam.copy()
        restored = self.restoration.restored(self.trials, at, failed)
        if len(restored):
            lam[like(restored, lam)] = 0.0
            self.acceptance.restored(restored)
            failed = failed.copy()
            failed[restored] = False
        return at, lam, failed
