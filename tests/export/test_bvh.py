"""BVH, read by another program: where its joints are, and that their angles do not leap."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

import bvhio
import moving
import mujoco
import numpy as np
import pytest
from robot_files import go2

import octo
from octo.errors import ModelError
from octo.export.bvh import AXES
from octo.export.moments import configurations
from octo.model.body import Body, Joint, floating_base
from octo.model.character import Character
from octo.model.kinematics import body_poses
from octo.result.solution import Solution

CLOSE = 1e-4  # m
ROBOTS: dict[str, Callable[[], Character]] = {
    "mammal": octo.gallery.mammal,
    "spider": octo.gallery.spider,
    "humanoid": octo.gallery.humanoid,
    "zxy": moving.other_chart,
    "scene": moving.pushing,
    "go2": go2,
}


def rows(path: Path) -> np.ndarray:
    """(frames, channels) of the file."""
    return np.loadtxt(path.read_text().partition("Frame Time")[2].splitlines()[1:], ndmin=2)


def doubled(path: Path) -> Path:
    """The file with a frame between every two, whose channels are their mean."""
    head, _, tail = path.read_text().partition("MOTION")
    every = rows(path)
    frames = np.empty((2 * len(every) - 1, every.shape[1]))
    frames[::2], frames[1::2] = every, 0.5 * (every[1:] + every[:-1])
    lines = "\n".join(" ".join(f"{value:.9g}" for value in row) for row in frames)
    other = path.with_name("doubled.bvh")
    other.write_text(f"{head}MOTION\nFrames: {len(frames)}\nFrame Time: 1\n{lines}\n")
    return other


def joints(path: Path) -> dict[str, np.ndarray]:
    """(frames, 3) m of every joint in the world."""
    skeleton = bvhio.readAsHierarchy(str(path))
    first, last = skeleton.getKeyframeRange()
    found: dict[str, list[np.ndarray]] = {}
    for frame in range(first, last + 1):
        for joint, _, _ in skeleton.loadPose(frame).layout():
            found.setdefault(joint.Name, []).append(np.array(joint.PositionWorld))
    return {name: np.array(places) for name, places in found.items()}


def worst(path: Path, motion: Solution, fps: float) -> float:
    """m, how far a joint is from the origin of its body, where all of its hinges are."""
    robot, found = motion.character, joints(path)
    assert robot is not None
    frames = len(next(iter(found.values())))
    t = body_poses(robot, configurations(motion, np.arange(frames) / fps))[1]
    moved = {robot.bodies[b].name for b in np.flatnonzero(robot.own) if robot.bodies[b].joints}
    assert set(found) == moved - set(robot.objects)
    off = [places - t[:, robot.body_index(name)] @ AXES.T for name, places in found.items()]
    return float(np.linalg.norm(off, axis=-1).max())


@pytest.mark.parametrize("name", ROBOTS)
def test_joints_are_where_the_motion_has_them(name: str, tmp_path: Path) -> None:
    motion, path = moving.moving(ROBOTS[name](), steps=12), tmp_path / "m.bvh"
    octo.export(motion, path, fps=30.0)
    assert len(rows(path)) == 10 and worst(path, motion, 30.0) < CLOSE
    octo.export(motion, path, fps=40.0)  # a frame at each node: right between them too
    assert len(rows(path)) == 13 and worst(doubled(path), motion, 80.0) < CLOSE


def test_hinges_about_several_points_and_a_fixed_base(tmp_path: Path) -> None:
    robot = moving.of_file(moving.FIXED, tmp_path)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    motion, data = moving.moving(robot), mujoco.MjData(model)
    octo.export(motion, tmp_path / "m.bvh", fps=40.0)
    found = joints(tmp_path / "m.bvh")
    assert set(found) == {"rail", "arm", "hand", "hand_2"}
    for frame, qpos in enumerate(motion.to_mujoco()[0]):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        for name, joint in {"arm": "shoulder", "hand": "wrist", "hand_2": "turn"}.items():
            np.testing.assert_allclose(
                found[name][frame], AXES @ data.joint(joint).xanchor, atol=CLOSE
            )


def test_angles_do_not_leap(tmp_path: Path) -> None:
    """In a somersault, whose angles are those of the base's chart; nor of a head that turns about
    an axis across all others and nods, whose own order comes by a right angle."""
    turn = Joint("turn", "hinge", np.full(3, 3.0**-0.5))
    nod = Joint("nod", "hinge", np.array([1.0, 0.0, 0.0]))
    trunk = Body("trunk", -1, floating_base(), mass=1.0, inertia=0.1 * np.eye(3))
    place = {"position": np.array([0.2, 0.0, 0.1]), "mass": 1.0, "inertia": np.eye(3)}
    tip = Body("tip", 1, (Joint("tip", "hinge", np.eye(3)[1]),), **place)
    robot = Character("tumbler", (trunk, Body("head", 0, (turn, nod), **place), tip))
    motion = moving.moving(robot, steps=100)
    motion.x[:, 4] = np.linspace(0.0, 7.0, 102)  # rad, pitch
    motion.x[:, 7] = 0.05
    for turned in (3.0, -3.0):
        motion.x[:, 6] = np.linspace(0.0, turned, 102)
        octo.export(motion, tmp_path / "m.bvh", fps=40.0)
        assert worst(tmp_path / "m.bvh", motion, 40.0) < CLOSE
        angles = rows(tmp_path / "m.bvh")[:, 3:]
        assert np.abs(np.diff(angles, axis=0)).max() < 10.0  # degrees
        assert np.ptp(angles[:, :3], axis=0).max() > 390.0


def test_the_skeleton_in_words(tmp_path: Path) -> None:
    octo.export(moving.moving(octo.gallery.mammal(), 4), tmp_path / "m.bvh", fps=20.0)
    text = (tmp_path / "m.bvh").read_text()
    assert text.startswith("HIERARCHY\nROOT trunk\n{\n\tOFFSET 0 0 0\n\tCHANNELS 6 Xposition")
    assert text.count("JOINT") == 8 and text.count("End Site") == 4
    assert "MOTION\nFrames: 3\nFrame Time: 0.05\n" in text


def test_what_bvh_cannot_say(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    sliding = moving.moving(moving.of_file(moving.SLIDING, tmp_path), 4)
    with pytest.raises(ModelError, match=r"'along' of .* slides, which BVH cannot say; a \.glb"):
        octo.export(sliding, tmp_path / "m.bvh")
    assert not (tmp_path / "m.bvh").exists()
    with caplog.at_level(logging.WARNING, logger="octo"):
        octo.export(moving.moving(moving.pushing(), 4), tmp_path / "m.bvh")
    assert caplog.messages == [
        "m.bvh has the robot's skeleton, not the objects (box): a .glb has both"
    ]


def test_two_robots_that_stand_are_limbs_of_one_root(tmp_path: Path) -> None:
    text = """<mujoco><worldbody><body name="a" pos="0 1 0"><joint name="p" axis="0 1 0"/>
<geom size=".1"/></body><body name="b" pos="0 -1 0"><joint name="q"/><geom size=".1"/></body>
</worldbody><actuator><motor joint="p"/><motor joint="q"/></actuator></mujoco>"""
    motion = moving.moving(moving.of_file(text, tmp_path), 8)
    octo.export(motion, tmp_path / "m.bvh", fps=40.0)
    found = joints(tmp_path / "m.bvh")
    assert len(found) == 3
    np.testing.assert_allclose(found["a"], np.tile([0.0, 0.0, -1.0], (9, 1)), atol=1e-6)
    np.testing.assert_allclose(rows(tmp_path / "m.bvh")[:, :6], 0.0)
    angles = np.radians(rows(tmp_path / "m.bvh")[:, 6:])
    np.testing.assert_allclose(
        np.abs(angles).sum(axis=1), np.abs(motion.x[1:]).sum(axis=1), atol=1e-6
    )
