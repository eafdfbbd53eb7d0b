"""Meshes that are no body, one line each; files of tetrahedra; closed surfaces that are filled."""

from __future__ import annotations

import dataclasses
import logging
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from octo import soft
from octo.errors import (
    MissingExtraError,
    ModelError,
    OctoError,
    ProblemError,
    RobotFileError,
    ShapeError,
    UsageError,
    ValueRangeError,
)
from octo.soft import modes
from octo.soft.quadratic import TURNED

meshio = pytest.importorskip("meshio")
pytest.importorskip("skfem")

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
SQUARES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
SIDES = np.array([part for a, b, c, d in SQUARES for part in ((a, b, c), (a, c, d))])  # outwards


def block() -> tuple[np.ndarray, np.ndarray]:
    """Points and corners of 12 tetrahedra, 40 × 20 × 20 cm."""
    mesh = soft.beam_mesh(0.4, 0.2, 0.2, (2, 1, 1))
    return mesh.nodes, mesh.cells[:, :4]


def body_of(points: np.ndarray, cells: np.ndarray, **options: Any) -> soft.Body:
    return soft.Body.from_mesh((points, cells), **{"modes": 3, **options})


# -- tetrahedra that are no body -------------------------------------------------------------------


def one_inverted() -> tuple[np.ndarray, np.ndarray]:
    points, cells = block()
    cells = cells.copy()
    cells[5] = cells[5, [1, 0, 2, 3]]
    return points, cells


def one_folded() -> tuple[np.ndarray, np.ndarray]:
    """A corner pushed through the face across, and its element wound to be positive again."""
    corner = np.concatenate([np.zeros((1, 3)), 0.2 * np.eye(3), [[0.05, 0.05, 0.2]]])
    return corner, np.array([[0, 1, 2, 3], [0, 1, 2, 4]])


def a_flat_one() -> tuple[np.ndarray, np.ndarray]:
    points, cells = block()
    more = np.concatenate([points, 0.5 * points[cells[3, :1]] + 0.5 * points[cells[3, 1:2]]])
    return more, np.concatenate([cells, [[*cells[3, :3], len(points)]]])


def two_pieces() -> tuple[np.ndarray, np.ndarray]:
    points, cells = block()
    apart = points + [1.0, 0.0, 0.0]
    return np.concatenate([points, apart]), np.concatenate([cells, cells + len(points)])


def two_at_an_edge() -> tuple[np.ndarray, np.ndarray]:
    points, cells = block()
    apart = points + [0.4, 0.2, 0.0]  # they share an edge of the box: a hinge
    return np.concatenate([points, apart]), np.concatenate([cells, cells + len(points)])


def a_crowded_face() -> tuple[np.ndarray, np.ndarray]:
    points = np.concatenate([np.zeros((1, 3)), np.eye(3), [[0, 0, -1], [0.1, 0.1, -2]]])
    return 0.2 * points, np.array([[0, 1, 2, 3], [0, 2, 1, 4], [0, 2, 1, 5]])


def in_millimetres() -> tuple[np.ndarray, np.ndarray]:
    points, cells = block()
    return 1000.0 * points, cells


def too_small() -> tuple[np.ndarray, np.ndarray]:
    points, cells = block()
    return 0.01 * points, cells


BAD: list[tuple[Callable[[], tuple[np.ndarray, np.ndarray]], type[OctoError], str]] = [
    (one_inverted, ModelError, "mesh 'mesh': 1 of 12 elements are inverted, wound against the"),
    (one_folded, ModelError, "mesh 'mesh' is folded: elements 0 and 1 lie on the same side of"),
    (a_flat_one, ModelError, "mesh 'mesh': 1 of 13 elements have no volume, the first of them is"),
    (two_pieces, ModelError, "mesh 'mesh' is 2 pieces, of 12, 12 elements, which share no face"),
    (two_at_an_edge, ModelError, "mesh 'mesh' is 2 pieces, of 12, 12 elements, which share no fa"),
    (a_crowded_face, ModelError, "mesh 'mesh': 3 elements share one face of element 0, where two"),
    (
        in_millimetres,
        ValueRangeError,
        "mesh 'mesh' is 400 × 200 × 200 m, larger than 20 m: it must be in metres; scale=0.001 "
        "makes it 0.4 m long",
    ),
    (too_small, ValueRangeError, "mesh 'mesh' is 0.004 × 0.002 × 0.002 m, smaller than 1 cm: it m"),
]


@pytest.mark.parametrize(
    ("make", "kind", "words"), BAD, ids=lambda value: getattr(value, "__name__", "")
)
def test_a_mesh_that_is_no_body(
    make: Callable[[], tuple[np.ndarray, np.ndarray]], kind: type[OctoError], words: str
) -> None:
    with pytest.raises(kind) as caught:
        body_of(*make())
    assert str(caught.value).startswith(words) and "\n" not in str(caught.value)


def test_a_mesh_without_volume() -> None:
    points, cells = block()
    with pytest.raises(ModelError, match="mesh 'sheet' has no volume: all of its tetrahedra are"):
        body_of(points * [1.0, 1.0, 0.0], cells, name="sheet")


def test_numbers_that_are_no_mesh() -> None:
    points, cells = block()
    with pytest.raises(ProblemError, match=f"whole numbers from 0 to {len(points) - 1}, its"):
        body_of(points, cells + len(points))
    with pytest.raises(ShapeError, match=r"elements of mesh 'mesh' has shape \(12, 3\), expected"):
        body_of(points, cells[:, :3])
    with pytest.raises(ShapeError, match="points of mesh 'mesh' has shape"):
        body_of(points[:, :2], cells)
    with pytest.raises(ModelError, match="mesh 'mesh' has no tetrahedra"):
        body_of(points, cells[:0])
    with pytest.raises(ValueRangeError, match="points of mesh 'mesh' is not finite at index 3, 1"):
        body_of(np.where(np.arange(points.size).reshape(points.shape) == 10, np.nan, points), cells)


def test_parts_that_hang_together_at_a_hinge_move_without_a_force(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What the faces say before, the eigenvalues would say too."""
    monkeypatch.setattr("octo.soft.tetrahedra._check_faces", lambda *_: None)
    mesh = soft.Tetrahedra(*two_at_an_edge())
    model = soft.Model(mesh, 1e5, 0.3, 500.0)
    with pytest.raises(ModelError, match="moves in 7 ways without a force, where a body has 6"):
        model.modes(3)
    monkeypatch.setattr(modes, "SMALL", 0)
    with pytest.raises(ModelError, match="moves in 7 ways without a force, where a body has 6"):
        model.modes(3)


def test_all_wound_the_other_way_is_the_same_body() -> None:
    mesh = soft.ball_mesh(0.2, 2)
    turned = soft.Tetrahedra(mesh.nodes, mesh.cells[:, TURNED])
    np.testing.assert_array_equal(turned.cells, mesh.cells)


def test_edges_that_bend_too_far_are_inverted() -> None:
    mesh = soft.ball_mesh(0.2, 1)
    nodes = mesh.nodes.copy()
    nodes[mesh.cells[0, 4]] *= 2.5
    nodes[mesh.cells[0, 5]] -= 3.0 * (nodes[mesh.cells[0, 3]] - nodes[mesh.cells[0, 0]])
    with pytest.raises(ModelError, match="elements are inverted where their edges bend"):
        soft.Tetrahedra(nodes, mesh.cells)


def test_elements_of_ten_nodes_that_are_not_joined() -> None:
    """A node of an edge that two elements share, doubled and moved for one of them; and two edges
    with one node."""
    mesh = soft.ball_mesh(0.2, 1)
    cells = mesh.cells.copy()
    edge = cells[0, 4]
    nodes = np.concatenate([mesh.nodes, mesh.nodes[edge : edge + 1] + 0.01])
    cells[0, 4] = len(mesh.nodes)
    with pytest.raises(ModelError, match="one node of its own; element [1-7] has another than its"):
        soft.Tetrahedra(nodes, cells)
    cells[cells == edge] = cells[0, 5]
    cells[0, 4] = cells[0, 5]
    with pytest.raises(ModelError, match="each edge of its elements must have one node of its own"):
        soft.Tetrahedra(mesh.nodes, cells)


def test_a_mesh_is_in_metres_once_it_is_made() -> None:
    mesh = soft.ball_mesh(0.2, 1)
    made = soft.Tetrahedra(1000.0 * mesh.nodes, mesh.cells, scale=0.001)
    again = dataclasses.replace(made, name="again")
    np.testing.assert_allclose(again.nodes, mesh.nodes, atol=1e-15)


def test_points_of_no_element_and_points_at_one_place() -> None:
    points, cells = block()
    doubled = np.concatenate([points, points, [[50.0, 0.0, 0.0]]])
    half = np.where(np.arange(len(cells))[:, None] < 6, cells, cells + len(points))
    plain, odd = body_of(points, cells), body_of(doubled, half)
    assert odd.nodes == plain.nodes
    np.testing.assert_allclose(odd.frequencies, plain.frequencies, rtol=1e-9)


# -- files of tetrahedra ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    "kind",
    [
        "gmsh .msh",
        "gmsh22 .msh",
        "ansys .msh",
        "vtk .vtk",
        "vtu .vtu",
        "medit .mesh",
        "abaqus .inp",
    ],
)
def test_files_of_tetrahedra(kind: str, tmp_path: Path) -> None:
    points, cells = block()
    name, ending = kind.split()
    path = tmp_path / f"block{ending}"
    meshio.Mesh(points, [("tetra", cells)]).write(path, file_format=name)
    read, given = soft.Body.from_mesh(path, 3), body_of(points, cells)
    assert read.name == "block" and read.elements == 12
    np.testing.assert_allclose(read.frequencies, given.frequencies, rtol=1e-6)


def test_elements_of_ten_nodes_keep_their_curves(tmp_path: Path) -> None:
    mesh = soft.ball_mesh(0.2, 2)
    path = tmp_path / "round.vtk"
    meshio.Mesh(mesh.nodes, [("tetra10", mesh.cells)]).write(path)
    read = soft.Body.from_mesh(str(path), 3)
    straight = body_of(mesh.nodes, mesh.cells[:, :4])
    assert read.mass > 1.2 * straight.mass
    assert read.mass == pytest.approx(500.0 * 4.0 / 3.0 * np.pi * 0.2**3, rel=0.02)


def test_millimetres_with_their_scale(tmp_path: Path) -> None:
    points, cells = block()
    path = tmp_path / "drawn.vtk"
    meshio.Mesh(1000.0 * points, [("tetra", cells)]).write(path)
    with pytest.raises(ValueRangeError, match=r"scale=0.001 makes it 0.4 m long"):
        soft.Body.from_mesh(path)
    read = soft.Body.from_mesh(path, 3, scale=0.001)
    np.testing.assert_allclose(read.frequencies, body_of(points, cells).frequencies, rtol=1e-9)


def written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_files_that_are_no_mesh(tmp_path: Path) -> None:
    points, _ = block()
    with pytest.raises(RobotFileError, match="is not there"):
        soft.Body.from_mesh(tmp_path / "none.msh")
    for name, text in (("cut.msh", "$MeshFormat\n4.1"), ("odd.vtk", "hello"), ("odd.what", "")):
        with pytest.raises(RobotFileError, match="is no mesh"):
            soft.Body.from_mesh(written(tmp_path / name, text))
    lines = tmp_path / "lines.vtk"
    meshio.Mesh(points, [("line", [[0, 1], [1, 2]])]).write(lines)
    words = "must have tetrahedra of 4 or 10 nodes, or the triangles of a closed surface"
    with pytest.raises(RobotFileError, match=f"has line, {words}"):
        soft.Body.from_mesh(lines)
    both = tmp_path / "both.vtk"
    blocks = [("tetra", block()[1]), ("hexahedron", [np.arange(8)])]
    meshio.Mesh(points, blocks).write(both)
    with pytest.raises(RobotFileError, match=f"has hexahedron, {words}"):
        soft.Body.from_mesh(both)
    with pytest.raises(UsageError, match="path is 3, must be a file's path"):
        soft.load_mesh(3)  # type: ignore[arg-type]


def test_what_cannot_be_read_is_not_printed_by_others(tmp_path: Path) -> None:
    """meshio prints, and ends the process."""
    path = written(tmp_path / "cut.vtk", "hello")
    code = (
        "from octo import soft, errors\n"
        f"try: soft.Body.from_mesh({str(path)!r})\nexcept errors.OctoError: pass"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_options_of_a_surface_are_not_for_tetrahedra(tmp_path: Path) -> None:
    points, cells = block()
    path = tmp_path / "block.vtk"
    meshio.Mesh(points, [("tetra", cells)]).write(path)
    with pytest.raises(UsageError, match="edge is given, but block.vtk has tetrahedra already"):
        soft.Body.from_mesh(path, edge=0.05)
    with pytest.raises(UsageError, match="edge is of a surface in a file"):
        body_of(points, cells, edge=0.05)


# -- closed surfaces -------------------------------------------------------------------------------


def surface(path: Path, vertices: np.ndarray, faces: np.ndarray) -> Path:
    meshio.Mesh(vertices, [("triangle", faces)]).write(path)
    return path


@pytest.mark.parametrize("ending", [".stl", ".obj", ".ply", ".vtk"])
def test_a_closed_surface_is_filled(ending: str, tmp_path: Path) -> None:
    pytest.importorskip("tetgen"), pytest.importorskip("trimesh")
    path = surface(tmp_path / f"box{ending}", CUBE * [0.4, 0.2, 0.1], SIDES)
    made = soft.Body.from_mesh(path, 3, density=500.0)
    assert made.name == "box" and made.elements > 100
    assert made.mass == pytest.approx(4.0, rel=1e-6)
    np.testing.assert_allclose(made.size, [0.4, 0.2, 0.1], rtol=1e-6)
    finer = soft.Body.from_mesh(path, 3, density=500.0, edge=0.04)
    assert finer.elements > made.elements
    np.testing.assert_allclose(finer.frequencies, made.frequencies, rtol=0.02)


def test_a_fine_surface_is_thinned_and_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip("tetgen"), pytest.importorskip("fast_simplification")
    trimesh = pytest.importorskip("trimesh")
    path = tmp_path / "pill.ply"
    trimesh.creation.capsule(height=0.3, radius=0.05, count=[40, 40]).export(path)
    with caplog.at_level(logging.WARNING, "octo"):
        made = soft.Body.from_mesh(path, 3, young=4e4, density=250.0)
    (line,) = (record.getMessage() for record in caplog.records)
    assert line.startswith("mesh 'pill': its surface of 3200 triangles is made of 600, which takes")
    edge = float(line.partition("edge = ")[2].partition(" m ")[0])
    finer = soft.load_mesh(path, edge=edge)
    assert 1.8 < len(finer.surface[0]) / len(made.points) < 2.2
    assert made.elements < 5000
    assert made.mass == pytest.approx(250.0 * np.pi * 0.05**2 * (0.3 + 4.0 / 3.0 * 0.05), rel=0.02)


def test_surfaces_that_cannot_be_filled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    pytest.importorskip("tetgen"), pytest.importorskip("trimesh")
    small = 0.3 * CUBE

    def refused(name: str, vertices: np.ndarray, faces: np.ndarray, words: str) -> None:
        with pytest.raises(OctoError) as caught:
            soft.Body.from_mesh(surface(tmp_path / name, vertices, faces))
        assert words in str(caught.value) and "\n" not in str(caught.value)

    refused("open.stl", small, SIDES[1:], "mesh 'open' is open: 3 edges border one face only")
    both = np.concatenate([small, small + 1.0]), np.concatenate([SIDES, SIDES + 8])
    refused("two.stl", *both, "mesh 'two' is 2 pieces, closed surfaces that share no vertex")
    refused("flat.obj", small * [1, 1, 0], SIDES, "mesh 'flat' has no inside")
    refused("mm.stl", 1000.0 * small, SIDES, "mesh 'mm' is 300 × 300 × 300 m, larger than 20 m")
    cut = small.copy()
    cut[0] = 0.15, 0.25, 0.6  # a corner of the bottom pulled through the top
    refused("cut.obj", cut, SIDES, "mesh 'cut' cannot be filled with tetrahedra")
    assert not list(Path().iterdir())  # TetGen writes what it skipped


def test_without_the_mesher_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("trimesh")
    path = surface(tmp_path / "box.stl", 0.3 * CUBE, SIDES)
    monkeypatch.setitem(sys.modules, "tetgen", None)
    words = "filling the surface 'box' with tetrahedra needs the extra 'mesher': pip"
    with pytest.raises(MissingExtraError, match=words):
        soft.Body.from_mesh(path)
    monkeypatch.setitem(sys.modules, "meshio", None)
    with pytest.raises(MissingExtraError, match="needs the extra 'soft': pip"):
        soft.Body.from_mesh(written(tmp_path / "some.msh", ""))
