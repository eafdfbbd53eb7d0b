"""Pictures of motions over shapes: a step is a step, what is buried is not seen; the page has a
node for each shape."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import motions
import numpy as np
import pytest

from octo import World, filmstrip, shapes, view, worlds
from octo.model.figure import ball, size
from octo.model.gallery import CHARACTERS
from octo.picture import Camera, Scene
from octo.result.solution import Solution
from octo.world.drawn import sampled
from octo.world.sampled import Heights

RISE = 0.04  # m


def over(world: World, **changes) -> Solution:
    """The mammal wandering over a world."""
    motion = motions.wandering(CHARACTERS["mammal"]())
    low, high = (end(motion.contact_point, axis=(0, 1)) for end in (np.min, np.max))
    ground = sampled(world.below, low - 1.0, high + 1.0)
    return replace(motion, world=world, ground=ground, **changes)


def painted(solution: Solution) -> Scene:
    assert solution.character is not None
    heights, camera = Heights.of(solution.ground), Camera.beside(0.0)
    scene = Scene(camera, heights, size(solution.character), solution.world)
    scene.ground_under(solution.com)
    scene.character(solution, 10, 0.5, np.zeros(3))
    return scene


@pytest.fixture(scope="module")
def low_steps() -> Solution:
    return over(worlds.stairs(rise=RISE, n=3, start=0.2))


def test_a_step_of_4_cm_is_painted_with_its_edge(low_steps: Solution) -> None:
    parts = np.concatenate([part for part, _ in painted(low_steps).shapes])
    x, _, z = np.moveaxis(parts, -1, 0)
    for k in range(3):  # each riser's upper edge is there, and nothing hangs between two treads
        edge = (np.abs(x - 0.2 - 0.3 * k).max(axis=1) < 0.02) & (z.min(axis=1) > RISE * k + 0.03)
        assert edge.any(), k
    levels = z[np.ptp(z, axis=1) < 1e-9].mean(axis=1)
    assert {round(level / RISE, 6) for level in levels if level < 0.13} >= {0.0, 1.0, 2.0, 3.0}


def test_what_is_buried_or_out_of_reach_is_not_painted(low_steps: Solution) -> None:
    scene = painted(low_steps)
    parts = np.concatenate([part for part, _ in scene.shapes])
    assert parts[..., 2].max(axis=1).min() > -0.03  # boxes go on 30 cm below the ground
    reach = scene.reach + 0.1
    assert parts[..., 0].min() > low_steps.com[:, 0].min() - reach
    assert parts[..., 0].max() < low_steps.com[:, 0].max() + reach


def test_no_shadow_hangs_over_a_step_or_on_a_bar_above() -> None:
    bar = shapes.Box((0.3, 2.0, 0.1), position=(0.2, 0.0, 0.8))
    scene = painted(over(World([shapes.Ground(), bar])))
    shadows = np.concatenate(scene.shadows)
    assert shadows[..., 2].max() < 0.1
    assert np.ptp(shadows[..., 2], axis=1).max() < 0.1


def test_small_triangles_leave_no_shadow_on_a_wall() -> None:
    """The heights are linear between samples: none is a line down a wall."""
    scene = painted(over(worlds.gap(width=0.25, start=0.2)))
    scene.shadows = []
    for x in np.linspace(0.15, 0.5, 200):  # over both walls; triangles of half a millimetre
        scene._add(ball(np.zeros(3), 0.002), np.eye(3), np.array([x, 0.0, 0.3]), np.ones(3))
    heights = np.concatenate(scene.shadows)[..., 2]
    bottom = heights.min()
    assert bottom < -0.5
    assert np.minimum(np.abs(heights), np.abs(heights - bottom)).max() < 0.01  # edges are rounded


def test_stills_are_drawn_of_every_kind_of_shape(tmp_path: Path) -> None:
    x, y = np.meshgrid(np.linspace(0, 1, 21), np.linspace(0, 1, 21), indexing="ij")
    kinds: list[shapes.Shape] = [
        shapes.HeightField(0.02 * np.sin(9 * x + 5 * y), 0.05, (-0.3, -0.5)),
        shapes.Sphere(0.1, position=(0.5, 0.3, 0.0)),
        shapes.Capsule(0.05, 0.3, position=(0.3, -0.4, 0.1)),
        shapes.Cylinder(0.1, 0.1, position=(0.0, 0.4, 0.05)),
    ]
    filmstrip(over(World(kinds)), tmp_path / "kinds.png", moments=2)
    assert (tmp_path / "kinds.png").stat().st_size > 10_000


def test_what_hardly_travels_among_shapes_has_a_picture_of_each_moment() -> None:
    bar = shapes.Box((0.3, 2.0, 0.1), position=(0.2, 0.0, 0.8))
    level, among = (over(World([shapes.Ground(), *more])) for more in ([], [bar]))
    for motion, pictures in ((level, 1), (among, 3)):
        axes = filmstrip(motion, moments=3).axes
        assert len(axes) == pictures
        assert len({(one.get_xlim(), one.get_ylim()) for one in axes}) == 1  # of the same place
        corners = np.array([one.get_position().min for one in axes])
        assert len(np.unique(corners.round(6), axis=0)) == pictures


def test_the_page_has_a_node_for_each_shape_and_the_camera_climbs(tmp_path: Path) -> None:
    pytest.importorskip("viser")
    from octo.viewer.ground import is_level
    from octo.viewer.scene import Actor, camera_path, frame_times

    world = worlds.blocks(n=2)
    plain = motions.wandering(CHARACTERS["mammal"]())
    text, bare = view(over(world), tmp_path / "a.html").text, view(plain).text
    for k in range(len(world.shapes)):
        assert f"/world/ground_0/{k}" in text and f"/world/ground_0/{k}" not in bare
    assert not is_level(over(world)) and is_level(plain)
    x = plain.x.copy()
    x[:, 2] += np.linspace(0.0, 1.0, len(x))
    rising = over(world, x=x)
    times = frame_times([rising])
    for motion, climb in ((rising, 1.0), (replace(rising, world=None), 0.0)):
        way = camera_path(Actor.of(motion, times, np.zeros(3)), times, True, 0.3, None)
        assert np.ptp(way[:, 2]) == pytest.approx(climb, abs=0.2 * climb)
