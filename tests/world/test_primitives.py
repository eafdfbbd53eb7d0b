"""φ of each shape in closed form: derivatives, smoothness, where the surface is and its normal."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import PRIMITIVES, near_surface, richardson, turn

from octo import World, shapes
from octo.world.jet import SIZES

STEP = 2.5e-4  # m, of differences
NAMES = list(PRIMITIVES)


def regions(shape: shapes.Shape, points: np.ndarray) -> np.ndarray:
    """(k, …) m: signed distances from the seams of a shape's φ, at points of its frame."""
    if isinstance(shape, shapes.Box):
        q = np.abs(points) - np.asarray(shape.size) / 2.0 + shape.rounding
        return np.concatenate([q, points], axis=1)
    across = np.linalg.norm(points[:, :2], axis=1)
    if isinstance(shape, shapes.Cylinder):
        end = np.abs(points[:, 2]) - shape.length / 2.0 + shape.rounding
        return np.stack([across - shape.radius + shape.rounding, end, across], axis=1)
    if isinstance(shape, shapes.Capsule):
        end, seam = np.abs(points[:, 2]) - shape.length / 2.0, 0.25 * shape.radius
        return np.stack([end - seam, end + seam, across], axis=1)
    return np.ones((len(points), 1))


@pytest.mark.parametrize("order", [1, 2, 3])
@pytest.mark.parametrize("name", NAMES)
def test_derivatives_are_those_of_differences_of_the_order_below(name: str, order: int) -> None:
    """In random poses: outside, on the surface and inside, over faces, edges and corners."""
    rng = np.random.default_rng(order)
    seen = 0
    for _ in range(5):
        shape = PRIMITIVES[name].moved(rng.normal(size=3), turn(rng))
        points = near_surface(shape, rng, 300, depth=0.02, height=0.15)
        apart = regions(shape, (points - shape.position) @ np.asarray(shape.rotation))
        points = points[(np.abs(apart) > 2.0 * STEP).all(axis=1)]  # no seam between differences
        seen += len(points)
        world = World([shape])
        made = world.jets(points, order)[:, SIZES[order - 1] :]
        wanted = richardson(world, points, order, STEP)
        size = max(np.abs(made).max(), 1.0)
        assert np.abs(made - wanted).max() < 1e-10 * size
    assert seen > 500


@pytest.mark.parametrize("name", ["box", "capsule", "cylinder"])
def test_all_regions_were_seen(name: str) -> None:
    """Faces, edges and corners: the test above means nothing in one of them alone."""
    rng = np.random.default_rng(0)
    points = near_surface(PRIMITIVES[name], rng, 300, depth=0.02, height=0.15)
    parts = regions(PRIMITIVES[name], points) > 0.0
    count = np.unique(parts[:, : 3 if name == "box" else 2], axis=0, return_counts=True)[1]
    assert len(count) == {"box": 7, "capsule": 3, "cylinder": 3}[name] and count.min() >= 3


@pytest.mark.parametrize("name", ["box", "capsule", "cylinder", "plate", "rod"])
def test_third_derivatives_do_not_jump(name: str) -> None:
    """On lines through all regions: half the step, half the largest change of a derivative."""
    shape = PRIMITIVES[name]
    rng = np.random.default_rng(1)
    changes = np.zeros((2, 3))
    for _ in range(20):
        inside, outside = near_surface(shape, rng, 2, depth=0.03, height=0.2)
        for k, count in enumerate((4001, 8001)):
            t = np.linspace(0.0, 1.0, count)[:, None]
            made = World([shape]).jets(inside + t * (outside - inside), 3)
            keep = made[:, 0] > -0.03  # not through the middle, where edges meet
            for order in (1, 2, 3):
                part = made[:, SIZES[order - 1] : SIZES[order]]
                step = np.abs(np.diff(part, axis=0))[keep[1:] & keep[:-1]].max(initial=0.0)
                changes[k, order - 1] = max(changes[k, order - 1], step)
    assert (changes[1] < 0.6 * changes[0]).all(), changes


SURFACE = {  # a point of the surface in the shape's frame and the normal there
    "ground": (
        (0.0, 0.0, 0.1),
        (-np.sin(0.3) * np.cos(1.0), -np.sin(0.3) * np.sin(1.0), np.cos(0.3)),
    ),
    "sphere": ((0.12, 0.0, -0.16), (0.6, 0.0, -0.8)),
    "face of a box": ((0.05, -0.2, 0.1), (0.0, -1.0, 0.0)),
    "edge of a box": (
        (0.1 + 0.05 * 0.5**0.25, 0.15 + 0.05 * 0.5**0.25, 0.1),
        (0.5**0.5, 0.5**0.5, 0.0),
    ),
    "corner of a box": (np.array([0.1, 0.15, 0.2]) + 0.05 * 3.0**-0.25, np.full(3, 3.0**-0.5)),
    "side of a capsule": ((0.12, -0.16, 0.05), (0.6, -0.8, 0.0)),
    "cap of a capsule": ((0.12, 0.0, 0.31), (0.6, 0.0, 0.8)),
    "side of a cylinder": ((0.12, -0.16, 0.05), (0.6, -0.8, 0.0)),
    "end of a cylinder": ((0.05, 0.05, -0.15), (0.0, 0.0, -1.0)),
}


@pytest.mark.parametrize("place", SURFACE)
def test_phi_is_zero_on_the_surface_and_the_gradient_normal_to_it(place: str) -> None:
    point, normal = (np.asarray(one, dtype=float) for one in SURFACE[place])
    rng = np.random.default_rng(2)
    plain = PRIMITIVES[place.split()[-1]]
    for shape in (plain, plain.moved(rng.normal(size=3), turn(rng))):
        rotation = np.asarray(shape.rotation)
        made = World([shape]).jets([shape.position + rotation @ point], 1)[0]
        assert abs(made[0]) < 1e-15 + 4e-16 * np.abs(shape.position).max()
        gradient = made[1:] / np.linalg.norm(made[1:])
        np.testing.assert_allclose(gradient, rotation @ normal, atol=1e-14)
    if " of " not in place or place.split()[0] not in ("edge", "corner"):
        assert np.linalg.norm(made[1:]) == pytest.approx(1.0, abs=1e-14)  # a distance


def test_faces_of_a_box_are_flat() -> None:
    made = World([shapes.Box((1.0, 2.0, 3.0))]).jets([[0.1, 0.2, 1.5], [0.5, 0.9, 1.0]], 3)
    np.testing.assert_array_equal(made[:, 4:], 0.0)
    np.testing.assert_array_equal(made[:, 1:4], [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])


def test_phi_of_a_box_is_no_longer_than_the_distance_and_not_much_shorter() -> None:
    rng = np.random.default_rng(4)
    box = PRIMITIVES["box"]
    points = rng.uniform(-1.5, 1.5, (5000, 3))
    phi = World([box]).distance(points)
    sharp = np.linalg.norm(np.maximum(np.abs(points) - np.asarray(box.size) / 2.0, 0.0), axis=1)
    inner = np.maximum(np.abs(points) - np.asarray(box.size) / 2.0 + box.rounding, 0.0)
    outside = phi > 0.0
    longest = (np.linalg.norm(inner, axis=1) - box.rounding * 3.0**-0.25)[outside]  # to the corners
    assert (phi[outside] >= 3.0**-0.25 * sharp[outside] - 1e-15).all()
    assert (phi[outside] <= longest + 1e-12).all()


@pytest.mark.parametrize("name", NAMES)
def test_a_box_around_a_shape_holds_all_of_it(name: str) -> None:
    """φ > 0 outside of it, and at least three quarters of the distance from it."""
    rng = np.random.default_rng(5)
    for turned in (np.eye(3), turn(rng)):
        shape = PRIMITIVES[name].moved(rng.normal(size=3), turned)
        low, high = shape.bounds()
        points = rng.uniform(-3.0, 3.0, (5000, 3))
        away = np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=1)
        phi = World([shape]).distance(points)
        assert (phi[away > 0.0] >= 0.75 * away[away > 0.0]).all()


@pytest.mark.parametrize("name", NAMES)
def test_derivatives_are_finite_everywhere(name: str) -> None:
    """At centres, on axes, in corners and where regions meet."""
    values = (-0.2, -0.15, -0.1, -0.0, 0.0, 1e-30, 1e-9, 0.1, 0.15, 0.2, 0.25, 1e3)
    points = np.stack(np.meshgrid(values, values, values), axis=-1).reshape(-1, 3)
    assert np.isfinite(World([PRIMITIVES[name]]).jets(points, 3)).all()


def test_a_quaternion_is_a_rotation() -> None:
    half = np.pi / 6.0
    quaternion = 2.0 * np.array([np.cos(half), 0.0, 0.0, np.sin(half)])  # of any length
    c, s = np.cos(2.0 * half), np.sin(2.0 * half)
    box = shapes.Box((1.0, 1.0, 1.0), rotation=quaternion)
    np.testing.assert_allclose(
        box.rotation, [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]], atol=1e-15
    )


def test_ground_is_the_plane_of_octo() -> None:
    import octo
    from octo.model.terrain import signed_distance

    plane = octo.Plane(0.3, 1.0, 0.1)
    points = np.random.default_rng(0).normal(size=(20, 3))
    wanted = signed_distance(plane, points, plane.parameters)
    made = World([shapes.Ground(0.3, 1.0, 0.1)]).distance(points)
    np.testing.assert_allclose(made, wanted, rtol=0.0, atol=1e-15)
