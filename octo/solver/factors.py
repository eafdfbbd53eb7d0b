"""KKT factors of a batch at one iterate, each member's with its own weight, and the steps they
give."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from octo.arrays import Array, Numbers, array_module, every, host, inner, largest, like, some
from octo.problem.evaluation import Evaluation
from octo.solver import kkt
from octo.solver.blocks import KKTBlocks
from octo.solver.options import SqpOptions

Three = tuple[Numbers, Numbers, Numbers]


class Attempt:
    """A KKT step Δ (batch, K, nc) with its multipliers (batch, K, ma), and what decides about it.

    trial: the evaluation at Δ times its first length, where it came in one copy with the numbers;
    None: not evaluated yet. numbers: ‖Δ‖∞ of each unit (batch, K), ‖b + Aᵀlam‖∞ (batch,) of the
    iterate and bᵀΔ (batch,), on the host.
    """

    def __init__(
        self,
        delta: Array,
        multipliers: Array,
        numbers: Callable[[], Three],
        trial: Evaluation | None = None,
    ):
        self.delta, self.multipliers, self.trial, self._numbers = delta, multipliers, trial, numbers

    @cached_property
    def numbers(self) -> Three:
        return self._numbers()

    @cached_property
    def largest(self) -> Numbers:
        """(batch,) ‖Δ‖∞."""
        return host(largest(self.delta)) if self.trial is None else self.numbers[0].max(axis=1)


class Factors(Protocol):
    """What a backend offers at one iterate."""

    def clear(self) -> None:
        """Forget what was factored."""
        ...

    def add(self, members: NDArray[np.bool_], weight: Numbers) -> NDArray[np.bool_]:
        """Factor [[H + diag(weight), Aᵀ], [A, 0]] of some members (batch,), weight (batch, K):
        where the inertia is right."""
        ...

    def solve(self, rhs_v: Array, rhs_c: Array) -> tuple[Array, Array]:
        """Solutions (batch, K, nc), (batch, K, ma) of the right-hand side; NaN for members without
        a factor."""
        ...

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
        ...


class HostFactors:
    """On the CPU: only the members that are asked for are factored, and no trial is evaluated
    before it is wanted."""

    def __init__(self, blocks: KKTBlocks, lam: Array, options: SqpOptions, threads: int):
        self.blocks, self._lam, self._options, self._threads = blocks, lam, options, threads
        # members factored together, which are good, their factor
        self.groups: list[tuple[Numbers, Numbers, Any]] = []

    def clear(self) -> None:
        self.groups = []

    def add(self, members: NDArray[np.bool_], weight: Numbers) -> NDArray[np.bool_]:
        H, A, own = self.blocks.H, self.blocks.A, np.flatnonzero(members)
        if not every(members):
            H, A, weight = H[own], A[own], weight[own]
        factor = kkt.factorize(
            H, A, weight, method=self._options.linear_solver, threads=self._threads
        )
        found, good = np.zeros(len(members), dtype=bool), host(factor.inertia_ok)
        found[own] = good
        if some(good):
            self.groups.append((own, good, factor))
        return found

    def solve(self, rhs_v: Array, rhs_c: Array) -> tuple[Array, Array]:
        if len(self.groups) == 1 and len(self.groups[0][0]) == len(rhs_v):
            return self.groups[0][2].solve(rhs_v, rhs_c)
        xp = array_module(rhs_v)
        dv, lam = xp.full(rhs_v.shape, xp.nan), xp.full(rhs_c.shape, xp.nan)
        for members, good, factor in self.groups:
            own, solved, kept = (
                like(index, rhs_v) for index in (members, members[good], np.flatnonzero(good))
            )
            v, multipliers = factor.solve(rhs_v[own], rhs_c[own])
            dv[solved], lam[solved] = v[kept], multipliers[kept]
        return dv, lam

    def attempt(
        self,
        rhs_c: Array | None,
        limit: Numbers | float,
        cap: float,
        members: NDArray[np.bool_] | None = None,
    ) -> Attempt:
        blocks, lam = self.blocks, self._lam
        delta, multipliers = self.solve(-blocks.b, -blocks.C if rhs_c is None else rhs_c)

        def numbers() -> Three:
            dual = host(largest(blocks.b + blocks.constraints_transposed_times(lam)))
            return host(abs(delta).max(axis=2)), dual, host(inner(blocks.b, delta))

        return Attempt(delta, multipliers, numbers)
