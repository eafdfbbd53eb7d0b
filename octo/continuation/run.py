"""From pass to pass: each starts from the solution of the one before, where that converged."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from octo.continuation import leaps
from octo.continuation.member import Member
from octo.continuation.schedule import (
    INTERMEDIATE_ITERATIONS,
    Schedule,
    Step,
    early,
    on_the_way,
    shifted,
    stiffened,
)
from octo.errors import OctoError
from octo.problem.phased import Compiled, compiled_of
from octo.problem.phases import Described
from octo.problem.problem import Array
from octo.result.explanation import LEFT_OUT, LIMITED
from octo.result.solution import Solution
from octo.solver import quasi_newton, sqp
from octo.solver.backend import Backend
from octo.solver.bounds import Slacks
from octo.solver.free_time import FreeTime, timed
from octo.solver.options import SqpOptions
from octo.solver.soft import Softened
from octo.solver.status import Status


@dataclass(eq=False)
class Continuation:
    """The passes of one batch."""

    compiled: Compiled  # the members that are still at work, with the laws of their pass
    nodes: Array  # (batch, N+2, nx) x_{-1} … x_N, where the next solve starts
    lam: Array | None  # (batch, K, ma) multipliers of that start; None for zeros
    options: SqpOptions  # of every pass; ``time_limit`` is of all of them
    threads: int
    backend: Backend
    monitor: sqp.Monitor
    setup_seconds: float  # so far
    seconds: float = 0.0  # of the solves so far
    slacks: Slacks | None = None  # of rows with bounds, of the solve before

    def run(self, schedules: Sequence[Schedule], seeds: Sequence[int]) -> list[Solution]:
        """Pass after pass, each member by its own schedule; it goes on from a converged pass only,
        and keeps the last one it was in."""
        members = [Member(seed, self.backend.name) for seed in seeds]
        at_work, count = list(range(len(members))), len(schedules[0])
        number = 0
        try:
            for number in range(1, count + 1):
                self.monitor.begin(number, count)
                if number == 1:
                    result = self._solve(self.options.max_iterations)
                else:
                    result = self._stiffer([schedules[k][number - 2 : number] for k in at_work])
                converged = [
                    members[k].add(self.compiled, result, place, self.setup_seconds)
                    for place, k in enumerate(at_work)
                ]
                at_work = [k for k, went_on in zip(at_work, converged, strict=True) if went_on]
                if not at_work or self.monitor.stopped:
                    break
                self._select(np.flatnonzero(converged), result)
            else:
                self._limited([members[k] for k in at_work])
        except KeyboardInterrupt:  # between two passes
            if not all(member.motion for member in members):
                raise
            self.monitor.stopped, number = True, min(number, count - 1)
        if self.monitor.stopped and number < count:
            for k in at_work:
                members[k].status = Status.INTERRUPTED
        self.monitor.end()
        return [member.solution() for member in members]

    def _select(self, members: NDArray[np.intp], result: sqp.Result) -> None:
        """Go on with these alone, from the end of a pass."""
        self.compiled = self.compiled.take(members)
        self.nodes = result.at.nodes[members]
        self.lam = np.ascontiguousarray(result.lam[members])
        self.slacks = None if result.slacks is None else result.slacks.select(members)

    def _limited(self, members: Sequence[Member]) -> None:
        """One more pass for those members at work whose motions leap where no constraint says how
        far they may: with a limit."""
        problems: tuple[Described, ...] = self.compiled.problems
        found = []
        for place, own in enumerate(zip(members, problems, self.nodes, strict=True)):
            member, problem, nodes = own
            if leap := leaps.leap_of(problem, nodes):
                if why_not := leaps.cannot(problem, self.options):
                    member.passes[-1][LEFT_OUT] = why_not
                else:
                    found.append((place, member, leap))
        if not found:
            return
        places, leaping, why = zip(*found, strict=True)
        many = "" if len(members) == 1 else f"{len(found)} of {len(members)} motions leap: "
        self.monitor.say(f"{many}{why[0]}; going on with {leaps.NAME}")
        try:
            self._within_steps([problems[place] for place in places], list(places))
            self.monitor.begin(self.monitor.number + 1, self.monitor.passes + 1)
            result = self._solve(self.options.max_iterations)
        except OctoError as error:
            for member in leaping:
                member.passes[-1][LEFT_OUT] = str(error)
            return
        except KeyboardInterrupt:  # while it was compiled
            self.monitor.stopped = True
            for member in leaping:
                member.status = Status.INTERRUPTED
            return
        for place, (member, leap) in enumerate(zip(leaping, why, strict=True)):
            member.add(self.compiled, result, place, self.setup_seconds, instead=True)
            member.passes[-1][LIMITED] = leap.why_added

    def _within_steps(self, problems: Sequence[Described], places: list[int]) -> None:
        """Go on with the members at some places alone, from where they are, as ``problems`` whose
        steps have limits."""
        began = time.perf_counter()
        limited = compiled_of([leaps.limited(problem) for problem in problems], self.threads)
        self.backend.prepare(limited, self.options)
        self.compiled, self.nodes, self.slacks = limited, self.nodes[places], None
        self.lam = None if self.lam is None else self.lam[places]
        self.setup_seconds += time.perf_counter() - began

    def _stiffer(self, ends: Sequence[Schedule]) -> sqp.Result:
        """From the end of one pass to the end of the next, in steps of the stiffness."""
        pairs = [(a, b) for a, b in ends if a is not None and b is not None]
        ways = [(*on_the_way(before, after), after) for before, after in pairs]
        results: list[sqp.Result] = []
        for passes in zip(*ways, strict=True):
            last = len(results) + 1 == len(ways[0])
            self._set_stiffness(passes)
            limit = self.options.max_iterations if last else INTERMEDIATE_ITERATIONS
            results.append(self._solve(limit))
            self.nodes, self.lam = results[-1].at.nodes, results[-1].lam
            self.slacks = results[-1].slacks
            if self.monitor.stopped and not last:
                results[-1].status = [Status.INTERRUPTED] * self.compiled.batch
                break
        result = results.pop()
        for earlier in reversed(results):
            result = result.after(earlier)
        return result

    def _set_stiffness(self, passes: Sequence[Step]) -> None:
        """The same problems with stiffer contact laws; the nodes are shifted to their starts."""
        began = time.perf_counter()
        before: tuple[Described, ...] = self.compiled.problems
        problems = stiffened(before, passes)
        pairs = zip(before, problems, strict=True)
        self.nodes = np.stack(
            [shifted(nodes, *pair) for nodes, pair in zip(self.nodes, pairs, strict=True)]
        )
        self.compiled = compiled_of(problems, self.threads, like=self.compiled)
        self.setup_seconds += time.perf_counter() - began

    def _solve(self, max_iterations: int) -> sqp.Result:
        """One solve with what is left of the time."""
        monitor = self.monitor
        wanted = self.options if monitor.number == monitor.passes else early(self.options)
        left = max(self.options.time_limit - self.seconds, 1e-9)
        options = replace(wanted, time_limit=left, max_iterations=max_iterations)
        problem, lam = timed(self.backend.place(self.compiled)), self.backend.array(self.lam)
        if isinstance(problem, FreeTime):
            lam = problem.widened(lam)
        if options.soft:
            return self._softly(Softened(problem, options.penalty), options)
        start = (problem.unknowns(self.nodes), lam)
        result = sqp.run(problem, *start, options, monitor, self.backend, self.slacks)
        self.seconds += result.seconds
        if isinstance(problem, FreeTime):
            self.compiled, result.at = problem.ended(result.at)
            result.lam = result.lam[..., :-1]
        return result

    def _softly(self, problem: Softened, options: SqpOptions) -> sqp.Result:
        """One solve with soft constraints."""
        start = problem.unknowns(self.nodes)
        if options.step == "lbfgs":
            result = quasi_newton.run(problem, start, options, self.monitor)
        else:
            result = sqp.run(problem, start, None, options, self.monitor, self.backend)
        self.seconds += result.seconds
        result.at, result.lam = problem.ended(result.at)
        return result
