"""KKT factors of a batch at one iterate, each member's with its own weight, and the steps they
give."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from octo.arrays import Array, Numbers, array_module, every, host, inner, largest, like, some
from octo.problem.evaluation import Evaluation
from octo.solver import kkt
from octo.solver.blocks import KKTBlocks
from octo.solver.border import Border, BorderedFactor
from octo.solver.border import factorize as bordered
from octo.solver.options import SqpOptions

Three = tuple[Numbers, Numbers, Numbers]


@dataclass(eq=False)
class Attempt:
    """A KKT step with its multipliers, and what decides about it."""

    delta: Array  # (batch, K, nc) Δ
    multipliers: Array  # (batch, K, ma)
    _numbers: Callable[[], Three]
    # at Δ times its first length, where it came in one copy with the numbers
    trial: Evaluation | None = None
    # (batch, w) of a border, the step of the shared unknowns and the multipliers of the shared rows
    shared: Array | None = None

    @cached_property
    def numbers(self) -> Three:
        """‖Δ‖∞ of each unit (batch, K), ‖b + Aᵀlam‖∞ (batch,) of the iterate and bᵀΔ (batch,), on
        the host; the last two count a border."""
        return self._numbers()

    @cached_property
    def largest(self) -> Numbers:
        """(batch,) ‖Δ‖∞."""
        return host(largest(self.delta)) if self.trial is None else self.numbers[0].max(axis=1)


class Factors(Protocol):
    """What a backend offers at one iterate."""

    def clear(self) -> None:
        """Forget what was factored."""

    def add(self, members: NDArray[np.bool_], weight: Numbers) -> NDArray[np.bool_]:
        """Factor [[H + diag(weight), Aᵀ], [A, 0]] of some members (batch,), weight (batch, K):
        where the inertia is right."""

    def solve(self, rhs_v: Array, rhs_c: Array) -> tuple[Array, ...]:
        """Solutions (batch, K, nc), (batch, K, ma) of the right-hand side; NaN for members without
        a factor."""

    def attempt(
        self,
        rhs_c: Array | None,
        limit: Numbers | float,
        cap: float,
        members: NDArray[np.bool_] | None = None,
    ) -> Attempt:
        """The step with the right-hand side (−b, rhs_c). Its first length is min(limit, cap /
        ‖Δ‖∞), limit (batch,).

        rhs_c: None is −C, asked for before any other. members (batch,): those that it is for; None:
        all.
        """


class HostFactors:
    """On the CPU: only the members that are asked for are factored, and no trial is evaluated
    before it is wanted. border: columns beside the blocks, if any."""

    def __init__(
        self,
        blocks: KKTBlocks,
        lam: Array,
        options: SqpOptions,
        threads: int,
        border: Border | None = None,
    ):
        self.blocks, self._lam, self._options, self._threads = blocks, lam, options, threads
        self.border = border
        # members factored together, which are good, their factor
        self.groups: list[tuple[Numbers, Numbers, Any]] = []

    def clear(self) -> None:
        self.groups = []

    def add(self, members: NDArray[np.bool_], weight: Numbers) -> NDArray[np.bool_]:
        H, A, border, own = self.blocks.H, self.blocks.A, self.border, np.flatnonzero(members)
        if not every(members):
            H, A, weight = H[own], A[own], weight[own]
            border = None if border is None else border.take(own)
        how: Any = {"method": self._options.linear_solver, "threads": self._threads}
        factor: kkt.KKTFactor | BorderedFactor
        if border is None:
            factor = kkt.factorize(H, A, weight, **how)
        else:
            factor = bordered(H, A, border, weight, **how)
        found, good = np.zeros(len(members), dtype=bool), host(factor.inertia_ok)
        found[own] = good
        if some(good):
            self.groups.append((own, good, factor))
        return found

    def solve(
        self, rhs_v: Array, rhs_c: Array, rhs_border: Array | None = None
    ) -> tuple[Array, ...]:
        """With a border also (batch, w), of the right-hand side ``rhs_border`` (batch, w)."""
        rhs = [rhs_v, rhs_c] if rhs_border is None else [rhs_v, rhs_c, rhs_border]
        if len(self.groups) == 1 and len(self.groups[0][0]) == len(rhs_v):
            return self.groups[0][2].solve(*rhs)
        shared = [] if self.border is None else [self.border.residual]
        found = tuple(array_module(p).full(p.shape, np.nan) for p in (rhs_v, rhs_c, *shared))
        for members, good, factor in self.groups:
            own, solved, kept = (
                like(index, rhs_v) for index in (members, members[good], np.flatnonzero(good))
            )
            for whole, part in zip(found, factor.solve(*(p[own] for p in rhs)), strict=True):
                whole[solved] = part[kept]
        return found

    def attempt(
        self,
        rhs_c: Array | None,
        limit: Numbers | float,
        cap: float,
        members: NDArray[np.bool_] | None = None,
    ) -> Attempt:
        blocks, border, lam = self.blocks, self.border, self._lam
        rhs = [-blocks.b, -blocks.C if rhs_c is None else rhs_c]
        if border is not None:
            rhs.append(-border.residual)
        delta, multipliers, *shared = self.solve(*rhs)

        def numbers() -> Three:
            slope = inner(blocks.b, delta)
            if border is None:
                dual = largest(blocks.b + blocks.constraints_transposed_times(lam))
            else:
                own = border.unknowns
                slope = slope + inner(border.residual[:, :own], shared[0][:, :own])
                dual = border.dual(blocks, lam)
            return host(abs(delta).max(axis=2)), host(dual), host(slope)

        return Attempt(delta, multipliers, numbers, shared=shared[0] if shared else None)
