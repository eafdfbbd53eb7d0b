"""What must hold (hard): rows of one time step that stay between bounds.

    lower ≤ residual ≤ upper at the steps of ``at``; an equality where the two are the same

One small class per constraint, as of costs; a constraint has no weight, no scale and no part of E.
Rows are scaled to about one, so that a solver's tolerance means the same for all of them. Bounds
are numbers of a run: changing them recompiles nothing. The ready-made ones are in limits.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import casadi as ca
import numpy as np

from octo.errors import ProblemError
from octo.problem.terms import Curvature, Row, Term

if TYPE_CHECKING:
    from octo.problem.symbols import Setting, StepSymbols


@dataclass(frozen=True, eq=False, kw_only=True)
class Constraint(Term):
    """Rows of one time step that must stay between bounds.

    Parameters
    ----------
    at: when it must hold: "all" steps, the "last" one, a list of steps from 0 (from the end where
        they are negative), a mask of one truth for each, or times as ``octo.At(seconds)``.
    name: what reports and messages call it; by default the class's name.
    curvature: what the solver's model has of it, "exact" by default: a multiplier does not vanish
        at a solution as a residual does.
    """

    kind: ClassVar[Literal["square", "bounded"]] = "bounded"

    curvature: Curvature = "exact"

    def bounds(self, setting: Setting) -> tuple[Any, Any]:
        """Lower and upper bounds of the rows, each a number, (rows,) or (N, rows): infinite where
        there is none, the same where the row is an equality."""
        raise ProblemError(f"{self.label}.bounds is missing: write bounds(self, setting)")

    def placed(self, setting: Setting) -> Constraint:
        """The constraint with names in place of what depends on the start, as "feet" does."""
        del setting
        return self


@dataclass(frozen=True, eq=False)
class Equality(Constraint):
    """The hard form of a term of E: its residual is zero.

    Parameters
    ----------
    term: whose residual it is, without weight, scale and loss.
    weighed_by: of its references the one whose entries weigh a row each; a weight of zero leaves
        the row out, any other counts as 1.
    """

    term: Term
    weighed_by: str = ""

    def references(self, setting: Setting) -> Mapping[str, Any]:
        found = dict(self.term.references(setting))
        if self.weighed_by:
            found[self.weighed_by] = (np.asarray(found[self.weighed_by]) > 0.0).astype(float)
        return found

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return self.term.residual(step, p)

    def bounds(self, setting: Setting) -> tuple[Any, Any]:
        if not self.weighed_by:
            return 0.0, 0.0
        free = np.where(self.references(setting)[self.weighed_by] > 0.0, 0.0, np.inf)
        return 0.0 - free, free

    def rows(self, setting: Setting) -> Sequence[Row]:
        return self.term.rows(setting)


@dataclass(frozen=True, eq=False)
class CustomConstraint(Constraint):
    """Any rows over (x_next, x, x_prev, u) written in CasADi, between bounds.

    Parameters
    ----------
    function: ``function(step, p) -> SX`` (rows,), of a :class:`~octo.problem.symbols.StepSymbols`
        and of ``values`` by name; best scaled so that its rows are about one.
    lower, upper: numbers, (rows,) or (N, rows); the same for an equality.
    values: references by name, each (size,) or (N, size).
    """

    function: Callable[..., ca.SX] | None = None
    lower: Any = -np.inf
    upper: Any = np.inf
    values: Mapping[str, Any] = field(default_factory=dict)

    def references(self, setting: Setting) -> Mapping[str, Any]:
        return self.values

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        if self.function is None:
            raise ProblemError(
                f"{self.label}.function is missing: give function(step, p) -> casadi.SX"
            )
        return self.function(step, p)

    def bounds(self, setting: Setting) -> tuple[Any, Any]:
        return self.lower, self.upper
