"""MJCF features and refusals, one small file each."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
from mujoco_oracle import mass_matrix_of, pose_errors, relative_difference

from octo.errors import ModelError, RobotFileError, UnsupportedFeatureError
from octo.model.load import load
from octo.model.mass_matrix import mass_matrix

BALL = '<geom size=".1" density="1000"/>'


def mjcf(world, rest=""):
    return (
        '<mujoco model="tiny"><compiler '
        f'angle="radian"/><worldbody>{world}</worldbody>{rest}</mujoco>'
    )


@pytest.fixture
def robot(tmp_path):
    """Writes an MJCF and returns its path."""

    def write(world, rest=""):
        path = tmp_path / "tiny.xml"
        path.write_text(mjcf(world, rest))
        return path

    return write


def notes(character, word):
    return [note for note in character.dropped if word in note]


def leg(joint='<joint name="hip" axis="0 1 0"/>', inside=""):
    geom = '<geom name="shin" type="capsule" fromto="0 0 0 0 0 -.4" size=".05"/>'
    return f'<body name="leg" pos=".1 0 0">{joint}{geom}{inside}</body>'


def trunk(inside, joint="<freejoint/>"):
    return f'<body name="trunk" pos="0 0 .7">{joint}{BALL}{inside}</body>'


def test_joint_fields(robot):
    joint = """<joint name="hip" axis="0 2 0" pos="0 .1 0" range="-.5 1" ref=".2" springref=".3"
      stiffness="4" damping=".5"
      armature=".6"/>"""
    hip = load(robot(trunk(leg(joint)))).joints[6]
    assert (hip.kind, hip.lower, hip.upper, hip.reference, hip.rest) == (
        "hinge",
        -0.5,
        1.0,
        0.2,
        0.3,
    )
    assert (hip.stiffness, hip.damping, hip.armature, hip.actuated) == (4.0, 0.5, 0.6, False)
    assert np.allclose(hip.axis, (0, 1, 0))
    assert np.allclose(hip.anchor, (0, 0.1, 0))


def test_default_pose_is_that_of_the_file(robot):
    character = load(
        robot(
            '<body name="b" pos="1 2 3" euler=".3 .2 .1"><freejoint/>'
            + BALL
            + leg('<joint name="hip" ref=".4"/>')
            + "</body>"
        )
    )
    model = mujoco.MjModel.from_xml_string(
        mjcf('<body name="b" pos="1 2 3" euler=".3 .2 .1"><freejoint/>' + BALL + "</body>")
    )
    assert np.allclose(character.default_pose[:3], (1, 2, 3))
    assert character.default_pose[6] == 0.4
    turned = np.zeros(4)
    mujoco.mju_euler2Quat(turned, character.default_pose[3:6], "zyx")
    assert np.allclose(turned, model.qpos0[3:])


def test_chart_avoids_its_singularity(robot):
    """A base that is written standing on its nose: pitch is 90 degrees, so the other chart is
    taken."""
    character = load(robot(f'<body name="b" euler="0 1.5708 0"><freejoint/>{BALL}</body>'))
    assert character.chart == "zxy"
    assert (
        pose_errors(
            character,
            mujoco.MjModel.from_xml_string(mjcf(f'<body name="b"><freejoint/>{BALL}</body>')),
            character.default_pose,
        )
        < 1e-9
    )


@pytest.mark.parametrize("base", ["auto", "fixed", "floating"])
def test_base_of_a_free_file(robot, base):
    character = load(robot(trunk(leg())), base)
    assert character.nx == (1 if base == "fixed" else 7)
    assert character.mass == pytest.approx(load(robot(trunk(leg()))).mass)
    assert character.bodies[0].name == "trunk"


@pytest.mark.parametrize("base", ["auto", "fixed", "floating"])
def test_base_of_a_fixed_file(robot, base):
    character = load(robot(trunk(leg(), "")), base)
    assert character.nx == (7 if base == "floating" else 1)
    if base == "floating":
        assert np.allclose(character.default_pose[:6], (0, 0, 0.7, 0, 0, 0))


def test_ball_joint_is_three_hinges(robot):
    path = robot(
        trunk(leg('<joint name="hip" type="ball" pos="0 0 .1" range="0 1" damping=".1"/>'))
    )
    character, model = load(path), mujoco.MjModel.from_xml_path(str(path))
    assert [joint.name for joint in character.joints[6:]] == ["hip_z", "hip_y", "hip_x"]
    x = np.random.default_rng(0).uniform(-0.8, 0.8, character.nx)
    assert pose_errors(character, model, x) < 1e-12
    model.dof_armature[:] = 0.0
    assert (
        relative_difference(mass_matrix(character, x), mass_matrix_of(character, model, x)) < 1e-6
    )
    assert notes(character, "cone limit of 1 rad")
    assert notes(character, "damping and spring act about each hinge")


@pytest.mark.parametrize(
    ("actuator", "limit", "gear"),
    [
        ('<motor joint="hip" gear="50"/>', math.inf, 50.0),
        ('<motor joint="hip" gear="50" ctrlrange="-2 2"/>', 100.0, 50.0),
        ('<motor joint="hip" gear="-50" ctrlrange="-2 2" forcerange="-1.5 1.5"/>', 75.0, -50.0),
        ('<general joint="hip" gear="3" gainprm="4" ctrlrange="-1 1"/>', 12.0, 12.0),
        ('<motor joint="hip" ctrlrange="0 5"/>', 5.0, 1.0),
        ('<position joint="hip" kp="80" forcerange="-7 7" gear="2"/>', 14.0, 2.0),
        ('<position joint="hip" kp="80" ctrlrange="-1 1"/>', math.inf, 1.0),
        ('<velocity joint="hip" kv="3" forcerange="-7 7"/>', 7.0, 1.0),
        ('<motor joint="hip" ctrlrange="-2 2"/><motor joint="hip" ctrlrange="-3 3"/>', 5.0, 1.0),
    ],
)
def test_torque_limit(robot, actuator, limit, gear):
    character = load(robot(trunk(leg()), f"<actuator>{actuator}</actuator>"))
    hip = character.joints[6]
    assert hip.actuated
    assert hip.torque_limit == pytest.approx(limit)
    assert hip.gear == pytest.approx(gear)
    assert bool(notes(character, "control laws")) == (
        "position" in actuator or "velocity" in actuator
    )
    assert bool(notes(character, "not symmetric")) == ('"0 5"' in actuator)
    assert bool(notes(character, "2 actuators")) == (actuator.count("motor") == 2)


def test_joint_force_range_bounds_the_torque(robot):
    hip = '<joint name="hip" axis="0 1 0" actuatorfrcrange="-6 6"/>'
    character = load(
        robot(
            trunk(leg(hip)), '<actuator><motor joint="hip" gear="9" ctrlrange="-1 1"/></actuator>'
        )
    )
    assert character.joints[6].torque_limit == 6.0


def test_actuator_armature_and_damping_are_the_joints(robot):
    hip = '<joint name="hip" axis="0 1 0" armature=".5" damping=".25"/>'
    path = robot(
        trunk(leg(hip)),
        '<actuator><motor joint="hip" gear="-3" armature=".1" damping=".2"/></actuator>',
    )
    character, model = load(path), mujoco.MjModel.from_xml_path(str(path))
    assert character.joints[6].armature == pytest.approx(0.5 + 9 * 0.1)
    assert character.joints[6].damping == pytest.approx(0.25 + 9 * 0.2)
    x = np.random.default_rng(0).uniform(-0.8, 0.8, character.nx)
    assert (
        relative_difference(mass_matrix(character, x), mass_matrix_of(character, model, x)) < 1e-6
    )


def test_names_of_the_base_do_not_collide(robot):
    inner = leg('<joint name="hip_y"/>').replace('"leg"', '"shank"').replace('"shin"', '"shank"')
    character = load(
        robot(
            trunk(leg('<joint name="base_x" armature=".1"/><joint name="hip" type="ball"/>', inner))
        )
    )
    assert [joint.name for joint in character.joints[:2]] == ["_base_x", "_base_y"]
    assert [joint.name for joint in character.joints[6:]] == [
        "base_x",
        "_hip_z",
        "_hip_y",
        "_hip_x",
        "hip_y",
    ]


def test_joints_that_move_nothing_together_are_refused(robot):
    with pytest.raises(
        ModelError, match="tiny.xml: joints one, two: a motion of theirs has no inertia"
    ):
        load(robot(trunk(leg('<joint name="one" axis="0 1 0"/><joint name="two" axis="0 1 0"/>'))))


def test_actuators_that_no_joint_takes_are_listed(robot):
    site = '<site name="tip"/>'
    tendon = '<tendon><fixed name="rope"><joint joint="hip" coef="1"/></fixed></tendon>'
    actuators = """<actuator><motor name="pull" tendon="rope"/><motor name="jet" site="tip"
      gear="0 0 1 0 0 0"/>
      <motor name="lift" joint="root" gear="0 0 1 0 0 0"/></actuator>"""
    character = load(robot(trunk(leg(inside=site), '<freejoint name="root"/>'), tendon + actuators))
    assert character.nu == 0
    for word in (
        "actuator pull on a tendon",
        "actuator jet on a site",
        "actuator lift on the free joint",
        "tendon rope",
    ):
        assert notes(character, word), word


def test_what_is_dropped_is_listed(robot):
    joint = '<joint name="hip" axis="0 1 0" frictionloss=".1"/><joint name="roll" axis="1 0 0"/>'
    rest = """<option density="1000" gravity="0 0 -1.6"><flag contact="disable"/></option>
      <equality><joint name="tie" joint1="hip" joint2="roll"/></equality>
      <contact><exclude body1="trunk" body2="leg"/></contact>"""
    world = '<geom name="floor" type="plane" size="1 1 1" friction=".5"/>' + trunk(
        leg(joint)
    ).replace('name="leg"', 'name="leg" gravcomp="1"')
    character = load(robot(world, rest))
    words = [
        "frictionloss) of joints: hip",
        "equality constraint tie",
        "fluid",
        "gravity (0, 0, -1.6) m/s²",
        "flags that switch off: contact",
        "gravity compensation of bodies: leg",
    ]
    words += ["contact parameters", "1 contact exclusions", "1 geoms of the world (plane)"]
    for word in words:
        assert notes(character, word), word


def test_second_free_body_is_left_out(robot):
    ball = f'<body name="toy" pos="2 0 1"><freejoint/>{BALL}</body>'
    for world in (ball + trunk(leg()), trunk(leg()) + ball):
        character = load(robot(world, '<actuator><motor joint="hip"/></actuator>'))
        assert [body.name for body in character.bodies] == ["trunk", "leg"]
        assert character.nx == 7
        assert notes(character, "free body toy (4.19 kg)")


def test_toy_beside_a_fixed_arm_is_left_out(robot):
    ball = f'<body name="toy" pos="2 0 1"><freejoint/>{BALL}</body>'
    character = load(robot(ball + trunk(leg(), ""), '<actuator><motor joint="hip"/></actuator>'))
    assert (character.base, character.nx) == ("fixed", 1)


def test_several_fixed_trees_are_all_kept(robot):
    world = trunk(leg(), "") + f'<body name="door"><joint name="hinge"/>{BALL}</body>'
    character = load(robot(world))
    assert [joint.name for joint in character.joints] == ["hip", "hinge"]
    with pytest.raises(
        UnsupportedFeatureError,
        match=r"tiny.xml: base is 'floating'.* 2 bodies of the world could float \(trunk, door\)",
    ):
        load(robot(world), "floating")


def test_body_with_joints_to_the_world_cannot_float(robot):
    with pytest.raises(UnsupportedFeatureError, match="body trunk has joints to the world"):
        load(robot(trunk(leg(), '<joint name="rail" type="slide"/>')), "floating")


def test_welded_bodies_are_fused(robot):
    path = robot(
        trunk(leg(inside=f'<body name="foot" pos="0 0 -.4" euler=".1 .2 .3">{BALL}</body>'))
    )
    character, model = load(path), mujoco.MjModel.from_xml_path(str(path))
    assert [body.name for body in character.bodies] == ["trunk", "leg"]
    assert character.mass == pytest.approx(model.body_mass.sum())
    assert notes(character, "foot into leg")
    x = np.random.default_rng(0).uniform(-0.8, 0.8, character.nx)
    assert (
        relative_difference(mass_matrix(character, x), mass_matrix_of(character, model, x)) < 1e-6
    )
    assert character.contacts[0].name == "foot"


def test_keyframes_are_poses(robot):
    path = robot(trunk(leg()), '<keyframe><key name="home" qpos="1 2 3 1 0 0 0 .5"/></keyframe>')
    assert np.allclose(load(path).poses["home"], (1, 2, 3, 0, 0, 0, 0.5))
    assert np.allclose(load(path, "fixed").poses["home"], (0.5,))


def test_nameless_elements_get_names(robot):
    world = f"<body><freejoint/>{BALL}<body pos='.5 0 0'><joint axis='0 1 0'/>{BALL}</body></body>"
    character = load(robot(world))
    assert [body.name for body in character.bodies] == ["body1", "body2"]
    assert character.joints[6].name == "joint1"
    assert [contact.name for contact in character.contacts] == ["body2", "body1"]


def test_missing_mesh_is_dropped_where_it_gives_no_mass(robot):
    assets = '<asset><mesh name="shell" file="shell.stl"/></asset>'
    inertial = '<inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/>'
    body = '<body name="b"><freejoint/>{}<geom type="mesh" mesh="shell"/></body>'
    character = load(robot(body.format(inertial), assets))
    assert character.mass == 2.0
    assert notes(character, "mesh shell.stl: the file is missing")
    with pytest.raises(
        RobotFileError,
        match=r"tiny.xml: mesh file shell.stl is missing and body 'b' takes its mass from it",
    ):
        load(robot(body.format(""), assets))


BAD = {
    "no body": ('<geom size="1"/>', "has no <body>"),
    "nothing moves": (f'<body name="b">{BALL}</body>', "has no joints"),
    "massless": (
        '<body name="b"><freejoint/></body>',
        "mass and inertia of moving bodies must be larger",
    ),
    "unknown element": ("<wing/>", "MuJoCo does not compile it"),
    "inner free joint": (trunk(leg("<freejoint/>")), "free joint can only be used on top level"),
}


@pytest.mark.parametrize("case", BAD)
def test_refusals_name_the_file(case, robot):
    world, message = BAD[case]
    with pytest.raises(RobotFileError, match=f"^tiny.xml: .*{message}") as caught:
        load(robot(world))
    assert "\n" not in str(caught.value)
