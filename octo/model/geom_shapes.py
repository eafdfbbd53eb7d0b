"""MuJoCo's simple geoms as shapes of a World."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from octo.checks import Array
from octo.model.figure import ball
from octo.world.shapes import Box, Capsule, Cylinder, Ground, Mesh, Shape, Sphere

ROUNDING = 0.01  # m, of edges, or a quarter of the smallest half size where that is less
FINE = 3  # an ellipsoid is a ball of 10·4³ + 2 vertices, stretched
Make = Callable[[Array, dict[str, Any]], Shape]  # of MuJoCo's size (3,), and of name and pose


def _box(size: Array, own: dict[str, Any]) -> Shape:
    return Box(2.0 * size, rounding=min(ROUNDING, 0.25 * float(size.min())), **own)


def _cylinder(size: Array, own: dict[str, Any]) -> Shape:
    radius, half = float(size[0]), float(size[1])
    return Cylinder(radius, 2.0 * half, rounding=min(ROUNDING, 0.25 * min(radius, half)), **own)


def _ellipsoid(size: Array, own: dict[str, Any]) -> Shape:
    sphere = ball(np.zeros(3), 1.0, FINE)
    return Mesh(sphere.vertices * size, sphere.faces, **own)


SIMPLE: dict[str, Make] = {  # by the kind of a geom
    "plane": lambda size, own: Ground(**own),
    "sphere": lambda size, own: Sphere(float(size[0]), **own),
    "capsule": lambda size, own: Capsule(float(size[0]), 2.0 * float(size[1]), **own),
    "cylinder": _cylinder,
    "box": _box,
    "ellipsoid": _ellipsoid,
}
