"""A solid that is cut into tetrahedra: checked, wound alike, its surface found."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from octo.checks import Array, numbers, positive
from octo.errors import ModelError, ProblemError, ShapeError, said
from octo.soft.quadratic import EDGES, FACES, QUARTERS, TURNED, jacobians, volumes, with_middles
from octo.world.shape import fixed
from octo.world.spline import Indices
from octo.world.units import check_size

SIZES = 0.01, 20.0  # m, of a soft body's longest edge: others are most likely in other units
MERGED = 1e-7  # of its longest edge: points so near to each other are one
FLAT = 1e-10  # of the cube of its longest edge: a volume that is none


@dataclass(frozen=True, eq=False)
class Tetrahedra:
    """A solid as tetrahedra of ten nodes: corners and a node on each edge.

    Elements of four corners get the middles of their edges. Points at one place become one, points
    of no element are left out; so ``points``, in m, and ``elements`` are not those that were given.

    Parameters
    ----------
    points: (n, 3) m.
    elements: (E, 4) corners, or (E, 10) corners and then a node on each edge, in the order of VTK:
        0–1, 1–2, 0–2, 0–3, 1–3, 2–3. All are wound alike, either way.
    scale: metres of what the points are in: 0.001 for millimetres.
    name: what messages and pictures call it.

    Raises
    ------
    ModelError: elements that are inverted, folded or have no volume; more than one piece.
    ValueRangeError, ShapeError, ProblemError: points that are not finite, elements of points that
        are not there, a size that only other units explain.
    """

    points: ArrayLike
    elements: ArrayLike
    scale: float = 1.0
    name: str = "mesh"

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise ProblemError(f"name is {said(self.name)}, must be a text")
        scale = positive(f"scale of {self.label}", self.scale)
        points, elements = self._given()
        points, elements = _merged(scale * points, elements)
        check_size(self.label, np.ptp(points, axis=0), scale, SIZES)
        self._check_volumes(points, elements)
        elements = self._wound(points, elements)
        _check_faces(self.label, elements)
        if elements.shape[1] == 4:
            points, elements = with_middles(points, elements)
        else:
            _check_middles(self.label, elements)
        bent = np.flatnonzero((jacobians(points, elements) <= 0.0).any(axis=1))
        if len(bent):
            raise ModelError(
                f"{self.label}: {len(bent)} of {len(elements)} elements are inverted where their "
                f"edges bend, the first of them is element {bent[0]}"
            )
        for name, value in (("points", fixed(points)), ("elements", fixed(elements))):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "scale", 1.0)

    @property
    def label(self) -> str:
        return f"mesh {self.name!r}"

    @property
    def nodes(self) -> Array:
        """(n, 3) m, what ``points`` became."""
        return np.asarray(self.points)

    @property
    def cells(self) -> Indices:
        """(E, 10), what ``elements`` became."""
        return np.asarray(self.elements)

    @cached_property
    def surface(self) -> tuple[Indices, Indices]:
        """The nodes (P,) on the surface, and triangles (F, 3) of those: four to a face of an
        element, wound with the outside out."""
        sides = self.cells[:, FACES].reshape(-1, FACES.shape[1])
        _, first, count = np.unique(
            np.sort(sides[:, :3], axis=1), axis=0, return_index=True, return_counts=True
        )
        outer = sides[np.sort(first[count == 1])]
        used, faces = np.unique(outer[:, QUARTERS].reshape(-1, 3), return_inverse=True)
        return used, faces.reshape(-1, 3)

    def _given(self) -> tuple[Array, Indices]:
        points = numbers(f"points of {self.label}", self.points)
        given = numbers(f"elements of {self.label}", self.elements)
        if points.ndim != 2 or points.shape[1] != 3 or not len(points):
            raise ShapeError(f"points of {self.label}", points.shape, "(n, 3)")
        if given.ndim != 2 or given.shape[1] not in (4, 10):
            raise ShapeError(f"elements of {self.label}", given.shape, "(E, 4) or (E, 10)")
        if not len(given):
            raise ModelError(f"{self.label} has no tetrahedra")
        elements = given.astype(np.int64)
        if (elements != given).any() or elements.min() < 0 or elements.max() >= len(points):
            allowed = f"whole numbers from 0 to {len(points) - 1}"
            raise ProblemError(f"elements of {self.label} must be {allowed}, its points")
        return points, elements

    def _check_volumes(self, points: Array, elements: Indices) -> None:
        corners = points[elements[:, :4]]
        longest = np.ptp(corners, axis=1).max(axis=1)
        flat = np.abs(volumes(points, elements[:, :4])) <= FLAT * longest**3
        if flat.all():
            raise ModelError(f"{self.label} has no volume: all of its tetrahedra are flat")
        if flat.any():
            first = int(np.argmax(flat))
            raise ModelError(
                f"{self.label}: {flat.sum()} of {len(elements)} elements have no volume, the first "
                f"of them is element {first} near {_place(corners[first].mean(axis=0))}"
            )

    def _wound(self, points: Array, elements: Indices) -> Indices:
        """The elements with positive volumes, where all are wound alike."""
        inverted = volumes(points, elements[:, :4]) < 0.0
        if inverted.all():
            return elements[:, TURNED[: elements.shape[1]]]
        if inverted.any():
            few = inverted if 2 * inverted.sum() <= len(elements) else ~inverted
            first = int(np.argmax(few))
            place = _place(points[elements[first, :4]].mean(axis=0))
            raise ModelError(
                f"{self.label}: {few.sum()} of {len(elements)} elements are inverted, wound "
                f"against the others: the first of them is element {first} near {place}"
            )
        return elements


def _place(point: Array) -> str:
    return f"({', '.join(f'{x:.3g}' for x in point)}) m"


def _merged(points: Array, elements: Indices) -> tuple[Array, Indices]:
    """Points at one place as one, and none that no element has."""
    quantum = MERGED * max(float(np.ptp(points, axis=0).max()), 1e-300)
    _, first, to = np.unique(
        np.round((points - points.min(axis=0)) / quantum),
        axis=0,
        return_index=True,
        return_inverse=True,
    )
    order = np.argsort(first)  # as they were given
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    elements = place[to.reshape(-1)][elements]
    used, own = np.unique(elements, return_inverse=True)
    return points[np.sort(first)][used], own.reshape(elements.shape)


def _check_middles(label: str, elements: Indices) -> None:
    """Refuse elements of ten nodes that are not joined: each edge has one node for all of them."""
    ends = np.sort(elements[:, EDGES].reshape(-1, 2), axis=1)
    edges, first, which = np.unique(ends, axis=0, return_index=True, return_inverse=True)
    middles = elements[:, 4:].ravel()
    apart = np.flatnonzero(middles != middles[first][which.reshape(-1)])
    shared = len(np.unique(middles)) < len(edges) or np.isin(middles, elements[:, :4]).any()
    where = ""
    if len(apart):
        where = f"; element {apart[0] // len(EDGES)} has another than its neighbour"
    if len(apart) or shared:
        raise ModelError(f"{label}: each edge of its elements must have one node of its own{where}")


def _check_faces(label: str, elements: Indices) -> None:
    """Refuse elements that overlap across a face, and more than one piece."""
    sides = elements[:, FACES[:, :3]].reshape(-1, 3)
    turn = np.argmin(sides, axis=1)
    wound = np.take_along_axis(sides, (turn[:, None] + np.arange(3)) % 3, axis=1)
    _, which, count = np.unique(
        np.sort(sides, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    which = which.reshape(-1)
    crowded = np.flatnonzero(count[which] > 2)
    if len(crowded):
        side = int(crowded[0])
        raise ModelError(
            f"{label}: {count[which[side]]} elements share one face of element {side // 4}, where "
            "two at most can lie"
        )
    order = np.argsort(which, kind="stable")
    inner = np.flatnonzero(np.diff(which[order]) == 0)
    one, other = order[inner], order[inner + 1]
    folded = np.flatnonzero((wound[one] == wound[other]).all(axis=1))
    if len(folded):
        pair = f"elements {one[folded[0]] // 4} and {other[folded[0]] // 4}"
        raise ModelError(
            f"{label} is folded: {pair} lie on the same side of the face that they share, so that "
            "one of them is inverted"
        )
    graph = coo_array((np.ones(len(one)), (one // 4, other // 4)), shape=[len(elements)] * 2)
    pieces, piece = connected_components(graph, directed=False)
    if pieces > 1:
        sizes = sorted(np.bincount(piece).tolist(), reverse=True)
        shown = ", ".join(str(size) for size in sizes[:4]) + (", …" if pieces > 4 else "")
        raise ModelError(
            f"{label} is {pieces} pieces, of {shown} elements, which share no face: a body is one "
            "piece"
        )
