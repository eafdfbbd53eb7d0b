"""What a world holds: as plain numbers, and as a table to read."""

from __future__ import annotations

from typing import Any

import numpy as np

from octo.checks import Array
from octo.world.shapes import (
    Box,
    Capsule,
    Cylinder,
    DistanceGrid,
    Ground,
    HeightField,
    Mesh,
    Shape,
    Sphere,
)
from octo.world.world import World

MEGABYTE = 1e6


def described(world: World) -> dict[str, Any]:
    """Name, kind, size in words, position (m) and the box (2, 3) m of each shape, infinite where it
    has no end; the memory that their numbers take, in bytes."""
    shapes = [
        {
            "name": shape.name,
            "kind": type(shape).__name__,
            "size": size_of(shape),
            "position": np.asarray(shape.position).tolist(),
            "bounds": shape.bounds().tolist(),
        }
        for shape in world.shapes
    ]
    return {"shapes": shapes, "blend": world.blend, "bytes": world.data.nbytes}


def table(world: World) -> str:
    """A line for each shape."""
    rows = [
        (shape.name or "-", type(shape).__name__, size_of(shape), _box(shape.bounds()))
        for shape in world.shapes
    ]
    wide = [max(len(row[k]) for row in rows) for k in range(3)]
    lines = [
        "  ".join([*(word.ljust(size) for word, size in zip(row, wide, strict=False)), row[3]])
        for row in rows
    ]
    count = f"{len(rows)} shape{'s' if len(rows) > 1 else ''}"
    total = f"{count}, {world.data.nbytes / MEGABYTE:.3g} MB of numbers"
    return "\n".join([*lines, total])


def size_of(shape: Shape) -> str:
    """The sizes of a shape in words."""
    if isinstance(shape, Box):
        return f"{_times(np.asarray(shape.size))} m"
    if isinstance(shape, Sphere):
        return f"radius {shape.radius:.4g} m"
    if isinstance(shape, (Capsule, Cylinder)):
        return f"radius {shape.radius:.4g} m, length {shape.length:.4g} m"
    if isinstance(shape, Ground):
        return f"slope {shape.slope:.4g} rad, height {shape.height:.4g} m"
    if isinstance(shape, (HeightField, DistanceGrid)):
        samples = np.shape(shape.heights if isinstance(shape, HeightField) else shape.values)
        return f"{_times(np.array(samples))} samples, cell {shape.scale * shape.cell:.4g} m"
    if isinstance(shape, Mesh):
        return f"{len(np.asarray(shape.faces))} triangles, cell {shape.cell:.4g} m"
    return ""


def _times(values: Array) -> str:
    return " × ".join(f"{value:.4g}" for value in values)


def _box(bounds: Array) -> str:
    low, high = (f"({', '.join(f'{value:.3g}' for value in end)})" for end in bounds)
    return f"from {low} to {high} m"
