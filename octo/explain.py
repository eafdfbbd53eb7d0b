"""Why a solve failed: what it says itself, and which of its constraints contradict each other.

A deletion filter over constraints (Chinneck and Dravnieks 1991), each question an elastic phase on
the code that the problem has already: are there motions that obey the laws of physics and keep
these constraints? What an elastic phase ends with breaks only some of them; those alone are as
impossible, so that the others are left out at once. Then one after the other is left out, and stays
out where the rest still cannot hold.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace

import numpy as np

from octo.checks import Array, asked
from octo.continuation import leaps
from octo.continuation.member import CONTACT
from octo.errors import ProblemError, ShapeError, said
from octo.problem.block_nlp import BlockNLP
from octo.problem.evaluation import Evaluation
from octo.problem.phased import compiled_of, parts_of
from octo.problem.phases import Described, Phases, times_of
from octo.problem.problem import Problem
from octo.result.explanation import LIMITED, Conflict, Explanation
from octo.result.phased import all_bounds_kept, row_labels
from octo.result.solution import Solution, solution_of
from octo.solver import sqp
from octo.solver.backend import CPU
from octo.solver.clocks import as_long_as
from octo.solver.elastic import Elastic
from octo.solver.free_time import FreeTime, timed
from octo.solver.options import SqpOptions
from octo.solver.status import Status
from octo.starts import first_nodes

HOLDS = 1e-4  # of a row: what it may be beyond its bounds
WIDTHS = (
    1.0,
    0.1,
    0.01,
    1e-3,
    1e-4,
)  # of a row, over which its price rises, one solve after the other
PART = 1e-3  # of the most that a row is beyond: constraints with less are left out first
PRICE = 1e-6  # of E beside the rows: it picks one of the motions that hold
OPTIONS = SqpOptions(max_iterations=300)
FAR = 100.0  # times the longest duration: how long it may become where that is left out
Kept = frozenset[str]  # labels of constraints, and END
END = ""


@asked
def explain(problem: Described, solution: Solution | str | os.PathLike[str]) -> Explanation:
    """Say why a solve failed, and look for constraints that cannot hold together.

    What :meth:`octo.Solution.explain` says costs nothing. The search for a contradiction is a
    feasibility solve, or two from two starts, for each constraint and for the fixed last state; it
    runs on the CPU and compiles nothing that the problem has not compiled already. What it says is
    as local as every solve: it names constraints that cannot hold together near the motions that it
    tried.

    Parameters
    ----------
    problem: that was solved, or phases.
    solution: what came of it, or the path of its file or folder; the search starts there.

    Returns
    -------
    An Explanation, which ``print`` shows. ``conflict.names`` are the constraints of the smallest
    set that was found, none where all can hold together; then ``conflict.motion`` (N+1, nx) is a
    ``start`` that keeps them.

    Raises
    ------
    OctoError: one of the two is none, or the solution is not of this problem.
    """
    if not isinstance(problem, Described):
        raise ProblemError(f"octo.explain was given {said(problem)}, must be an octo.Problem")
    found = solution_of(solution)
    if found.x.shape != (problem.steps + 2, problem.dynamics.nx):
        expected = f"({problem.steps + 2}, {problem.dynamics.nx}), as the problem has"
        raise ShapeError("solution.x", found.x.shape, expected)
    if any(LIMITED in own for own in found.passes):
        problem = leaps.limited(problem)
    own = found.explain()
    hints = tuple(hint for hint in own.hints if "octo.explain" not in hint)
    return replace(own, hints=hints, conflict=_Search(problem, found).conflict())


@dataclass(frozen=True, eq=False)
class _Trial:
    """What an elastic phase ended with."""

    kept: Kept  # what was asked for
    at: Evaluation
    times: Array  # (N+1,) s, of its x_0 … x_N
    holds: bool  # all of it
    certain: bool  # a least of what is broken, where it does not hold
    broken: Kept  # of kept, what is beyond its bounds, and END: nobody knows whether it pulls


class _Search:
    """Elastic phases over subsets of the constraints of one problem."""

    def __init__(self, problem: Described, solution: Solution):
        problem = _as_solved(problem, solution)
        last = problem if isinstance(problem, Problem) else problem.problems[-1]
        self.problem, self.fixed = problem, last.end is not None
        self.compiled = self.free = compiled_of([problem])
        if self.fixed:
            self.free = compiled_of([_without_end(problem)], like=self.compiled)
        for one in {id(one): one for one in (self.compiled, self.free)}.values():
            for part in parts_of(one):
                part.q[:, :, : len(part.problems[0].costs)] *= PRICE
        CPU.prepare(self.compiled, OPTIONS)
        self.labels = row_labels(self.compiled)  # (N, rows)
        self.names = [name for name in dict.fromkeys(self.labels.T.ravel()) if name]
        self.starts = [first_nodes(problem, 0, None)]
        if np.isfinite(solution.x).all():
            self.starts.insert(0, first_nodes(problem, 0, solution))
        self.solves = 0

    def conflict(self) -> Conflict:
        """The smallest set that was found."""
        trial = self._trial(frozenset([*self.names, *([END] if self.fixed else [])]))
        if trial.holds:
            motion = trial.at.nodes[0, 1:].copy()
            return Conflict(seconds=float(trial.times[-1]), motion=motion, solves=self.solves)
        self.starts[0] = trial.at.nodes[0]
        idle = trial.kept - trial.broken
        # as they are written, then the end, then those that the first search left within bounds
        names = sorted([*self.names, END], key=lambda name: name in idle)
        for left_out in [*([idle] if idle else []), *(frozenset([name]) for name in names)]:
            if left_out <= trial.kept:
                less = self._trial(trial.kept - left_out)
                trial = trial if less.holds else less
        return self._found(trial)

    def _found(self, trial: _Trial) -> Conflict:
        compiled = self.compiled if END in trial.kept else self.free
        rows = [row for row in all_bounds_kept(compiled, trial.at, 0) if row.name in trial.kept]
        if self.problem.duration is not None:  # the batch has those of the first guess
            rows = [replace(row, time=float(trial.times[row.step + 1])) for row in rows]
        return Conflict(
            rows=tuple(rows),
            end=END in trial.kept,
            seconds=float(trial.times[-1]),
            certain=trial.certain,
            solves=self.solves,
        )

    def _trial(self, kept: Kept) -> _Trial:
        """From one start after the other, until one ends where all of it holds."""
        best: _Trial | None = None
        for nodes in self.starts:
            trial = self._phase(kept, nodes)
            if best is None or trial.holds or (trial.certain and not best.certain):
                best = trial
            if trial.holds:
                break
        assert best is not None
        return best

    def _phase(self, kept: Kept, nodes: Array) -> _Trial:
        """One elastic phase, which stops where everything holds."""
        compiled = self.compiled if END in kept else self.free
        own, (low, high) = np.isin(self.labels, sorted(kept)), compiled.row_bounds
        lower, upper = np.where(own, low, -np.inf), np.where(own, high, np.inf)

        def beyond(at: Evaluation) -> Array:
            """(N, rows) how far each is beyond its bounds."""
            off = np.abs(at.rows - np.clip(at.rows, lower, upper))[0]
            return np.where(np.isnan(off), np.inf, off)

        def holds(iterate: sqp.Iterate) -> bool:
            most = beyond(iterate.at).max(initial=0.0)
            if most <= HOLDS and iterate.at.largest[0] <= OPTIONS.tolerance:
                held.append(iterate.at)
            return bool(held)

        self.solves += 1
        solved = timed(compiled, FAR)
        unknowns, lam, held = solved.unknowns(nodes[None]), None, list[Evaluation]()
        monitor = sqp.Monitor(holds)
        for width in WIDTHS:
            elastic = Elastic(lower, upper, width)
            result = sqp.run(solved, unknowns, lam, OPTIONS, monitor, bounds=elastic)
            unknowns, lam, status = result.at.unknowns, result.lam, result.status[0]
            if held:
                times = self._times(solved, held[0])
                return _Trial(kept, held[0], times, True, True, frozenset())
            if status is Status.INTERRUPTED:
                raise KeyboardInterrupt
        far = beyond(result.at)
        least = PART * far.max(initial=0.0)
        broken = frozenset(str(name) for name in self.labels[far > least])
        times, broken = self._times(solved, result.at), kept & {*broken, END}
        return _Trial(kept, result.at, times, False, status.converged, broken)

    def _times(self, solved: BlockNLP, at: Evaluation) -> Array:
        """(N+1,) s, of x_0 … x_N of an iterate."""
        if not isinstance(solved, FreeTime):
            return times_of(self.problem)
        steps = [part.steps for part in parts_of(self.compiled)]
        return np.append(0.0, np.cumsum(np.repeat(solved.dt(at.unknowns)[:, 0], steps)))


def _as_solved(described: Described, solution: Solution) -> Described:
    """With the contact stiffness of the pass that the solution is of, and as long as it."""
    described = as_long_as(described, solution.intervals)
    if isinstance(described, Problem):
        problem = _of_one_period(described, solution)
        stiffness = _stiffness(problem, solution)
        return problem.replace(parameters=stiffness) if stiffness else problem
    if len(solution.phases) != len(described.problems):
        many = f"{len(solution.phases)} phases, the problem {len(described.problems)}"
        raise ProblemError(f"the solution has {many}: it is not of this problem")
    pairs = zip(described.problems, solution.phases, strict=True)
    return described.with_parameters([_stiffness(*pair) for pair in pairs])


def _stiffness(problem: Problem, solution: Solution) -> dict[str, float]:
    own = solution.parameters  # of its last pass
    return {k: own[k] for k in CONTACT if k in own and k in problem.values}


def _without_end(described: Described) -> Described:
    """The same with a free last state."""
    if isinstance(described, Phases):
        return described.without_end()
    return described.replace(x_end=None, v_end=None, displacement=None)


def _of_one_period(problem: Problem, solution: Solution) -> Problem:
    """Of a cycle with a range of periods, the problem of the one that was returned."""
    cycle = problem.cycle
    if cycle is None or not isinstance(cycle.period, tuple):
        return problem
    found = solution.dt * solution.steps * cycle.rounds
    period = min(cycle.periods, key=lambda one: abs(one - found))
    return problem.replace(cycle=replace(cycle, period=period))
