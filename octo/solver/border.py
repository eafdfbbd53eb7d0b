"""Border columns: a few unknowns and rows that all units share (a free final time, a speed, a
period, a mass) beside the block-tridiagonal KKT matrix T of Eq. 12.

    [[T, B], [Bᵀ, D]] [y; z] = [f; g],  S = D − Bᵀ T⁻¹ B,  z = S⁻¹ (g − Bᵀ T⁻¹ f),
    y = T⁻¹ f − (T⁻¹ B) z

T is factored as without a border, by any factor of ``kkt``, and solved once for the w columns of B.
The inertia of the whole is that of T plus that of S (Haynsworth 1968). So T itself must not be
singular: rows that only the border makes independent belong into the border.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from octo.arrays import Array, array_module, largest
from octo.errors import ShapeError
from octo.solver import blas, kkt
from octo.solver.blocks import KKTBlocks, columns_of, of_members, refined, spread_sigma, turned
from octo.solver.cyclic_reduction import ROUNDING


@dataclass(frozen=True, eq=False)
class Border:
    """Columns of a batch: w of them, the shared unknowns first and then the multipliers of the
    shared rows.
    """

    # (batch, K, nc, w), their part of B beside the variables of each unit: d²E/dv dz, and the
    # slopes of the shared rows, turned
    over_variables: Array
    over_rows: Array  # (batch, K, ma, w), beside the rows of C: dC/dz, zero for the shared rows
    corner: Array  # (batch, w, w) D, symmetric
    residual: Array  # (batch, w) the gradient of E over the shared unknowns, the rows' values
    lam: Array  # (batch, rows) the multipliers of the shared rows at the iterate

    @property
    def rows(self) -> int:
        """How many of the w are rows."""
        return int(self.lam.shape[-1])

    @property
    def width(self) -> int:
        """w."""
        return int(self.corner.shape[-1])

    @property
    def unknowns(self) -> int:
        """How many of the w are unknowns."""
        return self.width - self.rows

    def take(self, members: NDArray[np.intp]) -> Border:
        """The border of some members."""
        return Border(*(getattr(self, field.name)[members] for field in fields(self)))

    def check(self, H: Array, A: Array) -> None:
        """Refuse a border of other sizes than those of the blocks."""
        (batch, K, _, nc, _), ma, w = H.shape, A.shape[3], self.width
        beside = ((batch, K, nc, w), (batch, K, ma, w))
        shapes = (*beside, (batch, w, w), (batch, w), (batch, self.rows))
        for field, shape in zip(fields(self), shapes, strict=True):
            own = getattr(self, field.name).shape
            if own != shape:
                raise ShapeError(f"{field.name} of the border", own, shape)

    def transposed_times(self, dv: Array, lam: Array) -> Array:
        """Bᵀ (dv, lam): (batch, w, count) of (batch, K, nc, count) and (batch, K, ma, count)."""
        of_variables = turned(_flat(self.over_variables)) @ _flat(dv)
        return of_variables + turned(_flat(self.over_rows)) @ _flat(lam)

    def times(self, z: Array) -> tuple[Array, Array]:
        """B z, of the variables and of the rows, for z (batch, w, count)."""
        return self.over_variables @ z[:, None], self.over_rows @ z[:, None]

    def dual(self, blocks: KKTBlocks, lam: Array) -> Array:
        """(batch,) ‖∇E + Aᵀlam‖∞ over all unknowns and rows, the shared ones too."""
        xp, shared = array_module(lam), self.lam[..., None]
        own = blocks.b + blocks.constraints_transposed_times(lam)
        own = own + (self.over_variables[..., self.unknowns :] @ shared[:, None])[..., 0]
        across = turned(_flat(self.over_rows)) @ _flat(lam[..., None])
        across = across + self.corner[..., self.unknowns :] @ shared
        corner = (self.residual + across[..., 0])[:, : self.unknowns]
        return xp.maximum(largest(own), largest(corner))


class BorderedFactor:
    """A factored batch of KKT matrices with a border. T is any factor of ``kkt`` or of a device;
    T, blocks, sigma and border are held by reference.

    negative (batch,): eigenvalues below zero, and those of S that are rounding, beyond one for each
    row, shared rows included; usable (batch,): can solve, neither T nor S is singular; the others
    are ``KKTFactor``'s, of the whole.
    """

    def __init__(
        self, factor: kkt.KKTFactor, blocks: KKTBlocks, sigma: float | Array | None, border: Border
    ):
        border.check(blocks.H, blocks.A)
        xp = array_module(blocks.H)
        self._factor, self._blocks, self._sigma = factor, blocks, sigma
        self.border, self._corner = border, _regularised(border, sigma, blocks.H)
        # T⁻¹ B: it decides about S, so it is refined as far as it goes
        self._columns: tuple[Array, Array] = (border.over_variables, border.over_rows)
        if border.width:
            self._columns = factor.solve(*self._columns, tolerance=1e-14)
        usable = xp.asarray(factor.usable)
        self._vectors, values = self._complement(usable)
        rounding = xp.abs(values) <= ROUNDING
        below = (rounding | (values < 0.0)).sum(axis=1) - border.rows
        self._inverse = 1.0 / xp.where(rounding, xp.inf, values)
        self.usable = usable & ~rounding.any(axis=1)
        self.negative = xp.where(usable, factor.negative + below, xp.maximum(factor.negative, 1))
        self.inertia_ok = self.usable & (self.negative == 0)
        self.residual = xp.full((blocks.batch, 1), xp.nan)

    def _complement(self, usable: Array) -> tuple[Array, Array]:
        """Eigenvectors and eigenvalues of S, scaled by what it was the difference of: an eigenvalue
        that rounding may have left is then small beside 1."""
        border, xp = self.border, array_module(self._corner)
        if not border.width:
            return border.corner, border.residual
        products, size = border.transposed_times(*self._columns), xp.abs(self._corner)
        S = self._corner - 0.5 * (products + turned(products))
        parts = (border.over_variables, border.over_rows)
        for part, column in zip(parts, self._columns, strict=True):
            size = size + turned(_flat(xp.abs(part))) @ _flat(xp.abs(column))
        top = xp.maximum(size, turned(size)).max(axis=2)
        finite = usable & xp.isfinite(S).all(axis=(1, 2))
        top = xp.where(finite[:, None] & (top > 0.0), top, 1.0)
        scale = 1.0 / xp.sqrt(top)
        S = xp.where(finite[:, None, None], S, xp.eye(border.width))
        with blas.one_thread():
            values, vectors = xp.linalg.eigh(scale[:, :, None] * S * scale[:, None, :])
        return scale[:, :, None] * vectors, values

    @property
    def first_bad(self) -> Array:
        """(batch,) the first bad unit of T, −1 for none."""
        return self._factor.first_bad

    def solve(
        self,
        rhs_v: Array,
        rhs_c: Array | None = None,
        rhs_border: Array | None = None,
        *,
        refine: int = 3,
        tolerance: float = 1e-10,
        check: bool = False,
    ) -> tuple[Array, Array, Array]:
        """dv (batch, K, nc[, count]), lam (batch, K, ma[, count]) and z (batch, w[, count]) of a
        right-hand side; parts that are None are zero, the rest as in ``KKTFactor.solve``."""
        blocks, shape = self._blocks, (self._blocks.batch, self._blocks.units)
        count = int(rhs_v.shape[3]) if rhs_v.ndim == 4 else 1
        wanted = [
            columns_of("rhs_v", rhs_v, (*shape, blocks.nc, count), rhs_v),
            columns_of("rhs_c", rhs_c, (*shape, blocks.ma, count), rhs_v),
            columns_of("rhs_border", rhs_border, (shape[0], self.border.width, count), rhs_v),
        ]
        how = (refine, tolerance, check)
        found, self.residual = refined(self._once, self._residual, wanted, *how)
        dv, lam, z = (of_members(self.usable, part, np.nan) for part in found)
        return (dv, lam, z) if rhs_v.ndim == 4 else (dv[..., 0], lam[..., 0], z[..., 0])

    def _once(self, rhs_v: Array, rhs_c: Array, rhs_border: Array) -> list[Array]:
        """The solution without refinement of the whole."""
        alone = self._factor.solve(rhs_v, rhs_c)
        dv, lam = (of_members(self.usable, part, 0.0) for part in alone)
        left = rhs_border - self.border.transposed_times(dv, lam)
        z = self._vectors @ (self._inverse[..., None] * (turned(self._vectors) @ left))
        v, rows = (of_members(self.usable, part, 0.0) for part in self._columns)
        return [dv - v @ z[:, None], lam - rows @ z[:, None], z]

    def _residual(
        self, dv: Array, lam: Array, z: Array, rhs_v: Array, rhs_c: Array, rhs_border: Array
    ) -> list[Array]:
        v, rows = self._blocks.residual(dv, lam, self._sigma, rhs_v, rhs_c)
        of_variables, of_rows = self.border.times(z)
        corner = rhs_border - self.border.transposed_times(dv, lam) - self._corner @ z
        return [v - of_variables, rows - of_rows, corner]


def factorize(
    H: Array,
    A: Array,
    border: Border,
    sigma: float | Array | None = None,
    *,
    method: kkt.Method = "auto",
    stop: bool = True,
    threads: int = 1,
) -> BorderedFactor:
    """``kkt.factorize`` with a border.

    sigma: also on the diagonal of the shared unknowns, the least of a member's units. stop: without
    shared rows. With them T alone may have a negative eigenvalue too many for each: the whole is
    right where S has one too few.
    """
    factor = kkt.factorize(
        H, A, sigma, method=method, stop=stop and not border.rows, threads=threads
    )
    xp, (batch, K, _, nc, _) = array_module(H), H.shape
    blocks = KKTBlocks(H, A, xp.zeros((batch, K, nc)), xp.zeros((batch, K, A.shape[3])))
    return BorderedFactor(factor, blocks, sigma, border)


def _regularised(border: Border, sigma: float | Array | None, H: Array) -> Array:
    """D with the weight of its member on the diagonal of the unknowns."""
    if sigma is None or not border.unknowns:
        return border.corner
    own = array_module(H).arange(border.unknowns)
    corner = border.corner.copy()
    corner[:, own, own] += spread_sigma(sigma, H).min(axis=(1, 2))[:, None]
    return corner


def _flat(part: Array) -> Array:
    """(batch, K, size, count) -> (batch, K·size, count)."""
    batch, K, size, count = part.shape
    return part.reshape(batch, K * size, count)
