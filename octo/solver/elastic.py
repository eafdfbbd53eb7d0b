"""Rows that may leave their bounds at a price: min E + Σ φ(z) subject to C = 0, of z how far a row
is beyond a bound.

    φ(z) = min_g ½ (z + g)² − μ log g = ½ e² + μ log(e/√μ) + constant
    e = φ'(z) = (z + √(z² + 4μ))/2

It is half of z² where z ≫ √μ and a log barrier where z ≪ −√μ: an elastic phase (Nocedal and
Wright, §18.3, with squares) whose slacks g are eliminated. Its Newton step is Eq. 12 with weights
φ'' = e/√(z² + 4μ) and shifts e of the rows. Rows whose bounds are equal cost ½ (r − bound)². Where
bounds cannot hold together it ends, for √μ → 0, at a motion that breaks them least among its
neighbours.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from octo.arrays import Array, array_module, host, like
from octo.problem.block_nlp import BlockNLP
from octo.problem.evaluation import Evaluation
from octo.solver.acceptance import Mask
from octo.solver.bounds import Bounds


class Elastic(Bounds):
    """The price of a batch.

    Parameters
    ----------
    lower, upper: (batch, N, rows), infinite where there is none.
    width: √μ, over which the price of a row rises.
    """

    def __init__(self, lower: Array, upper: Array, width: float):
        self.lower, self.upper, self.width = lower, upper, width

    def _prices(self, rows: Array) -> tuple[Array, Array, Array]:
        """Of each row its price, shift and weight."""
        xp = array_module(rows)
        equal, mu = self.lower == self.upper, self.width**2
        off = xp.where(equal, rows - xp.where(equal, self.lower, 0.0), 0.0)
        price, shift, weight = 0.5 * off**2, off, equal * 1.0
        for bound, side in ((self.lower, -1.0), (self.upper, 1.0)):
            has = xp.isfinite(bound) & ~equal
            z = xp.where(has, side * (rows - xp.where(has, bound, 0.0)), 0.0)
            root = xp.sqrt(z**2 + 4.0 * mu)
            e = xp.where(z < 0.0, 2.0 * mu / (root + abs(z)), 0.5 * (z + root))
            price = price + xp.where(has, 0.5 * e**2 + mu * xp.log(e / self.width), 0.0)
            shift = shift + xp.where(has, side * e, 0.0)
            weight = weight + xp.where(has, e / root, 0.0)
        return price, shift, weight

    def weigh(self, problem: BlockNLP, at: Evaluation) -> None:
        _, shift, weight = self._prices(at.rows)
        problem.set_row_weights(weight, shift)

    def seen(self, at: Evaluation) -> Evaluation:
        summary, objective = at.summary.copy(), at.terms.sum(axis=(1, 2))
        summary[:, 0] = objective + self._prices(at.rows)[0].sum(axis=(1, 2))
        return at.summarised(summary, host(summary), host(objective))

    def kept(self, rows: Array) -> Mask:
        beyond = np.maximum(host(self.lower) - rows, rows - host(self.upper))
        return np.asarray(beyond.reshape(len(beyond), -1).max(axis=1, initial=0.0) <= self.width)

    def take(self, members: NDArray[np.intp]) -> None:
        chosen = like(members, self.lower)
        self.lower, self.upper = self.lower[chosen], self.upper[chosen]
