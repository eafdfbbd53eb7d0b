"""matplotlib's Figure, which a notebook shows; imported where a picture is drawn.

Raises
------
MissingExtraError: at the import, where matplotlib is not there.
"""

from __future__ import annotations

import io

from octo.errors import MissingExtraError

try:
    import matplotlib.figure
except ImportError:
    raise MissingExtraError("a picture", "view") from None

DPI = 80  # of what a notebook shows; a file has its own


class Figure(matplotlib.figure.Figure):
    """A figure without pyplot: nothing global, no window, no backend to choose."""

    def _repr_png_(self) -> bytes:
        drawn = io.BytesIO()
        self.savefig(drawn, format="png", dpi=DPI)
        return drawn.getvalue()
