"""One thing that is drawn on a body: a mesh of a file, or a simple shape, with its colour."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from octo.checks import numbers, one_of
from octo.errors import ModelError, said
from octo.model.quantities import Array

KINDS = ("mesh", "box", "sphere", "capsule", "cylinder", "ellipsoid")


@dataclass(frozen=True, eq=False)
class Look:
    """One thing that is drawn on a body.

    Attributes
    ----------
    body: index of the body.
    kind: "mesh", "box", "sphere", "capsule", "cylinder" or "ellipsoid".
    size: (3,) half edges or radii in m; of a capsule and a cylinder its radius and half its length
        along z; of a mesh the factors that its file is scaled by.
    position: (3,) m, rotation: (3, 3): its frame in the body's.
    color: (4,) red, green, blue and alpha from 0 to 1; None: those of the mesh's file.
    file: of a mesh.
    """

    body: int
    kind: str
    size: Array
    position: Array
    rotation: Array
    color: Array | None = None
    file: str = ""

    def __post_init__(self) -> None:
        if isinstance(self.body, bool) or not isinstance(self.body, (int, np.integer)):
            raise ModelError(f"look: body is {said(self.body)}, must be the index of a body")
        one_of("kind of a look", self.kind, KINDS)
        shapes = {"size": (3,), "position": (3,), "rotation": (3, 3)}
        for name, shape in shapes.items():
            object.__setattr__(self, name, numbers(name, getattr(self, name), shape))
        if self.color is not None:
            object.__setattr__(self, "color", np.clip(numbers("color", self.color, (4,)), 0, 1))
        if (self.kind == "mesh") != bool(self.file):
            raise ModelError(f"look: file is {self.file!r}, must be that of a mesh and of no other")
