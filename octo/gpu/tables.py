"""Where each number of H, A, b and C comes from: the stencil of a basis turned round, so that a unit can gather its sums."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from octo.problem.basis import Stencil

Integers = NDArray[np.int32]
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Gather:
    """Sums in compressed rows: entries first[k] … first[k+1] − 1 belong to place k, in the order of the steps."""

    first: Integers
    step: Integers
    node: Integers  # of the step: 0 next, 1 now, 2 previous; 3 a + b for two of them
    value: Array

    @classmethod
    def of(cls, places: int, entries: list[tuple[int, int, int, float]]) -> Gather:
        """From (place, step, node, value), which come in the order of the steps."""
        place = np.array([entry[0] for entry in entries], dtype=np.int64)
        order = np.argsort(place, kind="stable")
        first = np.concatenate([[0], np.cumsum(np.bincount(place, minlength=places))]).astype(np.int32)
        step, node = (np.array([entry[k] for entry in entries], dtype=np.int32)[order] for k in (1, 2))
        return cls(first, step, node, np.array([entry[3] for entry in entries], dtype=float)[order])


@dataclass(frozen=True, eq=False)
class Tables:
    """hessian: places (unit, lag, part, part); gradient: (unit, part); jacobian: (row unit, lag, row part, part);
    tests: (unit, part)."""

    hessian: Gather
    gradient: Gather
    jacobian: Gather
    tests: Gather

    @classmethod
    def of(cls, stencil: Stencil, steps: int) -> Tables:
        parts, units = stencil.parts, stencil.units
        hessian, gradient, jacobian, tests = [], [], [], []
        for i in range(steps):
            slots = list(_slots(stencil, i))
            for a, unit, part, value in slots:
                gradient.append((unit * parts + part, i, a, value))
                for b, other, other_part, other_value in slots:
                    if other <= unit:
                        place = ((unit * 3 + unit - other) * parts + part) * parts + other_part
                        hessian.append((place, i, 3 * a + b, value * other_value))
            for k in np.flatnonzero(stencil.test_row[i] >= 0):
                row, row_part = int(stencil.test_row[i, k]), int(stencil.test_part[i, k])
                test = float(stencil.test_coefficient[i, k])
                tests.append((row * parts + row_part, i, 0, test))
                for a, unit, part, value in slots:
                    jacobian.append((((row * 3 + row - unit) * parts + row_part) * parts + part, i, a, test * value))
        places = units * 3 * parts * parts
        return cls(
            Gather.of(places, hessian), Gather.of(units * parts, gradient),
            Gather.of(places, jacobian), Gather.of(units * parts, tests),
        )  # fmt: skip


def _slots(stencil: Stencil, step: int) -> Iterator[tuple[int, int, int, float]]:
    """(node, unit, part, coefficient) of what the three nodes of a step are made of."""
    for node in range(3):
        row = step + 2 - node
        for k in np.flatnonzero(stencil.unit[row] >= 0):
            yield node, int(stencil.unit[row, k]), int(stencil.part[row, k]), float(stencil.coefficient[row, k])
