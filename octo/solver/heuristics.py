"""What the line search does beside the textbook: small objects, which ``SqpOptions(heuristics=…)``
switches on and off.

Each says what it is worth: medians of fifteen starts of three walks (from a stand, a speed and
effort alone) and two cycles (natural terms), without it against with all. ``python -m
benchmarks.heuristics`` measures them; docs/notes/solver.md has the table, and how much of it is
chance.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from octo.arrays import Array, Numbers, array_module, choose, host, inner, largest, scaled, some
from octo.problem.block_nlp import BlockNLP
from octo.problem.evaluation import Evaluation, Model
from octo.solver.acceptance import Acceptance, Mask, Step
from octo.solver.factors import Attempt, Factors
from octo.solver.options import SqpOptions
from octo.solver.regularisation import Regularisation
from octo.solver.search import Found, Line, Trials


class LeapDamping:
    """Single units that would leap get weights of their own before the step is tried.

    Without it the cycles take 3 % more iterations, mammal's walk 7 % fewer with E 4 % lower: all
    within chance.
    """

    TIMES = 3  # that the step is made anew
    LEAP = 0.4  # rad and m
    PART = 0.1  # of the units: where more of them leap, the step is long, not wrong
    RAISED, LEAST = 10.0, 1e-5

    def raised(
        self, times: int, step: Attempt, local: Numbers, sigma: Numbers, has: Mask
    ) -> Mask | None:
        """Raise weights ``local`` (batch, K) in place: the members (batch,) to factor again, None
        where there are none or it was done TIMES ``times``."""
        if times == self.TIMES or not some(step.largest > self.LEAP):
            return None
        beyond = (step.numbers[0] > self.LEAP) & has[:, None]
        count = beyond.sum(axis=1)
        few = (count > 0) & (count <= max(1, self.PART * beyond.shape[1]))
        if not some(few):
            return None
        least = np.maximum(self.RAISED * sigma[:, None], self.LEAST)
        local[:] = np.where(beyond & few[:, None], np.maximum(self.RAISED * local, least), local)
        return few


class LocalDamping:
    """The weights of the units where a refused full step broke the constraints or raised E are
    raised for the next iteration.

    Without it the cycles of mammal and go2 take 33 and 50 % more iterations, and 12 of 15 of
    mammal's are converged and not just acceptable, where all were. Walks take 1 to 5 % fewer, with
    E up to 6 % higher (chain).
    """

    BLAME = 0.1  # of the largest growth of a unit's ‖C‖₁
    RAISED, LEAST = 4.0, 1e-6

    def learn(
        self, regularisation: Regularisation, at: Evaluation, trial: Evaluation, refused: Mask
    ) -> None:
        """After the first trial of an iteration; the weights of all other units fall."""
        local = regularisation.local
        lowered = local.copy()
        regularisation.forget()
        if not some(refused):
            return
        worse = trial.unit_sizes - at.unit_sizes
        worse = np.where(np.isfinite(worse), worse, 1e9)
        for lag in (1, 2):  # a row of C sees three units
            worse[:, :-lag] = np.maximum(worse[:, :-lag], worse[:, lag:])
        most = np.maximum(worse.max(axis=1), 1e-300)
        blamed = refused[:, None] & (worse > self.BLAME * most[:, None])
        least = np.maximum(regularisation.last[:, None], self.LEAST)
        local[:] = np.where(blamed, np.maximum(self.RAISED * lowered, least), local)


class Extrapolation:
    """A full step that sigma has shortened is doubled while E falls faster: sigma shortens steps
    along directions of negative curvature.

    Without it E of the walks of chain and go2 is 23 and 31 % higher (10 and 12 of 15 starts), and
    the cycle of go2 takes 12 % more iterations; the walks take 4 to 9 % fewer.
    """

    DOUBLINGS = 5
    LARGEST = 0.1  # rad and m
    GAIN = 1.5  # by which E must fall more each time

    def further(
        self, trials: Trials, at: Evaluation, line: Line, near: Numbers, found: Found, growing: Mask
    ) -> Found:
        """``found``, with longer steps of ``growing`` members along the ``line`` where they are
        better, and ‖C‖₁ below ``near`` or no larger than it was."""
        new, moved = found.at, found.moved
        growing = growing & (new.energy < at.energy)
        for doubling in range(self.DOUBLINGS):
            factor = 2.0 ** (doubling + 1)
            longer = factor * line.largest
            growing &= longer <= self.LARGEST
            if not some(growing):
                break
            trial = trials.evaluate(at, choose(growing, factor * line.delta, 0.0), growing)
            growing &= trial.energy - at.energy <= self.GAIN * (new.energy - at.energy)
            growing &= trial.size <= np.maximum(near, at.size)
            new, moved = new.replaced(growing, trial), choose(growing, longer, moved)
        return replace(found, at=new, moved=moved)


class FeasibilityStep:
    """Where E or its gradient has settled and the constraints have not: a step for them alone.

    Without it 2 of 15 walks of the chain end within 600 iterations a pass, not all of them, and
    cycles and mammal's walk take 12 to 36 % more iterations. It has a price: the walks end on a
    plateau, and E is 21 % (mammal) to 70 % (go2) lower without it.
    """

    CLOSE = 10.0  # step tolerances

    def __init__(self, batch: int, options: SqpOptions):
        self.options = options
        self.flat = np.zeros(batch, dtype=int)  # iterations in a row without a change of E

    def take(self, members: NDArray[np.intp]) -> None:
        self.flat = self.flat[members]

    def wanted(self, feasible: Mask, level: Mask, full: Numbers) -> Mask:
        """(batch,) where; ``level``: the gradient is within its tolerance, ``full``: ‖Δ‖∞."""
        close = level & (full <= self.CLOSE * self.options.step_tolerance)
        return ~feasible & ((self.flat >= self.options.plateau) | close)

    def step(
        self, factors: Factors, model: Model, wanted: Mask, has: Mask, delta: Array
    ) -> tuple[Array, Numbers, Numbers]:
        """``delta``, with the step of zero gradient where it is wanted, bᵀΔ and ‖Δ‖∞ (batch,)."""
        still, _ = factors.solve(array_module(model.b).zeros_like(model.b), -model.C)
        delta = choose(wanted & has, still, delta)
        moving = choose(has, delta, 0.0)
        return delta, host(inner(model.b, moving)), host(largest(moving))

    def learn(self, at: Evaluation, new: Evaluation) -> None:
        """After an iteration."""
        o = self.options
        change = abs(new.energy - at.energy) <= o.plateau_change / o.plateau * abs(at.energy)
        self.flat = (self.flat + 1) * change


class SecondOrderCorrection:
    """A refused full step is mended with the residual of the constraints that it ended at (Wächter
    and Biegler 2006, §2.4), on the factors that are there.

    Without it E of the walks of chain and go2 is 12 and 14 % higher (8 of 15 starts each: within
    chance); mammal's cycle takes 20 % fewer iterations, the others 2 to 4 % fewer.
    """

    TIMES = 3
    GAIN = 0.99  # of ‖C‖₁ before: it goes on while it falls below

    def corrected(
        self,
        trials: Trials,
        acceptance: Acceptance,
        model: Model,
        factors: Factors,
        at: Evaluation,
        trial: Evaluation,
        moved: Numbers,
        line: Step,
        pending: Mask,
    ) -> tuple[Mask, Evaluation, Numbers]:
        """Of ``pending`` members: where a correction is accepted, and ``trial`` and ‖·‖∞ ``moved``
        with those."""
        length = line.length
        found, pending = np.zeros(len(length), dtype=bool), pending.copy()
        residual, before = scaled(length, model.C) + trial.C, trial.size
        for _ in range(self.TIMES):
            with trials.clock("solve"):
                step = factors.attempt(choose(pending, -residual, 0.0), length, np.inf, pending)
            if step.trial is None:
                change = choose(pending, scaled(length, step.delta), 0.0)
                new = trials.evaluate(at, change, pending, length)
            else:
                new = trials.bounds.tried(at, step.trial, length)
            good = pending & acceptance.accepts(at, new, line)
            if some(good):
                trial = trial.replaced(good, new)
                moved = choose(good, length * step.largest, moved)
                found |= good
            pending &= ~good & new.finite & (new.size <= self.GAIN * before)
            if not some(pending):
                break
            residual, before = scaled(length, residual) + new.C, new.size
        return found, trial, moved


class Restoration:
    """Where no length is accepted: the constraints alone, by damped steps of least norm.

    Without it one start of 15 fails in mammal's walk and one in its cycle, and 11 of 15 of its
    cycles are converged and not just acceptable; medians of E do not change.
    """

    OFTEN = 8  # of one member, before it counts as stalled
    STEPS = 10
    ENOUGH, SOME = 0.1, 0.99  # of ‖C‖₁ before

    def __init__(self, batch: int, options: SqpOptions):
        self.options, self.count = options, np.zeros(batch, dtype=int)

    def take(self, members: NDArray[np.intp]) -> None:
        self.count = self.count[members]

    def restored(self, trials: Trials, at: Evaluation, failed: Mask) -> NDArray[np.intp]:
        """The members of ``failed`` that were restored, in place."""
        self.count[failed] += 1
        tried = failed & (self.count <= self.OFTEN) & at.finite
        done = []
        for k in np.flatnonzero(tried):
            one, now = trials.problem.take(np.array([k])), at.take([k])
            start = now.size[0]
            for _ in range(self.STEPS):
                now, better = self._least_norm(trials, one, now)
                if not better or now.size[0] <= self.ENOUGH * start:
                    break
            if now.size[0] < self.SOME * start:
                at.put(np.array([k]), now)
                done.append(k)
        return np.array(done, dtype=np.intp)

    def _least_norm(
        self, trials: Trials, one: BlockNLP, now: Evaluation
    ) -> tuple[Evaluation, bool]:
        """One damped step v_N = −Aᵀ(AAᵀ)⁻¹C."""
        with trials.clock("linearize"):
            model = one.linearize(now, None)
        with trials.clock("solve"):
            step = trials.backend.normal(model.A).least_norm(-model.C)
        length = min(1.0, 0.5 * self.options.cap / max(float(host(largest(step))[0]), 1e-300))
        while length > 1e-4:
            with trials.clock("evaluate"):
                trial = one.evaluate(now.unknowns + length * step)
            if trial.finite[0] and trial.size[0] < (1.0 - 1e-3 * length) * now.size[0]:
                return trial, True
            length *= 0.5
        return now, False
