"""Worlds, and what tests of derivatives compare with."""

from __future__ import annotations

import itertools

import numpy as np
from scipy.spatial.transform import Rotation

from octo import World, shapes
from octo.world.jet import AXES, SIZES

PRIMITIVES: dict[str, shapes.Shape] = {
    "ground": shapes.Ground(0.3, 1.0, 0.1),
    "sphere": shapes.Sphere(0.2),
    "box": shapes.Box((0.3, 0.4, 0.5), 0.05),
    "capsule": shapes.Capsule(0.2, 0.3),
    "cylinder": shapes.Cylinder(0.2, 0.3, 0.05),
    "plate": shapes.Box((0.3, 0.4, 0.1), 0.05),  # rounded as far as it can be
    "rod": shapes.Cylinder(0.05, 0.3, 0.05),
}


def mixed(rng: np.random.Generator, each: int = 6, spread: float = 0.5) -> list[shapes.Shape]:
    """Shapes of every kind in random poses that overlap, on two grounds."""
    made: list[shapes.Shape] = [shapes.Ground(height=-0.5), shapes.Ground(0.2, 1.0, -0.6)]
    for shape in list(PRIMITIVES.values())[1:] * each:
        made.append(shape.moved(spread * rng.normal(size=3), turn(rng)))
    return made


def blocks(count: int, rng: np.random.Generator) -> list[shapes.Shape]:
    """Boxes that are turned about z, four a square metre, around the origin, nearest first."""
    side = 0.5 * np.sqrt(count)
    places = rng.uniform(-side / 2.0, side / 2.0, (count, 2))
    places = places[np.argsort(np.linalg.norm(places, axis=1))]
    return [
        shapes.Box(
            (0.3, 0.2, rng.uniform(0.1, 0.3)),
            position=(*place, 0.0),
            rotation=Rotation.from_euler("z", rng.uniform(0.0, np.pi)).as_matrix(),
        )
        for place in places
    ]


def turn(rng: np.random.Generator) -> np.ndarray:
    """A random rotation matrix."""
    return Rotation.random(random_state=rng).as_matrix()


def near_surface(
    shape: shapes.Shape, rng: np.random.Generator, count: int, depth: float, height: float
) -> np.ndarray:
    """Points of a shape's world with φ between −depth and height, all around it."""
    found: list[np.ndarray] = []
    low, high = np.clip(shape.own_bounds(), -1.0, 1.0)
    while len(found) < count:
        points = rng.uniform(low - height, high + height, (20 * count, 3))
        points = shape.position + points @ np.asarray(shape.rotation).T
        phi = World([shape]).distance(points)
        found += list(points[(phi > -depth) & (phi < height)])
    return np.array(found[:count])


def richardson(world: World, points: np.ndarray, order: int, step: float) -> np.ndarray:
    """Derivatives of an order (k, numbers) by differences of those of the order below."""
    below = [AXES.index(axes[:-1]) for axes in AXES[SIZES[order - 1] : SIZES[order]]]
    table: list[np.ndarray] = []  # at steps h, h/2, h/4
    for h in step / np.array([1.0, 2.0, 4.0]):
        rows = []
        for axis in range(3):
            move = h * np.eye(3)[axis]
            up, down = (world.jets(points + way * move, order - 1) for way in (1.0, -1.0))
            rows.append((up - down) / (2.0 * h))
        last = [axes[-1] for axes in AXES[SIZES[order - 1] : SIZES[order]]]
        table.append(np.stack([rows[k][:, b] for k, b in zip(last, below, strict=True)], axis=1))
    for power in (4.0, 16.0):
        table = [
            (power * fine - rough) / (power - 1.0) for rough, fine in itertools.pairwise(table)
        ]
    return table[0]


def worst(one: np.ndarray, other: np.ndarray) -> float:
    """The largest difference of two jets, of each order in parts of the largest number of it."""
    ends = [0, *(size for size in SIZES if size <= one.shape[1])]
    return max(
        float(np.abs(one[:, i:j] - other[:, i:j]).max() / max(1.0, np.abs(one[:, i:j]).max()))
        for i, j in itertools.pairwise(ends)
    )
