"""The KKT system and AAᵀ of a batch on a device: block cyclic reduction by the kernels of linear.cu and kkt.cu."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from octo.errors import ShapeError
from octo.gpu.device import Array, Device, source
from octo.solver.blocks import KKTBlocks
from octo.solver.cyclic_reduction import EQUILIBRATIONS, ROUNDING, SHIFT
from octo.solver.normal import DROP

WIDE, PIVOT, TILE, PARTS = 256, 256, 144, 128
CHOICES = 16  # of linear.cu


class Linear:
    """The kernels for units of nc variables and ma constraint rows."""

    def __init__(self, device: Device, nc: int, ma: int):
        self.device, self.nc, self.ma = device, nc, ma
        sizes = f"#define NCV {nc}\n#define MAV {ma}\n"
        files = ("common.cuh", "linear.cu", "kkt.cu", *(("gram.cu",) if ma else ()))
        kinds = {"kkt": 2 * (nc + ma), "gram": 2 * ma}
        reductions = [
            source("reduction.cu").replace("NAME_BLOCK", str(B)).replace("NAME", name) for name, B in kinds.items() if B
        ]
        self.text = "\n".join([sizes, *map(source, files), *reductions])
        self.module = device.module(self.text)
        self.kernel = self.module.kernel

    def each(self, name: str, grid: tuple[int, ...], *arguments: Any, threads: int = WIDE, shared: int = 0) -> None:
        self.kernel(name)(grid, self.device.threads(threads), *arguments, shared=shared)

    def hessian_times(self, H: Array, v: Array) -> Array:
        """H v for v (batch, K, nc[, count])."""
        out = self.device.empty(v.shape)
        self.each("octo_hessian_times", (v.shape[1], v.shape[0]), _columns(v), H, v, out)
        return out

    def rows_times(self, A: Array, v: Array, base: Array | None = None, factor: float = 1.0) -> Array:
        """base + factor A v."""
        out = self.device.empty((*v.shape[:2], self.ma, *v.shape[3:]))
        if self.ma:
            self.each("octo_rows_times", (v.shape[1], v.shape[0]), _columns(v), float(factor), A, base, v, out)
        return out

    def rows_transposed_times(self, A: Array, lam: Array, base: Array | None = None, factor: float = 1.0) -> Array:
        """base + factor Aᵀ lam."""
        out = self.device.empty((*lam.shape[:2], self.nc, *lam.shape[3:]))
        self.each("octo_rows_transposed_times", (lam.shape[1], lam.shape[0]), _columns(lam), float(factor), A, base, lam, out)
        return out

    def step_numbers(self, A: Array, b: Array, delta: Array, lam: Array) -> Array:
        """(batch, K, 3) of each unit: ‖Δ‖∞, ‖b + Aᵀlam‖∞, bᵀΔ."""
        out = self.device.empty((*b.shape[:2], 3))
        self.each("octo_step_numbers", (b.shape[1], b.shape[0]), A, b, delta, lam, out, threads=PARTS, shared=24 * PARTS)
        return out

    def largest(self, v: Array, lam: Array | None) -> Array:
        """(batch, count) largest entry of each column."""
        top = self.device.empty((v.shape[0], _columns(v)))
        self.each("octo_largest", (_columns(v), v.shape[0]), v.shape[1], v, lam, top, threads=PARTS, shared=8 * PARTS)
        return top


def _columns(v: Array) -> int:
    return int(v.shape[3]) if v.ndim == 4 else 1


@dataclass(frozen=True, eq=False)
class _Level:
    """What eliminated every other of D blocks."""

    D: int
    first: int  # the first block eliminated
    half: Array
    sign: Array
    left: Array
    right: Array


class Reduction:
    """A factored SBT(D, B): diagonal (batch, D, B, B) is overwritten, lower (batch, D-1, B, B).

    counts (batch, D, 2): negative and rounding eigenvalues of the pivot blocks, in the order of elimination.
    order (D,): which block each of those was.
    """

    def __init__(self, linear: Linear, name: str, diagonal: Array, lower: Array, rounding: float, shift: float):
        self._linear, self._name = linear, name
        device = linear.device
        batch, D, B, _ = diagonal.shape
        self.batch, self.D, self.B = int(batch), int(D), int(B)
        self.counts = device.empty((batch, D, 2), np.int32)
        self._levels: list[_Level] = []
        threads = device.threads(PIVOT)
        fixed = 8 * (2 * B + 4 * threads + 4 * CHOICES)
        spills = fixed + 8 * B * B > device.shared_limit
        room, tiles = fixed if spills else fixed + 8 * B * B, (-(-B // 48)) ** 2
        order, block, place = [], np.arange(D), 0

        def pivots(D: int, first: int, count: int) -> tuple[Array, Array]:
            half, sign = device.empty((batch, count, B, B)), device.empty((batch, count, B))
            own = (D, first, float(rounding), float(shift), self.D, place, int(spills), diagonal, half, sign, self.counts)
            self._each("pivots", (count, batch), *own, threads=PIVOT, shared=room)
            return half, sign

        while D > 1:
            first = D % 2
            E = (D - first) // 2
            S = D - E
            half, sign = pivots(D, first, E)
            left, right = device.empty((batch, E, B, B)), device.empty((batch, E, B, B))
            self._each("couple", (E * tiles, 2, batch), D, first, lower, half, left, right, threads=TILE)
            new, new_lower = device.empty((batch, S, B, B)), device.empty((batch, max(S - 1, 1), B, B))
            grid = (S * tiles, 2, batch)
            self._each("complement", grid, D, first, diagonal, sign, left, right, new, new_lower, threads=TILE)
            self._levels.append(_Level(D, first, half, sign, left, right))
            order += block[first::2].tolist()
            diagonal, lower, block, place, D = new, new_lower, block[1 - first :: 2], place + E, S
        self._last = pivots(1, 0, 1)
        self.order = np.array([*order, *block.tolist()])

    def _each(self, name: str, grid: tuple[int, ...], *arguments: Any, threads: int = WIDE, shared: int = 0) -> None:
        self._linear.each(f"octo_{self._name}_{name}", grid, *arguments, threads=threads, shared=shared)

    def solve(self, r: Array) -> Array:
        """x (batch, D, B, columns), without refinement."""
        device, batch, B = self._linear.device, self.batch, self.B
        columns, held = int(r.shape[3]), []
        size = 8 * B * columns
        for level in self._levels:
            S = level.D // 2 + level.first
            w, folded = device.empty((batch, level.D - S, B, columns)), device.empty((batch, S, B, columns))
            own = (level.D, level.first, columns, level.half, level.sign, level.left, level.right, r, w, folded)
            self._each("fold", (S, batch), *own, shared=3 * size)
            held.append(w)
            r = folded
        x = device.empty((batch, 1, B, columns))
        self._each("last", (1, batch), columns, *self._last, r, x, shared=size)
        for level, w in zip(reversed(self._levels), reversed(held), strict=True):
            unfolded = device.empty((batch, level.D, B, columns))
            own = (level.D, level.first, columns, level.half, level.sign, level.left, level.right, w, x, unfolded)
            self._each("unfold", (level.D, batch), *own, shared=2 * size)
            x = unfolded
        return x


class DeviceFactor:
    """A factored batch of KKT matrices on a device, with the interface and the meaning of ``CyclicReductionFactor``.

    sigma (batch, K) or None; H, A and sigma are held by reference.
    """

    def __init__(self, linear: Linear, H: Array, A: Array, sigma: Array | None):
        self._linear, self._held = linear, (H, A, sigma)
        device, xp = linear.device, linear.device.xp
        batch, K = int(H.shape[0]), int(H.shape[1])
        self.shape = (batch, K, linear.nc, linear.ma)
        D, B = -(-K // 2), 2 * (linear.nc + linear.ma)
        diagonal, lower = device.empty((batch, D, B, B)), device.empty((batch, max(D - 1, 1), B, B))
        blocks = device.empty((batch, D), np.int32)
        linear.each("octo_kkt_blocks", (D, batch), K, H, A, sigma, diagonal, lower, blocks, shared=8 * PARTS)
        self.usable = blocks.all(axis=1)
        self._finite = self.usable.astype(np.int32)
        scale = xp.ones((batch, D, B))
        for _ in range(EQUILIBRATIONS):
            old, scale = scale, device.empty((batch, D, B))
            linear.each("octo_kkt_equilibrate", (D, batch), diagonal, lower, old, scale)
        linear.each("octo_kkt_scale", (D, batch), self._finite, scale, diagonal, lower)
        self._scale = scale
        self._reduced = Reduction(linear, "kkt", diagonal, lower, ROUNDING, SHIFT)
        totals = self._reduced.counts.sum(axis=1)
        self.negative = xp.where(self.usable, totals[:, 0] - K * linear.ma, 1)
        self.shifted = totals[:, 1]
        self.residual = xp.full((batch, 1), xp.nan)

    @property
    def inertia_ok(self) -> Array:
        """True (batch,) where the Hessian is positive definite on the null space of the constraints."""
        return self.usable & (self.negative == 0)

    @cached_property
    def first_bad(self) -> Array:
        """(batch,) first unit of the first block with more negative eigenvalues than constraint rows, −1 where none shows it."""
        xp = self._linear.device.xp
        excess = self._reduced.counts[:, :, 0] > 2 * self.shape[3]
        block = self._linear.device.array(2 * self._reduced.order, np.int64)[xp.argmax(excess, axis=1)]
        return xp.where(self.usable & (self.negative > 0) & excess.any(axis=1), block, -1)

    def solve(
        self, rhs_v: Array, rhs_c: Array | None = None, *, refine: int = 3, tolerance: float = 1e-10, check: bool = False
    ) -> tuple[Array, Array]:
        """dv (batch, K, nc[, count]), lam (batch, K, ma[, count]); arguments as in ``EliminationFactor.solve``."""
        linear, (batch, K, nc, ma) = self._linear, self.shape
        xp, device = linear.device.xp, linear.device
        columns = _columns(rhs_v)
        if rhs_v.shape[:3] != (batch, K, nc):
            raise ShapeError("rhs_v", rhs_v.shape, f"{(batch, K, nc)}, or with one more axis of columns")
        if rhs_c is not None and rhs_c.shape != (batch, K, ma, *rhs_v.shape[3:]):
            raise ShapeError("rhs_c", rhs_c.shape, (batch, K, ma, *rhs_v.shape[3:]))
        rhs_v = xp.ascontiguousarray(rhs_v)
        rhs_c = None if rhs_c is None or ma == 0 else xp.ascontiguousarray(rhs_c)
        dv, lam = device.empty(rhs_v.shape), device.empty((batch, K, ma, *rhs_v.shape[3:]))
        left_v, left_c = device.empty(dv.shape), device.empty(lam.shape)
        size = linear.largest(rhs_v, rhs_c)
        size = xp.where(size > 0, size, 1.0)
        self.residual = xp.full((batch, columns), xp.nan)
        self._once(rhs_v, rhs_c, dv, lam, False)
        for step in range(refine + 1):
            if step == refine and not check:
                break
            linear.each("octo_kkt_residual", (K, batch), columns, *self._held, rhs_v, rhs_c, dv, lam, left_v, left_c)
            self.residual = linear.largest(left_v, left_c if ma else None) / size
            if step == refine or not bool((self.residual > tolerance).any()):
                break
            self._once(left_v, left_c, dv, lam, True)
        return dv, lam

    def _once(self, rhs_v: Array, rhs_c: Array | None, dv: Array, lam: Array, more: bool) -> None:
        batch, K, _, _ = self.shape
        linear, D, columns = self._linear, self._reduced.D, _columns(rhs_v)
        r = linear.device.empty((batch, D, self._reduced.B, columns))
        linear.each("octo_kkt_join", (D, batch), K, columns, self._finite, self._scale, rhs_v, rhs_c, r)
        x = self._reduced.solve(r)
        linear.each("octo_kkt_part", (D, batch), K, columns, int(more), self._finite, self._scale, x, dv, lam)


class DeviceNormal:
    """AAᵀ of a batch on a device, with the interface of ``NormalFactor``."""

    def __init__(self, linear: Linear, A: Array):
        self._linear, self.A = linear, A
        device, xp, ma = linear.device, linear.device.xp, linear.ma
        batch, K = int(A.shape[0]), int(A.shape[1])
        self.shape = (batch, K)
        self.dropped = xp.zeros(batch, dtype=np.int32)
        if ma == 0:
            return
        D = -(-K // 2)
        self._scale = device.empty((batch, K, ma))
        linear.each("octo_row_scale", (K, batch), A, self._scale)
        good = xp.isfinite(self._scale).all(axis=(1, 2))
        self._finite = good.astype(np.int32)
        diagonal, lower = device.empty((batch, D, 2 * ma, 2 * ma)), device.empty((batch, max(D - 1, 1), 2 * ma, 2 * ma))
        linear.each("octo_gram_blocks", (D, batch), K, self._finite, A, self._scale, diagonal, lower)
        self._reduced = Reduction(linear, "gram", diagonal, lower, DROP, 0.0)
        self.dropped = xp.where(good, self._reduced.counts[:, :, 1].sum(axis=1), -1)

    def solve(self, rhs: Array, *, refine: int = 1) -> Array:
        """lam (batch, K, ma[, count]) of AAᵀ lam = rhs."""
        linear, (batch, K) = self._linear, self.shape
        if rhs.shape[:3] != (batch, K, linear.ma) or rhs.ndim > 4:
            raise ShapeError("rhs", rhs.shape, f"{(batch, K, linear.ma)}, or with one more axis of columns")
        lam = linear.device.empty(rhs.shape)
        if linear.ma == 0:
            return lam
        rhs = linear.device.xp.ascontiguousarray(rhs)
        self._once(rhs, lam, False)
        for _ in range(refine):  # the residual uses A itself: AAᵀ squares its rounding
            x = linear.rows_transposed_times(self.A, lam)
            self._once(linear.rows_times(self.A, x, rhs, -1.0), lam, True)
        return lam

    def least_norm(self, rhs: Array, *, refine: int = 1) -> Array:
        """The shortest x (batch, K, nc[, count]) with A x = rhs (batch, K, ma[, count])."""
        return self._linear.rows_transposed_times(self.A, self.solve(rhs, refine=refine))

    def multipliers(self, gradient: Array, *, refine: int = 1) -> Array:
        """lam (batch, K, ma) of the smallest ‖gradient + Aᵀ lam‖."""
        return self.solve(self._linear.rows_times(self.A, gradient, None, -1.0), refine=refine)

    def project(self, v: Array, *, refine: int = 1) -> Array:
        """P v = v − Aᵀ(AAᵀ)⁻¹A v, the part of v (batch, K, nc[, count]) in the null space of A."""
        lam = self.solve(self._linear.rows_times(self.A, v), refine=refine)
        return self._linear.rows_transposed_times(self.A, lam, v, -1.0)

    def _once(self, rhs: Array, lam: Array, more: bool) -> None:
        (batch, K), linear, columns = self.shape, self._linear, _columns(rhs)
        D = self._reduced.D
        r = linear.device.empty((batch, D, self._reduced.B, columns))
        linear.each("octo_gram_join", (D, batch), K, columns, self._finite, self._scale, rhs, r)
        x = self._reduced.solve(r)
        linear.each("octo_gram_part", (D, batch), K, columns, int(more), self._finite, self._scale, x, lam)


@dataclass(frozen=True)
class DeviceBlocks(KKTBlocks):
    """``KKTBlocks`` whose products are kernels."""

    linear: Linear

    def hessian_times(self, v: Array, sigma: Array | None = None) -> Array:
        product = self.linear.hessian_times(self.H, v)
        return product if sigma is None else product + sigma[:, :, None] * v

    def constraints_times(self, v: Array) -> Array:
        return self.linear.rows_times(self.A, v)

    def constraints_transposed_times(self, lam: Array) -> Array:
        return self.linear.rows_transposed_times(self.A, lam)
