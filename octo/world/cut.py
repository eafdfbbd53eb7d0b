"""Triangles cut fine, as the painter's algorithm needs them, and no more of them than are near."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from octo.checks import Array

MOST = 40  # times that a triangle is halved


def halved(corners: Array, values: Array, longest: float, times: int = 8) -> tuple[Array, Array]:
    """Triangles (f, 3, 3) m and what belongs to each (f, ...), cut until no edge is over
    ``longest``."""
    for _ in range(times):
        # of corner k to k + 1
        edge = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        cut = edge.max(axis=1) > longest
        if not cut.any():
            break
        first = np.argmax(edge[cut], axis=1)[:, None]
        places = (((first + k) % 3)[..., None] for k in range(3))
        a, b, c = (np.take_along_axis(corners[cut], k, axis=1)[:, 0] for k in places)
        middle = 0.5 * (a + b)
        halves = [np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)]
        corners = np.concatenate([corners[~cut], *halves])
        values = np.concatenate([values[~cut], values[cut], values[cut]])
    return corners, values


def near(
    corners: Array, values: Array, path: Array, reach: float, longest: float
) -> tuple[Array, Array]:
    """The same of what is within ``reach`` m of a path (p, 2) m, seen from above."""
    tree = cKDTree(path)
    for _ in range(MOST):
        edge = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2).max(axis=1)
        close = tree.query(corners.mean(axis=1)[:, :2])[0] < reach + edge
        corners, values = corners[close], values[close]
        if not (edge[close] > longest).any():
            break
        corners, values = halved(corners, values, longest, 1)
    return corners, values
