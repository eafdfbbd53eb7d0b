"""The nodes of a phase that goes on where another one ended."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array
from octo.problem.basis import Basis, Stencil

BEFORE = 2  # nodes that a phase shares with the one before it: x_{−1} and x_0


@dataclass(frozen=True)
class Continued(Basis):
    """Every x_{-1}, x_0 … x_N is an unknown: the first two are those of the phase before
    (octo.problem.phased). FD_i stands in the rows of x_{i+1}; the rows of the first two stay
    empty."""

    def units(self, steps: int) -> int:
        return steps + BEFORE

    def stencil(self, steps: int) -> Stencil:
        unit = np.arange(steps + BEFORE, dtype=np.int32)[:, None]
        part, ones = np.zeros_like(unit), np.ones((steps + BEFORE, 1))
        tests = unit[BEFORE:].copy(), part[BEFORE:].copy(), ones[BEFORE:].copy()
        return Stencil(self.units(steps), 1, unit, part, ones, *tests)

    def constant(self, steps: int, x0: Array, x_previous: Array) -> Array:
        return np.zeros_like(super().constant(steps, x0, x_previous))

    def fit(self, nodes: Array) -> Array:
        return np.array(nodes, dtype=float)

    def fixed_end(self, steps: int, x_end: Array, v_end: Array, dt: float) -> dict[int, Array]:
        pinned = super().fixed_end(steps, x_end, v_end, dt)
        return {unit + BEFORE: value for unit, value in pinned.items()}


def chunks_behind(
    first: NDArray[np.int32], unit: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """First step (chunks+1,) and unit (chunks,) of the chunks of such a phase, of those of nodes
    without the units before them: a chunk without steps owns the first two units, which no step is
    the first to see."""
    zero = np.zeros(1, dtype=np.int32)
    return np.concatenate([zero, first]), np.concatenate([zero, unit + np.int32(BEFORE)])
