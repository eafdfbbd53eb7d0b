"""Worlds by name: the heights that a robot meets, without seams, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

from octo import World, worlds
from octo.errors import ValueRangeError

BULGE = 0.005 / 6.0 + 1e-4  # m, of a union, and of a height that is found


def heights(world: World, x: np.ndarray, y: float = 0.0) -> np.ndarray:
    """Heights (k,) m of what a foot lands on at x (k,) m."""
    return world.below(np.column_stack([x, np.full(len(x), y), np.full(len(x), 3.0)]))


def within(x: np.ndarray, first: float, last: float, margin: float = 0.015) -> np.ndarray:
    return x[(x > first + margin) & (x < last - margin)]


WAY = np.arange(-2.0, 8.0, 0.004)


@pytest.mark.parametrize("name", worlds.WORLDS)
def test_a_robot_stands_on_level_ground(name: str) -> None:
    world = worlds.WORLDS[name]()
    x, y = np.meshgrid(np.linspace(-1.0, 0.55, 12), np.linspace(-0.3, 0.3, 5))
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    jets = world.jets(points)
    assert np.abs(jets[:, 0]).max() < BULGE
    np.testing.assert_allclose(jets[:, 1:], np.tile([0.0, 0.0, 1.0], (x.size, 1)), atol=1e-9)


def test_stairs_rise_step_by_step_and_fall_again() -> None:
    world = worlds.stairs(rise=0.12, run=0.3, n=3, landing=0.8, start=0.5)
    for k, (first, last) in enumerate([(0.5, 0.8), (0.8, 1.1), (1.1, 1.9), (1.9, 2.2), (2.2, 2.5)]):
        level = 0.12 * min(k + 1, 5 - k)
        on = within(WAY, first, last)
        np.testing.assert_allclose(heights(world, on), level, atol=BULGE)
    np.testing.assert_allclose(heights(world, within(WAY, 2.5, 5.0)), 0.0, atol=BULGE)
    up = worlds.stairs(rise=0.12, n=3, down=False, landing=0.8, start=0.5)
    assert heights(up, np.array([1.85]))[0] == pytest.approx(0.36, abs=BULGE)
    assert heights(up, np.array([1.95]))[0] == pytest.approx(0.0, abs=BULGE)


def test_a_riser_goes_on_below_the_next_tread() -> None:
    """In front of a riser φ is the distance from it, down to the tread: nothing is open there."""
    world = worlds.stairs()
    z = np.linspace(0.11, 0.18, 9)
    points = np.column_stack([np.full(9, 0.9 - 0.002), np.zeros(9), z])
    np.testing.assert_allclose(world.distance(points), 0.002, atol=1e-4)


@pytest.mark.parametrize("name", ["gap", "ditch"])
def test_gaps_are_as_wide_and_as_deep_as_they_are_asked_for(name: str) -> None:
    world = worlds.WORLDS[name](width=0.4, depth=0.5)
    np.testing.assert_allclose(heights(world, within(WAY, 0.6, 1.0)), -0.5, atol=BULGE)
    np.testing.assert_allclose(heights(world, within(WAY, 1.0, 5.0)), 0.0, atol=BULGE)
    wall = world.jets([[0.62, 0.0, -0.25], [0.98, 0.0, -0.25]])
    np.testing.assert_allclose(wall[:, 0], 0.02, atol=1e-9)
    np.testing.assert_allclose(wall[:, 1], [1.0, -1.0], atol=1e-9)


def test_a_beam_has_no_seam_where_it_leaves_the_banks() -> None:
    world = worlds.beam(width=0.2, length=1.5)
    np.testing.assert_allclose(heights(world, WAY[WAY < 4.0]), 0.0, atol=BULGE)
    assert heights(world, np.array([1.3]), 0.15)[0] == pytest.approx(-1.0, abs=BULGE)


def test_blocks_stand_apart() -> None:
    world = worlds.blocks(height=0.2, n=2, length=0.6, apart=0.5)
    for first, last, level in ((0.6, 1.2, 0.2), (1.2, 1.7, 0.0), (1.7, 2.3, 0.2), (2.3, 4.0, 0.0)):
        np.testing.assert_allclose(heights(world, within(WAY, first, last)), level, atol=BULGE)


@pytest.mark.parametrize("angle", [0.1, 0.3, 0.7])
def test_a_ramp_rises_to_its_landing_without_a_ridge(angle: float) -> None:
    world = worlds.slope(angle=angle, length=1.2, landing=0.5)
    rise = np.minimum(WAY - 0.6, 0.6 + 1.2 + 0.5 + 1.2 - WAY) * math.tan(angle)
    expected = np.clip(rise, 0.0, 1.2 * math.tan(angle))
    way = (WAY > 0.0) & (WAY < 4.5)
    # at the ends of the landing the rounded edges of both parts cross
    np.testing.assert_allclose(heights(world, WAY[way]), expected[way], atol=0.006)


def test_rubble_is_uneven_closed_and_the_same_for_the_same_seed() -> None:
    world, same, other = worlds.rubble(3), worlds.rubble(3), worlds.rubble(4)
    np.testing.assert_array_equal(world.data, same.data)
    assert not np.array_equal(world.data, other.data)
    x, y = np.meshgrid(np.linspace(0.9, 3.0, 60), np.linspace(-0.6, 0.6, 40))
    z = world.below(np.column_stack([x.ravel(), y.ravel(), np.ones(x.size)]))
    assert 0.03 < z.max() <= 0.05 + BULGE and z.std() > 0.008
    assert (z < 0.003).mean() < 0.1  # ground between stones is rare


def test_an_arch_is_open_below_its_bar() -> None:
    world = worlds.arch(height=0.4, width=0.8)
    low, bar, post = world.distance([[0.65, 0, 0.2], [0.65, 0.0, 0.45], [0.65, 0.45, 0.2]])
    assert low == pytest.approx(0.2, abs=1e-3) and bar < -0.04 and post < -0.04


@pytest.mark.parametrize(
    ("name", "sizes", "words"),
    [
        ("stairs", {"rise": -0.1}, "rise of stairs is -0.1 m, must be positive"),
        ("stairs", {"n": 0}, "n of stairs is 0"),
        ("stairs", {"down": 2}, "down of stairs is 2"),
        ("gap", {"width": float("nan")}, "width of gap"),
        ("slope", {"angle": 15.0}, "angle of slope is 15 rad"),
        ("rubble", {"seed": -1}, "seed of rubble is -1"),
        ("arch", {"height": "tall"}, "height of arch is 'tall'"),
    ],
)
def test_sizes_are_refused_by_name(name: str, sizes: dict, words: str) -> None:
    with pytest.raises(ValueRangeError, match=words):
        worlds.WORLDS[name](**sizes)
