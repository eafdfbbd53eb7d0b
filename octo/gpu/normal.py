"""AAᵀ of a batch on a device: block cyclic reduction of its paired units (gram.cu)."""

from __future__ import annotations

import numpy as np

from octo.errors import ShapeError
from octo.gpu.device import Array
from octo.gpu.linear import PARTS, Linear, Reduction, columns_of
from octo.gpu.sequence import Sequence
from octo.solver.normal import DROP


class DeviceNormal:
    """AAᵀ of a batch on a device, asked as ``NormalFactor`` is."""

    def __init__(self, linear: Linear, A: Array):
        self._linear, self.A = linear, A
        device, ma = linear.device, linear.ma
        batch, K = int(A.shape[0]), int(A.shape[1])
        self.shape = (batch, K)
        if ma == 0:
            return
        D = -(-K // 2)
        self._scale = device.empty((batch, K, ma))
        linear.each("octo_row_scale", (K, batch), A, self._scale)
        self._finite = device.empty((batch,), np.int32)
        linear.each(
            "octo_gram_finite", (1, batch), K * ma, self._scale, self._finite, threads=PARTS
        )
        diagonal = device.empty((batch, D, 2 * ma, 2 * ma))
        lower = device.empty((batch, max(D - 1, 1), 2 * ma, 2 * ma))
        linear.each(
            "octo_gram_blocks", (D, batch), K, self._finite, A, self._scale, diagonal, lower
        )
        self._reduced = Reduction(linear, "gram", diagonal, lower, DROP, 0.0)

    @property
    def dropped(self) -> Array:
        """(batch,) rows that depend on others, −1 where A is not finite."""
        xp = self._linear.device.xp
        if self._linear.ma == 0:
            return xp.zeros(self.shape[0], dtype=np.int32)
        return xp.where(self._finite != 0, self._reduced.counts[:, :, 1].sum(axis=1), -1)

    def solve(self, rhs: Array, *, refine: int = 1) -> Array:
        """lam (batch, K, ma[, count]) of AAᵀ lam = rhs."""
        linear, (batch, K) = self._linear, self.shape
        if rhs.shape[:3] != (batch, K, linear.ma) or rhs.ndim > 4:
            raise ShapeError(
                "rhs", rhs.shape, f"{(batch, K, linear.ma)}, or with one more axis of columns"
            )
        lam = linear.device.empty(rhs.shape)
        if linear.ma == 0:
            return lam
        self._once(rhs, lam, False)
        for _ in range(refine):  # the residual uses A itself: AAᵀ squares its rounding
            x = linear.rows_transposed_times(self.A, lam)
            self._once(linear.rows_times(self.A, x, rhs, -1.0), lam, True)
        return lam

    def least_norm(self, rhs: Array, *, refine: int = 1) -> Array:
        """The shortest x (batch, K, nc[, count]) with A x = rhs (batch, K, ma[, count])."""
        return self._linear.rows_transposed_times(self.A, self.solve(rhs, refine=refine))

    def project(self, v: Array, *, refine: int = 1) -> Array:
        """P v = v − Aᵀ(AAᵀ)⁻¹A v, the part of v (batch, K, nc[, count]) in the null space of A."""
        lam = self.solve(self._linear.rows_times(self.A, v), refine=refine)
        return self._linear.rows_transposed_times(self.A, lam, v, -1.0)

    def _once(self, rhs: Array, lam: Array, more: bool) -> None:
        (batch, K), linear, columns = self.shape, self._linear, columns_of(rhs)
        D = self._reduced.D
        r = linear.device.empty((batch, D, self._reduced.B, columns))
        linear.each("octo_gram_join", (D, batch), K, columns, self._finite, self._scale, rhs, r)
        x = self._reduced.solve(r)
        linear.each(
            "octo_gram_part", (D, batch), K, columns, int(more), self._finite, self._scale, x, lam
        )


class NormalSequences:
    """``DeviceNormal`` of constraints A that stay where they are, as sequences; of single
    columns."""

    def __init__(self, linear: Linear, A: Array):
        device, (batch, K) = linear.device, A.shape[:2]
        self._device = device
        self._rhs = device.empty((batch, K, linear.ma))
        self._v = device.empty((batch, K, linear.nc))
        self._factor = Sequence(device, lambda: DeviceNormal(linear, A))
        self._least_norm = Sequence(device, lambda: self._factored.least_norm(self._rhs))
        self._project = Sequence(device, lambda: self._factored.project(self._v))

    def close(self) -> None:
        """Give everything back."""
        self.__dict__.clear()

    def factor(self) -> None:
        self._factored = self._factor()

    def least_norm(self, rhs: Array) -> Array:
        """As ``DeviceNormal``'s, in an array of its own."""
        self._device.copy(rhs, self._rhs)
        return self._least_norm().copy()

    def project(self, v: Array) -> Array:
        """As ``DeviceNormal``'s, in an array of its own."""
        self._device.copy(v, self._v)
        return self._project().copy()
