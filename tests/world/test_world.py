"""Worlds: many shapes as one distance, in C and in NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from octo import World, native, shapes
from octo.world import interpreted
from octo.world.blend import PART


def mixed(rng: np.random.Generator, each: int = 6) -> list[shapes.Shape]:
    """Shapes of every kind in random poses that overlap, on two grounds."""
    made: list[shapes.Shape] = [
        shapes.Ground(height=-0.5, name="ground"),
        shapes.Ground(0.2, 1.0, -0.6),
    ]
    for _ in range(each):
        for kind, sizes in (
            (shapes.Sphere, (0.2,)),
            (shapes.Box, ((0.3, 0.4, 0.5), 0.05)),
            (shapes.Capsule, (0.1, 0.3)),
            (shapes.Cylinder, (0.2, 0.3, 0.04)),
        ):
            rotation = Rotation.random(random_state=rng).as_matrix()
            made.append(kind(*sizes, position=rng.normal(size=3) * 0.5, rotation=rotation))
    return made


@pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("order", range(4))
def test_without_a_compiler_the_numbers_are_the_same(order: int) -> None:
    rng = np.random.default_rng(order)
    world = World(mixed(rng), blend=0.2)
    points = rng.normal(size=(200, 3)) * 0.7
    made = world.jets(points, order)
    other = interpreted.jets(world.shapes, PART * world.blend, points, order)
    size = np.maximum(1.0, np.abs(made).max(axis=1, keepdims=True))
    assert np.abs((made - other) / size).max() < 1e-12
