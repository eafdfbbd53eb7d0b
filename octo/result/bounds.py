"""How well a motion keeps to its constraints: of each the row that is nearest to breaking it, or
breaks it most."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from octo.problem.bounds import SAME, bounded_rows
from octo.problem.compiled import CompiledProblem, Evaluation
from octo.problem.duration import WHOLE


@dataclass(frozen=True)
class Bound:
    """The worst row of a constraint over the motion.

    Attributes
    ----------
    name: of the constraint. row: a joint, a body, a contact. unit: of ``value`` and ``bound``.
    step, time: of it; s, at the end of the step.
    value, bound: what it is, and what it must be ``side`` ("at least", "at most", "exactly").
    excess: how far it is beyond, relative to the constraint's size (a torque's limit, mg, a radian,
        a metre): what a solver's tolerance is of. Negative where there is room left.
    """

    name: str
    row: str
    unit: str
    step: int
    time: float
    value: float
    bound: float
    side: str
    excess: float

    @property
    def violation(self) -> float:
        """The same, 0 where it holds."""
        return max(self.excess, 0.0)

    @property
    def held(self) -> bool:
        """Whether it holds, to a millionth of its size."""
        return self.excess <= SAME

    def __str__(self) -> str:
        off = f"broken by {abs(self.value - self.bound):.2g} {self.unit}".rstrip()
        return f"{self.name} {'held' if self.held else off}: {self.short}"

    @property
    def short(self) -> str:
        """The row in words."""
        value = f"{self.value:.4g} {self.unit}".rstrip()
        allowed = f"{self.side} {self.bound:.4g}"
        return f"{self.row} is {value}{self.when}, must be {allowed}"

    @property
    def when(self) -> str:
        """Its time in words, behind those of the row; nothing of what is of the whole motion."""
        return "" if self.row == WHOLE else f" at {self.time:.4g} s"

    def plain(self) -> dict[str, Any]:
        """For files."""
        return asdict(self)

    def report(self) -> dict[str, Any]:
        """For report.json."""
        return {**asdict(self), "violation": self.violation, "held": self.held}


def bounds_kept(problem: CompiledProblem, at: Evaluation, member: int) -> tuple[Bound, ...]:
    """Of each constraint of one member; none of one that a fixed state settles everywhere."""
    described = problem.problems[member]
    rows, values = bounded_rows(described, problem.functions), at.rows[member]
    lower, upper = problem.lower[member], problem.upper[member]
    excess = np.maximum(lower - values, values - upper)
    excess[np.isnan(excess)] = np.inf  # of a motion that is not finite
    excess[np.isinf(lower) & np.isinf(upper)] = -np.inf
    made = []
    for k in dict.fromkeys(problem.functions.bounded):
        own = np.flatnonzero(np.array(problem.functions.bounded) == k)
        step, place = np.unravel_index(int(np.argmax(excess[:, own])), (len(excess), len(own)))
        row = own[place]
        if excess[step, row] == -np.inf:
            continue
        low, high, value = (float(each[step, row]) for each in (lower, upper, values))
        words, above = rows[row].words, value - high >= low - value
        side = "at most" if above != words.falling else "at least"
        made.append(
            Bound(
                described.terms[k].label,
                words.name,
                words.unit,
                int(step),
                float(described.dt * (step + 1)),
                words.shown(value),
                words.shown(high if above else low),
                "exactly" if low == high else side,
                float(excess[step, row]),
            )
        )
    return tuple(made)
