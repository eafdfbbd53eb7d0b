"""The bounds of rows: where a slack may stand between them, and how far a row is from its slack."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from octo.arrays import Array, array_module, like
from octo.solver.bounds import Slacks

INSIDE = 1e-2  # how far from a bound a slack starts, in parts of max(1, |bound|) and of the room
PART = 0.99  # of the way to a bound, or of a multiplier to zero, that one step may go
# a slack to a bound: in parts of μ/z where it is to end, but no nearer and no further than this
RELATIVE, NEAREST, FURTHEST = 1e-2, 1e-13, 1e-8


@dataclass(frozen=True, eq=False)
class Limits:
    """Bounds of rows, (batch, N, rows), infinite where there is none."""

    lower: Array
    upper: Array

    @cached_property
    def equal(self) -> Array:
        """Where both are the same."""
        return self.lower == self.upper

    @cached_property
    def low(self) -> Array:
        """Where there is a lower one, of its own."""
        return array_module(self.lower).isfinite(self.lower) & ~self.equal

    @cached_property
    def high(self) -> Array:
        return array_module(self.lower).isfinite(self.upper) & ~self.equal

    @cached_property
    def used(self) -> Array:
        return self.equal | self.low | self.high

    @cached_property
    def sides(self) -> Array:
        """(batch,) how many bounds there are, at least 1."""
        xp = array_module(self.lower)
        count = xp.where(self.low, 1.0, 0.0) + xp.where(self.high, 1.0, 0.0)
        return xp.maximum(count.reshape(len(count), -1).sum(axis=1), 1.0)

    def gaps(self, s: Array) -> tuple[Array, Array]:
        """s − lower and upper − s; 1 where there is no bound."""
        xp = array_module(s)
        below = xp.where(self.low, s - self.lower, 1.0)
        return below, xp.where(self.high, self.upper - s, 1.0)

    def inside(self, rows: Array) -> Array:
        """Slacks near ``rows`` and strictly inside (Wächter and Biegler 2006, §3.6)."""
        xp = array_module(rows)
        room = xp.where(self.low & self.high, self.upper - self.lower, np.inf)
        ends = []
        for has, bound, sign in ((self.low, self.lower, 1.0), (self.high, self.upper, -1.0)):
            own = xp.where(has, bound, 0.0)
            away = INSIDE * xp.minimum(xp.maximum(1.0, abs(own)), room)
            ends.append(xp.where(has, own + sign * away, -sign * np.inf))
        return xp.where(self.equal, xp.where(self.equal, self.lower, 0.0), xp.clip(rows, *ends))

    def box(self, own: Slacks, mu: Array, gaps: tuple[Array, Array]) -> tuple[Array, Array]:
        """Between what slacks may be after a step from their ``own`` with these ``gaps``; mu
        (batch, 1, 1)."""
        xp, near = array_module(own.s), []
        for gap, z in zip(gaps, (own.lower, own.upper), strict=True):
            end = RELATIVE * mu / xp.maximum(z, 1e-300)
            near.append(xp.maximum((1.0 - PART) * gap, xp.clip(end, NEAREST, FURTHEST)))
        least = xp.where(self.low, self.lower + near[0], -np.inf)
        most = xp.where(self.high, self.upper - near[1], np.inf)
        bound = xp.where(self.equal, self.lower, 0.0)
        return xp.where(self.equal, bound, least), xp.where(self.equal, bound, most)

    def residual(self, rows: Array, s: Array) -> Array:
        """r − s, zero where a row has no bound."""
        return array_module(rows).where(self.used, rows - s, 0.0)

    def beyond(self, rows: Array) -> Array:
        """(batch,) by how much a row misses its bounds at most; negative where all have room."""
        off = array_module(rows).maximum(self.lower - rows, rows - self.upper)
        return off.reshape(len(off), -1).max(axis=1)

    def select(self, members: NDArray[np.intp]) -> Limits:
        chosen = like(members, self.lower)
        return Limits(self.lower[chosen], self.upper[chosen])
