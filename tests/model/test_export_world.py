"""Worlds in MuJoCo: a ball touches the shapes of an exported file where φ says that it does."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import octo
from octo import World, shapes, worlds
from octo.errors import ModelError, ProblemError, ValueRangeError
from octo.model.body import Body, ContactSphere, floating_base
from octo.plant import MujocoPlant

mujoco = pytest.importorskip("mujoco")

RADIUS, DEPTH = 0.05, 0.001  # m, of the ball and how deep it is put
POSE: dict[str, Any] = {
    "position": (0.3, -0.2, 0.5),
    "rotation": Rotation.from_euler("xyz", [0.2, -0.3, 0.5]).as_matrix(),
}


def ball() -> octo.Character:
    """A ball that floats and touches the ground."""
    body = Body("ball", -1, floating_base("base"), mass=1.0, inertia=0.01 * np.eye(3))
    sphere = ContactSphere("skin", 0, np.zeros(3), RADIUS)
    return octo.Character("ball", (body,), contacts=(sphere,))


def waves() -> shapes.HeightField:
    x, y = np.meshgrid(np.linspace(0, 2, 81), np.linspace(0, 1, 41), indexing="ij")
    return shapes.HeightField(
        0.1 * np.sin(3 * x) + 0.05 * np.cos(2 * y) - 0.2, 0.025, (-1.0, -0.4), **POSE
    )


def tube() -> shapes.Mesh:
    """A square frame, which is not convex: its hull would fill it."""
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("igl")
    mesh = trimesh.creation.annulus(0.3, 0.5, 0.2, sections=64)
    return shapes.Mesh(mesh.vertices, mesh.faces, **POSE)


def grid() -> shapes.DistanceGrid:
    axis = np.linspace(-0.6, 0.6, 41)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    return shapes.DistanceGrid(np.sqrt(x**2 + y**2 + z**2) - 0.4, 0.03, (-0.6,) * 3, **POSE)


# with how far (m) contact is from φ: edges are sharp in MuJoCo, and a map is triangles there
CASES = [
    (shapes.Ground(0.2, 0.5, 0.1), 1e-9),
    (shapes.Ground(rotation=Rotation.from_euler("y", -60, degrees=True).as_matrix()), 1e-9),
    (shapes.Sphere(0.3, **POSE), 1e-9),
    (shapes.Capsule(0.2, 0.4, **POSE), 3e-4),
    (shapes.Box((0.4, 0.6, 0.3), 1e-4, **POSE), 1e-9),
    (shapes.Cylinder(0.3, 0.4, 1e-4, **POSE), 1e-9),
    (waves(), 5e-4),
    (grid(), 2e-3),
]


def touched(shape: shapes.Shape, tolerance: float) -> None:
    plant = MujocoPlant(ball(), terrain=World([shape]))
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.7, 0.7, (4000, 3)) + shape.position
    world = World([shape])
    points = points[world.covers(points)] if isinstance(shape, shapes.HeightField) else points
    for _ in range(30):  # to the surface along the slope
        jets = world.jets(points)
        slope = jets[:, 1:]
        points = points - jets[:, :1] * slope / np.sum(slope**2, axis=1, keepdims=True)
    jets = world.jets(points, 2)
    normal = jets[:, 1:4] / np.linalg.norm(jets[:, 1:4], axis=1, keepdims=True)
    # faces, not edges; and inside of the map
    plain = (np.abs(jets[:, 0]) < 1e-9) & (np.abs(jets[:, 4:]).max(axis=1) < 0.9 / RADIUS)
    centers = points + (RADIUS - DEPTH) * normal
    plain &= world.covers(centers) & (np.abs(world.distance(centers) - RADIUS + DEPTH) < 3e-3)
    seen = 0
    for center, n in zip(centers[plain][:60], normal[plain][:60], strict=True):
        plant.reset(np.array([*center, 1.0, 0.0, 0.0, 0.0]))
        found = [plant.data.contact[k] for k in range(plant.data.ncon)]
        if isinstance(shape, shapes.HeightField):  # φ is no distance there
            assert plant.ground(center[None])[1][0] @ n > 0.9
        assert found, (shape, center)
        deepest = min(found, key=lambda contact: contact.dist)
        assert deepest.dist == pytest.approx(-DEPTH, abs=tolerance), shape
        assert abs(deepest.frame[:3] @ n) > 1.0 - 0.02
        seen += 1
    assert seen >= 30, shape


@pytest.mark.parametrize(("shape", "tolerance"), CASES)
def test_a_ball_touches_where_the_distance_says(shape: shapes.Shape, tolerance: float) -> None:
    touched(shape, tolerance)


def test_a_mesh_with_a_hole_stays_open() -> None:
    shape = tube()
    touched(shape, 2e-3)
    plant = MujocoPlant(ball(), terrain=World([shape]))
    plant.reset(np.array([*np.asarray(shape.position), 1.0, 0.0, 0.0, 0.0]))
    assert plant.data.ncon == 0  # in the middle, which the hull would fill


@pytest.mark.parametrize("name", worlds.WORLDS)
def test_every_world_by_name_compiles_and_holds_a_robot(name: str, tmp_path: Path) -> None:
    robot, world = octo.gallery.mammal(), worlds.WORLDS[name]()
    octo.export_mjcf(robot, tmp_path / "scene.xml", world=world)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml"))
    assert model.ngeom == len(world.shapes) + len(robot.contacts)
    back = octo.load_world(tmp_path / "scene.xml")
    assert [shape.name for shape in back.shapes] == [shape.name for shape in world.shapes]
    points = np.random.default_rng(0).uniform((-1, -0.8, 0), (4, 0.8, 0.6), (400, 3))
    np.testing.assert_allclose(back.distance(points), world.distance(points), atol=1e-6)


def test_feet_and_height_are_over_the_shapes() -> None:
    robot = octo.gallery.mammal()
    world = worlds.blocks(height=0.2, length=2.0, start=0.5)
    plant = MujocoPlant(robot, terrain=world)
    x = robot.start_pose.copy()
    x[robot.base_coordinate] += 1.5
    x[robot.base_coordinate + 2] += 0.2
    plant.reset_chart(x)
    assert plant.height == pytest.approx(x[robot.base_coordinate + 2] - 0.2, abs=1e-3)
    for _ in range(100):
        plant.step(np.zeros(robot.nu))
    force, point = plant.contacts()
    assert force[:, 2].sum() > 0.1 * robot.mass * 9.81
    assert point[force[:, 2] > 0.0][:, 2].min() > 0.15


def test_what_does_not_go_together_is_refused(tmp_path: Path) -> None:
    robot, world = octo.gallery.mammal(), worlds.gap()
    with pytest.raises(ModelError, match="terrain and world are both given"):
        octo.export_mjcf(robot, tmp_path / "a.xml", world=world, terrain=octo.Plane())
    with pytest.raises(ProblemError, match="terrain is a World, must be an octo.Plane"):
        octo.export_mjcf(robot, tmp_path / "a.xml", terrain=world)  # type: ignore[arg-type]
    with pytest.raises(ValueRangeError, match="bumps is 0.1 m, must be 0"):
        MujocoPlant(robot, terrain=world, bumps=0.1)
    assert not (tmp_path / "a.xml").exists()
