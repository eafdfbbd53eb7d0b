"""The stencil of a basis turned round: where each number of H, A, b and C comes from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array
from octo.dynamics.slots import BLOCKS
from octo.problem.basis import Stencil

Integers = NDArray[np.int32]
BLOCK = {nodes: k for k, nodes in enumerate(BLOCKS)}  # of a step's Hessian


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


@dataclass(frozen=True, eq=False)
class Tables:
    """Places: (unit, lag) of hessian (N, 6, n, n) and, of the rows' units, jacobian (N, n, 3n),
    whose parts are pairs, that of the row first; unit of gradient (N, 3n); (unit, part) of tests,
    whose sources are the steps.
    """

    hessian: Gather
    gradient: Gather
    jacobian: Gather
    tests: Gather

    @classmethod
    def of(cls, stencil: Stencil, steps: int, n: int) -> Tables:
        parts, units = stencil.parts, stencil.units
        hessian, gradient, jacobian, tests = [], [], [], []
        for i in range(steps):
            slots = list(slots_of(stencil, i))
            for a, unit, part, value in slots:
                gradient.append((unit, (3 * i + a) * n, part, value))
                for b, other, other_part, other_value in slots:
                    if other <= unit:
                        block = (6 * i + BLOCK[min(a, b), max(a, b)]) * n * n
                        place, source = 3 * unit + unit - other, block if a <= b else ~block
                        pair = part * parts + other_part
                        hessian.append((place, source, pair, value * other_value))
            for k in np.flatnonzero(stencil.test_row[i] >= 0):
                row, row_part = int(stencil.test_row[i, k]), int(stencil.test_part[i, k])
                test = float(stencil.test_coefficient[i, k])
                tests.append((row * parts + row_part, i, 0, test))
                for a, unit, part, value in slots:
                    place, pair = 3 * row + row - unit, row_part * parts + part
                    jacobian.append((place, (3 * n * i + a) * n, pair, test * value))
        return cls(
            Gather.of(3 * units, parts**2, hessian),
            Gather.of(units, parts, gradient),
            Gather.of(3 * units, parts**2, jacobian),
            Gather.of(units * parts, 1, tests),
        )


def slots_of(stencil: Stencil, step: int, nodes: int = 3) -> Iterator[tuple[int, int, int, float]]:
    """(node, unit, part, coefficient) of what a step's nodes, or more of them, are made of; of a
    cycle x_{−2} is made of what x_{N−2} is."""
    for node in range(nodes):
        row = step + 2 - node if node < step + 3 else len(stencil.unit) - 3
        for k in np.flatnonzero(stencil.unit[row] >= 0):
            unit, part = int(stencil.unit[row, k]), int(stencil.part[row, k])
            yield node, unit, part, float(stencil.coefficient[row, k])
