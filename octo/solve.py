"""The front door: what a call asks for, checked, and its starts as one batch."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import Any, TypedDict, Unpack, overload

import numpy as np

from octo.checks import asked, instance, one_of, room, takes, whole
from octo.continuation.member import record
from octo.continuation.run import Continuation
from octo.continuation.schedule import Schedule, schedule_of, stiffened
from octo.devices import backend_of, say_cpu
from octo.dynamics.evaluate import Dynamics
from octo.errors import DeviceError, ProblemError, ValueRangeError, said
from octo.model.character import Character
from octo.problem.compiled import CompiledProblem
from octo.problem.phased import Compiled, check_all_alike, compiled_of
from octo.problem.phases import Described, Phases
from octo.problem.problem import Array, Problem
from octo.progress import Progress, check_progress
from octo.ranking import rank, rank_of_period, say_kept
from octo.result.measure import measured
from octo.result.solution import Solution, recorded
from octo.result.trajectory import Trajectory
from octo.solver.backend import CPU, Backend
from octo.solver.clocks import as_long_as
from octo.solver.options import CHOICES, FEASIBLE, SqpOptions
from octo.solver.sqp import Iterate, Monitor
from octo.solver.status import Status
from octo.starts import Starter, first_multipliers, first_nodes, first_slacks, starts_of

# (n, n) of a step, or of each part of a unit with each other, about: derivatives of FD, E and C,
# and the factors
BLOCKS = 20
MOST_STARTS, MOST_THREADS, LARGEST_SEED = 100_000, 1024, 2**64 - 1
Guess = Solution | Starter | Array | str | os.PathLike[str] | None
Start = Guess | Sequence[Guess]


class How(TypedDict, total=False):
    """How something is solved: options of :func:`solve` that other functions hand on to it."""

    passes: int | None
    options: SqpOptions | None
    max_iterations: int | None
    time_limit: float | None
    tolerance: float | None
    device: str
    threads: int
    progress: bool | str
    callback: Callable[[Iterate], bool | None] | None


@dataclass(frozen=True, kw_only=True)
class Usual:
    """The same where nothing is said."""

    passes: int | None = None
    options: SqpOptions | None = None
    max_iterations: int | None = None
    time_limit: float | None = None
    tolerance: float | None = None
    device: str = "auto"
    threads: int = 1
    progress: bool | str = False
    callback: Callable[[Iterate], bool | None] | None = None


@overload
def solve(
    problem: Described,
    *,
    start: Guess = None,
    seeds: int = 1,
    seed: int = 0,
    goal: str | None = None,
    **how: Unpack[How],
) -> Solution: ...
@overload
def solve(
    problem: Sequence[Described],
    *,
    start: Start = None,
    seeds: int = 1,
    seed: int = 0,
    goal: str | None = None,
    **how: Unpack[How],
) -> list[Solution]: ...
@asked
@takes(Usual)
def solve(
    problem: Described | Sequence[Described],
    *,
    start: Start = None,
    seeds: int = 1,
    seed: int = 0,
    goal: str | None = None,
    **how: Unpack[How],
) -> Solution | list[Solution]:
    """Find the motion.

    Parameters
    ----------
    problem: one problem, or several of one structure (same robot, terms, basis, steps) that are
        solved as one batch. In place of a problem also what :func:`octo.phases` makes.
    start: a Solution (or the path of its file or folder), or nodes x_0 … x_N (N+1, nx), to start
        from instead of the static pose with noise, or an octo.learn.Transition, which is unrolled
        from where the problem begins; of several problems one for all, or a list of one for each.
        With another number of steps than the problem's a motion is resampled: the whole of it over
        the whole of the problem.
    passes: how many passes of growing contact stiffness; four by default, one where the caller set
        the stiffness.
    seeds: starts, solved as one batch; ``seed`` is the first one's number. The converged one of
        least E is returned. Of a cycle with a range of periods each period has its own starts, all
        in one batch; of the best of each period the one is returned whose joints do least work on
        the same way (``Solution.power``).
    options: how; ``max_iterations`` (of a pass), ``time_limit`` (s, of all passes) and
        ``tolerance`` (‖C‖∞ over the weight) may also be given on their own.
    goal: "optimal"; "feasible" ends as :meth:`octo.SqpOptions.feasible` says, once all constraints
        hold and E has stopped falling fast.
    device: "cpu", "cuda", or "auto": the GPU where there is one, else the CPU. The solution's
        ``device`` says which it was, the log of the package ``logging`` (named "octo", level INFO)
        why.
    threads: of the CPU's native code.
    progress: print a line now and then, behind this text where it is one. callback: called with an
        :class:`~octo.solver.sqp.Iterate` after every iteration; returning True stops, with the best
        iterate so far.

    Returns
    -------
    A Solution for one problem, a list of them for several. Ctrl-C returns the best iterate so far.

    Raises
    ------
    OctoError: the problem, an option or the device is refused; nothing was computed.
    """
    return _best(problem, start, seeds=seeds, seed=seed, goal=goal, **how)


@dataclass(frozen=True, kw_only=True)
class _Request(Usual):
    """What one call asks for, beside its problems and their starts."""

    seeds: int = 1
    seed: int = 0
    goal: str | None = None

    def settings(self, problems: Sequence[Described]) -> SqpOptions:
        """The solver's options, where everything that was asked for can be done."""
        chosen = settings_of(
            self.options, self.max_iterations, self.time_limit, self.tolerance, self.goal
        )
        whole("seeds", self.seeds, most=MOST_STARTS)
        whole("threads", self.threads, most=MOST_THREADS)
        whole("seed", self.seed, 0, LARGEST_SEED)
        check_progress(self.progress, self.callback)
        if chosen.step != "line_search" and any(isinstance(one, Phases) for one in problems):
            raise ProblemError(
                f"options.step is {chosen.step!r}, must be 'line_search' to solve phases"
            )
        steps, n = max(problem.steps for problem in problems), problems[0].dynamics.nx
        starts, basis = len(problems) * self.seeds, problems[0].basis_object
        blocks = max(BLOCKS * float(steps), BLOCKS * float(basis.units(steps)) * basis.parts**2)
        room(f"{steps} steps of {starts} starts", blocks * n**2 * starts)
        return chosen

    def monitor(self) -> Monitor:
        """Who is told of each iteration."""
        if not self.progress:
            return Monitor(self.callback)
        doing = self.progress if isinstance(self.progress, str) else ""
        return Monitor(self.callback, Progress(doing))


def _best(
    given: Described | Sequence[Described], start: Start, **options: Any
) -> Solution | list[Solution]:
    """The best solution of each problem, of the best period where a cycle has a range."""
    problems = [given] if isinstance(given, Described) else _problems(given)
    periods = [_of_each_period(one) for one in problems]
    pairs = zip(starts_of(start, problems, 1), periods, strict=True)
    starts = [own for own, group in pairs for _ in group]
    members, best = _solve([one for group in periods for one in group], starts, _Request(**options))
    left = iter(best)
    chosen = []
    for described, group in zip(problems, periods, strict=True):
        rivals = [members[k] for k in islice(left, len(group))]
        chosen.append(min(rivals, key=partial(rank_of_period, described)))
    if not isinstance(given, Described):
        return chosen
    say_kept(chosen[0])
    return replace(chosen[0], starts=tuple(m.report() for m in members))


def _problems(given: Any) -> list[Described]:
    """A batch, or a sentence that says what is missing of one."""
    if isinstance(given, (Character, Dynamics)):
        raise ProblemError(
            f"octo.solve was given {said(given)}, must be an octo.Problem: what the robot is to do "
            "is missing. Say it with octo.Problem(robot, steps=160, dt=0.025, "
            "costs=[octo.Effort()]), or call octo.walk(robot)"
        )
    if not isinstance(given, (list, tuple)) or not all(isinstance(one, Described) for one in given):
        kinds = "an octo.Problem or a list of them"
        raise ProblemError(f"octo.solve was given {said(given)}, must be {kinds}")
    if not given:
        raise ValueRangeError("the list of problems is empty")
    return list(given)


def _of_each_period(problem: Described) -> list[Described]:
    """The problem itself, or one for each period of its cycle's range."""
    if isinstance(problem, Phases):
        return [problem]
    cycle = problem.cycle
    if cycle is None or not isinstance(cycle.period, tuple):
        return [problem]
    return [problem.replace(cycle=replace(cycle, period=period)) for period in cycle.periods]


def solve_all(
    problem: Described | Sequence[Described], *, start: Start = None, **options: Any
) -> list[Solution]:
    """As :func:`solve`, but the solutions of all starts of all problems, not the best of each."""
    problems = [problem] if isinstance(problem, Described) else list(problem)
    return _solve(problems, start, _Request(**options))[0]


def _solve(
    problems: list[Described], start: Start, request: _Request
) -> tuple[list[Solution], list[int]]:
    """All members' solutions, and the index of the best one of each problem."""
    options, seeds = request.settings(problems), request.seeds
    backend = backend_of(request.device)
    check_all_alike(problems)  # before the seeds, so that a message counts what the caller gave
    own = _schedules(problems, request.passes)
    starts = starts_of(start, problems, seeds)
    pairs = zip([problem for problem in problems for _ in range(seeds)], starts, strict=True)
    batch = [
        as_long_as(problem, given.intervals if isinstance(given, Solution) else None)
        for problem, given in pairs
    ]
    numbers = [request.seed + k for _ in problems for k in range(seeds)]
    schedules = [plan for plan in own for _ in range(seeds)]
    began = time.perf_counter()
    current = stiffened(batch, [plan[0] for plan in schedules])
    compiled = compiled_of(current, int(request.threads))
    default = options.step == "line_search"
    name = "octo.solve" if default else f"step={options.step!r}"
    compiled.check_squares(name, default, default, arrays=True)
    nodes = np.stack([first_nodes(*one) for one in zip(current, numbers, starts, strict=True)])
    backend = _prepared(backend, compiled, options, request.device)
    lam, how = first_multipliers(starts, compiled), (options, int(request.threads), backend)
    spent = time.perf_counter() - began
    continuation = Continuation(compiled, nodes, lam, *how, request.monitor(), spent)
    continuation.slacks = first_slacks(starts, compiled)
    try:
        members = continuation.run(schedules, numbers)
    finally:
        backend.release()
    groups = [range(k * seeds, (k + 1) * seeds) for k in range(len(problems))]
    return members, [min(group, key=lambda k: rank(members[k])) for group in groups]


def _schedules(problems: Sequence[Described], passes: int | None) -> list[Schedule]:
    """The passes of each problem, which grow in all of them or in none."""
    own = [schedule_of(problem, passes) for problem in problems]
    fixed = [[stage is None for stage in plan] for plan in own]
    if any(one != fixed[0] for one in fixed[1:]):
        told = "one has passes in which it grows, one is fixed"
        raise ProblemError(
            f"the contact laws of the problems differ in stiffness or friction: {told}, solve "
            "them one by one"
        )
    return own


def settings_of(
    options: Any, max_iterations: Any, time_limit: Any, tolerance: Any, goal: Any = None
) -> SqpOptions:
    """The options, with those in place that were given on their own."""
    chosen = SqpOptions()
    if options is not None:
        chosen = instance("options", options, SqpOptions, "an octo.SqpOptions")
    if goal is not None:
        one_of("goal", goal, CHOICES["goal"])
        chosen = replace(chosen, **(FEASIBLE if goal == "feasible" else {"goal": goal}))
    names = ("max_iterations", "time_limit", "tolerance")
    given = dict(zip(names, (max_iterations, time_limit, tolerance), strict=True))
    return replace(chosen, **{name: value for name, value in given.items() if value is not None})


def _prepared(backend: Backend, compiled: Compiled, options: SqpOptions, device: str) -> Backend:
    """The backend, compiled; with "auto", what the GPU cannot take goes to the CPU."""
    try:
        backend.prepare(compiled, options)
    except DeviceError as error:
        if device != "auto" or backend is CPU:
            raise
        say_cpu(str(error))
        backend = CPU
        CPU.prepare(compiled, options)
    return backend


def evaluated(problem: Problem, nodes: Array, status: Status) -> Solution:
    """A given trajectory x_0 … x_N (N+1, nx) as a Solution, without a solve."""
    compiled = CompiledProblem([problem])
    at = compiled.evaluate(compiled.unknowns(first_nodes(problem, 0, nodes)[None]))
    found, multipliers = measured(compiled, at, 0), np.zeros((compiled.K, compiled.ma))
    passes = (record(1, Trajectory(**found), status),)
    return recorded(**found, multipliers=multipliers, status=status, passes=passes)


__all__ = ["Solution", "Status", "solve"]
