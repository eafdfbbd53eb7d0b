"""CasADi's functions of a step over many steps, as NumPy arrays of one member."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo.checks import Array
from octo.problem.curvature import StateCurvature


def rows_over(function: ca.Function, given: Sequence[Array], steps: int) -> Array:
    """(steps, rows) of a function of one column."""
    return np.asarray(function.map(steps)(*given)).T.reshape(steps, -1)


def slopes_over(
    function: ca.Function, sparsity: ca.Sparsity, given: Sequence[Array], steps: int
) -> tuple[Array, Array]:
    """(steps, rows) residuals and (steps, rows, width) their slopes, of a function that gives the
    residuals and the nonzeros."""
    value, numbers = function.map(steps)(*given)
    slopes = np.zeros((steps, *sparsity.shape))
    slopes[:, sparsity.row(), sparsity.get_col()] = np.asarray(numbers).T
    return np.asarray(value).T, slopes


def live_rows(
    function: ca.Function, sparsity: ca.Sparsity, given: Sequence[Sequence[Array]], weight: Array
) -> tuple[Array, Array]:
    """r (batch, steps, rows) and its slopes (batch, steps, rows, width) of each member's arguments;
    zero where ``weight`` is: a step that a term leaves out may have no finite residual."""
    made = [slopes_over(function, sparsity, own, weight.shape[1]) for own in given]
    r, jac = (np.stack(part) for part in zip(*made, strict=True))
    live = weight != 0.0
    return np.where(live, r, 0.0), np.where(live[..., None], jac, 0.0)


def add_bends(
    own: StateCurvature,
    given: Sequence[Sequence[Array]],
    curved: NDArray[np.bool_],
    chain: Array,
    hess: Array,
) -> None:
    """Adds chainᵀ S chain, chain (batch, steps, width, w), to ``hess`` (batch, steps, w, w) of the
    members ``curved``; given: each member's arguments."""
    for k in np.flatnonzero(curved).tolist():
        numbers = rows_over(own.function, given[k], hess.shape[1])
        bend = np.zeros((hess.shape[1], *own.sparsity.shape))
        bend[:, own.rows, own.columns], bend[:, own.columns, own.rows] = numbers, numbers
        hess[k] += np.swapaxes(chain[k], 1, 2) @ bend @ chain[k]


def squares(coefficient: Array, r: Array) -> Array:
    """coefficient·r², where a step that a term leaves out may have no finite residual."""
    return coefficient * np.where(coefficient != 0.0, r, 0.0) ** 2


def by_term(matrix: Array, terms: NDArray[np.intp], count: int) -> Array:
    """(steps, count) sums of columns (steps, rows) by their ``terms``."""
    return np.stack([matrix[:, terms == t].sum(axis=1) for t in range(count)], axis=1)
