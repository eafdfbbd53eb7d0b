"""Worlds: the tree over shapes, motion, the numbers without a compiler, and what is refused."""

from __future__ import annotations

import copy
import ctypes
import gc
import pickle

import numpy as np
import pytest
from scenes import blocks, mixed, turn, worst

from octo import World, native, shapes
from octo.errors import OctoError, ProblemError, UnknownNameError, ValueRangeError
from octo.model.terrain import address_of, world_at
from octo.world import interpreted, layout, query
from octo.world.blend import PART
from tests.world.maps import maps

COUNTER = """
void look(const double *world, int count, const double *points, int *looked) {
  octo_world_near near;
  for (int k = 0; k < count; ++k) looked[k] = octo_world_find(world, points + 3 * k, &near);
}
"""
compiled = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")


def brute_force(world: World, points: np.ndarray, order: int) -> np.ndarray:
    """Jets from all shapes, without a tree."""
    values = [interpreted.of_shape(shape, points, 0)[:, 0] for shape in world.shapes]
    scale = PART * world.blend
    return interpreted.softened(world.shapes, scale, points, np.array(values).T, order)


@pytest.mark.parametrize("order", range(4))
def test_the_tree_finds_what_brute_force_finds(order: int) -> None:
    rng = np.random.default_rng(order)
    members = blocks(1000, rng)
    world = World([shapes.Ground(), *members], blend=0.05)
    points = np.column_stack([rng.uniform(-9.0, 9.0, (300, 2)), rng.uniform(-0.1, 2.0, 300)])
    points[:100, :2] = [members[k].position[:2] for k in range(100)]  # within boxes
    assert worst(world.jets(points, order), brute_force(world, points, order)) < 1e-12


@pytest.mark.parametrize("count", [1, 2, 7, 8, 9, 63, 64, 65, 513])
def test_trees_of_every_size_are_whole(count: int) -> None:
    rng = np.random.default_rng(count)
    world = World(blocks(count, rng))
    points = np.column_stack([rng.uniform(-6.0, 6.0, (50, 2)), rng.uniform(-0.1, 1.0, 50)])
    assert worst(world.jets(points, 1), brute_force(world, points, 1)) < 1e-12


def test_a_stack_of_the_largest_tree_fits() -> None:
    levels = np.ceil(np.log(layout.MOST) / np.log(layout.WIDTH))
    assert levels * (layout.WIDTH - 1) + 1 <= layout.STACK


@compiled
def test_a_thousand_boxes_cost_what_ten_do() -> None:
    """Shapes that are looked at, by a foot that goes through the middle of both worlds."""
    library = native.load(query.text() + COUNTER)
    assert library is not None
    members = blocks(1000, np.random.default_rng(0))
    t = np.linspace(0.0, 1.0, 2000)
    way = -0.7 + 1.4 * t, 0.1 * np.sin(7.0 * t), 0.03 + 0.05 * np.abs(np.sin(20.0 * t))
    points = np.ascontiguousarray(np.stack(way, axis=1))
    looked = np.zeros((2, len(points)), dtype=np.int32)
    for k, count in enumerate((10, 1000)):
        data = World([shapes.Ground(), *members[:count]]).data
        pointers = (ctypes.c_void_p(a.ctypes.data) for a in (data, points, looked[k]))
        world, given, out = pointers
        library.look(world, ctypes.c_int(len(points)), given, out)
    assert looked[1].mean() <= 1.3 * looked[0].mean()
    assert looked.max() < 12


# -- motion ----------------------------------------------------------------------------------------


def test_moved_shapes_are_where_they_were_moved_to() -> None:
    rng = np.random.default_rng(1)
    members = [shapes.Ground(), *blocks(200, rng)]
    members[7] = shapes.Sphere(0.2, name="ball")
    world = World(members)
    before = world.data.copy()
    points = np.column_stack([rng.uniform(-5.0, 5.0, (500, 2)), rng.uniform(0.0, 1.0, 500)])
    for k in (7, 30, 0, 7):
        place, turned = rng.normal(size=3), turn(rng)
        name = "ball" if k == 7 else k
        world = world.moved(name, place, turned)
        members[k] = members[k].moved(place, turned)
        assert worst(world.jets(points, 3), World(members).jets(points, 3)) < 1e-12
    assert (World([shapes.Ground(), *members[1:]]).data.shape) == before.shape
    np.testing.assert_array_equal(world.shapes[7].position, members[7].position)


def test_a_moved_shape_leaves_the_world_it_was_in_as_it_is() -> None:
    world = World([shapes.Sphere(0.2, name="ball"), shapes.Box((1.0, 1.0, 1.0))])
    before = world.data.copy()
    moved = world.moved("ball", position=(3.0, 0.0, 0.0))
    np.testing.assert_array_equal(world.data, before)
    assert moved.distance([[3.0, 0.0, 0.0]])[0] == pytest.approx(-0.2)
    assert moved.data.shape == world.data.shape and moved.blend == world.blend


def test_shapes_are_fixed() -> None:
    """Else a world's numbers would be others than those of its shapes."""
    place = np.zeros(3)
    box = shapes.Box((1.0, 1.0, 1.0), position=place)
    place[0] = 1.0
    assert box.position[0] == 0.0
    for one in (box.position, box.rotation, box.size, World([box]).data, World([box]).bounds):
        with pytest.raises(ValueError):
            one[0] = 2.0


def test_a_world_can_be_pickled() -> None:
    world = World(mixed(np.random.default_rng(0), 1))
    points = np.random.default_rng(1).normal(size=(20, 3))
    other = pickle.loads(pickle.dumps(world))
    np.testing.assert_array_equal(other.jets(points, 2), world.jets(points, 2))


def test_what_falls_beside_a_wall_comes_down() -> None:
    """In few steps, though φ is a hundredth of a millimetre all the way; onto the top, the ground,
    or nothing."""
    box = shapes.Box((1.0, 1.0, 1.0))
    points = [[0.5 + 1e-5, 0.0, 9.0], [0.1, 0.2, 3.0], [0.1, 0.2, 0.2], [3.0, 0.0, -2.0]]
    world, looks = World([shapes.Ground(slope=0.2, height=-0.4), box]), 0
    found = world.below(points)
    np.testing.assert_allclose(found[1:], [0.5, 0.2, -2.0], rtol=0.0, atol=1e-6)
    assert found[0] == pytest.approx(-0.4 + 0.5 * np.tan(0.2), abs=2e-3)  # but for the corner
    np.testing.assert_array_equal(World([box]).below(points[:2])[0], -np.inf)

    class Counted(World):
        def distance(self, points):
            nonlocal looks
            looks += 1
            return super().distance(points)

    Counted([shapes.Ground(), box]).below(points)
    assert looks < 2000


@compiled
def test_a_copy_has_numbers_of_its_own() -> None:
    """By their address problems find a world: when the copy is gone, it is still there."""
    world = World([BALL])
    address = address_of(world)
    other = copy.copy(world)
    assert address_of(other) != address
    del other
    gc.collect()
    assert world_at(address) is world
    assert not pickle.loads(pickle.dumps(world)).data.flags.writeable


def test_bounds_are_around_the_union() -> None:
    rng = np.random.default_rng(3)
    members = mixed(rng)[2:]
    world = World(members, blend=0.2)
    low, high = world.bounds
    points = rng.uniform(low - 0.5, high + 0.5, (20000, 3))
    inside = points[world.distance(points) <= 0.0]
    assert len(inside) and (inside >= low).all() and (inside <= high).all()
    assert np.isinf(World([shapes.Ground(), *members]).bounds).sum() == 5  # all but the top


def test_points_over_shapes_are_covered() -> None:
    box = shapes.Box((1.0, 2.0, 1.0), position=(1.0, 0.0, 0.0))
    points = [[1.4, 0.9, 5.0], [1.6, 0.0, 0.0], [1.0, -1.1, 0.0]]
    assert World([box]).covers(points).tolist() == [True, False, False]
    assert World([box, shapes.Ground()]).covers(points).all()


# -- without a compiler ----------------------------------------------------------------------------


@compiled
@pytest.mark.parametrize("order", range(4))
def test_without_a_compiler_the_numbers_are_the_same(order: int) -> None:
    rng = np.random.default_rng(order)
    world = World([*mixed(rng), *maps()], blend=0.2)
    points = 0.7 * rng.normal(size=(300, 3))
    other = interpreted.jets(world.shapes, PART * world.blend, points, order)
    assert worst(world.jets(points, order), other) < 1e-12


def test_a_machine_without_a_compiler_gets_them(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(mixed(np.random.default_rng(0), 1))
    wanted = world.jets([[0.1, 0.2, 0.3]], 2)
    monkeypatch.setattr(query, "_library", lambda: None)
    assert worst(world.jets([[0.1, 0.2, 0.3]], 2), wanted) < 1e-12
    assert world.jets(np.zeros((0, 3)), 2).shape == (0, 10)


# -- what is refused -------------------------------------------------------------------------------

BALL = shapes.Sphere(0.2, name="ball")
REFUSED = {
    "no shapes": (lambda: World([]), ProblemError, "0 shapes"),
    "no list": (lambda: World(BALL), ProblemError, "list of octo.shapes"),
    "no shape": (lambda: World([BALL, 3]), ProblemError, "shapes[1] is 3"),
    "a shape without a kind": (lambda: World([shapes.Shape()]), ProblemError, "shapes[0]"),
    "one name twice": (lambda: World([BALL, BALL]), ProblemError, "both named 'ball'"),
    "a blend of zero": (lambda: World([BALL], 0.0), ValueRangeError, "blend is 0.0 m"),
    "no radius": (lambda: shapes.Sphere(0.0), ValueRangeError, "radius of a Sphere is 0.0 m"),
    "a radius of nan": (lambda: shapes.Sphere(np.nan), ValueRangeError, "radius"),
    "a flat box": (lambda: shapes.Box((1.0, 0.0, 1.0)), ValueRangeError, "size[1] of a Box"),
    "a box of one size": (lambda: shapes.Box(1.0), OctoError, "size of a Box has shape ()"),
    "a ball of three": (lambda: shapes.Sphere((1.0, 2.0, 3.0)), OctoError, "radius of a Sphere"),
    "a box of two sizes": (lambda: shapes.Box((1.0, 1.0)), OctoError, "size of a Box"),
    "a rounding that is too large": (
        lambda: shapes.Box((1.0, 0.1, 1.0), 0.06),
        ValueRangeError,
        "rounding of a Box is 0.06 m, must be at most half of its smallest size, 0.05 m",
    ),
    "a rounding of a rim": (
        lambda: shapes.Cylinder(0.1, 0.02, 0.02),
        ValueRangeError,
        "at most half of its smallest size, 0.01 m",
    ),
    "no rounding": (lambda: shapes.Cylinder(0.1, 1.0, 0.0), ValueRangeError, "rounding"),
    "no file": (lambda: shapes.Mesh.from_file(None), ProblemError, "path is None"),
    "no length": (lambda: shapes.Capsule(0.1, -1.0), ValueRangeError, "length of a Capsule"),
    "a steep ground": (lambda: shapes.Ground(1.6), ValueRangeError, "slope of a Ground"),
    "a place that is none": (
        lambda: shapes.Sphere(1.0, position=(0.0, np.inf, 0.0)),
        ValueRangeError,
        "position of a Sphere is not finite at index 1",
    ),
    "two coordinates": (lambda: shapes.Sphere(1.0, position=(0.0, 1.0)), OctoError, "position"),
    "a mirror": (
        lambda: shapes.Sphere(1.0, rotation=np.diag([1.0, 1.0, -1.0]), name="ball"),
        ValueRangeError,
        "rotation of Sphere 'ball' is no rotation",
    ),
    "a stretch": (lambda: shapes.Sphere(1.0, rotation=2.0 * np.eye(3)), ValueRangeError, "no rot"),
    "a quaternion of zeros": (
        lambda: shapes.Sphere(1.0, rotation=np.zeros(4)),
        ValueRangeError,
        "length 0",
    ),
    "three angles": (lambda: shapes.Sphere(1.0, rotation=np.zeros(3)), OctoError, "(3, 3) or (4,)"),
    "a name that is none": (lambda: shapes.Sphere(1.0, name=3), ProblemError, "name of a Sphere"),
    "another name": (lambda: World([BALL]).moved("bal"), UnknownNameError, "did you mean ball?"),
    "another number": (lambda: World([BALL]).moved(1), ValueRangeError, "must be 0 to 0"),
    "points of a plane": (lambda: World([BALL]).jets([[0.0, 0.0]]), OctoError, "(k, 3)"),
    "one point below": (lambda: World([BALL]).below([0.0, 0.0, 1.0]), OctoError, "(k, 3)"),
    "one covered point": (lambda: World([BALL]).covers([0.0, 0.0]), OctoError, "(k, 3)"),
    "a covered point of a map": (
        lambda: World([shapes.HeightField(np.zeros((9, 9)), 0.1)]).covers([0.0, 0.0]),
        OctoError,
        "(k, 3)",
    ),
    "a point that is none": (lambda: World([BALL]).jets([[np.nan] * 3]), OctoError, "points"),
    "a fourth order": (lambda: World([BALL]).jets([[0.0] * 3], 4), OctoError, "order is 4"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_makes_no_sense_is_refused_in_one_line(case: str) -> None:
    make, kind, words = REFUSED[case]
    with pytest.raises(kind) as raised:
        make()
    assert words in str(raised.value) and "\n" not in str(raised.value)
