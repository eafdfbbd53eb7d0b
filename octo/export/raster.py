"""Triangles as pixels, the nearest in front: in a video the painter's algorithm flickers, whose
order of triangles that cut each other changes from frame to frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array

Pixels = NDArray[np.uint8]
Whole = NDArray[np.intp]
MOST = 1_000_000  # pixels of triangles that are drawn together
FLAT = 1e-9  # pixels², of a triangle that is seen from its edge


def draw(
    image: Pixels, depth: Array, corners: Array, away: Array, colors: Array, line: float
) -> None:
    """Draw into ``image`` (h, w, 3) what is nearer than ``depth`` (h, w), which it changes too.

    Parameters
    ----------
    corners: (f, 3, 2) pixels, right and down. away: (f, 3), depth at the corners.
    colors: (f, 3) from 0 to 1.
    line: pixels, half of the thickness of a triangle that is only an edge, whose last two corners
        are the same.
    """
    seen = ((corners.max(axis=1) > 0.0) & (corners.min(axis=1) < image.shape[1::-1])).all(axis=1)
    corners, away, colors = corners[seen], away[seen], colors[seen]
    thin = (corners[:, 1] == corners[:, 2]).all(axis=1)
    if thin.any():
        corners = np.concatenate([corners[~thin], _thick(corners[thin], line)])
        away = np.concatenate([away[~thin], away[thin][:, [0, 0, 1]], away[thin][:, [1, 0, 1]]])
        colors = np.concatenate([colors[~thin], colors[thin], colors[thin]])
    tints = np.round(255.0 * np.clip(colors, 0.0, 1.0)).astype(np.uint8)
    triangle, y, start, end = _spans(corners, image.shape[1], image.shape[0])
    slope, level = _planes(corners, away)
    count = end - start
    parts = np.split(np.arange(len(count)), np.flatnonzero(np.diff(np.cumsum(count) // MOST)) + 1)
    for own in parts:
        span = np.repeat(own, count[own])
        first = np.repeat(np.cumsum(count[own]) - count[own], count[own])
        x = start[span] + np.arange(len(span)) - first
        t = triangle[span]
        row = level[triangle[own]] + slope[triangle[own], 1] * (y[own] + 0.5)
        z = np.repeat(row, count[own]) + slope[t, 0] * (x + 0.5)
        pixel = y[span] * image.shape[1] + x
        flat = depth.reshape(-1)
        np.minimum.at(flat, pixel, z)
        nearest = np.flatnonzero(z == flat[pixel])
        image.reshape(-1, 3)[pixel[nearest]] = tints[t[nearest]]


def _thick(corners: Array, line: float) -> Array:
    """(2 f, 3, 2) two triangles of each edge."""
    a, b = corners[:, 0], corners[:, 1]
    way = b - a
    length = np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
    side = line * way[:, ::-1] * (-1.0, 1.0) / length
    first = np.stack([a + side, a - side, b + side], axis=1)
    return np.concatenate([first, np.stack([b + side, a - side, b - side], axis=1)])


def _spans(corners: Array, width: int, height: int) -> tuple[Whole, Whole, Whole, Whole]:
    """Rows of pixels whose middles are in triangles (f, 3, 2), within the picture: triangle, row,
    first column and the one behind the last, (k,) each."""
    low = np.clip(np.ceil(corners[..., 1].min(axis=1) - 0.5), 0, height).astype(int)
    high = np.clip(np.ceil(corners[..., 1].max(axis=1) - 0.5), 0, height).astype(int)
    rows = np.maximum(high - low, 0)
    triangle = np.repeat(np.arange(len(rows)), rows)
    y = np.arange(len(triangle)) - np.repeat(np.cumsum(rows) - rows, rows) + low[triangle]
    least, most = np.full(len(y), np.inf), np.full(len(y), -np.inf)
    for k in range(3):  # where the row crosses the sides
        a, b = corners[triangle, k], corners[triangle, (k + 1) % 3]
        rise = b[:, 1] - a[:, 1]
        share = (y + 0.5 - a[:, 1]) / np.where(rise == 0.0, np.inf, rise)
        x = a[:, 0] + share * (b[:, 0] - a[:, 0])
        crosses = (rise != 0.0) & (share >= 0.0) & (share <= 1.0)
        least = np.where(crosses, np.minimum(least, x), least)
        most = np.where(crosses, np.maximum(most, x), most)
    least, most = (np.clip(np.ceil(side - 0.5), 0, width) for side in (least, most))
    seen = np.flatnonzero(most > least)
    return triangle[seen], y[seen], least[seen].astype(int), most[seen].astype(int)


def _planes(corners: Array, away: Array) -> tuple[Array, Array]:
    """Depth of triangles as level (f,) + slope (f, 2) · (right, down)."""
    (ux, uy), (vx, vy) = ((corners[:, k] - corners[:, 0]).T for k in (1, 2))
    area = ux * vy - uy * vx
    area = np.where(np.abs(area) > FLAT, area, np.inf)
    u, v = away[:, 1] - away[:, 0], away[:, 2] - away[:, 0]
    slope = np.stack([u * vy - v * uy, v * ux - u * vx], axis=1) / area[:, None]
    return slope, away[:, 0] - np.sum(slope * corners[:, 0], axis=1)
