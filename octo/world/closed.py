"""A closed triangle mesh: each vertex once, faces wound alike; or why it is none."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from octo.checks import Array
from octo.errors import ModelError
from octo.world.spline import Indices
from octo.world.surface import edges_of, volume, wound_alike

MERGED = 1e-7  # of its longest edge: vertices so near to each other are one (STL has three a face)
FLAT = 1e-9  # of the cube of its longest edge: a volume that is none
ADVICE = "close it, or use HeightField for a ground"


def closed(
    vertices: Array, faces: Indices, label: str, scale: float, advice: str = ADVICE
) -> tuple[Array, Indices]:
    """Vertices and faces of a closed mesh: each vertex once, faces wound alike.

    Parameters
    ----------
    vertices: (n, 3), ``scale`` m each.
    faces: (m, 3).
    label: what messages call it.
    advice: what to do with one that is open.

    Raises
    ------
    ModelError: it is open, or has no inside.
    """
    vertices, faces = _merged(vertices, faces)
    if not len(faces):
        raise ModelError(f"{label} has no inside: all of its faces are lines or points")
    border, against = _borders(faces)
    if len(border):
        raise ModelError(_open(scale * vertices, border, label, advice))
    if len(against):
        faces = wound_alike(faces)
        against = _borders(faces)[1]
    if len(against):
        place = _place(scale * vertices[against[0]].mean(axis=0))
        raise ModelError(
            f"{label} has no inside: its faces cannot all be wound alike, near {place}"
        )
    if abs(volume(vertices, faces)) < FLAT * float(np.ptp(vertices, axis=0).max()) ** 3:
        raise ModelError(f"{label} has no inside: the faces on both sides are one")
    return vertices, faces


def _open(vertices: Array, border: Indices, label: str, advice: str) -> str:
    """What an open mesh is refused with."""
    edges = coo_array((np.ones(len(border)), tuple(border.T)), shape=[len(vertices)] * 2)
    labels = connected_components(edges, directed=False)[1][border[:, 0]]
    holes, sizes = np.unique(labels, return_counts=True)
    largest = np.unique(border[labels == holes[sizes.argmax()]])
    low, high = vertices[largest].min(axis=0), vertices[largest].max(axis=0)
    one = len(border) == 1
    return (
        f"{label} is open: {len(border)} {'edge borders' if one else 'edges border'} one "
        f"face only, around {len(holes)} {'hole' if len(holes) == 1 else 'holes'}, the largest "
        f"from {_place(low)} to {_place(high)}; only a closed mesh has an inside: {advice}"
    )


def _place(point: Array) -> str:
    return f"({', '.join(f'{x:.3g}' for x in point)}) m"


def _merged(vertices: Array, faces: Indices) -> tuple[Array, Indices]:
    """Vertices at one place as one, without faces of fewer than three places."""
    quantum = MERGED * max(float(np.ptp(vertices, axis=0).max()), 1e-300)
    low = vertices.min(axis=0)
    _, first, to = np.unique(
        np.round((vertices - low) / quantum), axis=0, return_index=True, return_inverse=True
    )
    faces = to.reshape(-1)[faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    used, local = np.unique(faces, return_inverse=True)
    return vertices[first][used], local.reshape(faces.shape)


def _borders(faces: Indices) -> tuple[Indices, Indices]:
    """Edges (k, 2) that border an odd number of faces, and (k, 2) those of faces that are wound
    against each other."""
    edges, which, way = edges_of(faces)
    odd = np.bincount(which) % 2 == 1
    return edges[odd], edges[~odd & (np.bincount(which, way) != 0)]
