"""Soft constraints (§8.4): E + ½ρ‖C‖² in place of E subject to C = 0.

What a solver sees has no rows of C: those of the problem are squares of its objective, whose
JᵀJ = ρAᵀA has the blocks that H has. At a minimum ρC is what the multipliers of hard constraints
would be.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from octo.arrays import Array, array_module
from octo.problem.block_nlp import BlockNLP
from octo.problem.evaluation import Evaluation, Model
from octo.problem.phases import Described
from octo.solver.blocks import transposed_times, turned


class Softened:
    """A batch as a :class:`~octo.problem.block_nlp.BlockNLP` without constraints.

    Of an Evaluation ``energy`` is E + ½ρ‖C‖² and ``size`` zero; ``objective`` is E, ``largest`` and
    C are those of the constraints.

    Parameters
    ----------
    inner: with constraints. penalty: ρ, of C in parts of the weight.
    """

    ma = 0

    def __init__(self, inner: BlockNLP, penalty: float):
        self.inner, self.penalty = inner, penalty
        self.batch, self.K, self.nc = inner.batch, inner.K, inner.nc
        self.steps, self.n, self.m = inner.steps, inner.n, inner.m
        self.weight, self.threads = inner.weight, inner.threads
        self.problems: tuple[Described, ...] = tuple(inner.problems)

    def take(self, members: Any) -> Softened:
        """Some members, by index."""
        return Softened(self.inner.take(members), self.penalty)

    def unknowns(self, nodes: Array) -> Array:
        """As those of ``inner``."""
        return self.inner.unknowns(nodes)

    def evaluate(self, unknowns: Array) -> Evaluation:
        """E + ½ρ‖C‖²."""
        at = self.inner.evaluate(unknowns)
        summary = at.summary.copy()
        summary[:, 0] += 0.5 * self.penalty * summary[:, 3]
        summary[:, 1] = 0.0
        return Evaluation(at.unknowns, at.nodes, at.fd, at.terms, at.rows, C=at.C, summary=summary)

    def term_values(self, at: Evaluation) -> Array:
        """(batch, terms) the parts of E."""
        return self.inner.term_values(at)

    def gradient(self, at: Evaluation) -> tuple[Array, Array]:
        """∇E + ρAᵀC (batch, K, nc), and no rows."""
        b, A = self.inner.gradient(at)
        return b + transposed_times(A, self.multipliers(at)), A[:, :, :, :0]

    @property
    def row_bounds(self) -> tuple[Array, Array]:
        """As those of ``inner``: none."""
        return self.inner.row_bounds

    def set_row_weights(
        self, weights: Array, shifts: Array, multipliers: Array | None = None
    ) -> None:
        """As that of ``inner``."""
        self.inner.set_row_weights(weights, shifts, multipliers)

    def row_products(self, model: Model, delta: Array) -> Array:
        """As those of ``inner``."""
        return self.inner.row_products(model, delta)

    def row_forces(self, model: Model, weights: Array) -> Array:
        """As those of ``inner``."""
        return self.inner.row_forces(model, weights)

    def linearize(self, at: Evaluation, lam: Array | None, curved: Array | None = None) -> Model:
        """H + ρAᵀA, and with ``lam`` the curvature of ½ρ‖C‖² too; ∇E + ρAᵀC."""
        force = self.multipliers(at)
        model = self.inner.linearize(at, None if lam is None else force, curved)
        b = model.b + transposed_times(model.A, force)
        H = model.H + self.penalty * squared(model.A)
        return Model(H, model.A[:, :, :, :0], b, model.C[:, :, :0], model.R)

    def multipliers(self, at: Evaluation) -> Array:
        """(batch, K, rows of C) ρC."""
        return self.penalty * at.C

    def ended(self, at: Evaluation) -> tuple[Evaluation, Array]:
        """The end of a solve as one of the problem with constraints, and their multipliers."""
        own = self.inner.evaluate(np.ascontiguousarray(at.unknowns))
        return own, self.multipliers(own)


def squared(A: Array) -> Array:
    """AᵀA (batch, K, 3, nc, nc) of row blocks A (batch, K, 3, ma, nc), both in lag storage."""
    K, product = A.shape[1], array_module(A).zeros((*A.shape[:3], A.shape[4], A.shape[4]))
    for lag in range(3):
        for row in range(3 - lag):  # a row of C that is so many units later sees both
            last = K - row
            product[:, :last, lag] += turned(A[:, row:, row]) @ A[:, row:, row + lag]
    for lag in (1, 2):
        product[:, :lag, lag] = 0.0
    return product
