"""Blocks of the KKT system of Eq. 12, their products, and the SBT storage of appendix B.

A trajectory has K units; unit k is a variable block v_k (nc) and a multiplier block lam_k (ma). Row
block k of the Hessian and of the constraint Jacobian touches the variables k, k-1 and k-2 only.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from octo.arrays import array_module
from octo.errors import ShapeError

Array = Any  # numpy.ndarray or cupy.ndarray


@dataclass(frozen=True)
class KKTBlocks:
    """[[H + diag(sigma), Aᵀ], [A, 0]] [dv; lam] = [-b; -C] of a batch of problems.

    H (batch, K, 3, nc, nc): H[:, k, o] = d²E/dv_k dv_{k-o}, zero where k < o, symmetric for o = 0.
    A (batch, K, 3, ma, nc): A[:, k, o] = dC_k/dv_{k-o}, zero where k < o.
    b (batch, K, nc): gradient of E. C (batch, K, ma): constraint residual.
    """

    H: Array
    A: Array
    b: Array
    C: Array

    @property
    def batch(self) -> int:
        """Number of problems."""
        return int(self.H.shape[0])

    @property
    def units(self) -> int:
        """K, the number of units of each problem."""
        return int(self.H.shape[1])

    @property
    def nc(self) -> int:
        """Variables of a unit."""
        return int(self.H.shape[3])

    @property
    def ma(self) -> int:
        """Constraint rows of a unit."""
        return int(self.A.shape[3])

    def hessian_times(self, v: Array, sigma: Array | None = None) -> Array:
        """(H + diag(sigma)) v for v (batch, K, nc) or (batch, K, nc, count)."""
        product = block_times(self.H, v) + transposed_times(self.H, v, first=1)
        if sigma is None:
            return product
        weight = spread_sigma(sigma, self.H)
        return product + (weight if v.ndim == 3 else weight[..., None]) * v

    def constraints_times(self, v: Array) -> Array:
        """A v (batch, K, ma) for v (batch, K, nc), or with one more axis of columns."""
        return block_times(self.A, v)

    def constraints_transposed_times(self, lam: Array) -> Array:
        """Aᵀ lam (batch, K, nc) for lam (batch, K, ma), or with one more axis of columns."""
        return transposed_times(self.A, lam)

    def residual(
        self,
        dv: Array,
        lam: Array,
        sigma: Array | None = None,
        rhs_v: Array | None = None,
        rhs_c: Array | None = None,
    ) -> tuple[Array, Array]:
        """Right-hand side minus KKT matrix times (dv, lam); the right-hand side is (-b, -C) unless
        given."""
        stationarity = (-self.b if rhs_v is None else rhs_v) - self.hessian_times(dv, sigma)
        feasibility = (-self.C if rhs_c is None else rhs_c) - self.constraints_times(dv)
        return stationarity - self.constraints_transposed_times(lam), feasibility

    def sbt(self, sigma: Array | None = None) -> SBT:
        """The KKT matrix as SBT(2(nc+ma)): units paired and interleaved, an odd K padded by an
        identity unit."""
        xp, (batch, K, nc, ma) = array_module(self.H), (self.batch, self.units, self.nc, self.ma)
        u, even = nc + ma, K + K % 2
        unit = xp.zeros((3, batch, even, u, u))  # unit[o, :, k] couples unit k to unit k - o
        for o in range(3):
            unit[o, :, o:K, :nc, :nc] = self.H[:, o:, o]
            unit[o, :, o:K, nc:, :nc] = self.A[:, o:, o]
        unit[0, :, :K, :nc, nc:] = turned(self.A[:, :, 0])
        if sigma is not None:
            diagonal = xp.arange(nc)
            unit[0][:, :K, diagonal, diagonal] += spread_sigma(sigma, self.H)
        unit[0, :, K:] = xp.eye(u)
        diagonals = xp.zeros((batch, even // 2, 2 * u, 2 * u))
        diagonals[:, :, :u, :u] = unit[0, :, 0::2]
        diagonals[:, :, u:, u:] = unit[0, :, 1::2]
        diagonals[:, :, u:, :u] = unit[1, :, 1::2]
        diagonals[:, :, :u, u:] = turned(unit[1, :, 1::2])
        lower = xp.zeros((batch, even // 2 - 1, 2 * u, 2 * u))
        lower[:, :, :u, :u] = unit[2, :, 2::2]
        lower[:, :, :u, u:] = unit[1, :, 2::2]
        lower[:, :, u:, u:] = unit[2, :, 3::2]
        return SBT(diagonals, lower)


@dataclass(frozen=True)
class SBT:
    """Symmetric block-tridiagonal matrix: diagonal (batch, D, B, B), lower (batch, D-1, B, B) =
    block (i+1, i)."""

    diagonal: Array
    lower: Array

    def times(self, x: Array) -> Array:
        """The matrix times x (batch, D, B, count)."""
        product = self.diagonal @ x
        product[:, 1:] += self.lower @ x[:, :-1]
        product[:, :-1] += turned(self.lower) @ x[:, 1:]
        return product


def interleave(v: Array, lam: Array) -> Array:
    """(batch, K, nc, count), (batch, K, ma, count) -> (batch, D, B, count) in the order of
    ``KKTBlocks.sbt``."""
    xp = array_module(v)
    units = xp.concatenate([v, lam], axis=2)
    if v.shape[1] % 2:
        units = xp.concatenate([units, xp.zeros_like(units[:, :1])], axis=1)
    return units.reshape(v.shape[0], units.shape[1] // 2, 2 * units.shape[2], v.shape[3])


def separate(x: Array, units: int, nc: int) -> tuple[Array, Array]:
    """Undo ``interleave``: (batch, D, B, count) -> v (batch, K, nc, count), lam (batch, K, ma,
    count)."""
    both = x.reshape(x.shape[0], 2 * x.shape[1], x.shape[2] // 2, x.shape[3])[:, :units]
    return both[:, :, :nc], both[:, :, nc:]


def refined(
    once: Callable[..., Sequence[Array]],
    residual: Callable[..., Sequence[Array]],
    wanted: Sequence[Array],
    refine: int,
    tolerance: float,
    check: bool,
) -> tuple[Sequence[Array], Array]:
    """``once`` of the right-hand side's parts ``wanted``, refined while ``residual`` of what was
    found and them exceeds ``tolerance``; and that residual (batch, count), relative."""
    xp, size = array_module(wanted[0]), _largest(wanted)
    size = xp.where(size > 0.0, size, 1.0)
    found, reached = once(*wanted), xp.full(size.shape, xp.nan)
    for step in range(refine + 1):
        if step == refine and not check:
            break
        left = residual(*found, *wanted)
        reached = _largest(left) / size
        coarse = (reached > tolerance).any(axis=1)
        if step == refine or not bool(coarse.any()):
            break
        # of the coarse members only: no member depends on another
        pairs = zip(found, once(*left), strict=True)
        found = [of_members(coarse, part + more, part) for part, more in pairs]
    return found, reached


def columns_of(name: str, part: Array | None, shape: tuple[int, ...], like: Array) -> Array:
    """A part of a right-hand side with its axis of columns, as ``like`` has one; zeros for None."""
    if part is None:
        return array_module(like).zeros(shape)
    given = part if like.ndim == 4 else part[..., None]
    if given.shape != shape:
        raise ShapeError(name, part.shape, shape if like.ndim == 4 else shape[:-1])
    return given


def check_blocks(H: Array, A: Array) -> None:
    """Refuse what is not in lag storage."""
    if H.ndim != 5 or H.shape[2] != 3 or H.shape[3] != H.shape[4]:
        raise ShapeError("H", H.shape, "(batch, K, 3, nc, nc)")
    if A.ndim != 5 or A.shape[:3] != H.shape[:3] or A.shape[4] != H.shape[4]:
        raise ShapeError("A", A.shape, "(batch, K, 3, ma, nc)")


def of_members(members: Array, part: Array, other: Array | float) -> Array:
    """``part`` of the members (batch,), ``other`` elsewhere."""
    return array_module(part).where(members.reshape(-1, *(1,) * (part.ndim - 1)), part, other)


def turned(blocks: Array) -> Array:
    """The blocks transposed."""
    return array_module(blocks).swapaxes(blocks, -1, -2)


def _largest(parts: Sequence[Array]) -> Array:
    """(batch, count) the largest entry of all parts."""
    xp = array_module(parts[0])
    tops = [xp.abs(part).max(axis=tuple(range(1, part.ndim - 1))) for part in parts if part.size]
    return xp.stack(tops).max(axis=0)


def spread_sigma(sigma: Array, H: Array) -> Array:
    """A scalar, (batch,), (batch, K) or (batch, K, nc) weight as (batch, K, nc)."""
    xp = array_module(H)
    sigma = xp.asarray(sigma, dtype=float)
    return xp.broadcast_to(
        sigma.reshape(sigma.shape + (1,) * (3 - sigma.ndim)), (*H.shape[:2], H.shape[3])
    )


def block_times(blocks: Array, v: Array) -> Array:
    """sum_o blocks[:, k, o] v_{k-o}."""
    columns = v if v.ndim == 4 else v[..., None]
    product = blocks[:, :, 0] @ columns
    for o in (1, 2):
        product[:, o:] += blocks[:, o:, o] @ columns[:, :-o]
    return product if v.ndim == 4 else product[..., 0]


def transposed_times(blocks: Array, w: Array, first: int = 0) -> Array:
    """sum_{o >= first} blocks[:, k+o, o]ᵀ w_{k+o}."""
    xp = array_module(blocks)
    columns = w if w.ndim == 4 else w[..., None]
    product = xp.zeros((*columns.shape[:2], blocks.shape[4], columns.shape[3]))
    for o in range(first, 3):
        product[:, : blocks.shape[1] - o] += turned(blocks[:, o:, o]) @ columns[:, o:]
    return product if w.ndim == 4 else product[..., 0]
