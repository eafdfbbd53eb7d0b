"""matplotlib's Figure, which a notebook shows; imported where a picture is drawn.

Raises
------
MissingExtraError: at the import, where matplotlib is not there.
"""

from __future__ import annotations

import io

import numpy as np

from octo.checks import Array
from octo.errors import MissingExtraError

try:
    import matplotlib.axes
    import matplotlib.figure
except ImportError:
    raise MissingExtraError("a picture", "view") from None

DPI = 80  # of what a notebook shows; a file has its own
NARROWEST, WIDEST = 5.0, 13.0  # inches
TALL = 2.2  # inches, of a picture that is not too wide for it


class Figure(matplotlib.figure.Figure):
    """A figure without pyplot: nothing global, no window, no backend to choose."""

    def _repr_png_(self) -> bytes:
        drawn = io.BytesIO()
        self.savefig(drawn, format="png", dpi=DPI)
        return drawn.getvalue()


def table(count: int, low: Array, high: Array) -> tuple[Figure, list[matplotlib.axes.Axes]]:
    """A figure of ``count`` pictures in rows, each without a frame from ``low`` to ``high`` (2,) m;
    as many in a row as make it about square, at least one."""
    extent = high - low
    columns = max(1, round(float(np.sqrt(count * extent[1] / extent[0]))))
    rows = -(-count // columns)
    width = float(np.clip(TALL * columns * extent[0] / extent[1], NARROWEST, WIDEST))
    figure = Figure(figsize=(width, width * rows / columns * extent[1] / extent[0]))
    made = []
    for k in range(count):
        row, column = divmod(k, columns)
        place = (column / columns, 1.0 - (row + 1) / rows, 1.0 / columns, 1.0 / rows)
        made.append(figure.add_axes(place))
        made[-1].set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        made[-1].axis("off")
    return figure, made
