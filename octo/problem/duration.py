"""How long a motion takes, where that is an unknown: as a price, and what it must stay between."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from octo.checks import LONGEST_STEP, SHORTEST_STEP, positive
from octo.errors import ProblemError, ValueRangeError, said
from octo.problem.at import At
from octo.problem.constraints import Constraint
from octo.problem.costs import Cost
from octo.problem.terms import Row

if TYPE_CHECKING:
    from octo.problem.symbols import Setting, StepSymbols

# times the longest, or the shortest over it, that a duration may be on the way: a fifth more lets a
# step overshoot, and no time is spent on motions that are far too short or too long
BEYOND = 1.2
WHOLE = "the duration"  # the name of its row, which is of the whole motion and of no moment
NARROW = 1e-6  # of the shortest: what a tolerance would not tell from a fixed duration


@dataclass(frozen=True, eq=False)
class Duration(Cost):
    """The time that the motion takes: ``weight``, by default 1/s, times N·dt. With nothing beside
    it E is the duration in seconds; of a cycle that of its steps, half a stride where mirrored."""

    def references(self, setting: Setting) -> Mapping[str, Any]:
        return {"steps": np.array([float(setting.steps)])}

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return ca.sqrt(step.dt * p["steps"])

    def hard(self) -> Constraint:
        """Refuse to be a constraint: a motion that takes no time is none.

        Raises
        ------
        ProblemError: always.
        """
        raise ProblemError(
            f"{self.label} has no hard form: what a motion may take is "
            "Problem(duration=(shortest, longest))"
        )


@dataclass(frozen=True, eq=False)
class DurationRange(Constraint):
    """The duration of a motion within a range: what ``Problem(duration=…)`` adds.

    Parameters
    ----------
    lower, upper: s.
    rounds: that a motion makes through the steps: those of its cycle, if it is one.
    """

    lower: float = 0.0
    upper: float = np.inf
    rounds: int = 1

    def references(self, setting: Setting) -> Mapping[str, Any]:
        return {"steps": np.array([self.rounds * setting.steps / self.upper])}

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return step.dt * p["steps"]

    def bounds(self, setting: Setting) -> tuple[Any, Any]:
        return self.lower / self.upper, 1.0

    def rows(self, setting: Setting) -> Sequence[Row]:
        return [Row(WHOLE, "s", self.upper)]


def range_of(given: Any, steps: int, of_robot: bool) -> tuple[float, float]:
    """(shortest, longest) s, of a motion in ``steps`` steps.

    Raises
    ------
    OctoError: ``given`` is no such pair, or it is of a robot and its steps would be too short or
        too long on the way.
    """
    if not isinstance(given, (tuple, list)) or len(given) != 2:
        raise ValueRangeError(
            f"duration is {said(given)}, must be (shortest, longest) in s, or None where it is "
            "steps·dt"
        )
    low, high = (positive("duration", value, "s") for value in given)
    if not low * (1.0 + NARROW) < high:
        raise ValueRangeError(
            f"duration is {said(given)}: the shortest must be less than the longest, by a "
            "millionth or more"
        )
    least, most = BEYOND * SHORTEST_STEP * steps, LONGEST_STEP * steps / BEYOND
    if of_robot and not (least <= low and high <= most):
        raise ValueRangeError(
            f"duration is {said(given)} s in {steps} steps, must be between {least:.4g} and "
            f"{most:.4g} s"
        )
    return low, high


def within(
    constraints: Sequence[Constraint],
    costs: Sequence[Cost],
    duration: tuple[float, float] | None,
    rounds: int,
) -> tuple[Constraint, ...]:
    """The constraints with that of a free duration, or without one where it is fixed; ``rounds`` as
    of a :class:`DurationRange`.

    Raises
    ------
    ProblemError: names a term that acts at times: nobody knows which steps these will be.
    """
    kept = [term for term in constraints if not isinstance(term, DurationRange)]
    if duration is None:
        return tuple(kept)
    for term in (*costs, *kept):
        if isinstance(term.at, At):
            raise ProblemError(
                f"{term.label}.at is in seconds and duration is free: say steps, for they keep "
                "their place"
            )
    return *kept, DurationRange(*duration, rounds, at="last")
