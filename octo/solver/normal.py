"""AAᵀ of the constraints, factored: the normal step v_N = −Aᵀ(AAᵀ)⁻¹C and least-squares
multipliers.

A has block lags 0, 1, 2, and so has AAᵀ: a banded Cholesky factorisation (normal.c), or the same by
blocks in NumPy. Rows are first scaled to length 1. A row that is zero or depends on rows before it
leaves no pivot above rounding and is dropped (its multiplier is 0); the NumPy way uses the
pseudo-inverse of the pivot block. Where the system is consistent, as for multipliers, the product
Aᵀ(AAᵀ)⁻¹r is the same whichever row was dropped.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from octo.errors import ShapeError
from octo.solver import blas
from octo.solver.blocks import block_times, columns_of, transposed_times, turned
from octo.solver.elimination import Floats, address, aligned, library

DROP = 1e-13  # a pivot of AAᵀ with unit diagonal that is smaller is rounding (DROP of normal.c)


class NormalFactor:
    """AAᵀ of a batch, A (batch, K, 3, ma, nc) in lag storage, held by reference. ma may be 0.

    dropped (batch,): rows that depend on others, −1 where A is not finite (solutions are then NaN).
    compiled: the C way; None takes it where there is a compiler.
    """

    def __init__(self, A: Floats, *, threads: int = 1, compiled: bool | None = None):
        if A.ndim != 5 or A.shape[2] != 3:
            raise ShapeError("A", A.shape, "(batch, K, 3, ma, nc)")
        self.A = np.ascontiguousarray(A, dtype=np.float64)
        batch, K, _, ma, nc = self.A.shape
        self._threads = threads
        self.dropped: NDArray[np.int32] = np.zeros(batch, dtype=np.int32)
        self._library = library(nc, ma) if ma and compiled is not False else None
        if self._library is not None:
            self._units = aligned((self._library.octo_normal_bytes() * batch * K + 7) // 8)
            self._library.octo_normal_factor(
                batch, threads, K, address(self.A), address(self._units), address(self.dropped)
            )
        elif ma:
            with blas.one_thread():
                self._blocks = _Blocks(self.A)
            self.dropped[:] = self._blocks.dropped

    def solve(self, rhs: Floats, *, refine: int = 1) -> Floats:
        """lam (batch, K, ma[, count]) of AAᵀ lam = rhs."""
        return self._both(rhs, refine)[0]

    def least_norm(self, rhs: Floats, *, refine: int = 1) -> Floats:
        """The shortest x (batch, K, nc[, count]) with A x = rhs (batch, K, ma[, count]); v_N is
        least_norm(−C)."""
        return self._both(rhs, refine)[1]

    def multipliers(self, gradient: Floats, *, refine: int = 1) -> Floats:
        """lam (batch, K, ma) of the smallest ‖gradient + Aᵀ lam‖, gradient (batch, K, nc)."""
        return self.solve(-block_times(self.A, gradient), refine=refine)

    def project(self, v: Floats, *, refine: int = 1) -> Floats:
        """P v = v − Aᵀ(AAᵀ)⁻¹A v, the part of v (batch, K, nc[, count]) in the null space of A."""
        return v - self.least_norm(block_times(self.A, v), refine=refine)

    def _both(self, rhs: Floats, refine: int) -> tuple[Floats, Floats]:
        """lam and Aᵀ lam."""
        batch, K, _, ma, nc = self.A.shape
        count = rhs.shape[3] if rhs.ndim == 4 else 1
        columns = columns_of("rhs", rhs, (batch, K, ma, count), rhs)
        if ma == 0:
            lam, x = np.empty(columns.shape), np.zeros((batch, K, nc, count))
        elif self._library is not None:
            lam, x = self._native(columns, refine)
        else:
            lam = self._blocks.solve(columns)
            for _ in range(refine):  # the residual uses A itself: AAᵀ squares its rounding
                left = columns - block_times(self.A, transposed_times(self.A, lam))
                lam = lam + self._blocks.solve(left)
            x = transposed_times(self.A, lam)
        return (lam, x) if rhs.ndim == 4 else (lam[..., 0], x[..., 0])

    def _native(self, columns: Floats, refine: int) -> tuple[Floats, Floats]:
        assert self._library is not None
        batch, K, _, ma, nc = self.A.shape
        count = columns.shape[3]
        rhs = np.ascontiguousarray(np.moveaxis(columns, 3, 1), dtype=np.float64)
        lam, x = np.empty((batch, count, K, ma)), np.empty((batch, count, K, nc))
        scratch = np.empty(self._threads * K * ma)
        factor = (address(self.A), address(self._units), address(self.dropped))
        self._library.octo_normal_solve(
            *(batch, self._threads, K, *factor),
            *(count, address(rhs), refine, address(lam), address(x), address(scratch)),
        )
        return np.moveaxis(lam, 1, 3), np.moveaxis(x, 1, 3)


class _Blocks:
    """AAᵀ = L Lᵀ by blocks of lags 0..2, the batch at once; ``half`` is the (pseudo-)inverse of L's
    diagonal, transposed.

    The pivot block V diag(d) Vᵀ has the factor V √d and the half inverse V / √d: multiplying by
    half inverses on either side keeps Cholesky's accuracy, which an inverse would lose.
    """

    def __init__(self, A: Floats):
        batch, K, _, ma, _ = A.shape
        length = np.sqrt(np.einsum("bkoij,bkoij->bki", A, A))
        self.scale = np.where(length > 0, 1 / np.where(length > 0, length, 1.0), 0.0)
        finite = np.isfinite(length).all(axis=(1, 2))
        rows = np.where(finite[:, None, None, None, None], A * self.scale[:, :, None, :, None], 0.0)
        self.scale[~finite] = np.nan
        self.lag1, self.lag2, self.half = np.zeros((3, batch, K, ma, ma))
        self.dropped = np.zeros(batch, dtype=np.int32)
        for k in range(K):
            pivot = (rows[:, k] @ turned(rows[:, k])).sum(axis=1)
            if k > 1:
                self.lag2[:, k] = rows[:, k, 2] @ turned(rows[:, k - 2, 0]) @ self.half[:, k - 2]
            if k > 0:
                coupling = (rows[:, k, 1:] @ turned(rows[:, k - 1, :2])).sum(axis=1)
                coupling -= self.lag2[:, k] @ turned(self.lag1[:, k - 1])
                self.lag1[:, k] = coupling @ self.half[:, k - 1]
            far, near = self.lag2[:, k], self.lag1[:, k]
            pivot -= far @ turned(far) + near @ turned(near)
            values, vectors = np.linalg.eigh(pivot)
            kept = values > DROP
            self.dropped += ma - kept.sum(axis=1, dtype=np.int32)
            root = np.sqrt(np.where(kept, values, 1.0))
            self.half[:, k] = vectors * np.where(kept, 1 / root, 0.0)[:, None]
        self.dropped[~finite] = -1

    def solve(self, rhs: Floats) -> Floats:
        """(batch, K, ma, count), without refinement."""
        K = rhs.shape[1]
        x = rhs * self.scale[..., None]
        for k in range(K):
            if k > 0:
                x[:, k] -= self.lag1[:, k] @ x[:, k - 1]
            if k > 1:
                x[:, k] -= self.lag2[:, k] @ x[:, k - 2]
            x[:, k] = turned(self.half[:, k]) @ x[:, k]
        for k in range(K - 1, -1, -1):
            if k + 1 < K:
                x[:, k] -= turned(self.lag1[:, k + 1]) @ x[:, k + 1]
            if k + 2 < K:
                x[:, k] -= turned(self.lag2[:, k + 2]) @ x[:, k + 2]
            x[:, k] = self.half[:, k] @ x[:, k]
        return x * self.scale[..., None]
