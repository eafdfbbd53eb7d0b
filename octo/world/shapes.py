"""Shapes that an ``octo.World`` is made of."""

from __future__ import annotations

from octo.world.primitives import Box, Capsule, Cylinder, Ground, Sphere
from octo.world.shape import Kind, Shape

__all__ = ["Box", "Capsule", "Cylinder", "Ground", "Shape", "Sphere"]

# Every kind of a look-up, by its number in World.data: a new one is one more entry.
KINDS: tuple[Kind, ...] = tuple(shape.kind for shape in (Ground, Sphere, Box, Capsule, Cylinder))
