"""Worlds out of files: what stands still in a scene, meshes, maps; what is left out or refused."""

from __future__ import annotations

import logging
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import octo
from octo import World, load_world, shapes
from octo.errors import OctoError

mujoco = pytest.importorskip("mujoco")

SCENE = """<mujoco>
  <asset>
    <hfield name="hills" nrow="5" ncol="7" size="1.5 1 0.4 0.1" elevation="
      0 0 0 0 0 0 1  0 0 0 0 0 0 0  0 0.5 0 0 0 0 0  0 0 0 0 0 0 0  0.25 0 0 0 0 0 0"/>
    <mesh name="wedge" vertex="0 0 0  1 0 0  0 1 0  0 0 1" inertia="exact"/>
  </asset>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" pos="0 0 -1"/>
    <geom type="plane" size="0 0 1" pos="5 0 0" zaxis="-1 0 3"/>
    <geom name="mark" type="sphere" size="0.1" contype="0" conaffinity="0"/>
    <geom name="hills" type="hfield" hfield="hills" pos="-10 20 0.5"/>
    <geom name="egg" type="ellipsoid" size="0.2 0.3 0.4" pos="0 8 0"/>
    <body name="table" pos="2 0 0" euler="0 0 90">
      <geom type="box" size="0.4 0.3 0.02" pos="0 0 0.7"/>
      <body pos="0.3 0.2 0"><geom type="cylinder" size="0.03 0.35" pos="0 0 0.35"/></body>
    </body>
    <body name="card" mocap="true" pos="0 3 1"><geom type="capsule" size="0.1 0.2"/></body>
    <body name="dog" pos="0 0 0.5"><freejoint/><geom type="sphere" size="0.1"/></body>
    <body name="arm" pos="0 -3 0"><geom type="box" size="0.1 0.1 0.1"/>
      <body><joint/><geom type="capsule" size="0.05 0.2" pos="0 0 0.3"/></body>
    </body>
  </worldbody>
</mujoco>"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.xml"
    path.write_text(SCENE)
    return path


def by_name(world: World) -> dict[str | None, shapes.Shape]:
    return {shape.name: shape for shape in world.shapes}


def test_a_scene_gives_what_stands_still_and_collides(
    scene: Path, caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip("igl")
    with caplog.at_level(logging.WARNING, "octo"):
        world = load_world(scene)
    found = by_name(world)
    own = {"floor", "world plane", "hills", "egg", "table box", "body2 cylinder", "card capsule"}
    assert {*found} == own
    (line,) = caplog.messages
    assert line == (
        "scene.xml: no part of the world: geoms that collide with nothing: 1; what moves (arm, dog)"
    )
    box = found["table box"]
    assert isinstance(box, shapes.Box)
    np.testing.assert_allclose(box.size, (0.8, 0.6, 0.04))
    np.testing.assert_allclose(box.position, (2.0, 0.0, 0.7), atol=1e-12)
    np.testing.assert_allclose(found["body2 cylinder"].position, (1.8, 0.3, 0.35), atol=1e-12)


def test_distances_are_those_of_mujoco(scene: Path) -> None:
    """Rays from above meet every shape where φ is 0; the map ends over the plane below it."""
    pytest.importorskip("igl")
    world = load_world(scene)
    model = mujoco.MjModel.from_xml_path(str(scene))
    data = mujoco.MjData(model)
    for name, low, high, tolerance in (
        ("table", (1.75, -0.35), (2.25, 0.35), 1e-3),
        ("hills", (-11.3, 19.2), (-8.7, 20.8), 2e-2),
        ("beside the hills", (-8.4, 19.2), (-7.3, 20.8), 1e-3),
        ("card", (-0.05, 2.95), (0.05, 3.05), 1e-3),
        ("egg", (-0.15, 7.8), (0.15, 8.2), 6e-3),
        ("slope", (5.5, -1.0), (7.0, 1.0), 1e-3),
        ("floor", (-2.0, -2.0), (-1.0, -1.0), 1e-3),
    ):
        x, y = (np.linspace(low[k], high[k], 6) for k in (0, 1))
        z = np.array([world.below([(a, b, 4.0) for b in y]) for a in x])
        seen = np.empty_like(z)
        mujoco.mj_forward(model, data)
        for k, a in enumerate(x):
            for j, b in enumerate(y):
                hit = np.zeros(1, dtype=np.int32)
                way = np.array([a, b, 4.0]), np.array([0.0, 0.0, -1.0])
                seen[k, j] = 4.0 - mujoco.mj_ray(model, data, *way, None, 1, -1, hit)
        assert np.abs(seen - z).max() < tolerance, name


WITHOUT_FLOOR = re.sub("<geom[^>]*plane[^>]*>", "", SCENE)


def test_a_map_of_a_scene_has_its_peaks_where_mujoco_has_them(tmp_path: Path) -> None:
    pytest.importorskip("igl")
    (tmp_path / "a.xml").write_text(WITHOUT_FLOOR)
    shape = by_name(load_world(tmp_path / "a.xml"))["hills"]
    assert isinstance(shape, shapes.HeightField)
    points = np.array(
        [[-8.5, 21.0, 3.0], [-11.0, 20.0, 3.0], [-11.5, 19.0, 3.0], [-10.0, 20.5, 3.0]]
    )
    height = 3.0 - World([shape]).distance(points)
    np.testing.assert_allclose(height, [0.9, 0.7, 0.6, 0.5], atol=1e-9)


def test_cells_that_are_not_square_are_sampled_anew(tmp_path: Path) -> None:
    pytest.importorskip("igl")
    text = WITHOUT_FLOOR.replace('size="1.5 1 0.4 0.1"', 'size="1.5 0.5 0.4 0.1"')
    (tmp_path / "flat.xml").write_text(text)
    shape = by_name(load_world(tmp_path / "flat.xml"))["hills"]
    assert isinstance(shape, shapes.HeightField) and shape.cell == pytest.approx(0.25)
    points = np.array([[-8.5, 20.5, 3.0], [-11.5, 19.5, 3.0], [-10.0, 20.25, 3.0]])
    np.testing.assert_allclose(3.0 - World([shape]).distance(points), [0.9, 0.6, 0.5], atol=0.02)


def test_a_urdf_is_a_world_whose_root_stands(tmp_path: Path) -> None:
    (tmp_path / "hall.urdf").write_text(
        """<robot name="hall"><link name="floor"><collision><origin xyz="0 0 -0.1"/><geometry>
        <box size="4 4 0.2"/></geometry></collision></link>
        <link name="post"><collision><geometry><cylinder radius="0.1" length="1"/></geometry>
        </collision></link>
        <joint name="a" type="fixed"><parent link="floor"/><child link="post"/>
        <origin xyz="1 0 0.5"/></joint></robot>"""
    )
    world = load_world(tmp_path / "hall.urdf", position=(0.0, 0.0, 0.3))
    kinds = [type(shape).__name__ for shape in world.shapes]
    assert kinds == ["Box", "Cylinder"]
    points = [[0.0, 0.0, 0.8], [1.0, 0.5, 0.8]]
    np.testing.assert_allclose(world.distance(points), [0.5, 0.4], atol=1e-9)


def test_a_robot_beside_its_scene_says_where_the_scene_is(scene: Path) -> None:
    notes = " ".join(octo.load(scene).dropped)
    assert "geoms of the world" in notes and "octo.load_world" in notes


def test_arrays_and_pictures_are_maps_with_their_middle_at_the_origin(tmp_path: Path) -> None:
    x, y = np.meshgrid(np.linspace(0, 1, 21), np.linspace(0, 1, 11), indexing="ij")
    np.save(tmp_path / "map.npy", 0.2 * x + 0.1 * y)
    world = load_world(tmp_path / "map.npy", cell=0.1, position=(5.0, 0.0, 1.0))
    points = np.array([[4.5, 0.0, 3.0], [5.5, 0.25, 3.0]])
    np.testing.assert_allclose(
        3.0 - world.distance(points), [1.0 + 0.05 + 0.05, 1.0 + 0.15 + 0.075], atol=1e-9
    )
    taller = load_world(tmp_path / "map.npy", cell=0.1, height=2.0)
    assert 3.0 - taller.distance([[0.0, 0.0, 3.0]])[0] == pytest.approx(2.0 * 0.15)
    image = pytest.importorskip("PIL.Image")
    levels = (65535 * (0.5 * x + 0.5 * y)).astype(np.uint16)
    image.fromarray(np.ascontiguousarray(levels.T[::-1])).save(tmp_path / "deep.png")
    image.fromarray((levels.T[::-1] // 257).astype(np.uint8)).save(tmp_path / "map.png")
    for name, atol in (("deep.png", 1e-4), ("map.png", 4e-3)):
        world = load_world(tmp_path / name, cell=0.1, height=0.8)
        points = np.array([[-0.5, -0.25, 3.0], [0.5, 0.25, 3.0], [0.5, -0.25, 3.0]])
        np.testing.assert_allclose(3.0 - world.distance(points), [0.2, 0.6, 0.4], atol=atol)


def test_a_mesh_file_is_a_shape_in_metres(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("igl")
    trimesh.creation.box((1000.0, 400.0, 200.0)).export(tmp_path / "block.stl")
    world = load_world(tmp_path / "block.stl", scale=0.001, cell=0.02, position=(0.0, 0.0, 0.1))
    height = world.below([(0.0, 0.0, 1.0), (0.4, 0.0, 1.0)])
    np.testing.assert_allclose(height, 0.2, atol=2e-3)


def written(folder: Path, name: str) -> str:
    texts: dict[str, Any] = {
        "empty.xml": "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody>"
        "</mujoco>",
        "cut.xml": "<mujoco>",
        "other.xml": "<sdf/>",
        "cut.png": "no picture",
        "cut.npy": "no array",
        "cut.stl": "no mesh",
        "map.txt": "1 2",
        "map.npy": None,
    }
    if texts.get(name):
        (folder / name).write_text(texts[name])
    elif name in texts:
        np.save(folder / name, np.zeros((2, 3, 4)))
    return str(folder / name)


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("empty.xml", {}, "nothing in it stands still and collides"),
        ("cut.xml", {}, "not well-formed XML"),
        ("other.xml", {}, "top element is <sdf>"),
        ("cut.png", {"cell": 0.1, "height": 1.0}, "cannot be read as a picture"),
        ("cut.png", {"cell": 0.1}, "needs height: m, of white"),
        ("cut.png", {"height": 1.0}, "needs cell: m"),
        ("cut.npy", {"cell": 0.1}, "cannot be read as an array"),
        ("map.npy", {"cell": 0.1}, r"must be numbers of shape \(nx, ny\)"),
        ("map.npy", {"cell": -0.1}, "cell of map.npy is -0.1 m, must be positive"),
        ("map.npy", {"scale": 2.0}, "scale is given, but a .npy file takes cell and height"),
        ("empty.xml", {"cell": 0.1}, "a .xml file takes no cell, height or scale"),
        ("map.txt", {}, "must end in .xml, .mjcf, .urdf, .stl"),
        ("nothing.stl", {}, "nothing.stl does not exist"),
        ("map.npy", {"cell": 0.1, "position": (1.0, 2.0)}, "position has shape"),
    ],
)
def test_what_is_no_world_is_one_line(
    name: str, options: dict[str, Any], words: str, tmp_path: Path
) -> None:
    with pytest.raises(OctoError, match=words):
        load_world(written(tmp_path, name), **options)
