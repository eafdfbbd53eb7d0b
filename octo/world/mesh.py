"""A closed triangle mesh as a shape: a grid of distances near its surface."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from octo.checks import Array, instance, numbers, positive, room
from octo.errors import ProblemError, ShapeError
from octo.world import build
from octo.world.closed import closed
from octo.world.grid import KIND, OVERSHOOT
from octo.world.shape import Kind, Shape, fixed
from octo.world.spline import Indices
from octo.world.units import check_size

FINE = 0.02  # m: the largest cell that is not given, and how many there are along the longest edge
CELLS = 200
MOST = 2.5e8  # doubles that a grid is made in, of a cell that is not given: 2 GB


@dataclass(frozen=True, eq=False)
class Mesh(Shape):
    """A closed triangle mesh: φ is the spline of a grid of signed distances.

    Every sample within four cells of the surface is kept, every fourth one elsewhere, and around
    sharp edges those of a quarter of the cell, so that it takes memory in proportion to its surface
    and to the length of its edges. Edges and corners are rounded by less than a tenth of a cell,
    and walls thinner than one and a half cells are thinned or lost, which is warned of. The grid is
    made by libigl when it is first needed, and kept in octo's cache. Parts that overlap or touch
    are a union, and parts within others whose faces look inwards are cavities.

    Parameters
    ----------
    vertices: (n, 3) m.
    faces: (m, 3) three vertices each, counted from 0; wound alike, as seen from outside, or they
        are turned.
    cell: m; None: a 200th of its longest edge, at most 2 cm, and more for hundreds of m².
    scale: metres of what the vertices are in: 0.001 for millimetres.
    position, rotation, name: see Shape.

    Raises
    ------
    ModelError: a mesh that is open: how many edges border one face only, and where.
    ValueRangeError, ShapeError: numbers that are not finite, a cell that is not positive, a mesh
        larger than 200 m or smaller than 5 cm.
    MissingExtraError: libigl is not installed.
    """

    vertices: ArrayLike
    faces: ArrayLike
    cell: float | None = None
    scale: float = 1.0
    kind: ClassVar[Kind] = KIND

    def __post_init__(self) -> None:
        super().__post_init__()
        scale = positive(f"scale of {self.label}", self.scale)
        vertices, faces = self._checked()
        low, high = scale * vertices.min(axis=0), scale * vertices.max(axis=0)
        check_size(self.label, high - low, scale)
        cell = positive(f"cell of {self.label}", FINE if self.cell is None else self.cell, "m")
        if self.cell is None:
            cell = min(FINE, float((high - low).max()) / CELLS)
            while build.doubles_for(scale * vertices, faces, cell) > MOST:
                cell *= 1.25
        needed = build.doubles_for(scale * vertices, faces, cell)
        room(f"distances to {self.label} at a cell of {cell:g} m", needed)
        for name, value in (("vertices", fixed(vertices)), ("faces", fixed(faces)), ("cell", cell)):
            object.__setattr__(self, name, value)

    @classmethod
    def from_file(cls, path: str | Path, **options: Any) -> Mesh:
        """The mesh of a file: STL, OBJ, PLY, GLB and what else trimesh reads.

        Parameters
        ----------
        path: of the file.
        options: cell, scale, position, rotation and name, which is the file's without one.
        """
        file = Path(instance("path", path, (str, Path), "the path of a mesh file"))
        vertices, faces = build.read(file)
        return cls(vertices, faces, **{"name": file.stem, **options})

    def _checked(self) -> tuple[Array, Indices]:
        """Vertices and faces of a closed mesh: each vertex once, faces wound alike."""
        vertices = numbers(f"vertices of {self.label}", self.vertices)
        given = numbers(f"faces of {self.label}", self.faces)
        for name, array in (("vertices", vertices), ("faces", given)):
            if array.ndim != 2 or array.shape[1] != 3 or not len(array):
                raise ShapeError(f"{name} of {self.label}", array.shape, "(n, 3)")
        faces = given.astype(np.int64)
        if (faces != given).any() or faces.min() < 0 or faces.max() >= len(vertices):
            allowed = f"whole numbers from 0 to {len(vertices) - 1}"
            raise ProblemError(f"faces of {self.label} must be {allowed}, its vertices")
        return closed(vertices, faces, self.label, self.scale)

    @cached_property
    def own(self) -> Array:
        vertices = self.scale * np.asarray(self.vertices)
        assert self.cell is not None
        return build.grid(self.label, vertices, np.asarray(self.faces), self.cell)

    @property
    def steepest(self) -> float:
        return float(OVERSHOOT * np.sqrt(3.0))  # distances, along each axis by 1 m a metre

    def own_bounds(self) -> Array:
        vertices = self.scale * np.asarray(self.vertices)
        assert self.cell is not None
        return np.stack([vertices.min(axis=0) - self.cell, vertices.max(axis=0) + self.cell])
