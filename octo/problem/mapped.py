"""CasADi's functions of a step over many steps, as NumPy arrays of one member."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo.checks import Array


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


def bends_over(
    function: ca.Function, sparsity: ca.Sparsity, given: Sequence[Array], steps: int
) -> Array:
    """(steps, width, width) symmetric, of a function that gives the nonzeros of the upper
    triangle."""
    numbers, (i, j) = rows_over(function, given, steps), (sparsity.row(), sparsity.get_col())
    bends = np.zeros((steps, *sparsity.shape))
    bends[:, i, j], bends[:, j, i] = numbers, numbers
    return bends


def squares(coefficient: Array, r: Array) -> Array:
    """coefficient·r², where a step that a term leaves out may have no finite residual."""
    return coefficient * np.where(coefficient != 0.0, r, 0.0) ** 2


def by_term(matrix: Array, terms: NDArray[np.intp], count: int) -> Array:
    """(steps, count) sums of columns (steps, rows) by their ``terms``."""
    return np.stack([matrix[:, terms == t].sum(axis=1) for t in range(count)], axis=1)
