"""Block cyclic reduction, and products with H and A of a batch on a device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from octo.dynamics.codegen import macros
from octo.gpu.device import WIDE, Array, Device, Kernels, source
from octo.solver.blocks import KKTBlocks

PARTS = 128
# entries and threads along the edge of a tile of a product; threads that share a sum
TILE, EDGE, SLICES = 48, 16, 4


def sizes(nc: int, ma: int, shared: int) -> str:
    """What the kernels know of units of nc variables and ma constraint rows, and of a GPU whose
    blocks have ``shared`` bytes."""
    known = {"NCV": nc, "MAV": ma, "SHARED_BYTES": shared}
    return macros(known | {"WIDE": WIDE, "TILE": TILE, "EDGE": EDGE, "SLICES": SLICES})


def text(nc: int, ma: int, shared: int) -> str:
    """The CUDA text of ``sizes``."""
    files = ("common.cuh", "pivots.cu", "linear.cu", "kkt.cu", *(("gram.cu",) if ma else ()))
    kinds = {"kkt": 2 * (nc + ma), "gram": 2 * ma}
    reductions = [
        source("reduction.cu").replace("NAME_BLOCK", str(B)).replace("NAME", name)
        for name, B in kinds.items()
        if B
    ]
    return "\n".join([sizes(nc, ma, shared), *map(source, files), *reductions])


def pivot_threads(B: int) -> int:
    """Of a pivot block: a thread has about 9 of its entries."""
    return min(512, max(32, 32 * (-(-B * B // 288))))


def pivot_room(B: int, shared: int) -> int:
    """Bytes of shared memory of a pivot block: PIVOT_BYTES of pivots.cu and, where there is room,
    the block itself."""
    scratch = 8 * 4 * 32 + 40 * B
    return scratch + 8 * B * B if scratch + 8 * B * B <= shared else scratch


class Linear(Kernels):
    """The kernels for units of nc variables and ma constraint rows."""

    def __init__(self, device: Device, nc: int, ma: int):
        super().__init__(device, text(nc, ma, device.shared_limit))
        self.nc, self.ma = nc, ma

    def hessian_times(self, H: Array, v: Array) -> Array:
        """H v for v (batch, K, nc[, count])."""
        out = self.device.empty(v.shape)
        self.each("octo_hessian_times", (v.shape[1], v.shape[0]), columns_of(v), H, v, out)
        return out

    def rows_times(
        self, A: Array, v: Array, base: Array | None = None, factor: float = 1.0
    ) -> Array:
        """base + factor A v."""
        out = self.device.empty((*v.shape[:2], self.ma, *v.shape[3:]))
        if self.ma:
            given = (columns_of(v), float(factor), A, base, v)
            self.each("octo_rows_times", (v.shape[1], v.shape[0]), *given, out)
        return out

    def rows_transposed_times(
        self, A: Array, lam: Array, base: Array | None = None, factor: float = 1.0
    ) -> Array:
        """base + factor Aᵀ lam."""
        out = self.device.empty((*lam.shape[:2], self.nc, *lam.shape[3:]))
        given = (columns_of(lam), float(factor), A, base, lam)
        self.each("octo_rows_transposed_times", (lam.shape[1], lam.shape[0]), *given, out)
        return out

    def step_numbers(self, A: Array, b: Array, delta: Array, lam: Array, out: Array) -> None:
        """out (batch, K, 3) of each unit: ‖Δ‖∞, ‖b + Aᵀlam‖∞, bᵀΔ."""
        own = (A, b, delta, lam, out)
        grid, room = (b.shape[1], b.shape[0]), 24 * PARTS
        self.each("octo_step_numbers", grid, *own, threads=PARTS, shared=room)

    def advance(
        self, bounds: Array, numbers: Array, at: Array, delta: Array, unknowns: Array
    ) -> None:
        """unknowns = at + length delta of each member, length = min(limit, cap / ‖Δ‖∞).

        bounds (batch, 2) are limit and cap, numbers those of ``step_numbers``.
        """
        own = (bounds, numbers, at, delta, unknowns)
        grid, room = (at.shape[1], at.shape[0]), 8 * PARTS
        self.each("octo_advance", grid, *own, threads=PARTS, shared=room)

    def negative(self, v: Array, out: Array) -> None:
        """out = −v."""
        self.flat("octo_negative", v.size, v, out)

    def unit_sizes(self, C: Array, sizes: Array) -> None:
        """sizes (batch, K) = ‖C‖₁ of each unit."""
        self.flat("octo_unit_sizes", sizes.size, C, sizes)


def columns_of(v: Array) -> int:
    """Columns of a right-hand side (batch, K, size[, count])."""
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

    def given(self, active: Array | None) -> tuple[Any, ...]:
        """What its kernels begin with."""
        return self.D, self.first, active, self.half, self.sign, self.left, self.right


class Reduction:
    """A factored SBT(D, B): diagonal (batch, D, B, B) is overwritten, lower (batch, D-1, B, B).

    counts (batch, D, 2): negative and rounding eigenvalues of the pivot blocks, in the order of
    elimination. active (batch,): the members to factor, None for all.
    """

    def __init__(
        self,
        linear: Linear,
        name: str,
        diagonal: Array,
        lower: Array,
        rounding: float,
        shift: float,
        active: Array | None = None,
    ):
        self._linear, self._name = linear, name
        device = linear.device
        batch, D, B, _ = diagonal.shape
        self.batch, self.D, self.B = int(batch), int(D), int(B)
        self.counts = device.empty((batch, D, 2), np.int32)
        self._levels: list[_Level] = []
        self._given = (float(rounding), float(shift), active)
        place = 0
        while D > 1:
            eliminated = D // 2
            diagonal, lower = self._eliminate(D, place, diagonal, lower)
            place, D = place + eliminated, D - eliminated
        self._last = self._pivots(1, 0, 1, place, diagonal)

    def _pivots(
        self, D: int, first: int, count: int, place: int, diagonal: Array
    ) -> tuple[Array, Array]:
        """T (batch, count, B, B) and the signs of every other of D blocks; ``place`` in counts."""
        device, batch, B = self._linear.device, self.batch, self.B
        half, sign = device.empty((batch, count, B, B)), device.empty((batch, count, B))
        rounding, shift, active = self._given
        own = (D, first, rounding, shift, self.D, place, active, diagonal, half, sign, self.counts)
        room = pivot_room(B, device.shared_limit)
        self._each("pivots", (count, batch), *own, threads=pivot_threads(B), shared=room)
        return half, sign

    def _eliminate(self, D: int, place: int, diagonal: Array, lower: Array) -> tuple[Array, Array]:
        """Every other of D blocks; what is left of the others: diagonal and lower."""
        device, batch, B, active = self._linear.device, self.batch, self.B, self._given[2]
        first = D % 2
        E = (D - first) // 2
        S = D - E
        tiles = (-(-B // TILE)) ** 2
        products = {"threads": EDGE * EDGE, "shared": 16 * TILE * (TILE + 1)}
        half, sign = self._pivots(D, first, E, place, diagonal)
        left, right = device.empty((batch, E, B, B)), device.empty((batch, E, B, B))
        grid = (E * tiles, 2, batch)
        self._each("couple", grid, D, first, active, lower, half, left, right, **products)
        new = device.empty((batch, S, B, B))
        new_lower = device.empty((batch, max(S - 1, 1), B, B))
        own = (D, first, active, diagonal, sign, left, right, new, new_lower)
        self._each("complement", (S * tiles, 2, batch), *own, **products)
        self._levels.append(_Level(D, first, half, sign, left, right))
        return new, new_lower

    def _each(self, name: str, grid: tuple[int, ...], *arguments: Any, **room: int) -> None:
        self._linear.each(f"octo_{self._name}_{name}", grid, *arguments, **room)

    def solve(self, r: Array, active: Array | None = None) -> Array:
        """x (batch, D, B, columns), without refinement, of all members or of the active ones."""
        device, batch, B = self._linear.device, self.batch, self.B
        columns, held = int(r.shape[3]), []
        for level in self._levels:
            S = level.D // 2 + level.first
            w = device.empty((batch, level.D - S, B, columns))
            folded = device.empty((batch, S, B, columns))
            room = 8 * (2 + 2 * SLICES) * B
            self._each("fold", (S, batch, columns), *level.given(active), r, w, folded, shared=room)
            held.append(w)
            r = folded
        x, room = device.empty((batch, 1, B, columns)), 8 * (1 + SLICES) * B
        self._each("last", (1, batch, columns), active, *self._last, r, x, shared=room)
        for level, w in zip(reversed(self._levels), reversed(held), strict=True):
            unfolded = device.empty((batch, level.D, B, columns))
            own = (*level.given(active), w, x, unfolded)
            self._each("unfold", (level.D, batch, columns), *own, shared=room)
            x = unfolded
        return x


@dataclass(frozen=True)
class DeviceBlocks(KKTBlocks):
    """``KKTBlocks`` whose products are kernels."""

    linear: Linear

    def hessian_times(self, v: Array, sigma: Array | None = None) -> Array:
        product = self.linear.hessian_times(self.H, v)
        if sigma is None:
            return product
        return product + sigma.reshape(*sigma.shape, *(1,) * (v.ndim - 2)) * v

    def constraints_times(self, v: Array) -> Array:
        return self.linear.rows_times(self.A, v)

    def constraints_transposed_times(self, lam: Array) -> Array:
        return self.linear.rows_transposed_times(self.A, lam)
