"""What a world looks like: its triangles lie where φ is 0, their outward side is outside."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from octo import World, shapes
from octo.world.cut import halved, near
from octo.world.drawn import creases, drawn, everywhere, sampled

POSE: dict[str, Any] = {
    "position": (0.3, -0.2, 0.5),
    "rotation": Rotation.from_euler("xyz", [0.3, -0.4, 0.7]).as_matrix(),
}


def ball_grid() -> shapes.DistanceGrid:
    axis = np.linspace(-0.6, 0.6, 25)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    return shapes.DistanceGrid(np.sqrt(x**2 + y**2 + z**2) - 0.4, 0.05, (-0.6, -0.6, -0.6), **POSE)


def waves(smooth: bool = False) -> shapes.HeightField:
    x, y = np.meshgrid(np.linspace(0, 2, 41), np.linspace(0, 1, 21), indexing="ij")
    heights = 0.1 * np.sin(3 * x) + 0.05 * np.cos(5 * y)
    return shapes.HeightField(heights, 0.05, (-1.0, -0.5), smooth=smooth, **POSE)


# with how far (m) triangles may be from φ = 0: chords of circles, straight lines between samples
ROUND, FLAT = 0.002, 1e-9
SOLIDS = [
    (shapes.Sphere(0.4, **POSE), ROUND),
    (shapes.Capsule(0.2, 0.5, **POSE), ROUND),
    (shapes.Cylinder(0.3, 0.5, 1e-6, **POSE), ROUND),
    (shapes.Box((0.5, 0.3, 0.4), 1e-6, **POSE), 1e-6),
    (ball_grid(), 0.004),
]


def test_a_shape_is_closed_outward_and_where_its_distance_is_0() -> None:
    for shape, tolerance in SOLIDS:
        (surface,) = drawn([shape], everywhere([shape]))
        corners = surface.vertices[surface.faces]
        distance = World([shape]).distance(corners.mean(axis=1))
        assert np.abs(distance).max() < tolerance, shape
        edges = np.concatenate([surface.faces[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
        forth, back = ({*map(tuple, e.tolist())} for e in (edges, edges[:, ::-1]))
        assert forth == back and len(forth) == len(edges), shape
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        slope = World([shape]).jets(corners.mean(axis=1))[:, 1:]
        assert (np.sum(normal * slope, axis=1) > 0.0).all(), shape


@pytest.mark.parametrize("smooth", [False, True])
def test_a_map_is_drawn_at_its_samples_and_only_around_the_picture(smooth: bool) -> None:
    shape = waves(smooth)
    (whole,) = drawn([shape], everywhere([shape]))
    assert len(whole.vertices) == 41 * 21
    assert np.abs(World([shape]).distance(whole.vertices)).max() < 1e-12
    around = np.array([[0.0, -0.4], [0.4, 0.0]])
    (part,) = drawn([shape], around)
    assert 0 < len(part.vertices) < len(whole.vertices) / 2
    normal = np.cross(*(np.diff(part.vertices[part.faces], axis=1)[:, k] for k in (0, 1)))
    assert (normal @ shape.rotation[:, 2] > 0.0).all()
    assert drawn([shape], np.array([[5.0, 5.0], [6.0, 6.0]])) == []


def test_a_plane_is_drawn_where_the_picture_is() -> None:
    shape = shapes.Ground(slope=0.3, direction=0.5, height=0.2, position=(0.0, 0.0, 0.1))
    around = np.array([[-1.0, 2.0], [3.0, 4.0]])
    (surface,) = drawn([shape], around)
    assert np.abs(World([shape]).distance(surface.vertices)).max() < 1e-12
    np.testing.assert_allclose(surface.vertices[:, :2].min(axis=0), around[0])
    np.testing.assert_allclose(surface.vertices[:, :2].max(axis=0), around[1])
    places = np.array([[0.3, 2.5], [1.0, 3.0]])
    points = np.column_stack([places, surface.height(places)])
    assert np.abs(World([shape]).distance(points)).max() < 1e-12
    wall = shapes.Ground(rotation=Rotation.from_euler("y", -90, degrees=True).as_matrix())
    (surface,) = drawn([wall], around)
    assert np.abs(World([wall]).distance(surface.vertices)).max() < 1e-12


def test_heights_for_shadows_are_those_of_the_highest_shape() -> None:
    bar = shapes.Box((0.2, 2.0, 0.1), position=(0.5, 0.0, 0.6))
    found = sampled(World([bar]).below, np.array([0.0, -1.0, 0.0]), np.array([1.0, 1.0, 1.0]))
    assert found["z"].shape == (len(found["x"]), len(found["y"]))
    over = np.abs(found["x"] - 0.5) < 0.08
    np.testing.assert_allclose(found["z"][over, 1:-1], 0.65, atol=1e-3)
    np.testing.assert_allclose(found["z"][np.abs(found["x"] - 0.5) > 0.11], -3.0)


def test_a_box_has_twelve_creases_and_a_ball_none() -> None:
    box, ball = shapes.Box((0.5, 0.3, 0.4), **POSE), shapes.Sphere(0.4)
    (surface,) = drawn([box], everywhere([box]))
    ends, normals = creases(surface.vertices, surface.faces)
    assert len(ends) == 12
    np.testing.assert_allclose(np.sum(normals[:, 0] * normals[:, 1], axis=1), 0.0, atol=1e-12)
    (surface,) = drawn([ball], everywhere([ball]))
    assert len(creases(surface.vertices, surface.faces)[0]) == 0


def test_triangles_are_cut_fine_near_a_path_and_left_out_elsewhere() -> None:
    square = np.array([[(0, 0, 0), (8, 0, 0), (8, 8, 0)], [(0, 0, 0), (8, 8, 0), (0, 8, 0)]], float)
    path = np.array([[1.0, 1.0], [2.0, 1.0]])
    corners, which = near(square, np.array([0, 1]), path, 0.5, 0.2)
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    assert edges.max() <= 0.2
    assert corners[..., :2].min() > 0.2 and corners[..., 0].max() < 2.8
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    assert area.sum() > 1.0 * 1.0 + np.pi * 0.25  # all that is within reach
    assert {*which.tolist()} == {0, 1}
    whole, _ = halved(square, np.zeros(2), 3.0)
    sides = np.cross(whole[:, 1] - whole[:, 0], whole[:, 2] - whole[:, 0])
    assert 0.5 * np.linalg.norm(sides, axis=1).sum() == pytest.approx(64.0)
