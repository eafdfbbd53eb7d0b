"""URDF features and refusals, one small file each."""

from __future__ import annotations

import dataclasses
import json
import math

import mujoco
import numpy as np
import pytest

from octo.errors import ModelError, RobotFileError, UnsupportedFeatureError
from octo.model import store
from octo.model.load import load

INERTIAL = (
    '<inertial><mass value="{mass}"/><inertia ixx=".01" iyy=".01" izz=".01" ixy="0" '
    'ixz="0" iyz="0"/></inertial>'
)
BALL = '<collision><geometry><sphere radius=".1"/></geometry></collision>'


def link(name, inside="", mass=1.0):
    return (
        "<link "
        f'name="{name}">{INERTIAL.format(mass=mass) if mass is not None else ""}{inside}</link>'
    )


def joint(
    name,
    parent,
    child,
    kind="revolute",
    inside='<limit lower="-1" upper="2" effort="5" velocity="3"/>',
    axis="0 1 0",
):
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return (
        f'<joint name="{name}" type="{kind}">{ends}<origin xyz="0 0 -.5"/><axis '
        f'xyz="{axis}"/>{inside}</joint>'
    )


@pytest.fixture
def robot(tmp_path):
    """Writes a URDF and returns its path."""

    def write(*elements, name="tiny"):
        path = tmp_path / f"{name}.urdf"
        path.write_text(f'<robot name="{name}">{"".join(elements)}</robot>')
        return path

    return write


def notes(character, word):
    return [note for note in character.dropped if word in note]


def test_base_is_the_callers_choice(robot):
    path = robot(link("trunk", BALL, 7.0), link("leg", BALL, 2.0), joint("hip", "trunk", "leg"))
    for base, n in (("auto", 7), ("floating", 7), ("fixed", 1)):
        character = load(path, base)
        assert character.nx == n
        assert character.nu == 1
        assert character.mass == pytest.approx(9.0)
        assert [body.name for body in character.bodies] == ["trunk", "leg"]
    assert load(path, "fixed").base == "fixed"
    assert not any(contact.touches_terrain for contact in load(path, "fixed").contacts)


def test_joint_kinds(robot):
    elements = [link(name) for name in "abcdef"]
    elements += [
        joint("turn", "a", "b"),
        joint("wheel", "b", "c", "continuous", '<dynamics damping=".4"/>'),
        joint("rail", "c", "d", "prismatic", axis="0 0 2"),
        joint("weld", "d", "e", "fixed"),
        joint("open", "e", "f", "revolute", '<limit effort="0" velocity="0"/>'),
    ]
    character = load(robot(*elements), "fixed")
    turn, wheel, rail, opened = character.joints
    assert (turn.kind, turn.lower, turn.upper, turn.torque_limit, turn.gear) == (
        "hinge",
        -1.0,
        2.0,
        5.0,
        1.0,
    )
    assert (wheel.kind, wheel.lower, wheel.upper, wheel.torque_limit, wheel.damping) == (
        "hinge",
        -math.inf,
        math.inf,
        math.inf,
        0.4,
    )
    assert rail.kind == "slide"
    assert np.allclose(rail.axis, (0, 0, 1))
    assert (opened.lower, opened.upper, opened.torque_limit) == (-math.inf, math.inf, math.inf)
    assert notes(character, "joint open: no range")
    assert character.mass == pytest.approx(6.0)
    assert notes(character, "e into d")


def test_welded_links_keep_mass_centre_and_inertia(robot):
    fixed = """<joint name="w" type="fixed"><parent link="a"/><child link="b"/>
      <origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/></joint>"""
    heavy = """<link name="b"><inertial><origin xyz="1 0 0"/><mass value="3"/>
      <inertia ixx="1" iyy="2" izz="2.5" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
    body = load(robot(link("a"), heavy, fixed)).bodies[0]
    assert body.mass == pytest.approx(4.0)
    assert np.allclose(body.com, (0, 0.75, 0.75))  # 3/4 of the way to the point (0, 1, 1)
    between = 1.0 * 3.0 / 4.0 * (2.0 * np.eye(3) - np.outer((0, 1, 1), (0, 1, 1)))
    assert np.allclose(body.inertia, 0.01 * np.eye(3) + np.diag([2.0, 1.0, 2.5]) + between)


def test_rotated_inertia_is_read_as_mujoco_reads_it(robot):
    turned = """<link name="b"><inertial><origin xyz=".1 .2 .3" rpy=".3 -.4 .5"/><mass value="3"/>
      <inertia ixx="1" iyy="1.2" izz="1.5" ixy=".1" ixz="-.05" iyz=".02"/></inertial></link>"""
    path = robot(link("a"), turned, joint("j", "a", "b"))
    body = load(path).bodies[1]
    model = mujoco.MjModel.from_xml_path(str(path))
    k = model.body("b").id
    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, model.body_iquat[k])
    axes = axes.reshape(3, 3)
    assert np.allclose(body.com, model.body_ipos[k])
    assert np.allclose(body.inertia, axes @ np.diag(model.body_inertia[k]) @ axes.T, atol=1e-6)


def test_links_without_inertial_stay_massless(robot):
    elements = (
        link("a", BALL),
        link("b", BALL, None),
        link("c"),
        joint("j", "a", "b"),
        joint("k", "b", "c", axis="1 0 0"),
    )
    character = load(robot(*elements))
    assert character.mass == pytest.approx(2.0)
    assert character.bodies[1].mass == 0.0
    assert not character.bodies[1].inertia.any()


def test_root_called_world_keeps_its_mass(robot):
    character = load(robot(link("world", mass=5.0), link("leg"), joint("j", "world", "leg")))
    assert character.mass == pytest.approx(6.0)
    assert character.nx == 7


def test_inertia_no_rigid_body_has_is_used_as_written(robot):
    odd = """<link name="b"><inertial><mass value="1"/>
      <inertia ixx=".1" iyy=".1" izz=".5" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
    character = load(robot(link("a"), odd, joint("j", "a", "b")))
    assert np.allclose(character.bodies[1].inertia, np.diag([0.1, 0.1, 0.5]))
    assert notes(character, "no rigid body")


def test_floating_joint_at_the_root(robot):
    elements = (
        link("odom", mass=None),
        link("trunk"),
        link("leg"),
        joint("free", "odom", "trunk", "floating", ""),
        joint("j", "trunk", "leg"),
    )
    character = load(robot(*elements))
    assert character.nx == 7
    assert [body.name for body in character.bodies] == ["trunk", "leg"]
    assert notes(character, "floating joint free")


def test_mimic_becomes_independent_and_is_listed(robot):
    mimic = (
        '<mimic joint="j" multiplier="-2" offset=".1"/><limit lower="-1" upper="1" '
        'effort="1" velocity="0"/>'
    )
    character = load(
        robot(
            link("a"),
            link("b"),
            link("c"),
            joint("j", "a", "b"),
            joint("k", "a", "c", inside=mimic),
        )
    )
    assert character.nu == 2
    assert notes(character, "k = -2·j + .1 is lost")


def test_what_is_dropped_is_listed(robot):
    inside = """<limit lower="-1" upper="1" effort="1" velocity="9"/><dynamics damping=".2"
      friction=".3"/>
      <safety_controller k_velocity="1"/>"""
    transmission = '<transmission name="t"><joint name="j"/></transmission><gazebo reference="a"/>'
    character = load(robot(link("a"), link("b"), joint("j", "a", "b", inside=inside), transmission))
    for word in ("dry friction of joints j", "safety controllers of joints j", "1 transmissions"):
        assert notes(character, word), word
    assert character.joints[6].damping == 0.2


CUBE = "".join(f"v {x} {y} {z}\n" for x in (-1, 1) for y in (-1, 1) for z in (-2, 2))
CUBE += (
    "f 1 2 4\nf 1 4 3\nf 5 7 8\nf 5 8 6\nf 1 5 6\nf 1 6 2\nf 3 4 8\nf 3 8 7\nf 1 3 7\nf "
    "1 7 5\nf 2 6 8\nf 2 8 4\n"
)


def mesh(filename, scale="1 1 1"):
    return (
        f'<collision><geometry><mesh filename="{filename}" scale="{scale}"/></geometry></collision>'
    )


def test_package_meshes_are_found_and_scaled(robot, tmp_path):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "cube.obj").write_text(CUBE)
    package = tmp_path.name
    visual = '<visual><geometry><mesh filename="package://nowhere/visual.dae"/></geometry></visual>'
    path = robot(link("a", visual + mesh(f"package://{package}/meshes/cube.obj", ".1 .1 .1")))
    character = load(path)
    reach = [np.abs(contact.position) + contact.radius for contact in character.contacts]
    assert len(reach) == 8
    assert np.allclose(reach, (0.1, 0.1, 0.2))
    assert not character.dropped


def test_meshes_that_cannot_be_used_are_listed(robot, tmp_path):
    (tmp_path / "good.obj").write_text(CUBE)
    (tmp_path / "broken.stl").write_text("not a mesh")
    unusable = mesh("trunk.dae") + mesh("package://p/gone.stl") + mesh("broken.stl")
    character = load(robot(link("a", unusable + mesh("good.obj"))))
    assert notes(character, "trunk.dae of links a: octo reads")
    assert notes(character, "gone.stl of links a: the file is missing")
    assert notes(character, "broken.stl of links a: ")
    assert len(character.contacts) == 8


def test_names_of_collisions_may_repeat(robot):
    named = BALL.replace("<collision>", '<collision name="same">')
    assert len(load(robot(link("a", named), link("b", named), joint("j", "a", "b"))).contacts) == 2


def test_infinite_effort_and_velocity(robot):
    limit = '<limit lower="-1" upper="1" effort="inf" velocity="inf"/>'
    character = load(robot(link("a"), link("b"), joint("j", "a", "b", inside=limit)))
    assert character.joints[6].torque_limit == math.inf
    assert character.joints[6].velocity_limit == math.inf
    assert not notes(character, "velocity")


def test_velocity_limits_are_kept(robot):
    limit = '<limit lower="-1" upper="1" effort="1" {}/>'
    joints = [
        joint("fast", "a", "b", inside=limit.format('velocity="9.5"')),
        joint("rail", "b", "c", "prismatic", limit.format('velocity=".25"')),
        joint("zero", "c", "d", inside=limit.format('velocity="0"')),
        joint("silent", "d", "e", inside=limit.format("")),
    ]
    character = load(robot(*(link(name) for name in "abcde"), *joints))
    assert character.velocity_limit[:6].tolist() == [math.inf] * 6  # of the base
    assert character.velocity_limit[6:].tolist() == [9.5, 0.25, math.inf, math.inf]
    assert not notes(character, "velocity")


def test_velocity_limits_survive_a_file(robot):
    character = load(robot(link("a"), link("b"), joint("j", "a", "b")))
    plain = json.loads(json.dumps(store.to_plain(character), allow_nan=False))
    assert np.array_equal(store.from_plain(plain).velocity_limit, character.velocity_limit)
    for body in plain["bodies"]:
        for old in body["joints"]:
            del old["velocity_limit"]  # a file of before there was the field
    assert np.isinf(store.from_plain(plain).velocity_limit).all()


def test_a_velocity_limit_must_be_positive(robot):
    character = load(robot(link("a"), link("b"), joint("j", "a", "b")))
    with pytest.raises(ModelError, match="joint 'j': velocity limit is 0.0, must be positive"):
        dataclasses.replace(character.joints[6], velocity_limit=0.0)


BAD = {
    "velocity": (
        [
            link("a"),
            link("b"),
            joint("j", "a", "b", inside='<limit lower="0" upper="1" effort="1" velocity="fast"/>'),
        ],
        RobotFileError,
        "joint 'j': velocity limit is 'fast'",
    ),
    "friction": (
        [link("a"), link("b"), joint("j", "a", "b", inside='<dynamics friction="some"/>')],
        RobotFileError,
        "joint 'j': friction is 'some'",
    ),
    "origin": (
        [link("a"), link("b"), joint("j", "a", "b").replace("0 0 -.5", "0 0 low")],
        RobotFileError,
        r"joint 'j': origin xyz is 'low', must be a finite number \(line 1\)",
    ),
    "planar": (
        [link("a"), link("b"), joint("j", "a", "b", "planar")],
        UnsupportedFeatureError,
        "joint 'j' is planar",
    ),
    "floating": (
        [link("a"), link("b"), joint("j", "a", "b", "floating", "")],
        UnsupportedFeatureError,
        "joint 'j' is floating",
    ),
    "kind": (
        [link("a"), link("b"), joint("j", "a", "b", "spring")],
        RobotFileError,
        "joint 'j': type is 'spring'",
    ),
    "axis": (
        [link("a"), link("b"), joint("j", "a", "b", axis="0 0 0")],
        RobotFileError,
        "joint 'j': axis is 0 0 0",
    ),
    "words": (
        [link("a"), link("b"), joint("j", "a", "b", axis="0 1")],
        RobotFileError,
        "joint 'j': axis xyz is '0 1'",
    ),
    "range": (
        [
            link("a"),
            link("b"),
            joint("j", "a", "b", inside='<limit lower="1" upper="0" effort="1"/>'),
        ],
        RobotFileError,
        "joint 'j': lower limit is 1.0",
    ),
    "effort": (
        [
            link("a"),
            link("b"),
            joint("j", "a", "b", inside='<limit lower="0" upper="1" effort="big"/>'),
        ],
        RobotFileError,
        "joint 'j': effort is 'big'",
    ),
    "negative": ([link("a", mass=-1.0)], RobotFileError, "link 'a': mass is -1.0 kg"),
    "not a number": ([link("a", mass="heavy")], RobotFileError, "link 'a': mass is 'heavy'"),
    "nan": ([link("a", mass="nan")], RobotFileError, "link 'a': mass is 'nan'"),
    "massless": ([link("a", mass=None)], RobotFileError, "total mass is 0.0 kg"),
    "weightless leg": (
        [link("a"), link("b", mass=None), joint("j", "a", "b")],
        ModelError,
        "joint 'j' moves link 'b' of mass 0 kg",
    ),
    "doubled link": ([link("a"), link("a")], RobotFileError, "link name 'a' occurs 2 times"),
    "two roots": ([link("a"), link("b")], RobotFileError, r"2 links have no parent \(a, b\)"),
    "no parent": (
        [link("a"), link("b"), joint("j", "x", "b")],
        RobotFileError,
        "joint 'j': parent link is 'x'",
    ),
    "two parents": (
        [
            link("a"),
            link("b"),
            link("c"),
            joint("j", "a", "c"),
            joint("k", "a", "b"),
            joint("l", "b", "c"),
        ],
        UnsupportedFeatureError,
        "link 'c' is the child of two joints",
    ),
    "loop": (
        [link("a"), link("b"), link("c"), joint("j", "b", "c"), joint("k", "c", "b")],
        UnsupportedFeatureError,
        "form a loop",
    ),
    "empty": ([], RobotFileError, "has no <link>"),
}


@pytest.mark.parametrize("case", BAD)
def test_refusals_name_file_element_and_value(case, robot):
    elements, error, message = BAD[case]
    with pytest.raises(error, match=f"^tiny.urdf: .*{message}") as caught:
        load(robot(*elements))
    assert "\n" not in str(caught.value)


def test_base_whose_motion_moves_no_inertia(robot):
    """A massless base that carries one hinge: turning the base and turning the hinge are the same
    motion."""
    path = robot(link("base", mass=None), link("arm"), joint("j", "base", "arm"))
    with pytest.raises(
        ModelError,
        match=r"tiny.urdf: joints .*: a motion of theirs has no inertia .*; base='fixed'",
    ):
        load(path)
    assert load(path, "fixed").nx == 1


def test_point_mass_on_its_own_axis(robot):
    point = (
        '<link name="b"><inertial><mass value="1"/><inertia ixx="0" iyy="0" izz="0" ixy="0" '
        'ixz="0" iyz="0"/></inertial></link>'
    )
    with pytest.raises(
        ModelError,
        match=r"tiny.urdf: joints j: a motion of theirs has no inertia \(0e\+00\), every one must$",
    ):
        load(robot(link("a"), point, joint("j", "a", "b")))
