"""What a worker does: one batch, solved in whatever process it was sent to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array
from octo.errors import OctoError
from octo.executors import Failed, stopped
from octo.gains import gains_of
from octo.problem.problem import Problem
from octo.result.solution import Solution
from octo.solve import Guess, solve
from octo.solver.sqp import Iterate


@dataclass(frozen=True, eq=False)
class Task:
    """One batch.

    Attributes
    ----------
    number: of the batch. first: of its first problem among all of them.
    starts: one for each problem. how: options of octo.solve. gains: whether they are asked for.
    """

    number: int
    first: int
    problems: tuple[Problem, ...]
    starts: tuple[Guess, ...]
    how: dict[str, Any]
    gains: bool

    @property
    def indices(self) -> NDArray[np.intp]:
        """Of its problems, among all of them."""
        return np.arange(self.first, self.first + len(self.problems))


@dataclass(frozen=True, eq=False)
class Done:
    """What came of it."""

    task: int
    motions: tuple[Solution, ...]
    gains: Array | None


def _stopped(at: Iterate) -> bool:
    del at
    return stopped()


def work(task: Task) -> Done | Failed | None:
    """Solve a batch; None where it was told to stop."""
    try:
        found = solve(list(task.problems), start=list(task.starts), callback=_stopped, **task.how)
        if stopped():
            return None
        own = tuple(_with_its_share(motion, len(found)) for motion in found)
        return Done(task.number, own, _gains(task, own) if task.gains else None)
    except Exception as error:  # a user's term may raise anything
        return Failed(_blamed(task, error))


def _with_its_share(motion: Solution, count: int) -> Solution:
    """A motion of a batch with its part of the time that all took."""
    names = ("seconds", "processor_seconds", "setup_seconds")
    times: dict[str, Any] = {name: getattr(motion, name) / count for name in names}
    return replace(motion, starts=(), **times)


def _gains(task: Task, motions: Sequence[Solution]) -> Array:
    """Of the motions that are finite; NaN of the others."""
    good = [k for k, motion in enumerate(motions) if np.isfinite(motion.x).all()]
    N, nu = motions[0].u.shape
    made = np.full((len(motions), N, nu, 2 * motions[0].x.shape[1]), np.nan)
    if good:
        made[good] = gains_of([task.problems[k] for k in good], [motions[k] for k in good])
    return made


def _blamed(task: Task, error: Exception) -> str:
    """The error, behind the problem that has it also alone, which single iterations find."""
    words = str(error) if isinstance(error, OctoError) else f"{type(error).__name__}: {error}"
    last = task.first + len(task.problems) - 1
    if last == task.first:
        return f"problem {task.first}: {words}"
    how = {**task.how, "max_iterations": 1, "seeds": 1}
    for k, (problem, start) in enumerate(zip(task.problems, task.starts, strict=True)):
        try:
            solve(problem, start=start, **how)
        except Exception as alone:
            own = str(alone) if isinstance(alone, OctoError) else f"{type(alone).__name__}: {alone}"
            return f"problem {task.first + k}: {own}"
    return f"problems {task.first} to {last}, solved as one batch: {words}"
