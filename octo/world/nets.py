"""Triangles of φ = 0 between the samples of a grid, by surface nets.

Every cell that the surface goes through has one vertex, the mean of where the surface crosses its
edges, and every edge that it crosses one quadrangle, of the four cells around it (Gibson 1998,
"Constrained elastic surface nets").
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array

Faces = NDArray[np.intp]


def zero_surface(values: Array) -> tuple[Array, Faces]:
    """Vertices (v, 3), in cells from ``values[0, 0, 0]``, and faces (f, 3), outward side
    counter-clockwise, of samples (nx, ny, nz) of φ; what reaches the edge of the grid ends
    there."""
    solid = np.pad(values, 1, constant_values=np.abs(values).max() + 1e-9)
    cells = np.array(solid.shape) - 1
    total, count = np.zeros((int(np.prod(cells)), 3)), np.zeros(int(np.prod(cells)))
    quads = []
    for axis in range(3):
        low, high = (np.delete(solid, end, axis) for end in (-1, 0))
        edges = np.argwhere((low < 0.0) != (high < 0.0))  # (k, 3) their lower ends
        at = tuple(edges.T)
        places = edges.astype(float)
        places[:, axis] += low[at] / (low[at] - high[at])
        b, c = np.eye(3, dtype=int)[[(axis + 1) % 3, (axis + 2) % 3]]
        around = [
            np.ravel_multi_index(tuple((edges - shift).T), tuple(cells))
            for shift in (b + c, c, 0 * b, b)
        ]
        for cell in around:
            np.add.at(total, cell, places)
            np.add.at(count, cell, 1.0)
        corners = np.stack(around, axis=1)
        rises = low[at] < 0.0  # the outside is ahead along the axis
        quads.append(np.where(rises[:, None], corners, corners[:, ::-1]))
    corners = np.concatenate(quads)
    used, numbered = np.unique(corners, return_inverse=True)
    a, b, c, d = numbered.reshape(corners.shape).T
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return total[used] / count[used, None] - 1.0, faces
