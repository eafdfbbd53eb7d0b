"""Grids of distances: through their samples, C², near the distance, and refused with a reason."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from octo import World, native, shapes
from octo.checks import Array
from octo.errors import ShapeError, ValueRangeError
from octo.world import query
from octo.world.bricks import BAND, near_surface
from octo.world.edges import around_edges
from octo.world.grid import KIND
from octo.world.jet import SIZES
from octo.world.lattice import Lattice
from octo.world.shape import FRACTION, Shape
from tests.world.maps import block, off_by, sampled, sphere, torus, within_cells

CELL, REACH = 0.025, 0.75  # m
LOW, HIGH = np.full(3, -REACH), np.full(3, REACH)


def whole(distance: Callable[[Array], Array] = torus) -> shapes.DistanceGrid:
    """A grid with all its samples."""
    values, corner = sampled(distance, REACH, CELL)
    return shapes.DistanceGrid(values, CELL, origin=corner)


class Near(Shape):
    """A grid with the samples near the surface, as of a mesh."""

    kind = KIND

    def __init__(self, distance: Callable[[Array], Array] = torus) -> None:
        super().__init__()
        self.__dict__["lattice"] = near_surface(distance, LOW, HIGH, CELL, lambda share: None)[0]

    @property
    def lattice(self) -> Lattice:
        return self.__dict__["lattice"]  # type: ignore[no-any-return]

    @property
    def own(self) -> Array:
        return self.lattice.numbers()

    def own_bounds(self) -> Array:
        return np.array([[-0.6] * 3, [0.6] * 3])


class Edged(Near):
    """The same of a cube whose edges are known."""

    def __init__(self) -> None:
        super().__init__(block)
        made, band = near_surface(block, LOW, HIGH, CELL, lambda share: None)
        along = np.linspace(-0.2, 0.2, 33)
        sides = [(k, i, j) for k in range(3) for i in (-0.2, 0.2) for j in (-0.2, 0.2)]
        edges = np.concatenate([np.roll([(x, i, j) for x in along], k, 1) for k, i, j in sides])
        self.__dict__["lattice"] = around_edges(made, band, block, edges, lambda share: None)


def at_edges(count: int) -> Array:
    """Random points (count, 3) m around the cube's edges: in their parts, beside and beyond."""
    rng = np.random.default_rng(8)
    points = rng.choice([-0.2, 0.2], (count, 3)) + rng.uniform(-0.1, 0.1, (count, 3))
    points[::2, 0] = rng.uniform(-0.2, 0.2, (count + 1) // 2)
    return points


GRIDS = pytest.mark.parametrize("make", [whole, Near])
SHAPES = pytest.mark.parametrize("distance", [sphere, torus])


def on_surface(world: World, count: int = 3000) -> Array:
    """Random points within half a cell of φ = 0."""
    points = np.random.default_rng(0).uniform(-0.6, 0.6, (40 * count, 3))
    jets = world.jets(points, 1)
    near = np.abs(jets[:, 0]) < 3.0 * CELL
    points = points[near] - jets[near, :1] * jets[near, 1:]
    points += CELL * np.random.default_rng(1).uniform(-0.3, 0.3, points.shape)
    return np.asarray(points[:count])


@GRIDS
@SHAPES
def test_it_is_near_the_distance(
    make: Callable[..., Shape], distance: Callable[[Array], Array]
) -> None:
    world = World([make(distance)])
    points = on_surface(world)
    assert len(points) == 3000
    assert np.abs(world.distance(points) - distance(points)).max() < 1e-3 * CELL


@GRIDS
def test_it_passes_through_the_samples(make: Callable[..., Shape]) -> None:
    made = make()
    values, corner = sampled(torus, REACH, CELL)
    index = np.argwhere(np.abs(values) <= (BAND * CELL if make is Near else np.inf))
    assert len(index) > 10_000
    found = World([made]).distance(corner + CELL * index)
    assert np.abs(found - values[tuple(index.T)]).max() < 1e-13


@GRIDS
def test_derivatives_are_those_of_differences(make: Callable[..., Shape]) -> None:
    points = within_cells(np.random.default_rng(2), LOW, HIGH, LOW, CELL)
    assert off_by(World([make()]), points, CELL) < 1e-10


@GRIDS
def test_it_is_twice_continuously_differentiable(make: Callable[..., Shape]) -> None:
    """Across edges of cells, where bricks end, and across the sides of the grid."""
    world, rng = World([make()]), np.random.default_rng(3)
    points = rng.uniform(-0.8, 0.8, (20_000, 3))
    points[:, 0] = LOW[0] + CELL * np.round((points[:, 0] - LOW[0]) / CELL)
    away = np.array([1e-10, 0.0, 0.0])
    low, high = world.jets(points - away, 3), world.jets(points + away, 3)
    largest = np.abs(high).max(axis=0)
    assert np.abs(high - low)[:, : SIZES[2]].max() < 3e-10 * largest.max()
    assert np.abs(high - low)[:, SIZES[2] :].max() > 0.1 * largest.max()  # and not three times


@pytest.fixture(scope="module")
def edged() -> Edged:
    return Edged()


def test_around_edges_it_is_nearer_and_elsewhere_the_same(edged: Edged) -> None:
    world, plain, points = World([edged]), World([Near(block)]), at_edges(50_000)
    near = np.abs(block(points)) < CELL
    off, before = (np.abs(one.distance(points) - block(points)) for one in (world, plain))
    assert off[near].max() < 0.1 * CELL < 0.2 * CELL < before[near].max()
    far = np.sort(np.abs(np.abs(points) - 0.2), axis=1)[:, 1] > 3.0 * CELL  # from all edges
    assert far.sum() > 1000
    assert np.abs(world.distance(points) - plain.distance(points))[far].max() < 1e-12


def test_around_edges_it_is_a_spline_of_a_quarter_of_the_cell(edged: Edged) -> None:
    """C² across the edges of its cells, where its parts end too, with derivatives of differences
    within them."""
    world, points, cell = World([edged]), at_edges(20_000), 0.25 * CELL
    inner = LOW + cell * (np.floor((points[:500] - LOW) / cell) + 0.5)
    assert off_by(world, inner, cell) < 1e-10
    points[:, 0] = LOW[0] + cell * np.round((points[:, 0] - LOW[0]) / cell)
    away = np.array([1e-10, 0.0, 0.0])
    low, high = world.jets(points - away, 3), world.jets(points + away, 3)
    largest = np.abs(high).max(axis=0)
    assert np.abs(high - low)[:, : SIZES[2]].max() < 3e-10 * largest.max()
    assert np.abs(high - low)[:, SIZES[2] :].max() > 0.1 * largest.max()


@pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("order", range(4))
def test_parts_without_a_compiler(edged: Edged, order: int) -> None:
    points = at_edges(2000)
    compiled = query.compiled(World([edged]).data, points, order)
    assert compiled is not None
    other = edged.kind.jets(edged.own, points, order)
    assert np.abs(compiled - other).max() < 1e-13 * np.abs(other).max()


def test_bricks_are_near_the_surface_alone() -> None:
    made = Near().lattice
    assert 0.1 < (made.places >= 0).mean() < 0.6
    assert made.coarse is not None and whole().own.size > 1.5 * made.numbers().size


@GRIDS
def test_outside_it_grows_with_the_way_there(make: Callable[..., Shape]) -> None:
    made = make()
    world, points = World([made]), np.random.default_rng(4).uniform(-3.0, 3.0, (3000, 3))
    corner = made.own[4:7]
    nearest = np.clip(points, corner, corner + (made.own[:3] - 1.0) * CELL)
    found, away = world.distance(points), np.abs(points - nearest).sum(axis=1)
    edge = world.distance(nearest)
    assert np.abs(found - edge - away).max() < 5.0 * CELL
    low, high = made.own_bounds()
    beyond = np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=1)
    assert (found >= FRACTION * beyond)[beyond > 0.0].all()


def test_the_box_holds_what_is_solid_at_the_sides() -> None:
    """A ground that ends where the grid does, and distances that are cut off."""
    values, corner = sampled(lambda points: points[:, 2], 0.3, CELL)
    ground = shapes.DistanceGrid(values, CELL, origin=corner)
    cut = shapes.DistanceGrid(np.minimum(sampled(sphere, REACH, CELL)[0], 0.05), CELL, origin=LOW)
    points = np.random.default_rng(5).uniform(-2.0, 2.0, (20_000, 3))
    for made in (ground, cut):
        low, high = made.own_bounds()
        beyond = np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=1)
        found = World([made]).distance(points)
        assert (found >= FRACTION * beyond)[beyond > 0.0].all()


@pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
@GRIDS
@pytest.mark.parametrize("order", range(4))
def test_without_a_compiler_the_numbers_are_the_same(
    make: Callable[..., Shape], order: int
) -> None:
    made, points = make(), np.random.default_rng(6).uniform(-1.0, 1.0, (2000, 3))
    points[0, 0], points[1, 1] = 1e40, -1e40
    compiled = query.compiled(World([made]).data, points, order)
    assert compiled is not None
    other = made.kind.jets(made.own, points, order)
    assert np.abs(compiled - other).max() < 1e-13 * np.abs(other[2:]).max()


@pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
def test_another_grid_recompiles_nothing() -> None:
    point = np.array([[0.2, 0.3, 0.1]])
    World([whole()]).distance(point)
    loaded = len(native._opened)
    small = shapes.DistanceGrid(np.full((2, 3, 4), -0.01), 0.1)
    for world in (World([small]), World([Near(sphere), small, whole(sphere)])):
        assert np.isfinite(world.distance(point)).all()
    assert len(native._opened) == loaded


def test_moving_a_grid_moves_its_distance() -> None:
    world = World([whole()])
    assert world.data.size > world.shapes[0].own.size
    turned = world.moved(
        0, position=(1.0, 2.0, 3.0), rotation=(np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0)
    )
    points = np.random.default_rng(7).uniform(-0.6, 0.6, (100, 3))
    there = np.array([1.0, 2.0, 3.0]) + points @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    assert np.abs(turned.distance(there) - world.distance(points)).max() < 1e-14
    assert turned.shapes[0].own is world.shapes[0].own  # and its numbers are not made again


def test_lengths_are_scaled_together() -> None:
    values, corner = sampled(sphere, REACH, CELL)
    made = shapes.DistanceGrid(1e3 * values, 1e3 * CELL, origin=1e3 * corner, scale=1e-3)
    points = on_surface(World([made]), 100)
    assert np.abs(World([made]).distance(points) - sphere(points)).max() < 1e-3 * CELL


def given(**other: object) -> shapes.DistanceGrid:
    values, corner = sampled(sphere, 0.5, 0.1)
    return shapes.DistanceGrid(**{"values": values, "cell": 0.1, "origin": corner, **other})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("other", "kind", "words"),
    [
        ({"values": np.full((3, 3, 3), np.nan)}, ValueRangeError, "is not finite at index 0, 0, 0"),
        ({"values": np.zeros((3, 3))}, ShapeError, r"expected \(nx, ny, nz\)"),
        ({"values": np.zeros((3, 1, 3))}, ShapeError, "at least 2"),
        ({"cell": 0.0}, ValueRangeError, "cell of a DistanceGrid is 0.0 m, must be positive"),
        ({"cell": float("nan")}, ValueRangeError, "must be positive and finite"),
        ({"scale": 0.0}, ValueRangeError, "must be positive"),
        ({"origin": (0.0, 0.0)}, ShapeError, r"expected \(3,\)"),
        ({"values": np.ones((3, 3, 3))}, ValueRangeError, "all positive, the least is 1: nothing"),
        ({"cell": 0.0001}, ValueRangeError, "smaller than 5 cm: .*scale=1000 makes it 1 m long"),
        (
            {"cell": 100.0},
            ValueRangeError,
            "1e.03 × 1e.03 × 1e.03 m, larger than 200 m: .*scale=0.001",
        ),
        (
            {"values": 1e3 * sampled(sphere, 0.5, 0.1)[0]},
            ValueRangeError,
            "change by 1e.03 m in 1 m, must be distances.* are values and cell in one unit",
        ),
    ],
)
def test_what_is_no_grid_is_refused(other: dict[str, object], kind: type, words: str) -> None:
    with pytest.raises(kind, match=words):
        given(**other)
