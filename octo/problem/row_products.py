"""Products R Δ of the bounded rows' derivatives with a step of the nodes, out of what a
linearisation keeps.

Of each time step a model keeps the slopes of its bounded rows over (x_next, x, x_prev, u) that may
not be zero, and ∂u/∂(x_next, x, x_prev) of the motors that they look at: the chain rule through the
torques is left to the product. Slopes over nodes are as they are before a cycle carries them back;
the step of the nodes is what is carried. The text for C and CUDA is row_products.c of this folder
and row_products.cu of octo.gpu.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from octo.problem.lane_tables import tables_text

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class RowSlopes:
    """What is kept of a time step: ``entries`` slopes, sorted by row, then rows of FD's Jacobian.

    Attributes
    ----------
    count: bounded rows. n: coordinates.
    entries: of each slope kept, its place among the derivatives of all rows over the state.
    rows, columns: of each slope kept, its bounded row and its column in (x_next, x, x_prev, u).
    motors: (T,) that a bounded row looks at.
    """

    count: int
    n: int
    entries: Indices
    rows: Indices
    columns: Indices
    motors: Indices

    @classmethod
    def of(cls, rows: Indices, columns: Indices, squares: int, count: int, n: int) -> RowSlopes:
        """Of derivatives at ``rows`` and ``columns``; the first ``squares`` rows are not bounded,
        ``count`` others are."""
        entries = np.flatnonzero(rows >= squares)
        entries = entries[np.argsort(rows[entries], kind="stable")]
        own = columns[entries]
        motors = np.unique(own[own >= 3 * n] - 3 * n)
        return cls(count, n, entries, rows[entries] - squares, own, motors)

    @property
    def size(self) -> int:
        """Numbers that are kept of a step."""
        return len(self.entries) + len(self.motors) * 3 * self.n

    def tables(self) -> str:
        """C text of sizes and places; a column over torques is the place of its motor here."""
        places = self.columns.copy()
        over = places >= 3 * self.n
        places[over] = 3 * self.n + np.searchsorted(self.motors, places[over] - 3 * self.n)
        sizes = {"NKEPT": len(self.entries), "NPULLED": len(self.motors)}
        tables = {
            "kept_entry": self.entries,
            "kept_first": np.searchsorted(self.rows, np.arange(self.count + 1)),
            "kept_column": places,
            "kept_motor": self.motors,
        }
        return tables_text(sizes, tables, anew=True)

    def c_text(self) -> str:
        """For assemble.c, after scatter.c."""
        own = (resources.files("octo.problem") / "row_products.c").read_text(encoding="utf-8")
        return f"{self.tables()}\n{own}"

    def packed(self, slopes: Array, torques: Array) -> Array:
        """(batch, N, size) what is kept: of ``slopes`` (batch, N, bounded rows, 3n + nu) and
        ∂u/∂(x_next, x, x_prev) ``torques`` (batch, N, nu, 3n)."""
        own = slopes[..., self.rows, self.columns]
        pulled = torques[:, :, self.motors].reshape(*own.shape[:2], -1)
        return np.concatenate([own, pulled], axis=-1)

    def products(self, kept: Array, moved: Array) -> Array:
        """(batch, N, bounded rows) R Δ in NumPy, ``moved`` (batch, N+2, n) being the step of the
        nodes."""
        batch, steps = kept.shape[:2]
        window = np.concatenate([moved[:, at : at + steps] for at in (2, 1, 0)], axis=-1)
        first, width = len(self.entries), 3 * self.n
        pulled = kept[..., first:].reshape(batch, steps, len(self.motors), width)
        whole = np.zeros((batch, steps, width + int(self.motors.max(initial=-1)) + 1))
        whole[..., :width] = window
        whole[..., width + self.motors] = (pulled @ window[..., None])[..., 0]
        parts = kept[..., :first] * whole[..., self.columns]
        out = np.zeros((self.count, batch, steps))
        np.add.at(out, self.rows, np.moveaxis(parts, -1, 0))
        return np.moveaxis(out, 0, -1)
