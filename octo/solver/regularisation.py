"""Factor the KKT matrix with the smallest weight sigma that gives it the right inertia.

An exact Hessian is indefinite. The weight is raised until the matrix has as many negative eigenvalues as constraints
and no more (Wächter and Biegler 2006, Algorithm IC), and remembered: the next iteration tries a third of it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from octo.arrays import Array, Numbers, array_module, host, like
from octo.solver.backend import CPU, Backend
from octo.solver.blocks import KKTBlocks
from octo.solver.options import SqpOptions

FLOOR = 1e-12  # always added: units that no term sees would leave zero pivots
SHRINK, GROW = 1.0 / 3.0, 8.0
LARGEST = 1e12


class Factors:
    """KKT factors of a batch, each member's with its own weight."""

    def __init__(self, blocks: KKTBlocks):
        self.blocks = blocks
        self.groups: list[tuple[Numbers, Numbers, Any]] = []  # members factored together, those that are good, their factor

    def solve(self, rhs_v: Array, rhs_c: Array) -> tuple[Array, Array]:
        """Solutions (batch, K, nc), (batch, K, ma) of the right-hand side; NaN for members without a factor."""
        if len(self.groups) == 1 and len(self.groups[0][0]) == len(rhs_v):
            return self.groups[0][2].solve(rhs_v, rhs_c)
        xp = array_module(rhs_v)
        dv, lam = xp.full(rhs_v.shape, xp.nan), xp.full(rhs_c.shape, xp.nan)
        for members, good, factor in self.groups:
            if good.any():
                own, solved, kept = (like(index, rhs_v) for index in (members, members[good], np.flatnonzero(good)))
                v, multipliers = factor.solve(rhs_v[own], rhs_c[own])
                dv[solved], lam[solved] = v[kept], multipliers[kept]
        return dv, lam


class Regularisation:
    """The weight of each member (batch,), remembered between iterations."""

    def __init__(self, batch: int, options: SqpOptions, backend: Backend = CPU):
        self.options, self.backend = options, backend
        self.last = np.zeros(batch)  # the last one that was needed, 0 before any was
        self.factorizations = np.zeros(batch, dtype=int)
        self.local = np.zeros((batch, 1))  # (batch, K) weights of single units, on top

    def take(self, members: Numbers) -> None:
        """Keep some members only."""
        self.last, self.factorizations, self.local = self.last[members], self.factorizations[members], self.local[members]

    def factorize(self, blocks: KKTBlocks, threads: int) -> tuple[Factors, Numbers, Numbers]:
        """The factors, the weights used (batch,), and where there is a factor (batch,) bool."""
        batch = blocks.batch
        factors, sigma = Factors(blocks), np.zeros(batch)
        pending, tries = np.arange(batch), 0
        while len(pending):
            whole = len(pending) == batch
            own = like(pending, blocks.H)
            H, A = (blocks.H, blocks.A) if whole else (blocks.H[own], blocks.A[own])
            weight = (sigma[pending] + FLOOR)[:, None] + self.local[pending]
            weight = np.ascontiguousarray(np.broadcast_to(weight, H.shape[:2]))
            factor = self.backend.factorize(H, A, weight, self.options, threads)
            self.factorizations[pending] += 1
            good = host(factor.inertia_ok)
            if good.any():
                factors.groups.append((pending, good, factor))
            pending = pending[~good]
            if not len(pending):
                break
            first = np.maximum(self.options.first_sigma, SHRINK * self.last[pending])
            sigma[pending] = first if tries == 0 else GROW * sigma[pending]
            pending = pending[sigma[pending] <= LARGEST]
            tries += 1
        needed = sigma > 0.0
        self.last[needed] = sigma[needed]
        has = np.zeros(batch, dtype=bool)
        for members, good, _ in factors.groups:
            has[members[good]] = True
        return factors, sigma, has
