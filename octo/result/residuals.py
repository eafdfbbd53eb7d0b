"""How well a motion obeys the laws of physics: of each row of C the moment at which most is
missing."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from octo.problem.compiled import CompiledProblem, Evaluation
from octo.problem.limits import in_words

SMALL = 1e-6  # of the weight: what may be missing where nothing else is said


@dataclass(frozen=True)
class Residual:
    """A force or a moment that nothing gives, where there is most of it over the motion.

    Attributes
    ----------
    row: the coordinate whose balance it is, one that no motor drives. unit: of ``value``, N or N m.
    step, time: of it; s, at the end of the step. With the Hermite basis C is a mean over steps: the
        one with most of it.
    value: what is missing.
    part: the same relative to the robot's weight, moments over ℓ: what a solver's tolerance is of.
    """

    row: str
    unit: str
    step: int
    time: float
    value: float
    part: float

    @property
    def held(self) -> bool:
        """Whether it is nothing, to a millionth of the weight."""
        return self.part <= SMALL

    def __str__(self) -> str:
        missing = f"{abs(self.value):.3g} {self.unit}".rstrip()
        return f"{self.row} is out of balance by {missing} at {self.time:.4g} s (step {self.step})"

    def plain(self) -> dict[str, Any]:
        """For files."""
        return asdict(self)


def residuals_of(problem: CompiledProblem, at: Evaluation, member: int) -> tuple[Residual, ...]:
    """Of each row of C of one member."""
    described, plan = problem.problems[member], problem.plan
    if plan.m == 0:
        return ()
    C = at.C[member][:, : plan.tested].reshape(-1, plan.m)  # (K·parts, m)
    rows = at.fd[member][:, problem.dynamics.unactuated]  # (N, m) N and N m
    units = ("N m", "N")
    made = []
    for k, coordinate in enumerate(problem.dynamics.unactuated):
        place = int(np.argmax(np.nan_to_num(np.abs(C[:, k]), nan=np.inf)))
        share = np.nan_to_num(np.abs(plan.test_matrix[place] * rows[:, k]), nan=np.inf)
        step, part = int(np.argmax(share)), float(abs(C[place, k]))
        names = problem.dynamics.names
        words = in_words(described.character, int(coordinate), units, names)
        value = float(C[place, k] / problem.row_scale[member, k])
        time = float(described.dt * (step + 1))
        made.append(Residual(*words, step, time, value, part))
    return tuple(made)
