"""Block cyclic reduction of the KKT matrix (§6, appendix B), over NumPy or CuPy, all problems of a
batch at once.

Every other block of the symmetric block-tridiagonal matrix is eliminated, which leaves one of half
the blocks; log2 levels. A pivot block is scaled and factored by its eigenvalues, V diag(d) Vᵀ: that
pivots inside the block, shows its inertia, and the inertia of the whole is the sum of those of its
pivot blocks (Haynsworth). Eigenvalues are exact to the digits of the largest alone, and blocks that
are left after small pivots have entries of 1e8 beside 1: hence the scaling at every level. The last
block is kept to the end: the rows of a fixed last unit touch earlier units only, so that it is
singular until those are eliminated. A pivot block can be singular elsewhere too, where the matrix
is not or where rows are dependent: an eigenvalue that is nothing but rounding becomes −SHIFT, and
refinement removes what that changed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from octo.arrays import Array, array_module
from octo.solver import blas
from octo.solver.blocks import (
    SBT,
    KKTBlocks,
    columns_of,
    interleave,
    of_members,
    refined,
    separate,
    turned,
)

# an eigenvalue of a pivot block of the equilibrated matrix, entries up to 1, below this is none
ROUNDING = 1e-11
SHIFT = 1e-8  # what it becomes, negated: half the digits are lost to it, refinement wins them back
# passes of Ruiz scaling: the largest entry of every row and column to within a few per cent of 1
EQUILIBRATIONS = 3


@dataclass(frozen=True)
class _Level:
    """What eliminates every other block of one level, counted back from the last but one.

    Of an even number of blocks the first is eliminated; it has no block before it, and `lead` is 1.
    """

    lead: int
    # (batch, E, B, B), S V / sqrt|d| where S P S = V diag(d) Vᵀ, S the scales of the pivot block P
    half: Array
    sign: Array  # (batch, E, B, 1), of d
    left: Array  # (batch, E - lead, B, B), halfᵀ times the block towards the block before
    right: Array  # (batch, E, B, B), halfᵀ times the block towards the block after


class ReducedSBT:
    """A factored SBT(D, B) of a batch. negatives (batch,): negative eigenvalues of the matrix,
    counted by pivot blocks.

    excess_block (batch,): the first pivot block, in the order of elimination, with more than
    `expected` negative eigenvalues, −1 for none. shifted (batch,): eigenvalues that were rounding.
    Factor finite numbers only.
    """

    def __init__(self, matrix: SBT, expected: int):
        xp = array_module(matrix.diagonal)
        self._xp = xp
        self.scale = _equilibration(matrix)
        diagonal = matrix.diagonal * self.scale[..., :, None] * self.scale[..., None, :]
        lower = matrix.lower * self.scale[:, 1:, :, None] * self.scale[:, :-1, None, :]
        batch = diagonal.shape[0]
        self.negatives, self.shifted = xp.zeros(batch, dtype=int), xp.zeros(batch, dtype=int)
        self.excess_block = xp.full(batch, -1)
        self._expected, self._levels = expected, list[_Level]()
        block = xp.arange(diagonal.shape[1])
        while diagonal.shape[1] > 1:
            lead = 1 - diagonal.shape[1] % 2
            half, sign = self._pivots(diagonal[:, 1 - lead :: 2], block[1 - lead :: 2])
            left = turned(half[:, lead:]) @ lower[:, lead::2]
            right = turned(half) @ turned(lower[:, 1 - lead :: 2])
            self._levels.append(_Level(lead, half, sign, left, right))
            weighted = sign[:, lead:] * left
            diagonal = diagonal[:, lead::2].copy()
            diagonal[:, : left.shape[1]] -= turned(left) @ weighted
            diagonal[:, 1 - lead :] -= turned(right) @ (sign * right)
            lower = -(turned(right[:, lead:]) @ weighted)
            block = block[lead::2]
        self._last = self._pivots(diagonal, block)

    def _pivots(self, pivot: Array, block: Array) -> tuple[Array, Array]:
        """S V / sqrt|d| and the signs of d of pivot blocks (batch, O, B, B); their inertia is added
        to the totals."""
        xp = self._xp
        scale = _equilibration(SBT(pivot, pivot[:, :0]), ROUNDING)
        values, vectors = xp.linalg.eigh(scale[..., :, None] * pivot * scale[..., None, :])
        rounding = xp.abs(values) <= ROUNDING
        values = xp.where(rounding, -SHIFT, values)
        self.shifted += rounding.sum(axis=(1, 2))
        negatives = (values < 0).sum(axis=2)
        self.negatives += negatives.sum(axis=1)
        excess = negatives > self._expected
        found = xp.where(excess.any(axis=1), block[xp.argmax(excess, axis=1)], -1)
        self.excess_block = xp.where(self.excess_block < 0, found, self.excess_block)
        half = scale[..., None] * vectors / xp.sqrt(xp.abs(values))[:, :, None, :]
        return half, xp.sign(values)[..., None]

    def solve(self, rhs: Array) -> Array:
        """x (batch, D, B, count), without refinement."""
        xp = self._xp
        r, held = rhs * self.scale[..., None], []
        for level in self._levels:
            lead, before = level.lead, level.left.shape[1]
            w = level.sign * (turned(level.half) @ r[:, 1 - lead :: 2])
            held.append(w)
            r = r[:, lead::2].copy()
            r[:, :before] -= turned(level.left) @ w[:, lead:]
            r[:, 1 - lead :] -= turned(level.right) @ w
        half, sign = self._last
        x = half @ (sign * (turned(half) @ r))
        for level, w in zip(reversed(self._levels), reversed(held), strict=True):
            lead, before = level.lead, level.left.shape[1]
            reach = level.right @ x[:, 1 - lead :]
            reach[:, lead:] += level.left @ x[:, :before]
            both = xp.empty((x.shape[0], x.shape[1] + w.shape[1], *x.shape[2:]))
            both[:, lead::2] = x
            both[:, 1 - lead :: 2] = level.half @ (w - level.sign * reach)
            x = both
        return x * self.scale[..., None]


def _equilibration(matrix: SBT, least: float = 0.0) -> Array:
    """Scales s (batch, D, B) that bring the largest entry of every row of diag(s) M diag(s), above
    ``least``, close to 1."""
    xp = array_module(matrix.diagonal)
    diagonal, lower = xp.abs(matrix.diagonal), xp.abs(matrix.lower)
    scale = xp.ones(diagonal.shape[:3])
    for _ in range(EQUILIBRATIONS):
        top = (diagonal * scale[..., None, :]).max(axis=3)
        if lower.shape[1]:
            top[:, 1:] = xp.maximum(top[:, 1:], (lower * scale[:, :-1, None, :]).max(axis=3))
            top[:, :-1] = xp.maximum(top[:, :-1], (lower * scale[:, 1:, :, None]).max(axis=2))
        top = top * scale
        scale = scale / xp.sqrt(xp.where(top > least, top, 1.0))
    return scale


class CyclicReductionFactor:
    """A factored batch of KKT matrices, with the interface of ``EliminationFactor``; H, A and sigma
    held by reference.

    negative (batch,): negative eigenvalues beyond the number of constraints; first_bad (batch,):
    first unit of the first block found to have more of them than it has constraint rows, −1 where
    no single block shows it; shifted (batch,): eigenvalues that were rounding (rows of fixed units,
    dependent rows); usable (batch,): can solve.
    """

    def __init__(self, H: Array, A: Array, sigma: Array | None = None):
        xp = array_module(H)
        batch, K, _, nc, _ = H.shape
        ma = int(A.shape[3])
        self.shape = (batch, K, nc, ma)
        self._sigma = sigma
        self._blocks = KKTBlocks(H, A, xp.zeros((batch, K, nc)), xp.zeros((batch, K, ma)))
        matrix = self._blocks.sbt(sigma)
        parts = (matrix.diagonal, matrix.lower)
        finite, other = (xp.isfinite(part).all(axis=(1, 2, 3)) for part in parts)
        finite &= other
        keep = finite[:, None, None, None]  # one member that is not finite must not stop the others
        identity = xp.eye(matrix.diagonal.shape[-1])
        matrix = SBT(xp.where(keep, matrix.diagonal, identity), xp.where(keep, matrix.lower, 0.0))
        with blas.one_thread():
            self._reduced = ReducedSBT(matrix, expected=2 * ma)
        self.usable = finite
        self.negative = xp.where(finite, self._reduced.negatives - K * ma, 1)
        shown = finite & (self.negative > 0) & (self._reduced.excess_block >= 0)
        self.first_bad = xp.where(shown, 2 * self._reduced.excess_block, -1)
        self.shifted = self._reduced.shifted
        self.inertia_ok = self.usable & (self.negative == 0)
        self.residual = xp.full((batch, 1), xp.nan)

    def solve(
        self,
        rhs_v: Array,
        rhs_c: Array | None = None,
        *,
        refine: int = 3,
        tolerance: float = 1e-10,
        check: bool = False,
    ) -> tuple[Array, Array]:
        """dv (batch, K, nc[, count]), lam (batch, K, ma[, count]); arguments as in
        ``EliminationFactor.solve``."""
        batch, K, nc, ma = self.shape
        count = int(rhs_v.shape[3]) if rhs_v.ndim == 4 else 1
        wanted = [
            columns_of("rhs_v", rhs_v, (batch, K, nc, count), rhs_v),
            columns_of("rhs_c", rhs_c, (batch, K, ma, count), rhs_v),
        ]
        how = (refine, tolerance, check)
        found, self.residual = refined(self._once, self._residual, wanted, *how)
        dv, lam = (of_members(self.usable, part, np.nan) for part in found)
        return (dv, lam) if rhs_v.ndim == 4 else (dv[..., 0], lam[..., 0])

    def _once(self, rhs_v: Array, rhs_c: Array) -> tuple[Array, Array]:
        with blas.one_thread():
            both = self._reduced.solve(interleave(rhs_v, rhs_c))
        return separate(both, self.shape[1], self.shape[2])

    def _residual(self, dv: Array, lam: Array, *rhs: Array) -> tuple[Array, Array]:
        return self._blocks.residual(dv, lam, self._sigma, *rhs)
