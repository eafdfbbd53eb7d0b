"""octo.load_scene: what moves in an MJCF beside its robot, as objects."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import octo
from octo.errors import RobotFileError, UsageError
from octo.model.element import DryFriction
from octo.model.kinematics import body_poses

HEAD = """<mujoco><worldbody><geom type="plane" size="5 5 .1"/>
<geom name="shelf" type="box" size=".2 .5 .1" pos="2 0 .1"/>
<body name="torso" pos="0 0 .53"><freejoint/><geom type="box" size=".2 .1 .05" mass="5"/>
<body name="front" pos=".15 0 0"><joint name="hip" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -.5" size=".03" mass="1"/></body>
<body name="back" pos="-.15 0 0"><joint name="hip2" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 0 0 -.5" size=".03" mass="1"/></body></body>"""
OBJECTS = """<body name="crate" pos="1 0 .15" euler="0 0 30"><freejoint/>
<geom name="side" type="box" size=".15 .2 .15" mass="1.5" rgba="1 .5 0 1"/></body>
<body name="hip" pos="1 1 .1"><freejoint/><geom type="sphere" size=".1" mass=".4"/></body>
<body name="door" pos="3 0 .8"><joint name="hinge" axis="0 0 1" frictionloss=".5"/>
<geom type="box" size=".4 .02 .7" pos=".4 0 0" mass="8"/></body>
<body name="stand" pos="0 3 0"><geom type="box" size=".1 .1 .1"/></body>"""
TAIL = """</worldbody><actuator><motor joint="hip"/><motor joint="hip2"/></actuator></mujoco>"""


def written(path: Path, objects: str = OBJECTS) -> Path:
    file = path / "scene.xml"
    file.write_text(f"{HEAD}{objects}{TAIL}", encoding="utf-8")
    return file


def test_the_robot_and_its_objects(tmp_path: Path) -> None:
    file = written(tmp_path)
    scene = octo.load_scene(file)
    whole, world = scene.character, octo.load_world(file)
    assert whole.objects == ("crate", "hip3", "door")  # hip and hip2 are joints of the robot
    assert whole.mass == pytest.approx(7.0)  # the robot's alone
    crate, ball, door = scene.objects
    assert [len(one.contacts) for one in scene.objects] == [8, 1, 4]
    assert [one.solids[0].kind for one in scene.objects] == ["box", "sphere", "box"]
    assert (crate.mass, ball.mass, door.base) == (1.5, 0.4, "fixed")
    assert scene.robot is not None
    assert not any("load_scene" in note for note in scene.robot.dropped)
    assert sum("load_scene" in note for note in octo.load(file).dropped) == 3
    assert {shape.name for shape in world.shapes} >= {"shelf", "stand box"}
    # where MuJoCo has them
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    rotation, origin = body_poses(whole, whole.start_pose)
    for name in ("torso", "front", "crate", "door"):
        b, theirs = whole.body_index(name), data.body(name)
        np.testing.assert_allclose(origin[b], theirs.xpos, atol=1e-12)
        np.testing.assert_allclose(rotation[b], theirs.xmat.reshape(3, 3), atol=1e-12)
    assert any(look.color is not None and look.color[1] == 0.5 for look in whole.looks)


def test_a_door_keeps_its_dry_friction(tmp_path: Path) -> None:
    scene = octo.load_scene(written(tmp_path))
    (friction,) = scene.objects[2].elements
    assert isinstance(friction, DryFriction) and friction.limit == 0.5
    apart = np.array(friction.point_b)
    assert np.linalg.norm(apart) == pytest.approx(1.0) and apart[2] == pytest.approx(0.0)
    np.testing.assert_allclose(friction.point_a, apart + (3.0, 0.0, 0.8), atol=1e-12)


def test_it_stands_on_the_world_of_its_file(tmp_path: Path) -> None:
    """A world, and an element: the door's friction."""
    file = written(tmp_path)
    scene, world = octo.load_scene(file), octo.load_world(file)
    costs = [octo.Effort()]
    x = octo.Problem(scene, steps=2, dt=0.02, costs=costs, terrain=world).start
    motion = octo.simulate(scene, x, steps=30, dt=0.01, terrain=world)
    first = scene.character.body_index("crate")
    crate = slice(scene.character.first_joint[first], scene.character.first_joint[first] + 6)
    np.testing.assert_allclose(motion.x[-1][crate], x[crate], atol=2e-3)


@pytest.mark.parametrize("joint", ['<joint type="ball" frictionloss="1"/>', ""])
def test_dry_friction_that_is_no_element_is_said(joint: str, tmp_path: Path) -> None:
    inner = f'<body name="in" pos=".4 0 0">{joint}<geom type="sphere" size=".1"/></body>'
    body = f'<body name="b" pos="1 0 1"><joint axis="0 0 1"/><geom size=".1"/>{inner}</body>'
    (thing,) = octo.load_scene(written(tmp_path, body)).objects
    assert any("frictionloss" in note for note in thing.dropped) == bool(joint)
    assert not thing.elements


def test_a_file_without_objects_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RobotFileError, match=r"scene.xml: nothing beside the robot moves in it"):
        octo.load_scene(written(tmp_path, ""))
    with pytest.raises(UsageError, match="no MJCF"):
        octo.load_scene("mammal")
