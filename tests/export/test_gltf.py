"""Animated glTF, read back as its specification says: where the bodies are, and what they look
like."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import moving
import numpy as np
import pygltflib
import pytest
import trimesh
from robot_files import go2
from scipy.spatial.transform import Rotation

import octo
from octo.export.moments import configurations, frame_times
from octo.model.character import Character
from octo.model.kinematics import body_poses
from octo.model.skins import skins
from octo.picture import NEAR
from octo.result.solution import Solution

Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # octo's axes to glTF's
CLOSE = 1e-4  # m


class Played:
    """A file, and its nodes at any time."""

    def __init__(self, path: Path):
        self.file = pygltflib.GLTF2().load(str(path))
        self.block = self.file.binary_blob()
        (animation,) = self.file.animations
        self.tracks = {
            (channel.target.node, channel.target.path): [
                self.numbers(number)
                for number in (
                    animation.samplers[channel.sampler].input,
                    animation.samplers[channel.sampler].output,
                )
            ]
            for channel in animation.channels
        }
        assert all(sampler.interpolation == "LINEAR" for sampler in animation.samplers)

    def numbers(self, number: int) -> np.ndarray:
        accessor = self.file.accessors[number]
        view = self.file.bufferViews[accessor.bufferView]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor.type]
        kind = {pygltflib.FLOAT: "<f4", pygltflib.UNSIGNED_INT: "<u4"}[accessor.componentType]
        data = np.frombuffer(self.block, kind, accessor.count * width, view.byteOffset)
        return data.reshape(-1, width) if width > 1 else data

    def own(self, number: int, time: float) -> np.ndarray:
        """(4, 4) of a node on its parent."""
        node, pose = self.file.nodes[number], np.eye(4)
        found: dict[str, Any] = {
            "rotation": node.rotation or [0.0, 0.0, 0.0, 1.0],
            "translation": node.translation or np.zeros(3),
        }
        for path in found:
            if (number, path) in self.tracks:
                times, values = self.tracks[number, path]
                i = int(np.clip(np.searchsorted(times, time, "right") - 1, 0, len(times) - 2))
                share = (time - times[i]) / (times[i + 1] - times[i])
                found[path] = blended(values[i], values[i + 1], float(np.clip(share, 0.0, 1.0)))
        pose[:3, :3] = Rotation.from_quat(found["rotation"]).as_matrix()
        pose[:3, 3] = found["translation"]
        return pose

    def world(self, time: float) -> dict[str, np.ndarray]:
        """(4, 4) of every node in the world, by name."""
        (root,) = self.file.scenes[self.file.scene].nodes
        poses, left = {}, [(root, np.eye(4))]
        while left:
            number, outer = left.pop()
            pose = outer @ self.own(number, time)
            poses[self.file.nodes[number].name] = pose
            left += [(child, pose) for child in self.file.nodes[number].children]
        return poses


def blended(first: np.ndarray, second: np.ndarray, share: float) -> np.ndarray:
    """Translations in a line, quaternions on the arc between them."""
    if len(first) == 3:
        return (1.0 - share) * first + share * second
    a, b = Rotation.from_quat(first), Rotation.from_quat(second)
    return (a * Rotation.from_rotvec(share * (a.inv() * b).as_rotvec())).as_quat()


ROBOTS: dict[str, Callable[[], Character]] = {
    "mammal": octo.gallery.mammal,
    "humanoid": octo.gallery.humanoid,
    "chain": octo.gallery.chain,
    "zxy": moving.other_chart,
    "scene": moving.pushing,
    "go2": go2,
}


def worst(played: Played, motion: Solution, times: np.ndarray) -> float:
    """m, how far any point within 0.3 m of a body's origin is from where the motion has it."""
    robot = motion.character
    assert robot is not None
    R, t = body_poses(robot, configurations(motion, times))
    off = 0.0
    for k, time in enumerate(times):
        found = played.world(float(time))
        for b, body in enumerate(robot.bodies):
            pose = found[body.name]
            off = max(off, float(np.linalg.norm(pose[:3, 3] - Y_UP @ t[k, b])))
            turned = pose[:3, :3] - Y_UP @ R[k, b]
            off = max(off, 0.3 * float(np.linalg.norm(turned, 2)))
    return off


@pytest.mark.parametrize("name", ROBOTS)
def test_bodies_are_where_the_motion_has_them_at_all_times(name: str, tmp_path: Path) -> None:
    motion = moving.moving(ROBOTS[name](), steps=8)
    octo.export(motion, tmp_path / "m.glb", visuals=False)
    played, frames = Played(tmp_path / "m.glb"), frame_times(motion, 30.0)
    between = np.random.default_rng(1).uniform(0.0, motion.times[-1], 12)
    assert worst(played, motion, np.concatenate([frames[:4], motion.times[3:6], between])) < CLOSE
    (moments, _), *_ = played.tracks.values()
    assert set(np.float32(frames)) <= set(moments) and moments[-1] == np.float32(motion.times[-1])


def test_a_soft_body_is_a_mesh_with_a_morph_target_a_mode(tmp_path: Path) -> None:
    body = octo.soft.ball(divisions=2, modes=4)
    how: dict[str, Any] = {"seconds": 0.5, "device": "cpu", "max_iterations": 30}
    motion = octo.soft_motion(body, "jump", -0.1, height=0.05, **how)
    assert motion.soft is not None
    octo.export(motion, tmp_path / "m.glb")
    played = Played(tmp_path / "m.glb")
    number = next(k for k, node in enumerate(played.file.nodes) if node.name == "surface")
    mesh = played.file.meshes[played.file.nodes[number].mesh]
    one, other = mesh.primitives
    points = played.numbers(one.attributes.POSITION)
    assert one.attributes.POSITION == other.attributes.POSITION
    targets = np.array([played.numbers(entry["POSITION"]) for entry in one.targets])
    times, weights = played.tracks[number, "weights"]
    weights = weights.reshape(len(times), 4)
    assert weights.min() >= 0.0 and weights.max() <= 1.0
    faces = [played.numbers(part.indices).reshape(-1, 3) for part in mesh.primitives]
    assert len(np.concatenate(faces)) == len(body.faces)
    for time in np.random.default_rng(0).uniform(0.0, 0.5, 20):
        own = [np.interp(time, times, column) for column in weights.T]
        bent = points + np.einsum("k,kpi->pi", own, targets)
        pose = played.world(float(time))["surface"]
        found = bent @ pose[:3, :3].T + pose[:3, 3]
        wanted = motion.soft.surface(configurations(motion, np.array([time])))[0] @ Y_UP.T
        np.testing.assert_allclose(found, wanted, atol=CLOSE)


def test_slides_balls_and_a_fixed_base(tmp_path: Path) -> None:
    motion = moving.moving(moving.of_file(moving.SLIDING, tmp_path))
    octo.export(motion, tmp_path / "m.glb", fps=7.0)
    played = Played(tmp_path / "m.glb")
    assert worst(played, motion, np.linspace(0.0, motion.times[-1], 20)) < CLOSE
    names = {played.file.nodes[node].name for node, _ in played.tracks}
    assert names == {"cart", "arm", "hand"}  # the rail is where it is


def test_neighbouring_quaternions_are_on_one_side(tmp_path: Path) -> None:
    octo.export(moving.moving(octo.gallery.chain(), steps=40), tmp_path / "m.glb", visuals=False)
    turns = [v for (_, path), (_, v) in Played(tmp_path / "m.glb").tracks.items() if path[0] == "r"]
    assert len(turns) == 5
    for turn in turns:
        assert (np.sum(turn[1:] * turn[:-1], axis=1) > 0.9).all()


def test_trimesh_finds_the_meshes_in_their_places_and_colours(tmp_path: Path) -> None:
    robot = octo.gallery.spider()
    motion = moving.moving(robot, steps=2)
    octo.export(motion, tmp_path / "m.glb")
    scene = trimesh.load_scene(tmp_path / "m.glb")
    R, t = body_poses(robot, motion.x[1])
    for b, (body, own) in enumerate(zip(robot.bodies, skins(robot), strict=True)):
        pose, mesh = scene.graph.get(body.name)
        points = np.concatenate([skin.surface.vertices for skin in own])
        wanted = (points @ R[b].T + t[b]) @ Y_UP.T
        found = scene.geometry[mesh].vertices @ pose[:3, :3].T + pose[:3, 3]
        for end in (np.min, np.max):
            np.testing.assert_allclose(end(found, axis=0), end(wanted, axis=0), atol=1e-5)
        assert trimesh.Trimesh(found, scene.geometry[mesh].faces).volume > 0.0
    light = scene.geometry[mesh].visual.material.baseColorFactor[:3] / 255.0  # linear
    np.testing.assert_allclose(light, NEAR**2.2, atol=0.02)
    assert "ground" in " ".join(scene.graph.nodes)


def test_ground_and_shapes_of_a_world(tmp_path: Path) -> None:
    world = octo.World(
        [
            octo.shapes.Ground(),
            octo.shapes.Box((0.4, 0.6, 0.2), position=(1.0, 0.3, 0.1), name="step"),
        ]
    )
    octo.export(moving.moving(octo.gallery.chain(), 4, world=world), tmp_path / "m.glb")
    scene = trimesh.load_scene(tmp_path / "m.glb")
    pose, mesh = scene.graph.get("step")
    corners = scene.geometry[mesh].vertices @ pose[:3, :3].T + pose[:3, 3]
    np.testing.assert_allclose(corners.min(axis=0), (0.8, 0.0, -0.6), atol=1e-6)
    np.testing.assert_allclose(corners.max(axis=0), (1.2, 0.2, 0.0), atol=1e-6)
    waves = {"x": np.linspace(-1, 1, 9), "y": np.array([-1.0, 0.0, 1.0])}
    waves["z"] = np.sin(3.0 * waves["x"])[:, None] * np.ones(3)
    octo.export(moving.moving(octo.gallery.chain(), 4, ground=waves), tmp_path / "m.glb")
    scene = trimesh.load_scene(tmp_path / "m.glb")
    pose, mesh = scene.graph.get("ground")
    heights = (scene.geometry[mesh].vertices @ pose[:3, :3].T)[:, 1]
    np.testing.assert_allclose((heights.min(), heights.max()), (-0.997, 0.997), atol=1e-3)


def test_a_robot_of_a_file_has_its_meshes_and_materials(tmp_path: Path) -> None:
    part = trimesh.creation.box((0.2, 0.1, 0.05))
    part.export(tmp_path / "part.stl")
    text = moving.FIXED.replace(
        '<geom size=".08"/>',
        '<geom size=".08" group="3"/><geom type="mesh" mesh="part" rgba="1 0.5 0 1" group="1"/>',
    ).replace("<worldbody>", '<asset><mesh name="part" file="part.stl"/></asset><worldbody>', 1)
    octo.export(moving.moving(moving.of_file(text, tmp_path), 4), tmp_path / "m.glb")
    played = Played(tmp_path / "m.glb")
    parts = [part for mesh in played.file.meshes for part in mesh.primitives]
    corners = [played.numbers(part.attributes.POSITION) for part in parts]
    (box,) = [c for c in corners if np.allclose(np.ptp(c, axis=0), (0.2, 0.1, 0.05), atol=1e-6)]
    assert len(box) == 24  # an edge of a box is sharp: each side has corners of its own
    colors = [m.pbrMetallicRoughness.baseColorFactor for m in played.file.materials]
    assert any(np.allclose(color, (1.0, 0.21404, 0.0, 1.0), atol=1e-4) for color in colors)


def test_a_motion_of_nothing_has_no_animation(tmp_path: Path) -> None:
    motion = moving.moving(octo.gallery.chain(), 3)
    still = dataclasses.replace(motion, x=np.repeat(motion.x[:1], len(motion.x), axis=0))
    octo.export(still, tmp_path / "m.glb")
    assert pygltflib.GLTF2().load(str(tmp_path / "m.glb")).animations == []
