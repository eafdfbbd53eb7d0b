"""The smooth minimum: what it is, that order does not matter, how far it sinks, its derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import mixed, richardson, turn, worst
from scipy.optimize import brentq

from octo import World, shapes
from octo.world.jet import SIZES
from octo.world.layout import NEAR

BLEND = 0.2  # m: T is 25 mm


def least(values: np.ndarray, blend: float) -> tuple[float, np.ndarray]:
    """m and λ of distances (n,) m, from their definition: the root by bisection."""
    T = blend / 8.0
    x = values / T
    tau = brentq(lambda t: (np.maximum(t - x, 0.0) ** 2).sum() - 4.0, x.min(), x.min() + 3.0)
    weight = (np.maximum(tau - x, 0.0) / 2.0) ** 2
    return float(weight @ values - T * 4.0 / 3.0 * (1.0 - (weight**1.5).sum())), weight


def balls(count: int, rng: np.random.Generator) -> list[shapes.Shape]:
    """Spheres and a ground around the origin, whose derivatives have no seams."""
    made = [
        shapes.Sphere(0.3, position=0.3 * p / np.linalg.norm(p))
        for p in rng.normal(size=(count, 3))
    ]
    return [shapes.Ground(0.3, 1.0), *made]


def test_it_is_the_minimum_of_its_definition() -> None:
    rng = np.random.default_rng(0)
    members = mixed(rng)
    points = 0.4 * rng.normal(size=(300, 3))
    each = np.array([World([shape]).distance(points) for shape in members]).T
    made = World(members, BLEND).distance(points)
    wanted = [least(row, BLEND) for row in each]
    np.testing.assert_allclose(made, [m for m, _ in wanted], rtol=0.0, atol=1e-12)
    felt = np.array([(weight > 0.0).sum() for _, weight in wanted])
    assert all(count > 10 for count in np.bincount(np.minimum(felt, 3))[1:])


def test_its_gradient_is_a_convex_combination_of_normals() -> None:
    rng = np.random.default_rng(1)
    members = balls(6, rng)
    points = 0.1 * rng.normal(size=(50, 3))
    each = [World([shape]).jets(points, 1) for shape in members]
    made = World(members, BLEND).jets(points, 1)
    for k in range(len(points)):
        weight = least(np.array([jet[k, 0] for jet in each]), BLEND)[1]
        gradient = sum(w * jet[k, 1:] for w, jet in zip(weight, each, strict=True))
        np.testing.assert_allclose(made[k, 1:], gradient, atol=1e-12)


def test_the_order_of_shapes_does_not_matter() -> None:
    rng = np.random.default_rng(2)
    members = mixed(rng)
    points = 0.7 * rng.normal(size=(300, 3))
    made = World(members, BLEND).jets(points, 3)
    for _ in range(3):
        other = World([members[k] for k in rng.permutation(len(members))], BLEND)
        assert worst(other.jets(points, 3), made) < 1e-12


@pytest.mark.parametrize("count", [1, 2, 3, 5, 20])
def test_coinciding_surfaces_bulge_by_less_than_a_sixth_of_the_blend(count: int) -> None:
    points = np.random.default_rng(3).normal(size=(50, 3))
    one = World([shapes.Sphere(0.3)]).distance(points)
    sunk = one - World([shapes.Sphere(0.3)] * count, BLEND).distance(points)
    wanted = BLEND / 6.0 * (1.0 - count**-0.5)
    np.testing.assert_allclose(sunk, wanted, atol=1e-13)
    assert (sunk <= BLEND / 6.0).all()


def test_of_more_shapes_at_one_place_than_it_holds_it_feels_the_nearest() -> None:
    members = [shapes.Sphere(0.3 + 1e-5 * k) for k in range(3 * NEAR)]
    made = World(members, BLEND).jets([[0.5, 0.1, 0.2]], 3)
    np.testing.assert_array_equal(made, World(members[-NEAR:], BLEND).jets([[0.5, 0.1, 0.2]], 3))


@pytest.mark.parametrize("order", [1, 2, 3])
def test_derivatives_are_those_of_differences_of_the_order_below(order: int) -> None:
    rng = np.random.default_rng(4)
    members = [shape.moved(None, turn(rng)) for shape in balls(8, rng)]
    world, step = World(members, BLEND), 5e-4
    points = 0.1 * rng.normal(size=(400, 3))
    each = np.array([World([shape]).distance(points) for shape in members]).T
    keep = []
    for row in each:  # where no shape begins to be felt between the differences
        felt = [(least(row + way, BLEND)[1] > 0.0) for way in np.eye(len(row)) * 4.0 * step]
        felt += [(least(row - way, BLEND)[1] > 0.0) for way in np.eye(len(row)) * 4.0 * step]
        keep.append(all((one == felt[0]).all() for one in felt) and felt[0].sum() > 1)
    points = points[keep]
    assert len(points) > 50
    made = world.jets(points, order)[:, SIZES[order - 1] :]
    wanted = richardson(world, points, order, step)
    assert np.abs(made - wanted).max() < 1e-10 * np.abs(made).max()


def test_second_derivatives_do_not_jump_where_a_shape_begins_to_be_felt() -> None:
    """On lines through many such places: half the step, half the largest change."""
    rng = np.random.default_rng(5)
    world = World(balls(12, rng), BLEND)
    changes = np.zeros((2, 2))
    for _ in range(20):
        start, end = 0.3 * rng.normal(size=(2, 3))
        for k, count in enumerate((2001, 4001)):
            made = world.jets(start + np.linspace(0.0, 1.0, count)[:, None] * (end - start), 2)
            for order in (1, 2):
                part = made[:, SIZES[order - 1] : SIZES[order]]
                step = np.abs(np.diff(part, axis=0)).max()
                changes[k, order - 1] = max(changes[k, order - 1], step)
    assert (changes[1] < 0.6 * changes[0]).all(), changes
