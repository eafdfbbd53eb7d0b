"""The default step: the regularised KKT step with exact curvature, shortened until a filter accepts
it.

Wächter and Biegler 2006, with a second-order correction, on the block factors of Eq. 12. Where no
length is accepted, the constraints alone are restored by Newton steps of least norm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from octo.arrays import (
    Array,
    Numbers,
    array_module,
    choose,
    every,
    host,
    inner,
    largest,
    like,
    scaled,
    some,
)
from octo.problem.compiled import CompiledProblem, Evaluation, Model
from octo.solver.backend import CPU, Backend
from octo.solver.factors import Attempt, Factors
from octo.solver.filter import ARMIJO, Filter
from octo.solver.options import SqpOptions
from octo.solver.regularisation import Regularisation
from octo.solver.rule import Clock, Move

Mask = NDArray[np.bool_]
HALVINGS = 12
CORRECTIONS = 3  # second-order corrections of the full step
# a few units that would move more than HELD get weights of their own
HOLDS, HELD, HELD_PART = 3, 0.4, 0.1
# doublings of a step, its largest change, how much more E must fall each time
STRETCHES, STRETCHED, GAIN = 5, 0.1, 1.5
# step tolerances: where the gradient is within its own and the step near, only the constraints are
# left to mend
POLISH = 10.0
BLAME, FORGET = 0.1, 1.0 / 3.0
RESTORATIONS = 8  # of one member, before it counts as stalled
RESTORATION_STEPS = 10


@dataclass(frozen=True, eq=False)
class _Direction:
    """Where the line goes: Δ (batch, K, nc), of it ‖Δ‖∞ and bᵀΔ (batch,), 0 where it does not, and
    the first length's trial."""

    delta: Array
    largest: Numbers
    slope: Numbers
    first: Evaluation | None


class LineSearch:
    """The rule of SqpOptions(step="line_search")."""

    def __init__(
        self,
        problem: CompiledProblem,
        at: Evaluation,
        options: SqpOptions,
        clock: Clock,
        backend: Backend = CPU,
    ):
        self.problem, self.options, self.clock, self.backend = problem, options, clock, backend
        self.filter = Filter(at.size)
        self.regularisation = Regularisation(problem.batch, problem.K, options)
        self.restorations = np.zeros(problem.batch, dtype=int)
        self.flat = np.zeros(problem.batch, dtype=int)  # iterations in a row without a change of E

    def take(self, members: NDArray[np.intp], problem: CompiledProblem) -> None:
        """Keep some members only, those of ``problem``."""
        self.problem = problem
        self.filter = self.filter.take(members)
        self.regularisation.take(members)
        self.restorations, self.flat = self.restorations[members], self.flat[members]

    def move(self, at: Evaluation, lam: Array, model: Model, iteration: int) -> Move:
        """One iteration."""
        factors = self.backend.factors(self.problem, model, at, lam, self.options)
        attempt, sigma, has = self._step(factors)
        delta, multipliers, first = attempt.delta, attempt.multipliers, attempt.trial
        _, dual, slope = attempt.numbers
        o, full = self.options, choose(has, attempt.largest, np.inf)
        feasible, level = at.largest <= o.tolerance, dual <= o.dual_tolerance
        converged = feasible & level & (full <= o.step_tolerance)
        polish = ~feasible & (
            (self.flat >= o.plateau) | (level & (full <= POLISH * o.step_tolerance))
        )
        # E or its gradient has settled and the constraints have not: a step for them alone
        if some(polish):
            with self.clock("solve"):
                still, _ = factors.solve(array_module(model.b).zeros_like(model.b), -model.C)
            delta, first = choose(polish & has, still, delta), None
            slope = host(inner(model.b, choose(has, delta, 0.0)))
            most = host(largest(choose(has, delta, 0.0)))
        else:
            most = full
        pending = has & ~converged
        direction = _Direction(
            delta, choose(pending, most, 0.0), choose(pending, slope, 0.0), first
        )
        accepted, length, after, step, corrected = self._search(
            at, model, factors, direction, pending
        )
        whole = accepted & ~polish
        growing = whole & ~corrected & (sigma > 0.0) & (length == 1.0)
        after, step = self._stretch(at, direction, growing, after, step)
        lam = choose(whole, lam + scaled(length, multipliers - lam), lam)
        failed = ~(accepted | converged)
        if some(failed):
            after, lam = after.copy(), lam.copy()
            failed = self._restore(after, lam, failed)
        change = abs(after.energy - at.energy) <= o.plateau_change / o.plateau * abs(at.energy)
        self.flat = (self.flat + 1) * change
        return Move(
            at=after,
            lam=lam,
            accepted=~converged,
            failed=failed,
            dual=dual,
            step=full,
            taken=step,
            ratio=length,
            radius=o.cap,
            sigma=sigma,
            factorizations=self.regularisation.factorizations,
            converged=converged,
        )

    def _step(self, factors: Factors) -> tuple[Attempt, Numbers, Mask]:
        """The KKT step, the weights of its factors (batch,), and where there is one.

        Where single units would move beyond the cap, their own weights are raised first.
        """
        local = self.regularisation.local
        with self.clock("factor"):
            sigma, has = self.regularisation.factorize(factors)
        for attempt in range(HOLDS + 1):
            with self.clock("solve"):
                step = factors.attempt(None, 1.0, self.options.cap)
            has &= np.isfinite(step.largest)
            if attempt == HOLDS or not some(step.largest > HELD):
                break
            beyond = (step.numbers[0] > HELD) & has[:, None]
            count = beyond.sum(axis=1)
            few = (count > 0) & (count <= max(1, HELD_PART * beyond.shape[1]))
            if not some(few):
                break
            raised = np.maximum(10.0 * local, np.maximum(10.0 * sigma[:, None], 1e-5))
            local[:] = np.where(beyond & few[:, None], raised, local)
            with self.clock("factor"):
                weight, factored = self.regularisation.factorize(factors, few)
            sigma, has = choose(few, weight, sigma), choose(few, factored, has)
        return step, sigma, has

    def _stretch(
        self, at: Evaluation, direction: _Direction, growing: Mask, new: Evaluation, step: Numbers
    ) -> tuple[Evaluation, Numbers]:
        """Double a regularised full step while E falls faster: sigma shortens steps along
        directions of negative curvature."""
        growing = growing & (new.energy < at.energy)
        for attempt in range(STRETCHES):
            factor = 2.0 ** (attempt + 1)
            moved = factor * direction.largest
            growing &= moved <= STRETCHED
            if not some(growing):
                break
            trial = self._evaluate(at, choose(growing, factor * direction.delta, 0.0), growing)
            growing &= trial.energy - at.energy <= GAIN * (new.energy - at.energy)
            growing &= trial.size <= np.maximum(self.filter.small, at.size)
            new, step = new.replaced(growing, trial), choose(growing, moved, step)
        return new, step

    def _blame(self, at: Evaluation, trial: Evaluation, refused: Mask) -> None:
        """Raise the weights of the units where a refused full step broke the constraints or raised
        E; forget the others."""
        local = self.regularisation.local
        if not some(refused):
            local *= FORGET
            return
        worse = trial.unit_sizes - at.unit_sizes
        worse = np.where(np.isfinite(worse), worse, 1e9)
        for lag in (1, 2):
            worse[:, :-lag] = np.maximum(worse[:, :-lag], worse[:, lag:])
        blamed = refused[:, None] & (worse > BLAME * np.maximum(worse.max(axis=1), 1e-300)[:, None])
        raised = np.maximum(4.0 * local, np.maximum(self.regularisation.last[:, None], 1e-6))
        local[:] = np.where(blamed, raised, FORGET * local)

    def _search(
        self, at: Evaluation, model: Model, factors: Factors, direction: _Direction, pending: Mask
    ) -> tuple[Mask, Numbers, Evaluation, Numbers, Mask]:
        """Halve the length until the filter accepts: accepted (batch,), lengths, the new
        evaluation, ‖·‖∞ of the steps taken, and which of them are second-order corrections."""
        here, batch = (at.size, at.energy), len(pending)
        slope, most = direction.slope, direction.largest
        length = np.minimum(1.0, self.options.cap / np.maximum(most, 1e-300))
        accepted, corrected = np.zeros(batch, dtype=bool), np.zeros(batch, dtype=bool)
        taken, result = np.zeros(batch), at
        for attempt in range(HALVINGS):
            if not some(pending):
                break
            moved, trial = length * most, direction.first if attempt == 0 else None
            if trial is None:
                trial = self._evaluate(
                    at, choose(pending, scaled(length, direction.delta), 0.0), pending
                )
            there = (trial.size, trial.energy)
            good = pending & self.filter.accepts(here, there, slope, length)
            if attempt == 0:
                refused = pending & ~good
                self._blame(at, trial, refused)
                worse = refused & trial.finite & (there[0] >= here[0])
                if some(worse):
                    corrected, trial, moved = self._correct(
                        at, model, factors, trial, moved, (here, slope, length), worse
                    )
                    good |= corrected
            result, taken = result.replaced(good, trial), choose(good, moved, taken)
            accepted |= good
            pending = pending & ~good
            length[pending] *= 0.5
        descends = accepted & self.filter.descends(slope, length, here[0])
        if some(descends):
            descends &= result.energy <= here[1] + ARMIJO * length * slope
        self.filter.add(here[0], here[1], accepted & ~descends)
        return accepted, length, result, taken, corrected

    def _evaluate(self, at: Evaluation, step: Array, members: Mask) -> Evaluation:
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

    def _correct(
        self,
        at: Evaluation,
        model: Model,
        factors: Factors,
        trial: Evaluation,
        moved: Numbers,
        search: tuple[tuple[Numbers, Numbers], Numbers, Numbers],
        pending: Mask,
    ) -> tuple[Mask, Evaluation, Numbers]:
        """Second-order corrections of a refused full step: where one is accepted, and ``trial`` and
        ‖·‖∞ ``moved`` with those."""
        here, slope, length = search
        found, pending = np.zeros(len(slope), dtype=bool), pending.copy()
        residual = scaled(length, model.C) + trial.C
        before = trial.size
        for _ in range(CORRECTIONS):
            with self.clock("solve"):
                step = factors.attempt(choose(pending, -residual, 0.0), length, np.inf, pending)
            corrected = step.trial
            if corrected is None:
                corrected = self._evaluate(
                    at, choose(pending, scaled(length, step.delta), 0.0), pending
                )
            after = corrected.size
            good = pending & self.filter.accepts(here, (after, corrected.energy), slope, length)
            if some(good):
                trial = trial.replaced(good, corrected)
                moved = choose(good, length * step.largest, moved)
                found |= good
            pending &= ~good & corrected.finite & (after <= 0.99 * before)
            if not some(pending):
                break
            residual = scaled(length, residual) + corrected.C
            before = after
        return found, trial, moved

    def _restore(self, at: Evaluation, lam: Array, failed: Mask) -> Mask:
        """Restore the constraints of ``failed`` members in place; the members that cannot be."""
        self.restorations[failed] += 1
        tried = failed & (self.restorations <= RESTORATIONS) & at.finite
        lost = failed & ~tried
        for k in np.flatnonzero(tried):
            one = self.problem.take(np.array([k]))
            now = at.take([k])
            start = now.size[0]
            for _ in range(RESTORATION_STEPS):
                now, better = self._least_norm(one, now)
                if not better or now.size[0] <= 0.1 * start:
                    break
            if now.size[0] < 0.99 * start:
                at.put(np.array([k]), now)
                lam[k] = 0.0
                self.filter.clear(np.array([k]))
            else:
                lost[k] = True
        return lost

    def _least_norm(self, one: CompiledProblem, now: Evaluation) -> tuple[Evaluation, bool]:
        """One damped step v_N = −Aᵀ(AAᵀ)⁻¹C."""
        with self.clock("linearize"):
            model = one.linearize(now, None)
        with self.clock("solve"):
            step = self.backend.normal(model.A).least_norm(-model.C)
        length = min(1.0, 0.5 * self.options.cap / max(float(host(largest(step))[0]), 1e-300))
        while length > 1e-4:
            with self.clock("evaluate"):
                trial = one.evaluate(now.unknowns + length * step)
            if trial.finite[0] and trial.size[0] < (1.0 - 1e-3 * length) * now.size[0]:
                return trial, True
            length *= 0.5
        return now, False
