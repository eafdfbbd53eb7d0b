"""Closed meshes as grids of distances, and open ones refused with the reason."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from octo import World, native, shapes
from octo.checks import Array
from octo.errors import (
    MissingExtraError,
    ModelError,
    ProblemError,
    RobotFileError,
    ShapeError,
    ValueRangeError,
)
from octo.world import build
from octo.world.shape import FRACTION
from octo.world.spline import Indices
from octo.world.surface import surface_of
from tests.world.maps import RISE, RUN, STEPS, block, cube, sphere, stairs

trimesh = pytest.importorskip("trimesh")
pytest.importorskip("igl")
pytest.importorskip("manifold3d")
CELL = 0.02  # m
FLIGHT, BROAD = 3, 0.8  # steps; m
TURNED = Rotation.from_euler("xyz", [1.1, -0.4, 0.2]).as_matrix()


@pytest.fixture(autouse=True)
def own_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("OCTO_CACHE", str(tmp_path / "cache"))


def mesh(given: tuple[Array, Indices], **options: object) -> shapes.Mesh:
    return shapes.Mesh(*given, **{"cell": CELL, **options})  # type: ignore[arg-type]


def near_faces(world: World, count: int, reach: float) -> Array:
    """Points within a cell of φ = 0, at random."""
    points = np.random.default_rng(0).uniform(-reach, reach, (count, 3))
    return points[np.abs(world.distance(points)) < CELL]


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> World:
    """A flight of three steps."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OCTO_CACHE", str(tmp_path_factory.mktemp("cache")))
        world = World([mesh(stairs(FLIGHT, BROAD))])
        assert world.data.size > 0
    return world


# -- distances -------------------------------------------------------------------------------------


def test_a_cube_is_a_box() -> None:
    made = World([mesh(cube())])
    box = World([shapes.Box((0.4, 0.4, 0.4), rounding=1e-4)])
    points = near_faces(box, 200_000, 0.25)
    beside = np.sort(np.abs(points), axis=1)[:, 1] < 0.2 - 2.0 * CELL  # 2 cells from the edges
    assert beside.sum() > 10_000
    off = np.abs(made.distance(points) - block(points)) / CELL
    assert off[beside].max() < 0.05
    assert off.max() < 0.1


def test_a_ball_is_a_sphere() -> None:
    ball = trimesh.creation.icosphere(5, 0.4)
    made = World([mesh((ball.vertices, ball.faces))])
    points = near_faces(World([shapes.Sphere(0.4)]), 100_000, 0.5)
    assert np.abs(made.distance(points) - sphere(points)).max() < 0.03 * CELL  # of which 0.02 flats


def from_steps(points: Array, steps: int = STEPS) -> Array:
    """The distance (k,) m from stairs, in the middle of their width."""
    corners = stairs(steps)[0][: 2 * steps + 2, [0, 2]]
    start, along = corners, np.roll(corners, -1, axis=0) - corners
    away = points[:, None, [0, 2]] - start
    part = np.einsum("kij,ij->ki", away, along) / np.einsum("ij,ij->i", along, along)
    least = np.linalg.norm(away - np.clip(part, 0.0, 1.0)[:, :, None] * along, axis=2).min(axis=1)
    x, _, z = points.T
    inside = (x > 0.0) & (x < steps * RUN) & (z > 0.0) & (z < (np.floor(x / RUN) + 1.0) * RISE)
    return np.asarray(np.where(inside, -least, least))


def test_the_error_of_stairs(flight: World) -> None:
    rng = np.random.default_rng(1)
    step, along = rng.integers(0, FLIGHT, 5000), rng.uniform(0.0, RUN, 5000)
    height = rng.uniform(-CELL, CELL, 5000)
    tread = np.stack(
        [step * RUN + along, np.full(5000, 0.5 * BROAD), (step + 1) * RISE + height], axis=1
    )
    off = np.abs(flight.distance(tread) - from_steps(tread, FLIGHT)) / CELL
    edge = np.minimum(along, RUN - along) / CELL
    assert off[edge > 2.0].max() < 0.05
    assert off[edge > 4.0].max() < 0.015
    assert off.max() < 0.1


def from_stairs(points: Array, steps: int, width: float) -> Array:
    """The distance (k,) m from stairs with their sides."""
    ahead, beside = from_steps(points, steps), np.maximum(-points[:, 1], points[:, 1] - width)
    away = np.hypot(np.maximum(ahead, 0.0), np.maximum(beside, 0.0))
    return np.asarray(away + np.minimum(np.maximum(ahead, beside), 0.0))


@pytest.mark.parametrize("turn", [np.eye(3), TURNED])
def test_edges_and_corners_are_sharper_than_a_tenth_of_a_cell(turn: Array) -> None:
    """Inner and outer ones of stairs, however they lie in the grid."""
    vertices, faces = stairs(2, 0.4)
    made = World([mesh((vertices @ turn.T + [0.004, 0.006, 0.009], faces))])
    rng = np.random.default_rng(4)
    start = vertices[rng.integers(0, len(vertices), 100_000)]
    start[::2, 1] = rng.uniform(0.0, 0.4, 50_000)
    points = start + rng.uniform(-2.0 * CELL, 2.0 * CELL, start.shape)
    true = from_stairs(points, 2, 0.4)
    near = np.abs(true) < CELL
    off = np.abs(made.distance(points @ turn.T + [0.004, 0.006, 0.009]) - true)[near] / CELL
    assert near.sum() > 20_000 and 0.04 < off.max() < 0.1


def test_edges_take_memory_by_their_length() -> None:
    """A cube of twice the size has four times the surface, and edges twice as long."""
    small, large = (mesh(cube(size)).own.nbytes for size in (0.2, 0.4))
    assert large < 3.0 * small
    assert large < 16e3 * 12 * 0.4 / CELL + 1.5e6


@pytest.mark.parametrize("given", [cube(), stairs(3, 1.0)])
def test_outside_its_box_it_is_as_far_as_the_tree_expects(given: tuple[Array, Indices]) -> None:
    made = mesh(given)
    low, high = made.bounds()
    points = np.random.default_rng(3).uniform(low - 1.0, high + 1.0, (50_000, 3))
    beyond = np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=1)
    assert (World([made]).distance(points) >= FRACTION * beyond)[beyond > 0.0].all()


def test_parts_that_overlap_are_a_union_without_faces_inside() -> None:
    one, faces = cube()
    two = one + [0.3, 0.0, 0.0]
    made = World([mesh((np.concatenate([one, two]), np.concatenate([faces, faces + 8])))])
    points = np.array([[0.1, 0.0, 0.0], [0.2, 0.0, 0.0], [0.15, 0.0, 0.25], [0.15, 0.0, 0.15]])
    depth = made.distance(points)  # at 5 cells of depth only every fourth sample is kept
    assert np.abs(depth - [-0.2, -0.2, 0.05, -0.05]).max() < 0.5 * CELL


def test_boxes_side_by_side_are_solid_between(tmp_path: Path) -> None:
    """Stairs of boxes, as a file with three vertices a face: their sides lie on each other."""
    boxes = []
    for k in range(STEPS):
        block = trimesh.creation.box((RUN, 8.0, (k + 1) * RISE))
        block.apply_translation(((k + 0.5) * RUN, 1.5, (k + 1) * RISE / 2.0))
        boxes.append(block)
    file = tmp_path / "steps.stl"
    trimesh.util.concatenate(boxes).export(file)
    made = shapes.Mesh.from_file(file, cell=CELL)
    vertices, faces = np.asarray(made.vertices), np.asarray(made.faces)
    points = np.random.default_rng(2).uniform([-0.5, 1.0, -0.5], [6.5, 2.0, 3.5], (2000, 3))
    points[:500, 0] = RUN * np.round(points[:500, 0] / RUN)  # where two boxes meet
    true = from_steps(points)
    for angle in (0.0, 0.3):  # turned ones touch but for rounding
        turn = Rotation.from_euler("xyz", [angle, 2.0 * angle, 0.7]).as_matrix()
        surface = surface_of(vertices @ turn.T, faces)
        assert np.abs(surface.distance(points @ turn.T) - true).max() < 1e-5


def test_a_part_within_another_that_looks_inwards_is_a_cavity() -> None:
    outer, faces = cube(0.6)
    inner = 0.5 * outer
    given = np.concatenate([outer, inner]), np.concatenate([faces, faces[:, ::-1] + 8])
    made = World([mesh(given)])
    points = np.array([[0.0, 0.0, 0.1], [0.0, 0.0, 0.2], [0.0, 0.0, 0.35]])
    assert np.abs(made.distance(points) - [0.05, -0.05, 0.05]).max() < 0.1 * CELL


def test_faces_may_be_wound_in_any_way() -> None:
    vertices, faces = cube()
    plain = World([mesh((vertices, faces))]).data
    some = faces.copy()
    some[::3] = some[::3, ::-1]
    for given in (faces[:, ::-1], some):
        assert np.abs(World([mesh((vertices, given))]).data - plain).max() < 1e-12


def test_vertices_of_each_face_on_their_own_are_merged() -> None:
    vertices, faces = cube()
    apart = vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
    assert len(np.asarray(mesh(apart).vertices)) == 8


# -- files and the cache ---------------------------------------------------------------------------


@pytest.mark.parametrize("ending", ["stl", "obj", "ply", "glb"])
def test_files_are_read(tmp_path: Path, ending: str) -> None:
    vertices, faces = cube(400.0)
    file = tmp_path / f"block.{ending}"
    trimesh.Trimesh(vertices, faces, process=False).export(file)
    made = shapes.Mesh.from_file(file, scale=1e-3, cell=CELL)
    assert made.name == "block" and np.abs(made.bounds()) == pytest.approx(0.2 + CELL)
    assert World([made]).distance([[0.0, 0.0, 0.25]]) == pytest.approx(0.05, abs=0.1 * CELL)


def test_a_file_that_is_no_mesh_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RobotFileError, match="is not there"):
        shapes.Mesh.from_file(tmp_path / "missing.stl")
    (tmp_path / "text.obj").write_text("hello")
    with pytest.raises(RobotFileError, match="is no mesh"):
        shapes.Mesh.from_file(tmp_path / "text.obj")


def test_a_grid_is_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    first = mesh(cube()).own
    monkeypatch.setattr(build, "_grid", None)  # would fail
    assert np.array_equal(mesh(cube(), position=(1.0, 0.0, 0.0)).own, first)
    with pytest.raises(TypeError):
        _ = mesh(cube(), cell=0.01).own


@pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
def test_another_mesh_recompiles_nothing() -> None:
    World([mesh(cube())]).distance(np.zeros((1, 3)))
    loaded = len(native._opened)
    World([mesh(cube(0.6), cell=0.05), mesh(cube(), cell=0.04)]).distance(np.zeros((1, 3)))
    assert len(native._opened) == loaded


def test_without_the_library_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "igl", None)
    made = mesh(cube())
    with pytest.raises(MissingExtraError, match=r"octo-trajopt\[mesh\]"):
        _ = made.own


def test_walls_that_are_lost_are_said(caplog: pytest.LogCaptureFixture) -> None:
    vertices, faces = cube(1.0)
    with caplog.at_level(logging.INFO, "octo"):
        _ = mesh((vertices * [1.0, 1.0, 0.008], faces), name="sheet").own
        _ = mesh((vertices * [1.0, 1.0, 0.05], faces), name="board").own
    warned = [one.getMessage() for one in caplog.records if one.levelno == logging.WARNING]
    assert len(warned) == 1
    assert "Mesh 'sheet': 98 % of its surface are walls thinner than 1.5 cells" in warned[0]
    assert any("MB" in one.getMessage() for one in caplog.records)


# -- what is refused -------------------------------------------------------------------------------


def test_an_open_mesh_is_refused_with_its_hole() -> None:
    vertices, faces = cube()
    with pytest.raises(ModelError) as refused:
        mesh((vertices, faces[2:]), name="box")  # without the quad at x = −0.2
    said = str(refused.value)
    assert "Mesh 'box' is open: 4 edges border one face only, around 1 hole" in said
    assert "from (-0.2, -0.2, -0.2) m to (-0.2, 0.2, 0.2) m" in said
    with pytest.raises(ModelError, match="6 edges border one face only, around 2 holes"):
        mesh((vertices, np.delete(faces, [1, 2], axis=0)))


def test_a_surface_with_one_side_is_refused() -> None:
    """A Klein bottle: closed, and without an inside."""
    n = 8
    u, v = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    a, b = 2.0 * np.pi * u / n, 2.0 * np.pi * (v + 0.5) / n
    r = 2.0 + np.cos(a / 2.0) * np.sin(b) - np.sin(a / 2.0) * np.sin(2.0 * b)
    z = np.sin(a / 2.0) * np.sin(b) + np.cos(a / 2.0) * np.sin(2.0 * b)
    vertices = np.stack([r * np.cos(a), r * np.sin(a), z], axis=-1).reshape(-1, 3)

    def at(i: int, j: int) -> int:
        return (i % n) * n + ((j if i < n else -1 - j) % n)

    cells = [(i, j) for i in range(n) for j in range(n)]
    faces = [(at(i, j), at(i + 1, j), at(i + 1, j + 1)) for i, j in cells]
    faces += [(at(i, j), at(i + 1, j + 1), at(i, j + 1)) for i, j in cells]
    with pytest.raises(ModelError, match="has no inside: its faces cannot all be wound alike"):
        mesh((vertices, np.array(faces)))


@pytest.mark.parametrize(
    ("size", "other", "words"),
    [
        (
            1500.0,
            {"name": "desk"},
            r"^Mesh 'desk' is 1.5e\+03 × 1.5e\+03 × 1.5e\+03 m, larger than 200 m: it must be in "
            r"metres; scale=0.001 makes it 1.5 m long$",
        ),
        (0.003, {}, "0.003 × 0.003 × 0.003 m, smaller than 5 cm: .*scale=1000 makes it 3 m long"),
        (0.4, {"cell": 0.0}, "cell of a Mesh is 0.0 m, must be positive"),
        (0.4, {"scale": float("nan")}, "scale of a Mesh is nan, must be positive"),
    ],
)
def test_what_is_no_mesh_in_metres_is_refused(
    size: float, other: dict[str, object], words: str
) -> None:
    with pytest.raises(ValueRangeError, match=words):
        mesh(cube(size), **other)


def test_a_mesh_without_an_inside_is_refused() -> None:
    vertices, faces = cube()
    with pytest.raises(ModelError, match="all of its faces are lines or points"):
        mesh((vertices, faces[:, [0, 0, 1]]))
    with pytest.raises(ModelError, match="the faces on both sides are one"):
        mesh((vertices * [1.0, 1.0, 0.0], faces))


def test_a_grid_that_does_not_fit_into_memory_is_refused() -> None:
    assert mesh(cube(100.0), cell=None).cell > 0.05  # what is not given fits
    with pytest.raises(ProblemError, match="distances to a Mesh at a cell of 0.001 m need .* GB"):
        mesh(cube(100.0), cell=0.001)


def test_faces_are_of_its_vertices() -> None:
    vertices, faces = cube()
    with pytest.raises(ProblemError, match="must be whole numbers from 0 to 7, its vertices"):
        mesh((vertices, faces + 1))
    with pytest.raises(ShapeError, match=r"faces of a Mesh has shape \(12, 4\), expected \(n, 3\)"):
        mesh((vertices, np.zeros((12, 4))))
    vertices[3, 1] = np.nan
    with pytest.raises(ValueRangeError, match="vertices of a Mesh is not finite at index 3, 1"):
        mesh((vertices, faces))
