"""The surfaces of bodies that the spheres of other bodies touch: shapes that a body carries.

Their numbers are data of the stages, so that a box of another size runs the same code.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from octo.errors import ModelError, said
from octo.model.quantities import Array, text
from octo.world.shape import Shape

SIZES = 4  # numbers of a shape in its own frame, at most
NUMBERS = 12 + SIZES  # with its pose in the body's frame


@dataclass(frozen=True, eq=False)
class Solid:
    """The surface of a body that spheres of other bodies may touch.

    Parameters
    ----------
    name: of the solid; one of a body is usually named as the body is.
    body: index of the body that carries it.
    shape: one of ``octo.shapes`` in closed form (Sphere, Box, Capsule, Cylinder), whose pose is in
        the body's frame.
    """

    name: str
    body: int
    shape: Shape

    def __post_init__(self) -> None:
        text("solid", self.name)
        which = f"solid {self.name!r}"
        if isinstance(self.body, bool) or not isinstance(self.body, (int, np.integer)):
            raise ModelError(f"{which}: body is {said(self.body)}, must be the index of a body")
        if not isinstance(self.shape, Shape):
            raise ModelError(f"{which}: shape is {said(self.shape)}, must be one of octo.shapes")
        bounded = self.shape.kind.expression is not None and np.isfinite(self.shape.bounds()).all()
        if not bounded or len(self.shape.own) > SIZES:
            raise ModelError(
                f"{which}: shape is a {self.shape.word}, must be a Sphere, a Box, a Capsule or a "
                "Cylinder: what moves has no grid and has an end"
            )

    @property
    def kind(self) -> str:
        """The name of its shape's kind."""
        return self.shape.kind.name

    @property
    def numbers(self) -> Array:
        """(16,) rotation row by row, position (m), and those of its shape filled up with zeros."""
        own = np.zeros(SIZES)
        own[: len(self.shape.own)] = self.shape.own
        pose = np.ravel(np.asarray(self.shape.rotation)), np.asarray(self.shape.position)
        return np.concatenate([*pose, own])

    def distance(self, point: Array) -> float:
        """Signed distance (m) of a point (3,) m of the body's frame."""
        rotation, position = np.asarray(self.shape.rotation), np.asarray(self.shape.position)
        local = rotation.T @ (np.asarray(point, dtype=float) - position)
        return float(self.shape.kind.jets(self.shape.own, local[None], 0)[0, 0])


def surface(solid: Solid, point: ca.SX, rotation: ca.SX, position: ca.SX, own: ca.SX) -> ca.SX:
    """Signed distance (m) of ``point`` (3,) m from a shape as that of ``solid``, with numbers
    ``own`` (SIZES,), at a pose in the frame of the point."""
    expression = solid.shape.kind.expression
    assert expression is not None  # checked where the solid was made
    return expression(own[: len(solid.shape.own)], rotation.T @ (point - position))
