"""Convergence of a solve, thinned for a file and a plot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from octo.checks import Array

POINTS = 100


def thinned(history: Mapping[str, Array], names: tuple[str, ...]) -> dict[str, list[float]]:
    """Columns at up to POINTS iterations, which are dense at the beginning, counted from 1."""
    count = len(history[names[0]])
    rows = np.unique(np.geomspace(1, max(count, 1), POINTS).astype(int)) - 1
    own = {name: [float(f"{v:.4g}") for v in history[name][rows]] for name in names}
    return {"iteration": (rows + 1).tolist(), **own}


def every(values: Array, points: int = POINTS) -> list[float]:
    """Some of many values, evenly apart."""
    rows = np.linspace(0, len(values) - 1, min(points, len(values))).astype(int)
    return [float(f"{v:.4g}") for v in np.asarray(values)[rows]]


def converging(axes: Any, curves: Mapping[str, dict[str, list[float]]]) -> None:
    """E, and on the second axes ‖C‖∞, by iteration."""
    for label, curve in curves.items():
        for one, name in zip(axes, ("energy", "violation"), strict=True):
            one.loglog(curve["iteration"], curve[name], label=label)
    axes[0].set(xlabel="iteration", ylabel="E")
    axes[1].set(xlabel="iteration", ylabel="‖C‖∞ (N)")
