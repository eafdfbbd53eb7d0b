"""The heights that a motion sampled of its ground, for pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array


@dataclass(frozen=True)
class Heights:
    """Heights z (a, b) m over x (a,) and y (b,) m, linear between; by their border beyond it."""

    x: Array
    y: Array
    z: Array

    @staticmethod
    def of(ground: Mapping[str, Array]) -> Heights | None:
        """Those of ``Solution.ground``; None: it has none."""
        return Heights(*(ground[axis] for axis in "xyz")) if ground else None

    def height(self, points: Array) -> Array:
        """(...) m under points (..., 2 or 3)."""
        (i, s), (j, t) = _place(self.x, points[..., 0]), _place(self.y, points[..., 1])
        low, high = ((1 - t) * self.z[k, j] + t * self.z[k, j + 1] for k in (i, i + 1))
        return np.asarray((1 - s) * low + s * high)

    def drop(self, points: Array) -> Array:
        """(...) m between the lowest and highest of four samples around points (..., 2 or 3), less
        what it is on a slope of 45°."""
        (i, _), (j, _) = _place(self.x, points[..., 0]), _place(self.y, points[..., 1])
        around = np.stack([self.z[k, m] for k in (i, i + 1) for m in (j, j + 1)])
        level = max(float(np.diff(self.x).max()), float(np.diff(self.y).max()))
        return np.asarray(np.ptp(around, axis=0) - level)

    @property
    def flat(self) -> bool:
        """Whether all of it is one plane."""
        spread = (np.ptp(np.diff(self.z, axis=axis), axis=axis) for axis in (0, 1))
        return all(float(values.max(initial=0.0)) < 1e-6 for values in spread)


def _place(grid: Array, value: Array) -> tuple[NDArray[np.intp], Array]:
    """Index of the interval of ``grid`` that holds ``value``, and where in it (0…1)."""
    index = np.clip(np.searchsorted(grid, value, side="right") - 1, 0, len(grid) - 2)
    return index, np.clip((value - grid[index]) / (grid[index + 1] - grid[index]), 0.0, 1.0)
