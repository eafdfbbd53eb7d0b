"""Algorithm 1 over a batch: linearise, ask the rule for a step, take it, test for convergence.

The rule (line_search.py, trust_region.py or levenberg_marquardt.py) owns the step and its
acceptance; this file owns the iterate, the tests, the clock and the history. Members that are done
leave the batch, so none waits for another and none disturbs another.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from octo.arrays import Array, array_module, choose, host, like, some
from octo.problem.block_nlp import BlockNLP, WeighedNLP
from octo.problem.evaluation import Evaluation, Model
from octo.solver.backend import CPU, Backend
from octo.solver.barrier import bounds_of
from octo.solver.bounds import Bounds, Slacks, joined
from octo.solver.levenberg_marquardt import LevenbergMarquardt
from octo.solver.line_search import LineSearch
from octo.solver.options import SqpOptions
from octo.solver.records import Records
from octo.solver.rule import STAGES, Clock, Move, Rule
from octo.solver.status import HISTORY, Status
from octo.solver.trust_region import TrustRegion


@dataclass(eq=False)
class Iterate:
    """What a callback sees after an iteration; arrays are over the members still at work, and the
    callback's to change."""

    number: int  # of the pass, counted from 1
    passes: int
    iteration: int
    energy: Array  # (batch,)
    violation: Array  # (batch,) N
    _at: Evaluation = field(repr=False)

    @cached_property
    def at(self) -> Evaluation:
        """A copy of all that is known of the iterate; of a device only for those who ask."""
        return self._at.copy()

    @cached_property
    def nodes(self) -> Array:
        """(batch, N+2, n); of a device only for those who ask."""
        return np.array(host(self._at.nodes))

    @property
    def words(self) -> str:
        """One line for a terminal."""
        best = int(np.argmin(self.energy))
        others = f", {len(self.energy)} starts" if len(self.energy) > 1 else ""
        return f"E {self.energy[best]:.5g}, ‖C‖∞ {self.violation[best]:.1e} N{others}"


@dataclass(eq=False)
class Monitor:
    """Callback and progress line of a solve, and whether it was told to stop."""

    callback: Callable[[Iterate], bool | None] | None = None
    progress: Callable[..., None] | None = None
    stopped: bool = False
    number: int = 1
    passes: int = 1
    last: Iterate | None = None

    def begin(self, number: int, passes: int) -> None:
        self.number, self.passes = number, passes

    def show(self, iteration: int, at: Evaluation, violation: Array) -> bool:
        """Tell everybody; True stops the solve."""
        if self.callback is None and self.progress is None:
            return False
        numbers = at.energy.copy(), violation.copy()
        self.last = Iterate(self.number, self.passes, iteration, *numbers, at)
        if self.progress is not None:
            self.progress(self.last)
        self.stopped |= self.callback is not None and bool(self.callback(self.last))
        return self.stopped

    def say(self, sentence: str) -> None:
        """What is not of an iteration."""
        if self.progress is not None:
            self.progress(sentence)

    def end(self) -> None:
        if self.progress is not None and self.last is not None:
            self.progress(self.last, final=True)


@dataclass(eq=False)
class Result:
    """The end of one pass, in the order of the batch."""

    at: Evaluation
    lam: Array
    slacks: Slacks | None  # of rows with bounds
    status: list[Status]
    iterations: NDArray[np.intp]
    factorizations: NDArray[np.intp]
    history: list[dict[str, Array]]
    stages: dict[str, float]
    seconds: float
    processor_seconds: float

    def after(self, before: Result) -> Result:
        """This result with the iterations, time and history that led to it."""
        joined = [
            {n: np.concatenate([a[n], b[n]]) for n in HISTORY}
            for a, b in zip(before.history, self.history, strict=True)
        ]
        names = ("iterations", "factorizations", "seconds", "processor_seconds")
        sums: dict[str, Any] = {n: getattr(before, n) + getattr(self, n) for n in names}
        stages = {n: before.stages[n] + self.stages[n] for n in STAGES}
        return replace(self, history=joined, stages=stages, **sums)


# iterations of an elastic phase, at most. Where one begins a solve: without any, strides within
# tight limits take 367 iterations for 228, with 100 (200) 217 (288)
ELASTIC = 50
RULES: dict[str, type[LineSearch] | type[TrustRegion] | type[LevenbergMarquardt]] = {
    "line_search": LineSearch,
    "trust_region": TrustRegion,
    "levenberg_marquardt": LevenbergMarquardt,
}


def run(
    problem: BlockNLP,
    unknowns: Array,
    lam: Array | None,
    options: SqpOptions,
    monitor: Monitor | None = None,
    backend: Backend = CPU,
    slacks: Slacks | None = None,
    bounds: Bounds | None = None,
) -> Result:
    """One pass from ``unknowns`` (batch, K, nc) and multipliers ``lam`` (batch, K, ma), zero by
    default; ``slacks``: of rows with bounds, from a solve before, if any; ``bounds``: what becomes
    of such rows, by default an interior point keeps them.

    ``problem``, ``unknowns`` and ``lam`` are where ``backend`` keeps its arrays; the result is
    NumPy's.
    """
    told = monitor or Monitor()
    return _Run(problem, unknowns, lam, options, told, backend, slacks, bounds).run()


class _Run:
    def __init__(
        self,
        problem: BlockNLP,
        unknowns: Array,
        lam: Array | None,
        options: SqpOptions,
        monitor: Monitor,
        backend: Backend,
        slacks: Slacks | None,
        bounds: Bounds | None,
    ):
        self.options, self.monitor, self.clock = options, monitor, Clock(backend.finish)
        self.problem = problem
        self.began, self.began_processor = time.perf_counter(), time.process_time()
        kind = RULES[options.step]
        if options.step == "trust_region":
            weighed = cast(WeighedNLP, problem)  # phases are refused before
            self.problem = problem = TrustRegion.normalised(weighed, unknowns)
        xp = array_module(unknowns)
        self.at = problem.evaluate(xp.ascontiguousarray(unknowns))
        shape = (problem.batch, problem.K, problem.ma)
        self.lam = xp.zeros(shape) if lam is None else xp.ascontiguousarray(lam, dtype=float)
        if bounds is None:
            bounds = bounds_of(problem, self.at, options.dual_tolerance, slacks)
        self.bounds = bounds
        self.at = self.bounds.seen(self.at)
        own = (self.bounds,) if kind is LineSearch else ()
        self.rule: Rule = kind(problem, self.at, options, self.clock, backend, *own)
        self.active = np.arange(problem.batch)
        self.records = Records(problem.batch, options)
        self.done: dict[int, tuple[Status, Evaluation, Array, Slacks | None]] = {}
        self.best, self.best_lam = self.at, self.lam
        self.best_score = np.full(problem.batch, np.inf)
        self.backend, self.batch = backend, problem.batch
        self.moved = np.ones(problem.batch, dtype=bool)
        self.settled = np.zeros(problem.batch, dtype=bool)  # where E has settled once
        # iterations and factorisations of elastic phases
        self.elsewhere = np.zeros((problem.batch, 2), dtype=np.intp)
        self.model: Model | None = None

    def run(self) -> Result:
        iteration = 0
        try:
            self._leave((~self.at.finite, Status.NOT_FINITE))
            if len(self.active) and some(self.bounds.outside):
                self._remember()
                self._eased(self.bounds.outside, 0)
            while len(self.active):
                everyone = np.ones(len(self.active), dtype=bool)
                spent = iteration + self.elsewhere[self.active, 0]
                if some(over := spent >= self.options.max_iterations):
                    self._leave((over, Status.ITERATION_LIMIT))
                elif time.perf_counter() - self.began > self.options.time_limit:
                    self._leave((everyone, Status.TIME_LIMIT))
                else:
                    self._iterate(iteration)
                    iteration += 1
        except KeyboardInterrupt:
            self.monitor.stopped = True
            self._leave((np.ones(len(self.active), dtype=bool), Status.INTERRUPTED))
        return self._result()

    def _iterate(self, iteration: int) -> None:
        first = self.options.gauss_newton_first
        exact = self.options.hessian != "gauss_newton" and iteration >= first
        if self.model is None or some(self.moved) or iteration == first:
            at = (self.problem, self.at, self.lam)
            with self.clock("linearize"):
                self.bounds.weigh(self.problem, self.at)
                self.model = self.backend.linearize(*at, exact, self.settled)
        self._remember()  # while a device linearises
        move = self.rule.move(self.at, self.lam, self.model, iteration)
        plateau = self._record(move)
        if self.options.hessian == "exact":
            self.settled |= self.records.settled(self.active)
        self.at, self.lam, self.moved = move.at, move.lam, move.accepted
        lost = (move.failed | self.bounds.jammed) & ~move.converged
        if some(lost):
            move.failed &= ~self._eased(lost, iteration + 1)
        stopped = self.monitor.show(iteration, self.at, self.violation)
        if stopped or some(move.converged | move.failed | plateau):
            acceptable = plateau & (self.violation <= self.tolerance) & ~move.converged
            kept = self.options.goal == "feasible"
            acceptable &= self.bounds.within(self.at) if kept else self.bounds.ended
            stalled = move.failed & ~(acceptable | move.converged)
            ended = [(move.converged, Status.CONVERGED), (acceptable, Status.ACCEPTABLE)]
            ended.append((stalled, Status.STALLED))
            if stopped:
                ended.append((~(move.converged | acceptable | stalled), Status.INTERRUPTED))
            self._leave(*ended)

    def _eased(self, members: NDArray[np.bool_], iterations: int) -> NDArray[np.bool_]:
        """Where ``members`` go on, after so many ``iterations``, from where an elastic phase of
        their bounds led the best iterate so far."""
        rest = self.options.max_iterations - iterations - self.elsewhere[self.active, 0]
        jammed = np.broadcast_to(self.bounds.jammed, len(members))
        done = self.bounds.eased(members & (rest > 0))
        own = np.flatnonzero(done)
        if not len(own):
            return done
        problem = self.problem.take(own)
        left = max(self.options.time_limit - (time.perf_counter() - self.began), 1e-9)
        most = min(ELASTIC, int(rest[own].min()))
        options = replace(self.options, dual_tolerance=1e-3, max_iterations=most, time_limit=left)
        start = self.best.unknowns[like(own, self.lam)]
        price = self.bounds.elastic(problem)
        result = run(problem, start, None, options, None, self.backend, bounds=price)
        if Status.INTERRUPTED in result.status:
            raise KeyboardInterrupt  # it is this solve that was told to stop
        spent = np.stack([result.iterations, result.factorizations], axis=1)
        self.elsewhere[self.active[own]] += spent
        # out of a jam, but not into another one
        inside = self.bounds.elastic(problem).kept(result.at.rows)
        done[own] &= inside | ~jammed[own]
        led, own = done[own], np.flatnonzero(done)
        if not len(own):
            return done
        self.at, self.lam = self.at.copy(), self.lam.copy()
        self.at.put(own, self.problem.take(own).evaluate(like(result.at.unknowns[led], self.lam)))
        self.lam[like(own, self.lam)] = like(result.lam[led], self.lam)
        self.at = self.bounds.anew(self.at, done)
        self.rule.anew(own)
        self.moved = self.moved | done
        return done

    @property
    def violation(self) -> Array:
        """(batch,) N."""
        return self.at.largest * self.problem.weight

    @property
    def score(self) -> Array:
        """(batch,) the smaller, the better an iterate."""
        if self.options.soft:
            return self.at.energy
        return self.bounds.objective(self.at) + 100.0 * self.violation / self.problem.weight

    @property
    def tolerance(self) -> float:
        """N; of soft constraints there is none."""
        if self.options.soft:
            return np.inf
        return self.options.tolerance * (
            self.problem.weight if self.options.step == "line_search" else 1.0
        )

    def _remember(self) -> None:
        """Keep what is at hand where it is better than the best so far."""
        score = self.score
        better = score <= self.best_score
        if some(better):
            self.best = self.best.replaced(better, self.at)
            self.best_lam = choose(better, self.lam, self.best_lam)
            self.best_score = choose(better, score, self.best_score)

    def _record(self, move: Move) -> NDArray[np.bool_]:
        """Where E has not changed lately."""
        lengths, seconds = (move.step, move.taken), time.perf_counter() - self.began
        regularised = (move.ratio, move.radius, move.sigma, move.factorizations)
        return self.records.add(
            self.active,
            self.bounds.objective(self.at),
            self.violation,
            move.dual,
            *lengths,
            *regularised,
            seconds,
        )

    def _leave(self, *groups: tuple[NDArray[np.bool_], Status]) -> None:
        """Members that are done go out of the batch; those that did not converge keep their best
        iterate."""
        gone = np.zeros(len(self.active), dtype=bool)
        for mask, status in groups:
            if not some(mask):
                continue
            gone |= mask
            score = self.score
            for place in np.flatnonzero(mask):
                better = (
                    status.converged
                    or score[place] <= self.best_score[place]
                    or not np.isfinite(self.best_score[place])
                )
                at, lam = (self.at, self.lam) if better else (self.best, self.best_lam)
                k = int(place)
                end = (status, at.take([k]).on_host(), host(lam[k : k + 1]))
                self.done[int(self.active[k])] = (*end, self.bounds.state(k))
        if not some(gone):
            return
        keep = np.flatnonzero(~gone)
        self.active = self.active[keep]
        if len(keep):
            own = like(keep, self.lam)
            self.problem = self.problem.take(keep)
            self.at, self.lam, self.moved = self.at.take(keep), self.lam[own], self.moved[keep]
            self.settled = self.settled[keep]
            self.best, self.best_lam = self.best.take(keep), self.best_lam[own]
            self.best_score = self.best_score[keep]
            self.model = None
            self.rule.take(keep, self.problem)

    def _result(self) -> Result:
        ends, histories = [self.done[k] for k in range(self.batch)], self.records.histories()
        status, ats, lams, slacks = zip(*ends, strict=True)
        parts = [[getattr(at, part.name) for at in ats] for part in fields(Evaluation)]
        factored = [int(history["factorizations"].max(initial=0.0)) for history in histories]
        return Result(
            at=Evaluation(*map(np.concatenate, parts)),
            lam=np.concatenate(lams),
            slacks=joined(slacks),
            status=list(status),
            iterations=np.array([len(h["energy"]) for h in histories]) + self.elsewhere[:, 0],
            factorizations=np.array(factored) + self.elsewhere[:, 1],
            history=histories,
            stages=dict(self.clock.seconds),
            seconds=time.perf_counter() - self.began,
            processor_seconds=time.process_time() - self.began_processor,
        )
