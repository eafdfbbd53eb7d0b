"""Tetrahedra of ten nodes: four corners, and a node on each edge, in VTK's order."""

from __future__ import annotations

from functools import cache

import numpy as np

from octo.checks import Array
from octo.world.spline import Indices

EDGES = np.array([[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]])  # corners of nodes 4 to 9
TURNED = np.array([0, 2, 1, 3, 6, 5, 4, 7, 9, 8])  # the same element wound the other way
# of a positive element seen from outside: three corners, then the nodes between 1–2, 2–3 and 3–1
FACES = np.array([[0, 2, 1, 6, 5, 4], [0, 1, 3, 4, 8, 7], [1, 2, 3, 5, 9, 8], [0, 3, 2, 7, 9, 6]])
QUARTERS = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])  # triangles of such a face


def with_middles(points: Array, corners: Indices) -> tuple[Array, Indices]:
    """Nodes (n, 3) and elements (E, 10) of corners (E, 4): those of the points, then the middles of
    all edges."""
    ends = np.sort(corners[:, EDGES].reshape(-1, 2), axis=1)
    edges, which = np.unique(ends, axis=0, return_inverse=True)
    middles = points[edges].mean(axis=1)
    own = len(points) + which.reshape(-1, len(EDGES))
    return np.concatenate([points, middles]), np.concatenate([corners, own], axis=1)


def volumes(points: Array, corners: Indices) -> Array:
    """(E,) m³ of straight tetrahedra, negative of inverted ones."""
    a, b, c, d = points[corners.T]
    return np.asarray(np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6.0)


def derivatives(where: Array) -> Array:
    """(k, 10, 3) of the ten shape functions, by ξ, η, ζ, at points (k, 3) of the unit element."""
    share = np.column_stack([1.0 - where.sum(axis=1), where])  # (k, 4) barycentric
    slope = np.concatenate([-np.ones((1, 3)), np.eye(3)])  # (4, 3) of them
    corners = (4.0 * share - 1.0)[:, :, None] * slope
    a, b = EDGES.T
    middles = 4.0 * (share[:, a, None] * slope[b] + share[:, b, None] * slope[a])
    return np.concatenate([corners, middles], axis=1)


@cache
def _at_nodes() -> Array:
    corners = np.concatenate([np.zeros((1, 3)), np.eye(3)])
    return derivatives(np.concatenate([corners, corners[EDGES].mean(axis=1)]))


def jacobians(nodes: Array, elements: Indices) -> Array:
    """(E, 10) m³, determinants at the ten nodes of elements (E, 10)."""
    return np.asarray(np.linalg.det(np.einsum("kna,enb->ekab", _at_nodes(), nodes[elements])))
