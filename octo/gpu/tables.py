"""The stencil of a basis turned round: where each number of H, A, b and C comes from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array
from octo.dynamics.slots import BLOCKS
from octo.problem.basis import WINDOW, Slot, Stencil, slots_of

Integers = NDArray[np.int32]
# (3, 3) the block of a step's Hessian by its two nodes
BLOCK = np.array([[BLOCKS.index((min(a, b), max(a, b))) for b in range(3)] for a in range(3)])


@dataclass(frozen=True, eq=False)
class Gather:
    """Sums in compressed rows: entries first[k] … first[k+1] − 1 belong to place k, in the order of
    the steps.

    source: where in the array of all steps the block of n columns, or of n × n numbers, starts that
    an entry takes; ~ of it where the block is taken transposed. value (entries, width): its
    coefficient for each part of the place.
    """

    first: Integers
    source: Integers
    value: Array

    @classmethod
    def of(cls, places: int, width: int, entries: list[tuple[int, int, int, float]]) -> Gather:
        """From (place, source, part, value), which come in the order of the steps."""
        rows: dict[tuple[int, int], Array] = {}
        for place, source, part, value in entries:
            rows.setdefault((place, source), np.zeros(width))[part] += value
        keys = np.array(list(rows), dtype=np.int64).reshape(-1, 2)
        order = np.argsort(keys[:, 0], kind="stable")
        counts = np.bincount(keys[:, 0], minlength=places)
        first = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        values = np.array(list(rows.values())).reshape(-1, width)
        return cls(first, keys[order, 1].astype(np.int32), values[order])


Entry = tuple[int, int, int, float]  # place, source, part, value


def squares(slots: list[Slot], parts: int, source: NDArray[np.int_]) -> Iterator[Entry]:
    """What a window's second derivatives add to the places (unit, lag) of H, whose parts are pairs;
    ``source``: by two nodes."""
    for a, unit, part, value in slots:
        for b, other, other_part, other_value in slots:
            if other <= unit:
                pair = part * parts + other_part
                yield 3 * unit + unit - other, int(source[a, b]), pair, value * other_value


def gathers(stencil: Stencil, steps: int, n: int) -> dict[str, Gather]:
    """Places: (unit, lag) of "hessian" (N, 6, n, n) and, of the rows' units, "jacobian" (N, n, 3n),
    whose parts are pairs, that of the row first; unit of "gradient" (N, 3n); (unit, part) of
    "tests", whose sources are the steps.
    """
    parts, units = stencil.parts, stencil.units
    hessian: list[Entry] = []
    gradient, jacobian, tests = [], [], []
    for i in range(steps):
        slots, blocks = slots_of(stencil, i), (6 * i + BLOCK) * n * n
        hessian += squares(slots, parts, np.where(np.tri(3, dtype=bool).T, blocks, ~blocks))
        gradient += [(unit, (3 * i + a) * n, part, value) for a, unit, part, value in slots]
        for k in np.flatnonzero(stencil.test_row[i] >= 0):
            row, row_part = int(stencil.test_row[i, k]), int(stencil.test_part[i, k])
            test = float(stencil.test_coefficient[i, k])
            tests.append((row * parts + row_part, i, 0, test))
            for a, unit, part, value in slots:
                place, pair = 3 * row + row - unit, row_part * parts + part
                jacobian.append((place, (3 * n * i + a) * n, pair, test * value))
    return {
        "hessian": Gather.of(3 * units, parts**2, hessian),
        "gradient": Gather.of(units, parts, gradient),
        "jacobian": Gather.of(3 * units, parts**2, jacobian),
        "tests": Gather.of(units * parts, 1, tests),
    }


def pair_gathers(stencil: Stencil, steps: int, cycle: bool) -> dict[str, Gather]:
    """Where the blocks of H ("pairs") and b ("pairs_b") take what terms over two steps in a row
    have from: (step, node, other node) and (step, node) of the windows of four nodes, as one
    number."""
    hessian: list[Entry] = []
    gradient: list[Entry] = []
    places = np.arange(WINDOW**2).reshape(WINDOW, WINDOW)
    for i in range(0 if cycle else 1, steps):
        slots = slots_of(stencil, i, WINDOW)
        hessian += squares(slots, stencil.parts, WINDOW**2 * i + places)
        gradient += [(unit, WINDOW * i + a, part, value) for a, unit, part, value in slots]
    return {
        "pairs": Gather.of(3 * stencil.units, stencil.parts**2, hessian),
        "pairs_b": Gather.of(stencil.units, stencil.parts, gradient),
    }
