"""The bounded rows behind C in g: which of them, between what, and how their slopes over x are made
of what a linearisation keeps (octo.problem.row_products)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from octo.checks import Array
from octo.problem.compiled import CompiledProblem
from octo.problem.row_products import RowSlopes
from octo.solver.barrier import AGAIN, ERRORS, FIRST, LAST
from octo.solver.options import SqpOptions

Indices = NDArray[np.intp]
# D of a row in g: octo derives no row without one, and of H nothing is left of this one
USED = 1e-200


def given_rows(compiled: CompiledProblem) -> Indices:
    """Of each row that has a bound its place among the bounded rows (N, rows)."""
    lower, upper = compiled.lower[0], compiled.upper[0]
    return np.flatnonzero(np.isfinite(lower) | np.isfinite(upper))


def limits(compiled: CompiledProblem, place: Indices) -> tuple[Array, Array]:
    """Lower and upper bounds of g, whose rows have a ``place`` among the bounded rows (N, rows), -1
    where they are zero."""
    made = []
    for bound in (compiled.lower[0], compiled.upper[0]):
        made.append(np.zeros(len(place)))
        made[-1][place >= 0] = bound.ravel()[place[place >= 0]]
    return made[0], made[1]


def steps_rows(steps: int, n: int) -> Indices:
    """(N, 3n) the row of (x_{-1} … x_N), (N+2)·n of them, that each of (x_next, x, x_prev) is."""
    node = np.arange(steps)[:, None, None] + np.array([2, 1, 0])[:, None]
    return np.asarray(node * n + np.arange(n)).reshape(steps, 3 * n)


def used(compiled: CompiledProblem) -> Array:
    """q (N, NQ) in which rows that have a bound are derived and add nothing to E's model."""
    q = compiled.q[0].copy()
    weights, *others = compiled.functions.row_weights
    steps, rows = np.divmod(given_rows(compiled), max(len(compiled.functions.bounded), 1))
    for place in (weights, *others):
        q[:, place] = 0.0
    q[steps, weights.start + rows] = USED
    return q


def complementarity(steps: int, options: SqpOptions) -> float:
    """What a multiplier times the room to its bound may be at the end, as of octo's interior
    point."""
    return (1.0 + ERRORS) * LAST * options.dual_tolerance / steps


def first_weight(compiled: CompiledProblem, warm: bool) -> float:
    """Of the barrier at a start, with multipliers or without, as of octo's interior point."""
    return (AGAIN if warm else FIRST) / compiled.steps


def gap(lower: Array, upper: Array, found: Mapping[str, Any]) -> float:
    """The largest multiplier of an inequality times the room to its bound, of what CasADi's solver
    ``found``."""
    g, lam = (np.asarray(found[name], dtype=float).ravel() for name in ("g", "lam_g"))
    room = np.where(lam > 0.0, upper - g, g - lower)
    counted = (lower < upper) & np.isfinite(room)
    return float(np.abs(lam * np.where(counted, room, 0.0)).max(initial=0.0))


@dataclass(frozen=True, eq=False)
class Slopes:
    """Nonzeros of the Jacobian of the rows in g, each a sum of value·kept[one]·kept[other]: kept
    are the numbers of a linearisation (N·size), and behind them a 1.

    Attributes
    ----------
    row, column: of each nonzero, by row; a row is counted among those that have a bound.
    target: of each product, the nonzero that it belongs to; value, one, other.
    """

    row: Indices
    column: Indices
    target: Indices
    value: Array
    one: Indices
    other: Indices

    @classmethod
    def of(cls, compiled: CompiledProblem, nodes: sparse.csr_array, window: Indices) -> Slopes:
        """Over x, of which ``nodes`` (rows, x) are made; ``window`` (N, 3n): the row of ``nodes``
        that each of a step's (x_next, x, x_prev) is."""
        kept, given = compiled.program.kept, given_rows(compiled)
        if kept is None or not len(given):
            none = np.zeros(0, dtype=np.intp)
            return cls(none, none, none, np.zeros(0), none, none)
        position = np.full((compiled.steps, kept.count), -1)
        position.flat[given] = np.arange(len(given))
        row, column, *factors = _of_a_step(kept)
        step, entry = np.nonzero(position[:, row] >= 0)
        node = window[step, column[entry]]
        count = np.diff(nodes.indptr)[node]  # numbers of x that it is made of
        first = np.repeat(nodes.indptr[node] - np.cumsum(count) + count, count)
        at = first + np.arange(count.sum())
        step, entry = np.repeat(step, count), np.repeat(entry, count)
        width, last = nodes.shape[1], compiled.steps * kept.size
        key = position[step, row[entry]] * width + nodes.indices[at]
        found, target = np.unique(key, return_inverse=True)
        one, other = (
            np.where(factor[entry] >= 0, step * kept.size + factor[entry], last)
            for factor in factors
        )
        return cls(*np.divmod(found, width), target, nodes.data[at], one, other)


def _of_a_step(kept: RowSlopes) -> tuple[Indices, ...]:
    """Of each product in a step's slopes over (x_next, x, x_prev), through the torques too: row,
    column, and the two numbers kept, the second -1 where there is none."""
    width, entries = 3 * kept.n, np.arange(len(kept.entries))
    direct = kept.columns < width
    of_motor, column = kept.pulled
    through = kept.columns[:, None] - width == kept.motors[of_motor][None]
    slope, pulled = np.nonzero(through)
    none = np.full(int(direct.sum()), -1)
    return (
        np.concatenate([kept.rows[direct], kept.rows[slope]]),
        np.concatenate([kept.columns[direct], column[pulled]]),
        np.concatenate([entries[direct], slope]),
        np.concatenate([none, len(entries) + pulled]),
    )
