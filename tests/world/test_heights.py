"""Maps of heights: through their samples, C², smooth beyond their edges."""

from __future__ import annotations

import numpy as np
import pytest

from octo import World, native, shapes
from octo.checks import Array
from octo.errors import ShapeError, ValueRangeError
from octo.world import query
from octo.world.jet import SIZES
from tests.world.maps import off_by, within_cells

CELL = 0.05
ORIGIN = np.array([1.0, -2.0])


def field(seed: int = 0, size: tuple[int, int] = (40, 30), **options: object) -> shapes.HeightField:
    heights = 0.1 * np.random.default_rng(seed).normal(size=size)
    return shapes.HeightField(heights, CELL, origin=ORIGIN, **options)  # type: ignore[arg-type]


def places(made: shapes.HeightField, edge: float = 0.0) -> Array:
    """Random points (500, 3) m over a map and ``edge`` m beyond it."""
    low, high = ORIGIN - edge, ORIGIN + CELL * (np.array(np.shape(made.heights)) - 1) + edge
    return np.random.default_rng(1).uniform([*low, -1.0], [*high, 1.0], (500, 3))


def test_heights_pass_through_the_samples() -> None:
    made = field()
    heights = np.asarray(made.heights)
    index = np.argwhere(np.ones(heights.shape))
    points = np.c_[ORIGIN + CELL * index, np.zeros(len(index))]
    assert np.abs(World([made]).distance(points) + heights.ravel()).max() < 1e-14


def test_derivatives_are_those_of_differences() -> None:
    made = field()
    corner = np.array([*ORIGIN, 0.0])
    high = corner + CELL * np.array([39.0, 29.0, 10.0])
    points = within_cells(np.random.default_rng(2), corner, high, corner, CELL)
    assert off_by(World([made]), points, CELL) < 1e-10


def test_they_are_twice_continuously_differentiable() -> None:
    """Across edges of cells, and across the edges of the map."""
    world, points = World([field()]), places(field(), edge=0.2)
    points[:, 0] = ORIGIN[0] + CELL * np.round((points[:, 0] - ORIGIN[0]) / CELL)
    points[:100, 0] = ORIGIN[0] + CELL * np.random.default_rng(3).choice([0, 39], 100)
    away = np.array([1e-10, 0.0, 0.0])
    low, high = world.jets(points - away, 3), world.jets(points + away, 3)
    slopes = np.abs(np.concatenate([low, high])).max(axis=0)
    assert np.abs(high - low)[:, : SIZES[2]].max() < 3e-10 * slopes.max()
    assert np.abs(high - low)[:, SIZES[2] :].max() > 0.1 * slopes.max()  # and not three times


def test_a_plane_is_a_plane_beyond_the_map_too() -> None:
    """Up to the one cell in which it becomes level."""
    x, y = np.meshgrid(CELL * np.arange(20), CELL * np.arange(30), indexing="ij")
    made = World([shapes.HeightField(0.3 * x - 0.2 * y, CELL)])
    points = np.random.default_rng(4).uniform([0.0, 0.0, -1.0], [0.95, 1.45, 1.0], (300, 3))
    jets = made.jets(points, 3)
    height = 0.3 * points[:, 0] - 0.2 * points[:, 1]
    assert np.abs(jets[:, 0] - points[:, 2] + height).max() < 1e-13
    assert np.abs(jets[:, 1:4] - [-0.3, 0.2, 1.0]).max() < 1e-12
    assert np.abs(jets[:, 4:]).max() < 1e-7
    far = np.array([[9.0, 0.7, 0.0], [-9.0, 0.7, 0.0]])
    ends = np.array([0.95 + CELL, -CELL])
    assert np.abs(made.distance(far) + 0.3 * ends - 0.2 * 0.7).max() < 1e-6


def test_smooth_heights_do_not_overshoot() -> None:
    step = np.where(np.arange(40) < 20, 0.0, 0.1)[:, None] * np.ones(10)
    points = np.c_[np.linspace(0.0, 39 * CELL, 999), np.full(999, 0.2), np.zeros(999)]
    exact = -World([shapes.HeightField(step, CELL)]).distance(points)
    smooth = -World([shapes.HeightField(step, CELL, smooth=True)]).distance(points)
    assert 0.010 < exact.max() - 0.1 < 0.011
    assert smooth.min() > -1e-15 and smooth.max() < 0.1 + 1e-15
    assert (np.diff(smooth) > -1e-15).all()


@pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("order", range(4))
def test_without_a_compiler_the_numbers_are_the_same(order: int) -> None:
    made = field()
    points = places(made, edge=0.5)
    points[0, 0], points[1, 1] = 1e40, -1e40
    compiled = query.compiled(World([made]).data, points, order)
    assert compiled is not None
    other = made.kind.jets(made.own, points, order)
    assert np.abs(compiled - other).max() < 1e-13 * np.abs(other[2:]).max()


@pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
def test_another_map_recompiles_nothing() -> None:
    World([field()]).distance(np.zeros((1, 3)))
    loaded = len(native._opened)
    for size in ((2, 2), (3, 200)):
        assert np.isfinite(World([field(size=size)]).distance(np.zeros((1, 3)))).all()
    assert len(native._opened) == loaded


def test_a_map_of_10_m_at_2_cm_is_small() -> None:
    made = World([shapes.HeightField(np.zeros((501, 501)), 0.02)])
    assert made.data.nbytes < 2.1e6


def test_which_points_have_the_map_under_them() -> None:
    world = World([field(position=(0.0, 0.0, 1.0), rotation=(0.0, 0.0, 0.0, 1.0))])  # turned by π
    points = np.array([[-1.1, 1.9, 5.0], [-1.1, 2.1, 5.0], [1.1, -1.9, 5.0]])
    assert world.covers(points).tolist() == [True, False, False]


def test_its_box_holds_what_is_solid() -> None:
    made, points = field(), places(field(), edge=1.0)
    top = made.bounds()[1, 2]
    assert (World([made]).distance(points) >= points[:, 2] - top).all()


@pytest.mark.parametrize("options", [{}, {"scale": 0.01}])
def test_lengths_are_scaled_together(options: dict[str, float]) -> None:
    scale = options.get("scale", 1.0)
    heights = 0.1 * np.random.default_rng(5).normal(size=(12, 9)) / scale
    made = shapes.HeightField(heights, CELL / scale, origin=ORIGIN / scale, **options)
    plain = shapes.HeightField(scale * heights, CELL, origin=ORIGIN)
    assert np.abs(made.own - plain.own).max() < 1e-14


def given(**other: object) -> shapes.HeightField:
    return shapes.HeightField(**{"heights": np.zeros((10, 10)), "cell": 0.1, **other})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("other", "kind", "words"),
    [
        ({"heights": np.full((3, 3), np.nan)}, ValueRangeError, "is not finite at index 0, 0"),
        ({"heights": np.zeros(5)}, ShapeError, r"expected \(nx, ny\)"),
        ({"heights": np.zeros((1, 5))}, ShapeError, "at least 2"),
        ({"cell": 0.0}, ValueRangeError, "cell of a HeightField is 0.0 m, must be positive"),
        ({"cell": -1.0}, ValueRangeError, "must be positive"),
        ({"scale": -1.0}, ValueRangeError, "must be positive"),
        ({"origin": (0.0, 0.0, 0.0)}, ShapeError, r"expected \(2,\)"),
        ({"smooth": 1}, ValueRangeError, "True or False"),
        (
            {"cell": 100.0, "name": "yard"},
            ValueRangeError,
            r"^HeightField 'yard' is 900 × 900 × 0 m, larger than 200 m: it must be in metres; "
            r"scale=0.001 makes it 0.9 m long$",
        ),
        (
            {"cell": 0.0001},
            ValueRangeError,
            "0.0009 × 0.0009 × 0 m, smaller than 5 cm: .*scale=1000 makes it 0.9 m long",
        ),
        ({"cell": 100.0, "scale": 10.0}, ValueRangeError, "scale=0.01 makes it 9 m long"),
    ],
)
def test_what_is_no_map_is_refused(other: dict[str, object], kind: type, words: str) -> None:
    with pytest.raises(kind, match=words):
        given(**other)
