"""A residual over neighbouring controls that is written in arrays, of all transitions at once: what
CasADi cannot say at its size, above all a network."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from octo.arrays import Array
from octo.errors import ProblemError
from octo.problem.costs import Cost

if TYPE_CHECKING:
    from octo.problem.problem import Problem
    from octo.problem.symbols import Setting


@dataclass(frozen=True, eq=False)
class ArrayCost(Cost):
    """A residual r(c, c_next) of each two neighbouring controls, with its slopes, in NumPy.

    In the nodes basis c_i = (x_i, x_i − x_{i−1}), i = 0 … N; in the Hermite basis c_k = (x_k,
    τ ẋ_k), k = 0 … Z, c_0 included. E has weight/scale times the mean of |r|² over these
    transitions, its model JᵀJ. What the residual is made of is data: other numbers of it compile
    nothing.

    A class whose ``value`` and ``slopes`` also take arrays of a device (CuPy's, through
    ``octo.arrays.array_module``) says ``anywhere = True``: a GPU evaluates it then.
    """

    anywhere: ClassVar[bool] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_square("is written in arrays")
        for name, usual in (("loss", None), ("curvature", "gauss_newton")):
            if getattr(self, name) != usual:
                raise ProblemError(
                    f"{self.label}.{name} is given, must be left out: its residual is written in "
                    "arrays, which nobody differentiates"
                )

    def hard(self) -> None:  # type: ignore[override]
        raise ProblemError(f"{self.label} is over neighbouring controls and has no hard form")

    def check(self, problem: Problem) -> None:
        """Refuse a problem that the term does not fit, by an error that names the field."""
        del problem

    def value(self, c: Array, c_next: Array, setting: Setting) -> Array:
        """The residuals (…, rows).

        Parameters
        ----------
        c, c_next: (…, 2 nx) neighbouring controls, rad and m. setting: of the problem.
        """
        raise ProblemError(f"{self.label}.value is missing: write value(self, c, c_next, setting)")

    def slopes(self, c: Array, c_next: Array, setting: Setting) -> tuple[Array, Array]:
        """The residuals (…, rows) and their slopes (…, rows, 4 nx) with respect to (c, c_next).

        Parameters
        ----------
        c, c_next: (…, 2 nx) neighbouring controls, rad and m. setting: of the problem.
        """
        raise ProblemError(
            f"{self.label}.slopes is missing: write slopes(self, c, c_next, setting)"
        )
