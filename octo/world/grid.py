"""A grid of signed distances: φ is the C² tricubic spline through its samples (lattice.py)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from octo.checks import Array, numbers, positive
from octo.errors import ShapeError, ValueRangeError
from octo.world import lattice, spline
from octo.world.shape import FRACTION, Kind, Shape, fixed
from octo.world.units import check_size

OVERSHOOT = 1.25  # of the slopes of a spline through samples over those of the samples
STEEPEST = 3.0  # m in 1 m: distances by voxels are off by a cell, and change by 1 m in 1 m


def text() -> str:
    return spline.text("grid.c")


KIND = Kind("grid", text, lattice.jets)


@dataclass(frozen=True, eq=False)
class DistanceGrid(Shape):
    """Signed distances at the samples of a grid, negative inside, with all samples kept.

    φ passes through the samples and is twice continuously differentiable everywhere. Where a
    distance has a kink (in front of an inner edge, and at the surface's own edges) φ is rounded
    over two cells to each side, by less than a quarter of one, and a third at corners. Outside of
    the grid it is what it is at the nearest point of the grid, plus the way there along the axes:
    what is solid at a side of the grid ends there, with a slope of 45°.

    Parameters
    ----------
    values: (nx, ny, nz) m, at least 2 of each.
    cell: m, between two samples.
    origin: (3,) m, of ``values[0, 0, 0]`` in its frame.
    scale: metres of what values, cell and origin are in.
    position, rotation, name: see Shape.

    Raises
    ------
    ValueRangeError, ShapeError: a value that is NaN, a cell that is not positive, a grid larger
        than 200 m or smaller than 5 cm, values that are no distances, or all positive.
    """

    values: ArrayLike
    cell: float
    origin: ArrayLike = (0.0, 0.0, 0.0)
    scale: float = 1.0
    kind: ClassVar[Kind] = KIND

    def __post_init__(self) -> None:
        super().__post_init__()
        values = numbers(f"values of {self.label}", self.values)
        if values.ndim != 3 or min(values.shape) < 2:
            allowed = "(nx, ny, nz) with at least 2 of each"
            raise ShapeError(f"values of {self.label}", values.shape, allowed)
        positive(f"cell of {self.label}", self.cell, "m")
        origin = numbers(f"origin of {self.label}", self.origin, (3,))
        object.__setattr__(self, "origin", fixed(origin))
        scale = positive(f"scale of {self.label}", self.scale)
        check_size(self.label, self._cell * (np.array(values.shape) - 1), scale)
        object.__setattr__(self, "values", fixed(values))
        steepest = max(float(np.abs(np.diff(values, axis=axis)).max()) for axis in range(3))
        if steepest > STEEPEST * self.cell:
            raise ValueRangeError(
                f"values of {self.label} change by {steepest / self.cell:.3g} m in 1 m, must be "
                "distances, which change by at most 1 m in 1 m: are values and cell in one unit?"
            )
        if not (values <= 0.0).any():
            raise ValueRangeError(
                f"values of {self.label} are all positive, the least is {values.min():g}: nothing "
                "in it is solid, or it is thinner than a cell"
            )

    @property
    def _cell(self) -> float:
        return self.scale * self.cell

    @property
    def _corner(self) -> Array:
        return self.scale * np.asarray(self.origin, dtype=float)

    @cached_property
    def own(self) -> Array:
        values = self.scale * np.asarray(self.values)
        return lattice.dense(values, self._cell, self._corner).numbers()

    @cached_property
    def _box(self) -> Array:
        """own_bounds: see there."""
        values = self.scale * np.asarray(self.values)
        edge = self._corner + self._cell * (np.array(values.shape) - 1)
        solid = np.argwhere(values <= 0.0)
        low, high = (
            self._corner + self._cell * (end(solid, axis=0) + side)
            for side, end in ((-1.0, np.min), (1.0, np.max))
        )
        axes = [self._corner[k] + self._cell * np.arange(n) for k, n in enumerate(values.shape)]
        away = [
            np.maximum(np.maximum(low[k] - axes[k], axes[k] - high[k]), 0.0) ** 2 for k in range(3)
        ]
        least = np.sqrt(away[0][:, None, None] + away[1][:, None] + away[2])
        if (values < FRACTION * least).any():  # distances that are cut off, for one
            low, high = self._corner - self._cell, edge + self._cell
        for axis in range(3):  # what is solid at a side goes on as deep as it is there
            sides = np.moveaxis(values, axis, 0)[[0, -1]]
            depths = np.maximum(-sides.min(axis=(1, 2)), 0.0)
            if depths[0] > 0.0:
                low[axis] = min(low[axis], self._corner[axis] - depths[0] - 2.0 * self._cell)
            if depths[1] > 0.0:
                high[axis] = max(high[axis], edge[axis] + depths[1] + 2.0 * self._cell)
        return np.stack([low, high])

    def own_bounds(self) -> Array:
        return self._box

    @property
    def steepest(self) -> float:
        values = np.asarray(self.values)
        slopes = [np.abs(np.diff(values, axis=k)).max() / self.cell for k in range(3)]
        return float(OVERSHOOT * np.linalg.norm(np.maximum(slopes, 1.0)))  # outside 1 a metre
