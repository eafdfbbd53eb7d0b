"""Shapes that an ``octo.World`` is made of."""

from __future__ import annotations

from octo.world.grid import DistanceGrid
from octo.world.heights import HeightField
from octo.world.mesh import Mesh
from octo.world.primitives import Box, Capsule, Cylinder, Ground, Sphere
from octo.world.shape import Kind, Shape

__all__ = [
    "Box",
    "Capsule",
    "Cylinder",
    "DistanceGrid",
    "Ground",
    "HeightField",
    "Mesh",
    "Shape",
    "Sphere",
]

# Every kind of a look-up, by its number in World.data: a new one is one more entry.
# A mesh is looked up as the distance grid that is made of it.
KINDS: tuple[Kind, ...] = tuple(
    shape.kind for shape in (Ground, Sphere, Box, Capsule, Cylinder, HeightField, DistanceGrid)
)
