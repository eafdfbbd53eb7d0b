"""octo and other solvers on one problem: the same start for all, pass by pass."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from octo import reference
from octo.continuation.schedule import (
    INTERMEDIATE_ITERATIONS,
    Pass,
    intermediate,
    schedule,
    shifted,
    stiffened,
)
from octo.errors import ShapeError
from octo.problem.problem import Array, Problem
from octo.reference.run import one_core
from octo.result.solution import Solution
from octo.solve import solve
from octo.solver.options import SqpOptions
from octo.starts import first_nodes

OTHERS: dict[str, Callable[..., Any]] = {"ipopt": reference.Ipopt, "fatrop": reference.Fatrop}


@dataclass(frozen=True, eq=False)
class Entry:
    """One solver's run of one pass from one start. ``said``: its own word; ``compiled``: no Python
    in an iteration."""

    solver: str
    seed: int
    number: int  # of the pass, counted from 1
    solution: Solution
    said: str
    compiled: bool = True
    settings: dict[str, Any] = field(default_factory=dict)


@dataclass(eq=False)
class Contest:
    """Every solver on every seed and pass, one core each.

    ``guess`` gives x_0 … x_N (N+1, n) of a seed, or None, where a task has a first guess of its
    own.

    The first pass starts where octo's own does with the seed's noise, or from ``start``; each later
    pass, for all solvers, from the same converged solution of the pass before: octo's, or where
    octo did not converge another one's.
    """

    problem: Problem
    others: Sequence[str]
    options: SqpOptions
    passes: int = 1
    threads: int = 1
    device: str = "cpu"
    start: Solution | None = None
    guess: Callable[[int], Array | None] | None = None

    def __post_init__(self) -> None:
        shape = (self.problem.steps + 2, self.problem.dynamics.nx)
        if self.start is not None and self.start.x.shape != shape:
            raise ShapeError("start", self.start.x.shape, shape)
        if self.problem.character is None:  # the others see the constraints that are written
            self.problem = self.problem.replace(step_limit=None)
        self.plan = schedule(self.problem, self.passes)
        self.problems = [self._for_pass(stage) for stage in self.plan]
        self.ready: dict[tuple[str, int], Any] = {}
        self.octo_setup: dict[int, float] = {}

    def _for_pass(self, stage: Pass | None) -> Problem:
        return stiffened([self.problem], [stage])[0]

    def run(self, seeds: Sequence[int]) -> Iterator[Entry]:
        """Entries as they are done."""
        for seed in seeds:
            before: Solution | None = None
            for number, problem in enumerate(self.problems, start=1):
                start = self._start(problem, number, seed, before)
                done = []
                for solver in ("octo", *self.others):
                    done.append(self._entry(solver, number, seed, start, before))
                    yield done[-1]
                before = next((entry.solution for entry in done if entry.solution.converged), None)
                if before is None:
                    break

    def _start(self, problem: Problem, number: int, seed: int, before: Solution | None) -> Array:
        """Nodes x_{-1} … x_N (N+2, nx)."""
        if before is not None:
            return shifted(before.x, self.problems[number - 2], problem)
        own = None if self.guess is None else self.guess(seed)
        return first_nodes(problem, seed, own if self.start is None else self.start)

    def _entry(
        self, solver: str, number: int, seed: int, start: Array, before: Solution | None
    ) -> Entry:
        if solver == "octo":
            with one_core():
                solution = self._octo(number, seed, start, before)
            # of the first seed: what compiles
            setup = self.octo_setup.setdefault(number, solution.setup_seconds)
            own = replace(solution, setup_seconds=setup)
            return Entry("octo", seed, number, own, solution.status.label)
        key = (solver, number)
        if key not in self.ready:
            self.ready[key] = OTHERS[solver](self.problems[number - 1], options=self.options)
        warm = (
            (None, seed) if before is None else (before.multipliers, seed, before.row_multipliers)
        )
        run = self.ready[key].solve(start, *warm)
        return Entry(solver, seed, number, run.solution, run.said, run.compiled, run.settings)

    def _octo(self, number: int, seed: int, start: Array, before: Solution | None) -> Solution:
        """A later pass approaches its stiffness in small factors, as octo's own do; all count."""
        own: dict[str, Any] = {"seed": seed, "threads": self.threads, "device": self.device}
        problem, now = self.problems[number - 1], before
        if now is None:
            return solve(problem, start=start[1:], options=self.options, **own)
        first, last = self.plan[number - 2], self.plan[number - 1]
        assert first is not None and last is not None
        at, way = self.problems[number - 2], []
        for part in [*map(self._for_pass, intermediate(first, last)), problem]:
            iterations = self.options.max_iterations if part is problem else INTERMEDIATE_ITERATIONS
            warm = replace(now, x=shifted(now.x, at, part))
            options = replace(self.options, max_iterations=iterations)
            now, at = solve(part, start=warm, options=options, **own), part
            way.append(now)
        return joined(way)


def both_converged(entries: Sequence[Entry], solver: str) -> list[tuple[Solution, Solution]]:
    """octo's solutions and those of another solver from the same start, where both converged."""
    done = {(e.solver, e.seed): e.solution for e in entries if e.solution.converged}
    seeds = sorted({seed for _, seed in done})
    return [
        (done["octo", k], done[solver, k]) for k in seeds if {("octo", k), (solver, k)} <= {*done}
    ]


def ratios(pairs: Sequence[tuple[Solution, Solution]]) -> dict[str, float]:
    """The medians of one solver over those of another, by what is compared; times are processor
    time."""

    def ratio(value: Callable[[Solution], float]) -> float:
        own, other = (float(np.median([value(pair[k]) for pair in pairs])) for k in (0, 1))
        return own / other if other else float("nan")

    return {
        "iterations": ratio(lambda s: s.iterations),
        "E": ratio(lambda s: s.energy),
        "time an iteration": ratio(lambda s: s.processor_seconds / max(s.iterations, 1)),
        "time": ratio(lambda s: s.processor_seconds),
    }


def joined(parts: Sequence[Solution]) -> Solution:
    """The last of several solves in a row, with the iterations, times and histories of all of
    them."""
    columns: dict[str, list[Array]] = {name: [] for name in parts[-1].history}
    seconds, count = 0.0, 0
    for part in parts:
        for name, values in part.history.items():
            columns[name].append(values + {"seconds": seconds, "iteration": count}.get(name, 0.0))
        seconds, count = seconds + part.seconds, count + part.iterations
    stages = {name: sum(part.stages.get(name, 0.0) for part in parts) for name in parts[-1].stages}
    history = {name: np.concatenate(values) for name, values in columns.items()}
    sums = ("iterations", "factorizations", "seconds", "setup_seconds", "processor_seconds")
    spent: dict[str, Any] = {name: sum(getattr(part, name) for part in parts) for name in sums}
    return replace(parts[-1], history=history, stages=stages, **spent)
