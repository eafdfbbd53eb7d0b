"""When a contact stands: the one definition that figures, pictures and checks share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
TOUCHDOWN = 0.05  # of mg: a stance begins
# of mg: a contact that carries more is loaded, and a stance ends where it is not; lower than
# TOUCHDOWN, so that a load that wavers is one stance
LOADED = 0.01


def stances(force: Array, weight: float) -> NDArray[np.bool_]:
    """(N, c) whether each contact stands, of its normal force (N, c) N.

    Between the two thresholds it does what it did before; it does not stand before it has touched
    down.
    """
    sure = (force >= TOUCHDOWN * weight) | (force < LOADED * weight)
    rows = np.where(sure, np.arange(len(force))[:, None], 0)
    known = np.maximum.accumulate(rows, axis=0)  # the last row that says
    return np.take_along_axis(force, known, axis=0) >= TOUCHDOWN * weight


def runs(on: NDArray[np.bool_], begin: int, end: int) -> list[tuple[int, int]]:
    """First row and the row after the last of each run of True that begins and ends in a window.

    The rows of the window are begin … end−1; the motion's own first and last run never count.
    """
    flips = np.flatnonzero(on[1:] != on[:-1]) + 1
    pairs = zip(flips[:-1].tolist(), flips[1:].tolist(), strict=True)
    return [(a, b) for a, b in pairs if on[a] and begin <= a and b <= end]
