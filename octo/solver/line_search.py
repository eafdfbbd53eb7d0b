"""The default step: the regularised KKT step with exact curvature, shortened until a filter accepts it.

Wächter and Biegler 2006, with a second-order correction, on the block factors of Eq. 12. Where no length is accepted,
the constraints alone are restored by Newton steps of least norm.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from octo.problem.compiled import CompiledProblem, Evaluation, Model
from octo.solver.blocks import KKTBlocks
from octo.solver.filter import ARMIJO, Filter
from octo.solver.normal import NormalFactor
from octo.solver.options import SqpOptions
from octo.solver.regularisation import Factors, Regularisation
from octo.solver.rule import Clock, Move
from octo.solver.subproblem import inner, spread

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
HALVINGS = 12
CORRECTIONS = 3  # second-order corrections of the full step
HOLDS, HELD, HELD_PART = 3, 0.4, 0.1  # a few units that would move more than HELD get weights of their own
STRETCHES, STRETCHED, GAIN = 5, 0.1, 1.5  # doublings of a step, its largest change, how much more E must fall each time
POLISH = 10.0  # step tolerances: where the gradient is within its own and the step near, only the constraints are left to mend
BLAME, FORGET = 0.1, 1.0 / 3.0
RESTORATIONS = 8  # of one member, before it counts as stalled
RESTORATION_STEPS = 10


def size(C: Array) -> Array:
    """(batch,) ‖C‖₁."""
    return np.abs(C).reshape(len(C), -1).sum(axis=1)


def largest(step: Array) -> Array:
    """(batch,) ‖·‖∞."""
    return np.abs(step).reshape(len(step), -1).max(axis=1)


class LineSearch:
    """The rule of SqpOptions(step="line_search")."""

    def __init__(self, problem: CompiledProblem, at: Evaluation, options: SqpOptions, clock: Clock):
        self.problem, self.options, self.clock = problem, options, clock
        self.filter = Filter(size(at.C))
        self.regularisation = Regularisation(problem.batch, options, np)
        self.restorations = np.zeros(problem.batch, dtype=int)
        self.flat = np.zeros(problem.batch, dtype=int)  # iterations in a row without a change of E

    def take(self, members: NDArray[np.intp]) -> None:
        """Keep some members only."""
        self.problem = self.problem.take(members)
        self.filter = self.filter.take(members)
        self.regularisation.take(members)
        self.restorations, self.flat = self.restorations[members], self.flat[members]

    def move(self, at: Evaluation, lam: Array, model: Model, iteration: int) -> Move:
        """One iteration."""
        blocks = KKTBlocks(model.H, model.A, model.b, model.C)
        factors, sigma, has, delta, multipliers = self._step(blocks)
        full = np.where(has, largest(np.where(spread(has), delta, 0.0)), np.inf)
        violation = np.abs(model.C).max(axis=(1, 2)) if model.C.size else np.zeros(len(full))
        dual = largest(model.b + blocks.constraints_transposed_times(lam))
        o = self.options
        converged = (full <= o.step_tolerance) & (violation <= o.tolerance) & (dual <= o.dual_tolerance)
        settled = (self.flat >= o.plateau) | ((dual <= o.dual_tolerance) & (full <= POLISH * o.step_tolerance))
        polish = settled & (violation > o.tolerance) & ~converged
        if polish.any():  # E or its gradient has settled and the constraints have not: a step for them alone
            with self.clock("solve"):
                still, _ = factors.solve(np.zeros_like(model.b), -model.C)
            delta = np.where(spread(polish & has), still, delta)
        accepted, length, new, correction = self._search(at, model, factors, delta, has & ~converged)
        self._stretch(at, delta, accepted & (sigma > 0.0) & (length == 1.0) & ~polish, new, correction)
        failed = ~accepted & ~converged
        step = np.where(spread(accepted), correction, 0.0)
        after = at.take(np.arange(len(full)))
        taken = np.flatnonzero(accepted)
        after.put(taken, new.take(taken))
        lam = np.where(spread(accepted & ~polish), lam + spread(length) * (multipliers - lam), lam)
        if failed.any():
            failed = self._restore(after, lam, failed)
        change = np.abs(after.energy - at.energy) <= o.plateau_change / o.plateau * np.abs(at.energy)
        self.flat = np.where(change, self.flat + 1, 0)
        return Move(
            at=after, lam=lam, accepted=~converged, failed=failed, dual=dual, step=full, taken=largest(step), ratio=length,
            radius=np.full(len(full), o.cap), sigma=sigma, factorizations=self.regularisation.factorizations.copy(),
            converged=converged,
        )  # fmt: skip

    def _step(self, blocks: KKTBlocks) -> tuple[Factors, Array, Mask, Array, Array]:
        """The KKT step; where single units would move beyond the cap, their own weights are raised first."""
        local = self.regularisation.local
        if local.shape[1] == 1:
            local = self.regularisation.local = np.zeros((blocks.batch, blocks.units))
        for attempt in range(HOLDS + 1):
            with self.clock("factor"):
                factors, sigma, has = self.regularisation.factorize(blocks, self.problem.threads)
            with self.clock("solve"):
                delta, multipliers = factors.solve(-blocks.b, -blocks.C)
            has &= np.isfinite(delta).all(axis=(1, 2))
            units = np.abs(np.where(spread(has), delta, 0.0)).max(axis=2)
            beyond = units > HELD
            few = (beyond.sum(axis=1) <= max(1, HELD_PART * blocks.units)) & beyond.any(axis=1)
            if attempt == HOLDS or not few.any():
                return factors, sigma, has, delta, multipliers
            raised = np.maximum(10.0 * local, np.maximum(10.0 * sigma[:, None], 1e-5))
            local[:] = np.where(beyond & few[:, None], raised, local)
        raise AssertionError("unreachable")

    def _stretch(self, at: Evaluation, delta: Array, growing: Mask, new: Evaluation, step: Array) -> None:
        """Double a regularised full step while E falls faster: sigma shortens steps along directions of negative curvature."""
        growing = growing & (step == delta).all(axis=(1, 2)) & (new.energy < at.energy)
        for attempt in range(STRETCHES):
            trial_step = 2.0 ** (attempt + 1) * delta
            growing &= largest(trial_step) <= STRETCHED
            if not growing.any():
                return
            trial = self._evaluate(at, np.where(spread(growing), trial_step, 0.0), growing)
            growing &= trial.finite & (trial.energy - at.energy <= GAIN * (new.energy - at.energy))
            growing &= size(trial.C) <= np.maximum(self.filter.small, size(at.C))
            chosen = np.flatnonzero(growing)
            new.put(chosen, trial.take(chosen))
            step[chosen] = trial_step[chosen]

    def _blame(self, at: Evaluation, trial: Evaluation, refused: Mask) -> None:
        """Raise the weights of the units where a refused full step broke the constraints or raised E; forget the others."""
        local = self.regularisation.local
        worse = np.abs(trial.C).sum(axis=2) - np.abs(at.C).sum(axis=2)
        worse = np.where(np.isfinite(worse), worse, 1e9)
        for lag in (1, 2):
            worse[:, :-lag] = np.maximum(worse[:, :-lag], worse[:, lag:])
        blamed = refused[:, None] & (worse > BLAME * np.maximum(worse.max(axis=1), 1e-300)[:, None])
        raised = np.maximum(4.0 * local, np.maximum(self.regularisation.last[:, None], 1e-6))
        local[:] = np.where(blamed, raised, FORGET * local)

    def _search(
        self, at: Evaluation, model: Model, factors: Factors, delta: Array, pending: Mask
    ) -> tuple[Mask, Array, Evaluation, Array]:
        """Halve the length until the filter accepts: accepted (batch,), lengths, the new evaluation, the steps taken."""
        here = (size(at.C), at.energy)
        slope = np.where(pending, inner(model.b, np.where(spread(pending), delta, 0.0)), 0.0)
        length = np.minimum(1.0, self.options.cap / np.maximum(largest(np.where(spread(pending), delta, 0.0)), 1e-300))
        accepted, pending = np.zeros(len(slope), dtype=bool), pending.copy()
        taken, result = np.zeros_like(delta), at.take(np.arange(len(slope)))
        for attempt in range(HALVINGS):
            if not pending.any():
                break
            step = np.where(spread(pending), spread(length) * delta, 0.0)
            trial = self._evaluate(at, step, pending)
            there = (size(trial.C), trial.energy)
            good = pending & trial.finite & self.filter.accepts(here, there, slope, length)
            if attempt == 0:
                self._blame(at, trial, pending & ~good)
                worse = pending & ~good & trial.finite & (there[0] >= here[0])
                if worse.any():
                    good |= self._correct(at, model, factors, step, trial, (here, slope, length), worse)
            if good.any():
                chosen = np.flatnonzero(good)
                result.put(chosen, trial.take(chosen))
                taken[chosen] = step[chosen]
                accepted |= good
                pending &= ~good
            length = np.where(pending, 0.5 * length, length)
        descends = self.filter.descends(slope, length, here[0]) & (result.energy <= at.energy + ARMIJO * length * slope)
        self.filter.add(here[0], at.energy, accepted & ~descends)
        return accepted, length, result, taken

    def _evaluate(self, at: Evaluation, step: Array, members: Mask) -> Evaluation:
        """The batch at ``at`` + ``step``; only ``members`` are computed."""
        with self.clock("evaluate"):
            if members.all():
                return self.problem.evaluate(at.unknowns + step)
            chosen = np.flatnonzero(members)
            whole = at.take(np.arange(len(members)))
            whole.put(chosen, self.problem.take(chosen).evaluate(at.unknowns[chosen] + step[chosen]))
            return whole

    def _correct(
        self, at: Evaluation, model: Model, factors: Factors, step: Array, trial: Evaluation,
        search: tuple[tuple[Array, Array], Array, Array], pending: Mask,
    ) -> Mask:  # fmt: skip
        """Second-order corrections of a refused full step: ``step`` and ``trial`` are replaced where one is accepted."""
        here, slope, length = search
        found, pending = np.zeros(len(slope), dtype=bool), pending.copy()
        residual = spread(length) * model.C + trial.C
        before = size(trial.C)
        for _ in range(CORRECTIONS):
            with self.clock("solve"):
                delta, _ = factors.solve(-model.b, np.where(spread(pending), -residual, 0.0))
            delta = np.where(spread(pending), spread(length) * delta, 0.0)
            corrected = self._evaluate(at, delta, pending)
            after = size(corrected.C)
            good = pending & corrected.finite & self.filter.accepts(here, (after, corrected.energy), slope, length)
            chosen = np.flatnonzero(good)
            trial.put(chosen, corrected.take(chosen))
            step[chosen] = delta[chosen]
            found |= good
            pending &= ~good & corrected.finite & (after <= 0.99 * before)
            if not pending.any():
                break
            residual = spread(length) * residual + corrected.C
            before = after
        return found

    def _restore(self, at: Evaluation, lam: Array, failed: Mask) -> Mask:
        """Restore the constraints of ``failed`` members in place; the members that cannot be."""
        self.restorations[failed] += 1
        tried = failed & (self.restorations <= RESTORATIONS) & at.finite
        lost = failed & ~tried
        for k in np.flatnonzero(tried):
            one = self.problem.take(np.array([k]))
            now = at.take([k])
            start = size(now.C)[0]
            for _ in range(RESTORATION_STEPS):
                now, better = self._least_norm(one, now)
                if not better or size(now.C)[0] <= 0.1 * start:
                    break
            if size(now.C)[0] < 0.99 * start:
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
            step = NormalFactor(model.A).least_norm(-model.C)
        length = min(1.0, 0.5 * self.options.cap / max(float(largest(step)[0]), 1e-300))
        while length > 1e-4:
            with self.clock("evaluate"):
                trial = one.evaluate(now.unknowns + length * step)
            if trial.finite[0] and size(trial.C)[0] < (1.0 - 1e-3 * length) * size(now.C)[0]:
                return trial, True
            length *= 0.5
        return now, False
