"""What is fixed to the world is world: it is no part of the robot's mass, centre of mass or
coordinates."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import octo
from octo.errors import UnsupportedFeatureError
from octo.model.character import Body, Character, Joint
from octo.model.describe import whole_inertia
from octo.model.kinematics import center_of_mass
from octo.model.load import load

CASES = Path(__file__).parent / "cases"
LEG = '<body name="leg" pos=".2 0 0"><joint name="hip" axis="0 1 0"/><geom size=".05"/></body>'
WALKER = f'<body name="trunk" pos="0 0 1"><freejoint/><geom size=".1"/>{LEG}</body>'
ARM = WALKER.replace("<freejoint/>", "")
MOTOR = '<actuator><motor joint="hip" ctrlrange="-9 9"/></actuator>'
CLOTH = (
    '<flexcomp name="cloth" type="grid" count="3 3 1" spacing=".1 .1 .1" radius=".01" '
    'mass="1" dim="2">{}</flexcomp>'
)

STILL = {
    "table": '<body name="table" pos="3 0 .4"><geom type="box" size=".5 .5 .05" mass="50"/></body>',
    "stacked": '<body name="shelf"><geom size=".1" mass="3"/><body name="vase"><geom size=".1" '
    'mass="2"/></body></body>',
    "mocap": '<body name="hand" mocap="true" pos="0 1 1"><geom size=".1" mass="7"/></body>',
    "inertial": '<body name="wall"><inertial pos="0 0 0" mass="900" diaginertia="1 1 1"/></body>',
    "nameless": '<body><geom size=".3"/></body>',
}
HUNG = {
    "door": '<body name="frame"><geom size=".1"/><body name="door"><joint name="hinge"/><geom '
    'size=".3"/></body></body>',
    "drawer": '<body name="drawer"><joint name="rail" type="slide"/><geom size=".2"/></body>',
    "lamp": '<body name="lamp"><joint name="cord" type="ball"/><geom size=".2"/></body>',
    "puck": '<body name="puck"><joint name="x" type="slide"/><joint name="y" type="slide" '
    'axis="0 1 0"/><geom size=".2"/></body>',
    "cloth": CLOTH.format(""),
    "pinned cloth": CLOTH.format('<pin id="0"/>'),
    "cloth on a table": '<body name="table"><geom size=".2" mass="4"/>'
    + CLOTH.format('<pin id="0"/>')
    + "</body>",
}


def written(tmp_path, world, rest=""):
    path = tmp_path / "scene.xml"
    path.write_text(f'<mujoco model="scene"><worldbody>{world}</worldbody>{rest}</mujoco>')
    return path


def alike(found: Character, alone: Character) -> None:
    assert found.mass == pytest.approx(alone.mass, rel=1e-12)
    assert [joint.name for joint in found.joints] == [joint.name for joint in alone.joints]
    x = np.random.default_rng(0).uniform(-1.0, 1.0, found.nx)
    np.testing.assert_allclose(center_of_mass(found, x), center_of_mass(alone, x), atol=1e-12)
    np.testing.assert_allclose(whole_inertia(found, x), whole_inertia(alone, x), atol=1e-9)


def test_the_case_of_the_table():
    path = CASES / "table_in_the_scene.xml"
    robot, model = load(path), mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    trunk = model.body("trunk").id
    assert robot.mass == pytest.approx(5.6) == pytest.approx(model.body_subtreemass[trunk])
    np.testing.assert_allclose(
        center_of_mass(robot, robot.default_pose), data.subtree_com[trunk], atol=1e-12
    )
    assert any("table (50 kg) is fixed to the world" in note for note in robot.dropped)
    assert "table" not in [body.name for body in robot.bodies]


@pytest.mark.parametrize("first", [True, False])
@pytest.mark.parametrize("thing", [*STILL, *HUNG])
def test_beside_a_robot_that_floats(tmp_path, thing, first):
    world = {**STILL, **HUNG}[thing]
    alone = load(written(tmp_path, WALKER, MOTOR))
    found = load(written(tmp_path, world + WALKER if first else WALKER + world, MOTOR))
    alike(found, alone)
    assert len(found.dropped) > len(alone.dropped)


@pytest.mark.parametrize("thing", STILL)
def test_beside_an_arm(tmp_path, thing):
    alike(load(written(tmp_path, STILL[thing] + ARM, MOTOR)), load(written(tmp_path, ARM, MOTOR)))


@pytest.mark.parametrize("thing", STILL)
def test_the_base_may_be_chosen(tmp_path, thing):
    for base, world in (("fixed", WALKER), ("floating", ARM)):
        alike(
            load(written(tmp_path, STILL[thing] + world), base),
            load(written(tmp_path, world), base),
        )


HINGED = [thing for thing in HUNG if "cloth" not in thing]


@pytest.mark.parametrize("thing", HINGED)
def test_things_hinged_to_the_world_beside_an_arm(tmp_path, thing):
    """They move, as an arm may push them, but their mass is not the arm's."""
    alone = load(written(tmp_path, ARM, MOTOR))
    found = load(written(tmp_path, HUNG[thing] + ARM, MOTOR))
    assert found.mass == pytest.approx(alone.mass, rel=1e-12)
    assert any(
        "nothing drives it: it moves, but its mass is not the robot's" in note
        for note in found.dropped
    )
    x = np.random.default_rng(0).uniform(-1.0, 1.0, found.nx)
    own = x[[found.joint_index(joint.name) for joint in alone.joints]]
    np.testing.assert_allclose(center_of_mass(found, x), center_of_mass(alone, own), atol=1e-12)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml"))
    assert sum(body.mass for body in found.bodies) == pytest.approx(model.body_mass.sum())


@pytest.mark.parametrize("motors", ["", MOTOR.replace("</", '<motor joint="pivot"/></')])
def test_several_arms_are_one_robot_and_said(tmp_path, motors):
    other = ARM.replace('"trunk"', '"post"').replace('"leg"', '"beam"').replace('"hip"', '"pivot"')
    robot = load(written(tmp_path, ARM + other, motors))
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml"))
    assert robot.nx == 2
    assert robot.mass == pytest.approx(model.body_mass.sum())
    assert any(
        "several trees stand on the world" in note and "post" in note for note in robot.dropped
    )


def test_a_pedestal_is_the_arms(tmp_path):
    post = f'<body name="post"><geom size=".1" mass="20"/>{LEG}</body>'
    robot = load(written(tmp_path, STILL["table"] + post))
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml"))
    assert robot.mass == pytest.approx(model.body_subtreemass[model.body("post").id])


def test_deformable_bodies_alone_are_refused(tmp_path):
    with pytest.raises(
        UnsupportedFeatureError, match="scene.xml: all that moves is a deformable body"
    ):
        load(written(tmp_path, CLOTH.format("")))


def test_a_deformable_body_of_the_robot_is_refused(tmp_path):
    rope = 'type="grid" count="3 1 1" spacing=".1 .1 .1" radius=".01" mass="1" dim="1"'
    soft = f'<flexcomp name="skin" {rope}><pin id="0"/></flexcomp>'
    with pytest.raises(
        UnsupportedFeatureError, match="deformable body .flex. 'skin' moves with body 'trunk'"
    ):
        load(
            written(tmp_path, '<body name="trunk"><freejoint/><geom size=".1"/>' + soft + "</body>")
        )


def test_bodies_of_ones_own():
    """The same where a robot is written in Python: what stands in the world, or hangs on it, beside
    a robot that floats."""
    robot = octo.gallery.mammal()
    swing = Joint("swing", "hinge", np.array([0.0, 1.0, 0.0]))
    things = (Body("table", -1, mass=50.0), Body("door", -1, (swing,), mass=9.0, inertia=np.eye(3)))
    found = replace(robot, bodies=robot.bodies + things, default_pose=None, poses={})
    assert found.mass == pytest.approx(robot.mass)
    assert found.masses[-2:].tolist() == [0.0, 0.0]
    x = np.random.default_rng(0).uniform(-1.0, 1.0, found.nx)
    np.testing.assert_allclose(center_of_mass(found, x), center_of_mass(robot, x[:-1]), atol=1e-12)
