"""Motions of dynamics that the user wrote which leap from one node to the next, though no
constraint was asked for.

Most never leap, and rows with bounds cost iterations: so the limit of the steps is a lazy
constraint. A solve knows nothing of it; where its end breaks it, the solve goes on from there with
the limit among its constraints. From the leap itself rather than from the first start: of eleven
motions that leap, a double pendulum's and a pendulum's, eight take fewer iterations so (1 to 30 %),
and all converge both ways.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from octo.checks import Array
from octo.problem.bounds import SAME
from octo.problem.limits import StepLimit
from octo.problem.phases import Described, Phases
from octo.problem.problem import Problem
from octo.result.trajectory import LEAP
from octo.solver.options import SqpOptions

NAME = "implied StepLimit"


@dataclass(frozen=True)
class Leap:
    """The step of a motion that is furthest beyond its limit, in the user's units and s."""

    coordinate: int
    change: float
    time: float
    limit: float

    def __str__(self) -> str:
        return f"x{self.coordinate} leaps by {self.change:.3g} in the step at {self.time:.4g} s"

    @property
    def why_added(self) -> str:
        """Of the pass that has the limit among its constraints."""
        return (
            f"where nothing limits the steps, {self}: here {NAME}, at most {self.limit:.3g}, is "
            "among the constraints (Problem(step_limit=…) sets it, step_limit=None leaves it out)"
        )


def leap_of(described: Described, nodes: Array) -> Leap | None:
    """Of a motion x_{-1} … x_N (N+2, nx); None where it keeps its limit, or has none."""
    limit = _largest(described)
    change = np.abs(np.diff(nodes[1:], axis=0))  # (N, nx)
    beyond = change / limit
    if not np.isfinite(change).all() or not (beyond > 1.0 + SAME).any():
        return None
    step, k = (int(place) for place in np.unravel_index(int(np.argmax(beyond)), beyond.shape))
    intervals = described.intervals if isinstance(described, Phases) else np.array([described.dt])
    time = float(np.resize(intervals, len(change))[:step].sum())
    return Leap(k, float(change[step, k]), time, float(limit[step, k]))


def cannot(described: Described, options: SqpOptions) -> str:
    """Why the limit cannot be a constraint; nothing where it can."""
    if options.step != "line_search":
        return f"step={options.step!r} knows no constraints"
    last = described if isinstance(described, Problem) else described.problems[-1]
    if last.end is not None:
        way, most = np.abs(last.end - described.start), _largest(described).sum(axis=0)
        if (way > most).any():
            k = int(np.argmax(way / most))
            return f"x{k} is to end {way[k]:.3g} from its start, the steps reach {most[k]:.3g}"
    return ""


def limited(described: Described) -> Described:
    """The same with the limit among its constraints."""
    if isinstance(described, Phases):
        return described.with_numbers([_limited(problem) for problem in described.problems])
    return _limited(described)


def _limited(problem: Problem) -> Problem:
    limit = implied(problem)
    if limit is None:
        return problem
    return problem.replace(constraints=[*problem.constraints, limit])


def implied(problem: Problem) -> StepLimit | None:
    """The limit that a problem has though it is no constraint of it; None where it has none."""
    own, names = problem.step_limit, [term.label for term in problem.constraints]
    said = NAME in names or any(isinstance(term, StepLimit) for term in problem.constraints)
    if own is None or said or problem.character is not None:
        return None
    return StepLimit(LEAP if isinstance(own, str) else own, name=NAME)


def _largest(described: Described) -> Array:
    """(N, nx) the largest change of each step, infinite where there is no limit."""
    problems: Sequence[Problem] = (
        (described,) if isinstance(described, Problem) else described.problems
    )
    parts = []
    for problem in problems:
        limit, shape = implied(problem), (int(problem.steps), problem.dynamics.nx)
        parts.append(np.broadcast_to(np.inf if limit is None else limit.largest, shape))
    return np.concatenate(parts)
