"""What a cost and a constraint have in common: a residual over one time step, with numbers of its
own by name."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple, get_args

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo.checks import instance, number, one_of, owned, positive, shares, vectors
from octo.errors import ProblemError
from octo.problem.at import Steps, check_at

if TYPE_CHECKING:
    from octo.problem.symbols import Setting, StepSymbols

Array = NDArray[np.float64]
Curvature = Literal["gauss_newton", "exact"]


class Row(NamedTuple):
    """One row of a residual, in words.

    Parameters
    ----------
    name: what it is of: a joint, a body, a contact.
    unit: of what is shown.
    size: how many units a value of 1 is.
    """

    name: str
    unit: str = ""
    size: float = 1.0

    def shown(self, value: float) -> float:
        """A value of the row in ``unit``."""
        return value * self.size

    @property
    def falling(self) -> bool:
        """Whether what is shown is less where the row is more."""
        return False

    def allowed(self, lower: float, upper: float) -> str:
        """What lies between two bounds of the row, in words."""
        low, high = (None if math.isinf(b) else self.shown(b) for b in (lower, upper))
        if self.falling:
            low, high = high, low
        if low is None or high is None:
            return f"at most {high:g}" if low is None else f"at least {low:g}"
        return f"{low:g}" if low == high else f"between {low:g} and {high:g}"


@dataclass(frozen=True, eq=False, kw_only=True)
class Term:
    """A residual over one time step: the squares of a :class:`~octo.problem.costs.Cost` are
    minimised, a :class:`~octo.problem.constraints.Constraint` stays between its bounds.

    Parameters
    ----------
    at: when it acts: "all" steps, the "last" one, a list of steps from 0 (from the end where they
        are negative), a mask of one truth for each, or times as ``octo.At(seconds)``.
    name: what reports and ``Controller.update`` call it; by default the class's name.
    curvature: what the solver's model has of it: Gauss and Newton's, which leaves out how its
        residual bends, or the exact second derivative.
    """

    # "bounded": its rows are no squares of E; a solver gives each a weight and a shift of its own
    # at every iterate (CompiledProblem.set_row_weights)
    kind: ClassVar[Literal["square", "bounded"]] = "square"

    at: Steps = "all"
    name: str = ""
    curvature: Curvature = "gauss_newton"

    def __post_init__(self) -> None:
        for each in fields(self):  # the caller's arrays, lists and dicts stay the caller's
            object.__setattr__(self, each.name, owned(getattr(self, each.name)))
        kind = type(self).__name__
        for name in ("name", *(("body",) if getattr(self, "body", None) is not None else ())):
            instance(f"{kind}.{name}", getattr(self, name), str, "a text")
        check_at(f"{self.label}.at", self.at)
        one_of(f"{self.label}.kind", self.kind, ("square", "bounded"))
        one_of(f"{self.label}.curvature", self.curvature, get_args(Curvature))

    @property
    def label(self) -> str:
        """The name the term goes by in reports and in ``Controller.update``."""
        return self.name or type(self).__name__

    def references(self, setting: Setting) -> Mapping[str, Any]:
        """Run-time numbers by name, each (size,) or (N, size)."""
        del setting
        return {}

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        """The residual of one time step, from its symbols and this term's references."""
        raise ProblemError(f"{self.label}.residual is missing: write residual(self, step, p)")

    def rows(self, setting: Setting) -> Sequence[Row]:
        """The rows of the residual in words; none where their numbers are all there is to say."""
        del setting
        return ()

    def shaped(self, residual: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
        """(rows,) what a solver is given of the residual.

        Parameters
        ----------
        residual: of this term. p: its references by name.
        """
        del p
        return ca.densify(ca.vec(ca.SX(residual)))

    def check_square(self, why: str) -> None:
        """Refuse rows that a solver weights itself, where there are none because of ``why``.

        Raises
        ------
        ProblemError: the term's kind is not "square".
        """
        if self.kind != "square":
            raise ProblemError(f"{self.label} {why}: its kind is {self.kind!r}, must be 'square'")

    def _vector(self, name: str, size: int) -> Array:
        """A field as finite numbers, (size,) or (N, size)."""
        return vectors(f"{self.label}.{name}", getattr(self, name), size)

    def _roots(self, name: str, size: int) -> Array:
        """The square roots of a field of weights, (size,) or (N, size)."""
        return np.sqrt(shares(f"{self.label}.{name}", getattr(self, name), size))

    def _number(self, name: str) -> Array:
        """(1,) of a field that is a number."""
        return np.array([number(f"{self.label}.{name}", getattr(self, name))])

    def _inverse(self, name: str, unit: str = "") -> Array:
        """(1,) one over a field that is a positive number in ``unit``."""
        return np.array([1.0 / positive(f"{self.label}.{name}", getattr(self, name), unit)])
