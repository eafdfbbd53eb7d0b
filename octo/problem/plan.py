"""Where the numbers of a time step go: sizes and tables of one basis and number of steps, without a
number of a problem."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array
from octo.problem.basis import Basis, Folded, Hermite, PairedNodes, Stencil
from octo.problem.continued import Continued, chunks_behind

Integers = NDArray[np.int32]
GROUP = 8  # steps that the dynamics take at a time, at most


@dataclass(frozen=True, eq=False)
class Plan:
    """Of problems with n coordinates, m of them without a motor.

    Attributes
    ----------
    stencil: what makes the nodes of the unknowns; pinned units are in none.
    fixed: units that are dummies of the KKT matrix.
    extra: unknowns of a unit that no node is made of (contact forces, activations), behind those
        that nodes are made of; they are free in pinned units too. Their terms write their blocks.
    extra_rows: rows of C of a unit on which no residual is tested, behind the others.
    """

    basis: Basis
    steps: int
    n: int
    m: int
    stencil: Stencil
    fixed: NDArray[np.intp]
    extra: int = 0
    extra_rows: int = 0

    @classmethod
    def of(cls, basis: Basis, steps: int, n: int, m: int, pinned: Collection[int] = ()) -> Plan:
        """``pinned``: units that are constants of the trajectory: those of a fixed last state."""
        stencil = basis.stencil(steps)
        fixed = [stencil.units - 1] if _carries_rows(basis, steps) else []
        live = ~np.isin(stencil.unit, sorted(pinned))
        free = replace(
            stencil,
            unit=np.where(live, stencil.unit, -1).astype(np.int32),
            coefficient=np.where(live, stencil.coefficient, 0.0),
        )
        return cls(basis, steps, n, m, free, np.array(sorted([*fixed, *pinned]), dtype=np.intp))

    @property
    def K(self) -> int:
        """Units."""
        return self.stencil.units

    @property
    def nodal(self) -> int:
        """Numbers of a unit that nodes are made of: the first ones."""
        return self.stencil.parts * self.n

    @property
    def nc(self) -> int:
        """Numbers of a unit."""
        return self.nodal + self.extra

    @property
    def tested(self) -> int:
        """Rows of C of a unit on which residuals are tested: the first ones."""
        return self.stencil.parts * self.m

    @property
    def ma(self) -> int:
        """Rows of C of a unit."""
        return self.tested + self.extra_rows

    @cached_property
    def idle(self) -> list[tuple[int, int]]:
        """(unit, part) that no node is made of, beside the fixed units: where nodes share units,
        of some numbers of steps."""
        return self.basis.idle(self.steps)

    @cached_property
    def test_matrix(self) -> Array:
        """(K·parts, N) Sᵀ of the test rows."""
        s = self.stencil
        matrix = np.zeros((s.units * s.parts, self.steps))
        for k in range(s.test_row.shape[1]):
            live = np.flatnonzero(s.test_row[:, k] >= 0)
            rows = s.test_row[live, k] * s.parts + s.test_part[live, k]
            matrix[rows, live] += s.test_coefficient[live, k]
        return matrix

    def unknowns(self, nodes: Array) -> Array:
        """(batch, K, nc) unknowns of a trajectory (batch, N+2, n); pinned and extra ones are
        zero."""
        fitted = self.basis.fit(nodes)
        fitted[:, self.fixed] = 0.0
        return np.ascontiguousarray(_widened(fitted, self.extra))

    def reduce(self, fd: Array, row_scale: Array) -> Array:
        """C (batch, K, ma) = (Sᵀ ⊗ I) of the unactuated rows of FD (batch, N, m), scaled (batch,
        m); extra rows are zero."""
        rows = np.matmul(self.test_matrix, fd * row_scale[:, None])
        return _widened(rows.reshape(len(fd), self.K, self.tested), self.extra_rows)

    def chunks(self, threads: int) -> tuple[Integers, Integers, Integers]:
        """First own step, unit and row of each chunk of neighbouring steps (see assemble.c)."""
        if isinstance(self.basis, Folded):  # both ends of the chain write to the same units
            zero = np.zeros(1, dtype=np.int32)
            return np.array([0, self.steps], dtype=np.int32), zero, zero
        q = self.basis.steps_per_segment if isinstance(self.basis, Hermite) else 1
        pieces, grain = self.steps // q, GROUP if q == 1 else 1
        groups = -(-pieces // grain)
        count = 1 if threads == 1 else max(1, min(4 * threads, groups // (3 if q > 1 else 1)))
        first = np.array([groups * c // count * grain for c in range(count)], dtype=np.int32)
        row = first + (1 if q > 1 else 0)
        unit = first.copy()
        if isinstance(self.basis, PairedNodes):  # the first unit that no step before it touches
            unit = row = (first + self.steps % 2 + 1) // 2
        unit[0] = row[0] = 0
        ends = np.append(first * q, self.steps).astype(np.int32)
        if isinstance(self.basis, Continued):
            ends, unit = chunks_behind(ends, unit)
            row = unit
        return ends, unit, row.astype(np.int32)

    @cached_property
    def carries_rows(self) -> bool:
        """Whether the last unit is no unknown at all: it has the rows that are left over."""
        return _carries_rows(self.basis, self.steps)

    @cached_property
    def still(self) -> NDArray[np.bool_]:
        """(K,) the units that nothing moves."""
        return np.isin(np.arange(self.K), self.fixed)

    def fill_dummies(self, H: Array) -> None:
        """The identity on what nothing moves, in H (batch, K, 3, nc, nc)."""
        size = self.nodal
        H[:, self.fixed, 0, :size, :size] = np.eye(size)
        if self.extra and self.carries_rows:
            H[:, -1, 0, size:, size:] = np.eye(self.extra)
        for unit, part in self.idle:
            own = np.arange(part * self.n, (part + 1) * self.n)
            H[:, unit, 0, own, own] = 1.0


def _carries_rows(basis: Basis, steps: int) -> bool:
    """Whether the last unit is no unknown at all: it has the rows that are left over."""
    return bool(basis.dummies(steps)[-1].all())


def _widened(values: Array, extra: int) -> Array:
    """(batch, K, size) with as many zeros more in each unit."""
    return np.pad(values, ((0, 0), (0, 0), (0, extra))) if extra else values
