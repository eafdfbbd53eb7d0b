"""What the coordinates of a soft body say: where its frame and its surface are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from octo.checks import Array, numbers
from octo.errors import ProblemError, ShapeError, said
from octo.model.body import floating_base
from octo.model.chart import Chart
from octo.soft.body import Body

CHARTS = ("zyx", "zxy")


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Of a body: x, y, z of its frame (m), three angles of the chart (rad), outermost first, then
    z_1 … z_r of its modes (kg^½ m). The frame is at the centre of mass, however the body bends.

    Parameters
    ----------
    body: what bends.
    chart: "zyx" or "zxy".
    actuated: which modes have motors, counted from 0; all by default.

    Raises
    ------
    ProblemError: names the argument and what is allowed.
    """

    body: Body
    chart: Chart = "zyx"
    actuated: Sequence[int] | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.body, Body):
            raise ProblemError(f"body is {said(self.body)}, must be an octo.soft.Body")
        if self.chart not in CHARTS:
            raise ProblemError(f"chart is {said(self.chart)}, must be zyx or zxy")
        modes = range(self.body.modes.shape[1])
        driven = tuple(modes) if self.actuated is None else tuple(int(k) for k in self.actuated)
        if not set(driven) <= set(modes) or len(set(driven)) != len(driven):
            allowed = f"different modes of 0…{len(modes) - 1}"
            raise ProblemError(f"actuated is {list(driven)}, must be {allowed}")
        object.__setattr__(self, "actuated", driven)

    def same_as(self, other: Coordinates) -> bool:
        """Whether both say the same of x and u."""
        own, its = self.body, other.body
        return (
            (self.chart, self.actuated) == (other.chart, other.actuated)
            and np.array_equal(own.points, its.points)
            and np.array_equal(own.modes, its.modes)
        )

    @property
    def count(self) -> int:
        """6 + r."""
        return 6 + self.body.modes.shape[1]

    @property
    def names(self) -> tuple[str, ...]:
        """Of the coordinates, in their order."""
        base = [joint.name for joint in floating_base(chart=self.chart)]
        return (*base, *(f"mode_{k}" for k in range(1, self.count - 5)))

    @property
    def driven(self) -> NDArray[np.intp]:
        """(nu,) the coordinates that have motors."""
        return np.array(self.actuated, dtype=np.intp) + 6

    def rotation(self, x: Array) -> Array:
        """(k, 3, 3) of the frame, at x (k, n)."""
        turns = Rotation.from_euler(self.chart.upper(), np.asarray(x)[:, 3:6])
        return np.asarray(turns.as_matrix())

    def surface(self, x: Array) -> Array:
        """The points of the surface (k, P, 3) m, world.

        Parameters
        ----------
        x: (k, n); ``solution.x`` is such.

        Raises
        ------
        ShapeError: another number of coordinates.
        """
        x = numbers("x", x)
        if x.ndim != 2 or x.shape[1] != self.count:
            raise ShapeError("x", x.shape, f"(k, {self.count})")
        own = self.body.points + self.body.moved(x[:, 6:])
        return np.asarray(own @ self.rotation(x).swapaxes(1, 2) + x[:, None, :3])
