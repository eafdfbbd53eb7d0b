"""A map of heights: φ = z − h(x, y), h a C² bicubic spline through the samples.

The numbers of a map are samples in x and y, 1/cell, the place of the first sample, and the spline's
coefficients, so that a map of any size is looked up by the same code (heights.c; ``jets`` without a
compiler).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from octo.checks import Array, flag, numbers, positive
from octo.errors import ShapeError
from octo.world import spline
from octo.world.jet import AXES, SIZES
from octo.world.shape import Kind, Shape, fixed, places
from octo.world.units import check_size

HEAD = 5  # numbers before the coefficients


def text() -> str:
    return spline.text("heights.c")


def jets(own: Array, points: Array, order: int) -> Array:
    """Jets (k, SIZES[order]) at points (k, 3) m of a map's frame."""
    sizes, inverse, corner = own[:2], own[2], own[3:HEAD]
    table = own[HEAD:].reshape(int(sizes[0]) + 2 * spline.BEYOND, -1)
    first, weights = [], []
    for axis in range(2):
        image = spline.images((points[:, axis] - corner[axis]) * inverse, sizes[axis])
        index, weight = spline.weights(image, sizes[axis], inverse)
        first.append(index[:, None] + np.arange(4))
        weights.append(weight)
    around = table[first[0][:, :, None], first[1][:, None, :]]
    height = np.einsum("kab,kaf,kbe->kfe", around, *weights)
    found = np.zeros((len(points), SIZES[order]))
    for k, axes in enumerate(AXES[: SIZES[order]]):
        if 2 not in axes:
            found[:, k] = -height[:, axes.count(0), axes.count(1)]
    found[:, 0] += points[:, 2]
    if order > 0:
        found[:, 3] = 1.0
    return found


@dataclass(frozen=True, eq=False)
class HeightField(Shape):
    """A map of heights, with everything below them solid.

    φ is the height of a point above the map, z − h(x, y), and not its distance, which is φ/√(1 +
    |∇h|²) on an even slope: what uses φ normalises ∇φ. h is twice continuously
    differentiable. Beyond the map it goes on, smoothly, to what it is one cell from the edge:
    ``covers`` says which points have a map under them.

    Parameters
    ----------
    heights: (nx, ny) m, samples along x and y, at least 2 of each.
    cell: m, between two samples.
    origin: (x, y) m, of ``heights[0, 0]`` in its frame.
    smooth: whether h passes near the samples in place of through them, which are then its
        B-spline's coefficients. A step between two samples rises over three cells, without the
        overshoot (of 11 % of the step) of a spline through the samples, and peaks are cut.
    scale: metres of what heights, cell and origin are in.
    position, rotation, name: see Shape.

    Raises
    ------
    ValueRangeError, ShapeError: a height that is NaN, a cell that is not positive, a map larger
        than 200 m or smaller than 5 cm.
    """

    heights: ArrayLike
    cell: float
    origin: ArrayLike = (0.0, 0.0)
    smooth: bool = False
    scale: float = 1.0
    kind: ClassVar[Kind] = Kind("heights", text, jets)

    def __post_init__(self) -> None:
        super().__post_init__()
        heights = numbers(f"heights of {self.label}", self.heights)
        if heights.ndim != 2 or min(heights.shape) < 2:
            raise ShapeError(
                f"heights of {self.label}", heights.shape, "(nx, ny) with at least 2 of each"
            )
        object.__setattr__(self, "heights", fixed(heights))
        positive(f"cell of {self.label}", self.cell, "m")
        origin = numbers(f"origin of {self.label}", self.origin, (2,))
        object.__setattr__(self, "origin", fixed(origin))
        flag(f"smooth of {self.label}", self.smooth)
        scale = positive(f"scale of {self.label}", self.scale)
        spans = [*(self.cell * (np.array(heights.shape) - 1.0)), np.ptp(heights)]
        check_size(self.label, scale * np.array(spans), scale)

    @cached_property
    def own(self) -> Array:
        heights = self.scale * np.asarray(self.heights)
        if self.smooth:
            along_x = spline.extended(heights)
            table = np.moveaxis(spline.extended(np.moveaxis(along_x, 1, 0)), 0, 1)
        else:
            table = spline.coefficients(heights)
        corner = self.scale * np.asarray(self.origin, dtype=float)
        return np.concatenate(
            [heights.shape, [1.0 / (self.scale * self.cell)], corner, table.ravel()]
        )

    def own_bounds(self) -> Array:
        # a spline lies within its coefficients
        return np.array([[-np.inf] * 3, [np.inf, np.inf, self.own[HEAD:].max()]])

    @property
    def steepest(self) -> float:
        # slopes of a spline lie within those of its coefficients
        shape = tuple(n + 2 * spline.BEYOND for n in np.shape(self.heights))
        table = self.own[HEAD:].reshape(shape)
        slopes = [np.abs(np.diff(table, axis=k)).max() * self.own[2] for k in range(2)]
        return float(np.sqrt(1.0 + np.sum(np.square(slopes))))

    def covers(self, points: ArrayLike) -> Array:
        given = (places(points) - np.asarray(self.position)) @ np.asarray(self.rotation)
        cells = (given[:, :2] / self.scale - np.asarray(self.origin)) / self.cell
        inside = (cells >= 0.0) & (cells <= np.array(np.shape(self.heights)) - 1.0)
        return np.asarray(inside.all(axis=1))
