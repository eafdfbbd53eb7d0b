"""The bounds of the rows of a problem's constraints as numbers, and the contradictions in them that
show before anything is solved."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from octo.checks import floats
from octo.errors import ProblemError, ShapeError, ValueRangeError
from octo.problem.at import shares
from octo.problem.codegen import CostFunctions
from octo.problem.constraints import Constraint
from octo.problem.plan import Plan
from octo.problem.problem import Problem
from octo.problem.references import blamed
from octo.problem.terms import Row

Array = NDArray[np.float64]
SAME = 1e-6  # of a row: what a fixed state may miss a bound by


class BoundedRow(NamedTuple):
    """One of the bounded rows of a problem: the row ``place`` of its ``term``, in ``words``."""

    term: int
    place: int
    words: Row


def bounded_rows(problem: Problem, functions: CostFunctions) -> list[BoundedRow]:
    """The bounded rows in words, in their order."""
    made: list[BoundedRow] = []
    for k in dict.fromkeys(functions.bounded):
        count = functions.bounded.count(k)
        words = list(problem.terms[k].rows(problem.setting)) or [
            Row(f"row {i}") for i in range(count)
        ]
        made += [BoundedRow(k, i, row) for i, row in enumerate(words)]
    return made


def bounds_of(problem: Problem, functions: CostFunctions) -> tuple[Array, Array]:
    """Lower and upper bounds (N, rows) of the bounded rows, infinite where there is none.

    Raises
    ------
    OctoError: bounds that are not of the shape of their rows, or that contradict each other.
    """
    steps, bounded = int(problem.steps), np.array(functions.bounded, dtype=int)
    lower = np.full((steps, len(bounded)), -np.inf)
    upper = -lower
    for k, term in enumerate(problem.terms):
        if isinstance(term, Constraint):
            own = np.flatnonzero(bounded == k)
            at = shares(f"{term.label}.at", term.at, steps, problem.setting.dt) > 0.0
            given = _given(problem, term, len(own))
            for bound, values in zip((lower, upper), given, strict=True):
                bound[np.ix_(at, own)] = np.broadcast_to(values, (steps, len(own)))[at]
            _check_order(problem, term, lower[:, own], upper[:, own])
    return lower, upper


def _given(problem: Problem, term: Constraint, rows: int) -> list[Array]:
    """The bounds that a constraint says, each a number, (rows,) or (N, rows)."""
    with blamed(term, "its bounds cannot be formed"):
        lower, upper = term.bounds(problem.setting)
    allowed = ((), (rows,), (int(problem.steps), rows))
    found = []
    for name, value in (("lower", lower), ("upper", upper)):
        array = floats(f"{term.label}.{name}", value)
        if array.shape not in allowed:
            raise ShapeError(f"{term.label}.{name}", array.shape, f"{allowed[1]} or {allowed[2]}")
        if np.isnan(array).any():
            raise ValueRangeError(f"{term.label}.{name} is not a number, must be numbers or ±inf")
        found.append(array)
    return found


def _check_order(problem: Problem, term: Constraint, lower: Array, upper: Array) -> None:
    """Refuse bounds (N, rows) that no number is between, or that are none."""
    wrong = (lower > upper) | ((lower == upper) & np.isinf(lower))
    if wrong.any():
        step, row = (int(k) for k in np.argwhere(wrong)[0])
        words = term.rows(problem.setting) or [Row(f"row {i}") for i in range(lower.shape[1])]
        low, high = (words[row].shown(float(bound[step, row])) for bound in (lower, upper))
        raise ValueRangeError(
            f"{term.label}: {words[row].name} has the lower bound {low:g} and the upper bound "
            f"{high:g} {words[row].unit} at step {step}, must leave a number between them"
        )
    if np.isinf(lower).all() and np.isinf(upper).all():
        raise ProblemError(
            f"{term.label} has no bound: every row is without limit at every step, leave it out or "
            "give it one"
        )


@dataclass(frozen=True, eq=False)
class Fixed:
    """What of a trajectory no unknown moves: the first two nodes, and a fixed last state.

    Attributes
    ----------
    nodes: (N+2, n) values where ``known`` (N+2,) says so. p, q: of FD, and of the terms.
    """

    nodes: Array
    known: NDArray[np.bool_]
    p: Array
    q: Array

    @classmethod
    def of(cls, plan: Plan, constant: Array, p: Array, q: Array) -> Fixed:
        """Of one problem of a plan, whose nodes have a ``constant`` part (N+2, n)."""
        moved = (plan.stencil.unit >= 0) & (plan.stencil.coefficient != 0.0)
        return cls(constant, ~moved.any(axis=1), p, q)

    def take_out(
        self, problem: Problem, functions: CostFunctions, lower: Array, upper: Array
    ) -> None:
        """Take the bounds away from rows that have one value whatever the unknowns are, in place.

        Raises
        ------
        ProblemError: such a value is not within its bounds.
        """
        if functions.calls:  # of stages of code: what they look at is not known here
            return
        first = len(functions.state_terms) - len(functions.bounded)
        looks = self._looks(functions)[first:]
        if problem.duration is not None:
            looks[:, 3] |= self._looks_at_dt(problem, functions)[first:]
        for step in np.flatnonzero(np.lib.stride_tricks.sliding_window_view(self.known, 3).any(1)):
            window = self.known[step : step + 3][::-1]  # of x_next, x, x_prev
            settled = ~(looks[:, :3] & ~window).any(axis=1) & ~looks[:, 3]
            asked = np.isfinite(lower[step]) | np.isfinite(upper[step])
            if not (settled & asked).any():
                continue
            values = self._values(functions, int(step))[first:]
            low, high = lower[step] - SAME, upper[step] + SAME
            off = settled & asked & ~((values >= low) & (values <= high))
            if off.any():
                row = int(np.flatnonzero(off)[0])
                term, _, words = bounded_rows(problem, functions)[row]
                shown = f"{words.shown(float(values[row])):g} {words.unit}".strip()
                allowed = words.allowed(lower[step, row], upper[step, row])
                raise ProblemError(
                    f"{problem.terms[term].label}: {words.name} is {shown} at step {step}, where "
                    f"the state is fixed, must be {allowed}"
                )
            lower[step, settled], upper[step, settled] = -np.inf, np.inf

    def _looks(self, functions: CostFunctions) -> NDArray[np.bool_]:
        """(rows, 4) whether a row over the state looks at x_next, x, x_prev, u."""
        pattern, n = functions.state_sparsity, self.nodes.shape[1]
        looks = np.zeros((pattern.size1(), 4), dtype=bool)
        looks[pattern.row(), np.minimum(np.array(pattern.get_col(), dtype=int) // n, 3)] = True
        return looks

    def _looks_at_dt(self, problem: Problem, functions: CostFunctions) -> NDArray[np.bool_]:
        """(rows,) whether a row over the state looks at dt."""
        pattern = functions.state.jac_sparsity(0, 4)
        place = problem.dynamics.layout.index("dt")
        looks = np.zeros(pattern.size1(), dtype=bool)
        looks[np.array(pattern.row())[np.array(pattern.get_col(), dtype=int) == place]] = True
        return looks

    def _values(self, functions: CostFunctions, step: int) -> Array:
        """(rows,) over the state at a step, without torques."""
        state, size = functions.state, max(functions.references.size, 1)
        nodes = self.nodes[step : step + 3][::-1]
        torques = np.zeros(state.numel_in(3))
        return np.asarray(state(*nodes, torques, self.p, self.q[step, :size])).ravel()
