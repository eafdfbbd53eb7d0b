"""Products R Δ of the bounded rows' derivatives with a step of the nodes, and Rᵀ w with weights of
the rows, out of what a linearisation keeps.

Of each time step a model keeps what may not be zero of the slopes of its bounded rows over (x_next,
x, x_prev, u), and of ∂u/∂(x_next, x, x_prev) of the motors that they look at: the chain rule
through the torques is left to the product. Slopes over nodes are as they are before a cycle carries
them back; the step of the nodes is what is carried. The text for C and CUDA is row_products.c of
this folder and row_products.cu of octo.gpu.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from octo.problem.lane_tables import tables_text

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class RowSlopes:
    """What is kept of a time step: slopes sorted by row, then numbers of FD's Jacobian by motor.

    Attributes
    ----------
    count: bounded rows. n: coordinates.
    entries: of each slope kept, its place among the derivatives of all rows over the state.
    rows, columns: of each slope kept, its bounded row and its column in (x_next, x, x_prev, u).
    motors: (T,) that a bounded row looks at. pulled: of each number of FD's Jacobian kept, its
        place in ``motors`` and its column in (x_next, x, x_prev).
    """

    count: int
    n: int
    entries: Indices
    rows: Indices
    columns: Indices
    motors: Indices
    pulled: tuple[Indices, Indices]

    @classmethod
    def of(
        cls, places: tuple[Indices, Indices], squares: int, count: int, pattern: NDArray[np.bool_]
    ) -> RowSlopes:
        """Of derivatives at ``places``, rows and columns; the first ``squares`` rows are not
        bounded, ``count`` others are. pattern (nu, 3n): where ∂u/∂(x_next, x, x_prev) is not
        zero."""
        (rows, columns), n = places, pattern.shape[1] // 3
        entries = np.flatnonzero(rows >= squares)
        entries = entries[np.argsort(rows[entries], kind="stable")]
        own = columns[entries]
        motors = np.unique(own[own >= 3 * n] - 3 * n)
        of_motor, column = np.nonzero(pattern[motors])
        return cls(count, n, entries, rows[entries] - squares, own, motors, (of_motor, column))

    @property
    def size(self) -> int:
        """Numbers that are kept of a step."""
        return len(self.entries) + len(self.pulled[0])

    @cached_property
    def places(self) -> Indices:
        """Columns of the slopes, one over torques as the place of its motor here, behind those
        over nodes."""
        places = self.columns.copy()
        over = places >= 3 * self.n
        places[over] = 3 * self.n + np.searchsorted(self.motors, places[over] - 3 * self.n)
        return places

    def tables(self) -> str:
        """C text of sizes and places."""
        of_motor, column = self.pulled
        sizes = {"NKEPT": len(self.entries), "MOTORS": len(self.motors), "NPULLED": len(column)}
        tables = {
            "kept_entry": self.entries,
            "kept_first": np.searchsorted(self.rows, np.arange(self.count + 1)),
            "kept_column": self.places,
            "pulled_motor": self.motors[of_motor],
            "pulled_first": np.searchsorted(of_motor, np.arange(len(self.motors) + 1)),
            "pulled_column": column,
        }
        return tables_text(sizes, tables, anew=True)

    def turned_tables(self) -> str:
        """C text of the same by columns, for products with Rᵀ in which each sum has one writer."""
        of_motor, column = self.pulled
        own, back = np.argsort(self.places, kind="stable"), np.argsort(column, kind="stable")
        width, count = 3 * self.n, 3 * self.n + len(self.motors)
        tables = {
            "turned_first": np.searchsorted(self.places[own], np.arange(count + 1)),
            "turned_entry": own,
            "turned_row": self.rows[own],
            "back_first": np.searchsorted(column[back], np.arange(width + 1)),
            "back_entry": back,
            "back_motor": of_motor[back],
        }
        return tables_text({}, tables)

    def c_text(self) -> str:
        """For assemble.c, after scatter.c."""
        own = (resources.files("octo.problem") / "row_products.c").read_text(encoding="utf-8")
        return f"{self.tables()}\n{own}"

    def packed(self, slopes: Array, torques: Array) -> Array:
        """(batch, N, size) what is kept: of ``slopes`` (batch, N, bounded rows, 3n + nu) and
        ∂u/∂(x_next, x, x_prev) ``torques`` (batch, N, nu, 3n)."""
        own = slopes[..., self.rows, self.columns]
        of_motor, column = self.pulled
        return np.concatenate([own, torques[:, :, self.motors[of_motor], column]], axis=-1)

    def products(self, kept: Array, moved: Array) -> Array:
        """(batch, N, bounded rows) R Δ in NumPy, ``moved`` (batch, N+2, n) being the step of the
        nodes."""
        batch, steps = kept.shape[:2]
        window = np.concatenate([moved[:, at : at + steps] for at in (2, 1, 0)], axis=-1)
        first, width = len(self.entries), 3 * self.n
        pulled = np.zeros((batch, steps, len(self.motors), width))
        pulled[:, :, self.pulled[0], self.pulled[1]] = kept[..., first:]
        whole = np.zeros((batch, steps, width + int(self.motors.max(initial=-1)) + 1))
        whole[..., :width] = window
        whole[..., width + self.motors] = (pulled @ window[..., None])[..., 0]
        parts = kept[..., :first] * whole[..., self.columns]
        out = np.zeros((self.count, batch, steps))
        np.add.at(out, self.rows, np.moveaxis(parts, -1, 0))
        return np.moveaxis(out, 0, -1)

    def forces(self, kept: Array, weights: Array) -> Array:
        """(batch, N, 3n) Rᵀ ``weights`` (batch, N, rows), what they are on each step's nodes, in
        NumPy."""
        first, width = len(self.entries), 3 * self.n
        to_columns, to_nodes = self._incidence
        whole = (kept[..., :first] * weights[..., self.rows]) @ to_columns
        torques = whole[..., width:][..., self.pulled[0]]
        return np.asarray(whole[..., :width] + (kept[..., first:] * torques) @ to_nodes)

    @cached_property
    def _incidence(self) -> tuple[Array, Array]:
        """Ones where each slope stands among the nodes and the motors looked at, and each number of
        FD's Jacobian among the nodes."""
        width = 3 * self.n
        return np.eye(width + len(self.motors))[self.places], np.eye(width)[self.pulled[1]]
