"""The KKT matrices of a batch on a device: equilibrated, factored, solved with refinement."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from octo.errors import ShapeError
from octo.gpu.device import Array
from octo.gpu.linear import PARTS, SLICES, Linear, Reduction, columns_of
from octo.solver.cyclic_reduction import EQUILIBRATIONS, ROUNDING, SHIFT


@dataclass(frozen=True, eq=False)
class Solving:
    """One right-hand side and what is known of its solution: fixed arrays, so that a refinement can
    be launched again.

    v, lam: the solution. left_v, left_c: what is left of the right-hand side (rhs_v, rhs_c; None:
    zero). tops (batch, K, columns, 2): of each unit the largest entries of the one and of the
    other. first, residual (batch, columns): the ratio of their maxima without refinement and after
    the last one, of the members that had one. coarse (batch,): 1 where the ratio is above the
    tolerance: the members that a refinement works on.
    """

    rhs_v: Array
    rhs_c: Array | None
    v: Array
    lam: Array
    left_v: Array
    left_c: Array
    tops: Array
    first: Array
    residual: Array
    coarse: Array
    tolerance: float

    @property
    def columns(self) -> int:
        return columns_of(self.v)

    @classmethod
    def of(
        cls,
        linear: Linear,
        rhs_v: Array,
        rhs_c: Array | None,
        tolerance: float,
        out: tuple[Array, ...] | None = None,
    ) -> Solving:
        """For a right-hand side (batch, K, nc[, count]), (batch, K, ma[, count]); ``out``: v, lam,
        first and residual."""
        device, columns, (batch, K) = linear.device, columns_of(rhs_v), rhs_v.shape[:2]
        if out is None:
            multipliers = (batch, K, linear.ma, *rhs_v.shape[3:])
            shapes = (rhs_v.shape, multipliers, (batch, columns), (batch, columns))
            out = tuple(map(device.empty, shapes))
        v, lam, first, residual = out
        lefts = device.empty(v.shape), device.empty(lam.shape)
        tops, coarse = device.empty((batch, K, columns, 2)), device.empty((batch,), np.int32)
        given = (rhs_v, rhs_c if linear.ma else None)
        return cls(*given, v, lam, *lefts, tops, first, residual, coarse, tolerance)


class DeviceFactor:
    """A factored batch of KKT matrices on a device, whose solutions and inertia mean what those of
    ``CyclicReductionFactor`` do.

    sigma (batch, K) or None; H, A and sigma are held by reference. active (batch,): the members to
    factor; None: all. Everything here is launches: nothing waits for the device. (batch,): finite
    is 1 where the matrix is, good where its inertia is right; negative and shifted are counts.
    """

    def __init__(
        self, linear: Linear, H: Array, A: Array, sigma: Array | None, active: Array | None = None
    ):
        self._linear, self._held = linear, (H, A, sigma)
        device = linear.device
        batch, K = int(H.shape[0]), int(H.shape[1])
        self.shape = (batch, K, linear.nc, linear.ma)
        D, B = -(-K // 2), 2 * (linear.nc + linear.ma)
        grid, one = (D, batch), (1, batch)
        diagonal, lower = device.empty((batch, D, B, B)), device.empty((batch, max(D - 1, 1), B, B))
        blocks = device.empty((batch, D), np.int32)
        linear.each("octo_kkt_blocks", grid, K, active, H, A, sigma, diagonal, lower, blocks)
        self.finite, self.good, self.negative, self.shifted = (
            device.empty((batch,), np.int32) for _ in range(4)
        )
        linear.each("octo_kkt_finite", one, D, active, blocks, self.finite, threads=PARTS)
        scales: list[Array] = [None, *(device.empty((batch, D, B)) for _ in range(EQUILIBRATIONS))]
        for old, new in pairwise(scales):
            own = (active, diagonal, lower, old, new)
            linear.each("octo_kkt_equilibrate", grid, *own, shared=8 * SLICES * B)
        self._scale = scales[-1]
        linear.each("octo_kkt_scale", grid, active, self.finite, self._scale, diagonal, lower)
        self._reduced = Reduction(linear, "kkt", diagonal, lower, ROUNDING, SHIFT, active)
        given = (D, K, active, self.finite, self._reduced.counts)
        found = (self.good, self.negative, self.shifted)
        linear.each("octo_kkt_verdict", one, *given, *found, threads=PARTS, shared=16 * PARTS)
        self.residual: Array | None = None

    @property
    def usable(self) -> Array:
        """(batch,) where the matrix is finite."""
        return self.finite != 0

    @property
    def inertia_ok(self) -> Array:
        """True (batch,) where the Hessian is positive definite on the null space of the
        constraints."""
        return self.good != 0

    def solve(
        self,
        rhs_v: Array,
        rhs_c: Array | None = None,
        *,
        refine: int = 3,
        tolerance: float = 1e-10,
        check: bool = True,
    ) -> tuple[Array, Array]:
        """dv (batch, K, nc[, count]), lam (batch, K, ma[, count]); arguments as in
        ``EliminationFactor.solve``.

        A member is refined where its residual asks for it, which the device decides: all ``refine``
        refinements are launched.
        """
        batch, K, nc, ma = self.shape
        if rhs_v.shape[:3] != (batch, K, nc):
            raise ShapeError(
                "rhs_v", rhs_v.shape, f"{(batch, K, nc)}, or with one more axis of columns"
            )
        if rhs_c is not None and rhs_c.shape != (batch, K, ma, *rhs_v.shape[3:]):
            raise ShapeError("rhs_c", rhs_c.shape, (batch, K, ma, *rhs_v.shape[3:]))
        xp = self._linear.device.xp
        rhs_c = None if rhs_c is None else xp.ascontiguousarray(rhs_c)
        solving = Solving.of(self._linear, xp.ascontiguousarray(rhs_v), rhs_c, tolerance)
        self.begin(solving)
        for _ in range(refine):
            self.refine(solving)
        self.residual = solving.first
        if refine:
            self.residual = xp.where(solving.first > tolerance, solving.residual, solving.first)
        return solving.v, solving.lam

    def begin(self, solving: Solving, usable: Array | None = None) -> None:
        """The solution without refinement, and its residual; NaN for members that are not
        ``usable`` (finite, unless given)."""
        self._once(solving, (solving.rhs_v, solving.rhs_c), None, usable)
        self._check(solving, solving.first, None)

    def refine(self, solving: Solving, usable: Array | None = None) -> None:
        """One refinement of the members that are coarse, and their residual."""
        self._once(solving, (solving.left_v, solving.left_c), solving.coarse, usable)
        self._check(solving, solving.residual, solving.coarse)

    def _check(self, s: Solving, residual: Array, active: Array | None) -> None:
        linear, (batch, K, nc, ma) = self._linear, self.shape
        arrays = (s.rhs_v, s.rhs_c, s.v, s.lam, s.left_v, s.left_c, s.tops)
        grid, room = (K, batch, s.columns), 8 * (SLICES + 2) * (nc + ma)
        linear.each(
            "octo_kkt_residual", grid, active, *self._held, *arrays, threads=PARTS, shared=room
        )
        own = (K, s.columns, s.tolerance, active, s.tops, residual, s.coarse)
        linear.each("octo_kkt_check", (1, batch), *own, threads=PARTS, shared=16 * PARTS)

    def _once(
        self,
        s: Solving,
        rhs: tuple[Array, Array | None],
        active: Array | None,
        usable: Array | None,
    ) -> None:
        """Solve for ``rhs``: the solution, or what is added to that of the active members."""
        linear, (batch, K, _, ma), D = self._linear, self.shape, self._reduced.D
        usable = self.finite if usable is None else usable
        r = linear.device.empty((batch, D, self._reduced.B, s.columns))
        sizes, rhs_v, rhs_c = (K, s.columns), rhs[0], None if ma == 0 else rhs[1]
        own = (active, usable, self._scale)
        linear.each("octo_kkt_join", (D, batch), *sizes, *own, rhs_v, rhs_c, r)
        x, more = self._reduced.solve(r, active), int(active is not None)
        linear.each("octo_kkt_part", (D, batch), *sizes, more, *own, x, s.v, s.lam)
