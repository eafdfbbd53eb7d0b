"""URDF files: limits as they are written, and nothing of the file lost without a word."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import octo
from octo.cli.main import main
from octo.errors import ModelError, RobotFileError, UnsupportedFeatureError
from octo.model.describe import lost_shapes
from octo.model.load import load

CASES = Path(__file__).parent / "cases"
INERTIAL = (
    '<inertial>{}<mass value="{}"/><inertia ixx="{}" iyy=".01" izz=".01" ixy="0" ixz="0" '
    'iyz="0"/></inertial>'
)
NONE = math.inf


def link(name, inside="", mass="1", ixx=".01", origin=""):
    return f'<link name="{name}">{INERTIAL.format(origin, mass, ixx)}{inside}</link>'


def joint(inside="", kind="revolute", origin="0 0 .5", axis="0 1 0"):
    ends = '<parent link="a"/><child link="b"/>'
    return (
        f'<joint name="j" type="{kind}">{ends}<origin xyz="{origin}"/><axis '
        f'xyz="{axis}"/>{inside}</joint>'
    )


PAIR = link("a") + link("b")


def written(tmp_path, inside, name="tiny.urdf"):
    path = tmp_path / name
    path.write_text(
        f'<robot name="tiny" xmlns:xacro="http://www.ros.org/wiki/xacro">{inside}</robot>'
    )
    return path


# attributes of <limit>, lower, upper, effort, velocity, a word of what is said
LIMITS = {
    "upper alone": ('upper="0.04" effort="3" velocity="1"', 0.0, 0.04, 3.0, 1.0, ""),
    "lower alone": ('lower="-1.5" effort="3" velocity="1"', -1.5, 0.0, 3.0, 1.0, ""),
    "held": (
        'lower=".3" upper=".3" effort="3" velocity="1"',
        0.3,
        0.3,
        3.0,
        1.0,
        "the lower limit is the upper limit",
    ),
    "held at zero": (
        'lower="0" upper="0" effort="3" velocity="1"',
        0.0,
        0.0,
        3.0,
        1.0,
        "the lower limit is the upper limit",
    ),
    "all zero": (
        'lower="0" upper="0" effort="0" velocity="0"',
        -NONE,
        NONE,
        NONE,
        NONE,
        "joint j: no range in <limit>",
    ),
    "no range": ('effort="3" velocity="1"', -NONE, NONE, 3.0, 1.0, "joint j: no range in <limit>"),
    "no effort": (
        'lower="-1" upper="1" effort="0" velocity="2"',
        -1.0,
        1.0,
        NONE,
        2.0,
        "joint j: effort 0 in <limit>",
    ),
    "no speed": (
        'lower="-1" upper="1" effort="5" velocity="0"',
        -1.0,
        1.0,
        5.0,
        NONE,
        "joint j: speed 0 in <limit>",
    ),
    "negative": (
        'lower="-1" upper="1" effort="-5" velocity="-2"',
        -1.0,
        1.0,
        5.0,
        2.0,
        "negative effort in <limit>",
    ),
    "infinite": (
        'lower="-inf" upper="Infinity" effort="inf" velocity="1e400"',
        -NONE,
        NONE,
        NONE,
        NONE,
        "",
    ),
    "infinite below": (
        'lower="-1e400" upper=".5" effort="-inf" velocity="-Infinity"',
        -NONE,
        0.5,
        NONE,
        NONE,
        "",
    ),
    "infinite above": (
        'lower=".2" upper="1e999" effort="1e308" velocity="+inf"',
        0.2,
        NONE,
        1e308,
        NONE,
        "",
    ),
}


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize("case", LIMITS)
def test_limits(tmp_path, case, kind):
    attributes, lower, upper, effort, velocity, said = LIMITS[case]
    robot = load(written(tmp_path, PAIR + joint(f"<limit {attributes}/>", kind)), "fixed")
    found = robot.joints[0]
    assert (found.lower, found.upper, found.torque_limit, found.velocity_limit) == (
        lower,
        upper,
        effort,
        velocity,
    )
    assert found.actuated
    if said:
        assert any(said in note for note in robot.dropped)
    else:
        assert not robot.dropped


def test_a_continuous_joint_has_no_range(tmp_path):
    robot = load(
        written(
            tmp_path,
            PAIR + joint('<limit lower="-1" upper="1" effort="2" velocity="3"/>', "continuous"),
        ),
        "fixed",
    )
    assert (robot.lower[0], robot.upper[0], robot.torque_limit[0]) == (-NONE, NONE, 2.0)
    assert any(
        "joint j: continuous, the range in <limit> does not count" in note for note in robot.dropped
    )


def test_the_case_of_one_limit():
    robot = load(CASES / "one_sided_limit.urdf")
    assert (robot.lower[6], robot.upper[6]) == (0.0, 0.04)


def test_a_joint_that_is_held_stays_there(tmp_path):
    """Its limit acts in the dynamics, in the pose of a start and in a file for MuJoCo."""
    mujoco = pytest.importorskip("mujoco")
    robot = load(
        written(tmp_path, PAIR + joint('<limit lower=".3" upper=".3" effort="9" velocity="1"/>')),
        "fixed",
    )
    problem = octo.Problem(robot, steps=10, dt=0.02, costs=[octo.Effort()])
    assert problem.start.tolist() == [0.3]
    octo.export_mjcf(robot, tmp_path / "held.xml")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "held.xml"))
    assert model.jnt_limited[0]
    np.testing.assert_allclose(model.jnt_range[0], 0.3, atol=2e-6)


LIMITS_REFUSED = {
    "a lower one above the upper": (
        'lower="1" upper="-1"',
        "joint 'j': lower limit is 1.0, must not be above",
    ),
    "a lower one above the missing": (
        'lower=".5"',
        r"joint 'j': lower limit is 0.5, .* 0.0 \(one that is missing is 0\)",
    ),
    "an upper one below the missing": (
        'upper="-.5"',
        r"joint 'j': lower limit is 0.0, .* -0.5 \(one that is missing is 0\)",
    ),
    "no number": ('lower="nan" upper="1"', "joint 'j': limit lower is 'nan', must be a number"),
    "words": ('lower="-1" upper="one"', "joint 'j': limit upper is 'one', must be a number"),
    "two numbers": (
        'lower="-1" upper="1" effort="1 2"',
        "joint 'j': effort is '1 2', must be a number",
    ),
    "both endless": ('lower="inf" upper="inf"', "joint 'j': lower limit is inf"),
}


@pytest.mark.parametrize("case", LIMITS_REFUSED)
def test_limits_that_are_none(tmp_path, case):
    attributes, message = LIMITS_REFUSED[case]
    with pytest.raises(RobotFileError, match=f"^tiny.urdf: {message}"):
        load(written(tmp_path, PAIR + joint(f"<limit {attributes}/>")))


LOST = {
    "a macro": (
        PAIR + joint() + '<xacro:leg prefix="fl"/>',
        UnsupportedFeatureError,
        "<xacro:leg>: macros of xacro",
    ),
    "a macro in a link": (
        link("a", "<xacro:box/>"),
        UnsupportedFeatureError,
        "<xacro:box>: macros",
    ),
    "a property": (
        link("a") + '<xacro:property name="m" value="1"/>',
        UnsupportedFeatureError,
        "<xacro:property> 'm': macros",
    ),
    "a mass": (
        link("a", mass="${m}"),
        UnsupportedFeatureError,
        r"<link> 'a', <mass>: value is '\${m}': expressions of xacro",
    ),
    "a name": (
        link("${side}_leg"),
        UnsupportedFeatureError,
        r"name is '\${side}_leg': expressions",
    ),
    "an argument": (
        PAIR + joint('<limit lower="$(arg low)"/>'),
        UnsupportedFeatureError,
        r"<joint> 'j', <limit>: lower is '\$\(arg low\)'",
    ),
    "a group": (
        link("a") + f"<group>{link('b')}</group>",
        RobotFileError,
        "<link> 'b' is inside of <group>, must be a child",
    ),
    "a frame in a group": (
        link("a") + '<group><link name="tool"/></group>',
        RobotFileError,
        "<link> 'tool' is inside of",
    ),
    "a joint in a group": (
        PAIR + f"<group>{joint()}</group>",
        RobotFileError,
        "<joint> 'j' is inside of <group>",
    ),
    "a link in a link": (
        link("a", link("b")),
        RobotFileError,
        "<link> 'b' is inside of <link> 'a'",
    ),
    "deeper": (
        link("a") + f"<x><y><z>{link('b')}</z></y></x>",
        RobotFileError,
        "<link> 'b' is inside of <x>",
    ),
    "in an extension": (
        link("a") + f"<gazebo>{link('b')}</gazebo>",
        RobotFileError,
        "<link> 'b' is inside of <gazebo>",
    ),
    "a robot in a robot": (
        link("a") + f"<robot>{link('b')}</robot>",
        RobotFileError,
        "<link> 'b' is inside of <robot>",
    ),
    "capitals": (
        link("a") + '<Link name="b"/>',
        RobotFileError,
        "<Link> 'b' is no element of a URDF, must be <link>",
    ),
    "another language": (
        link("a") + '<d:joint xmlns:d="http://d" name="k"/>',
        RobotFileError,
        "<joint> 'k' is no element",
    ),
}


@pytest.mark.parametrize("case", LOST)
def test_what_would_be_lost_is_refused(tmp_path, case):
    inside, error, message = LOST[case]
    with pytest.raises(error, match=f"^tiny.urdf: .*{message}") as caught:
        load(written(tmp_path, inside))
    assert "\n" not in str(caught.value)


def test_a_macro_without_its_namespace(tmp_path):
    path = tmp_path / "leg.urdf"
    path.write_text(f'<robot name="leg">{link("a")}<xacro:leg/></robot>')
    with pytest.raises(RobotFileError, match="leg.urdf: .*unbound prefix.*xacro must be expanded"):
        load(path)


@pytest.mark.parametrize(
    ("name", "message"),
    [("unexpanded_xacro", "<xacro:leg>"), ("link_in_a_group", "<link> 'a' is inside of <group>")],
)
def test_the_cases_of_lost_parts(name, message):
    with pytest.raises(RobotFileError, match=f"{name}.urdf: {message}"):
        load(CASES / f"{name}.urdf")


SAID = {
    "a misspelt inertia": (link("a", "<inertail/>"), "<inertail> in 1 <link>"),
    "a misspelt shape": (link("a", "<colision/>") + link("b") + joint(), "<colision> in 1 <link>"),
    "a sensor of a link": (link("a", "<camera/>"), "<camera> in 1 <link>"),
    "two of a kind": (
        link("a", "<magnet/>") + link("b", "<magnet/>") + joint(),
        "<magnet> in 2 <link>",
    ),
    "of a joint": (PAIR + joint("<backlash/>"), "<backlash> in 1 <joint>"),
    "of a robot": (link("a") + "<muscle/>", "<muscle> in 1 <robot>"),
}


@pytest.mark.parametrize("case", SAID)
def test_unknown_elements_are_said(tmp_path, case):
    inside, words = SAID[case]
    robot = load(written(tmp_path, inside))
    assert any(words in note for note in robot.dropped)


def test_extensions_and_looks_may_name_what_they_like(tmp_path):
    extra = '<transmission name="t"><joint name="j"/></transmission><material name="grey"/>'
    extra += '<ros2_control name="c"><joint name="j"/></ros2_control>'
    sdf = (
        '<gazebo><link name="x"><inertial><mass>1</mass></inertial></link><plugin '
        'file="$(find p)/x.yaml"/></gazebo>'
    )
    looks = link("b", '<visual><geometry><mesh filename="$(find p)/x.dae"/></geometry></visual>')
    robot = load(written(tmp_path, link("a") + looks + joint() + extra + sdf))
    assert robot.mass == 2.0
    assert not [note for note in robot.dropped if "none of URDF's" in note]


NUMBERS = {
    "damping": (
        PAIR + joint('<dynamics damping="-1"/>'),
        "joint 'j': damping is -1.0, must be finite and not negative",
    ),
    "endless damping": (PAIR + joint('<dynamics damping="inf"/>'), "joint 'j': damping is 'inf'"),
    "no damping": (PAIR + joint('<dynamics damping="nan"/>'), "joint 'j': damping is 'nan'"),
    "origin": (PAIR + joint(origin="0 nan 0"), "joint 'j': origin xyz is 'nan'"),
    "endless origin": (PAIR + joint(origin="inf 0 0"), "joint 'j': origin xyz is 'inf'"),
    "origin far away": (PAIR + joint(origin="0 0 1e200"), "joint 'j': origin xyz is '1e200'"),
    "radius": (
        link("a", '<collision><geometry><sphere radius="1e300"/></geometry></collision>'),
        "radius of its sphere is '1e300'",
    ),
    "endless radius": (
        link("a", '<collision><geometry><sphere radius="inf"/></geometry></collision>'),
        "radius of its sphere is 'inf'",
    ),
    "no place of a shape": (
        link(
            "a",
            '<collision><origin xyz="0 nan 0"/><geometry><sphere '
            'radius=".1"/></geometry></collision>',
        ),
        "collision origin xyz is 'nan'",
    ),
    "inertia": (
        PAIR.replace('ixx=".01"', 'ixx="-1"') + joint(),
        "body .*: inertia has the principal moments -1, 0.01, 0.01",
    ),
    "large inertia": (
        link("a", ixx="1e300"),
        "link 'a': inertia ixx is '1e300', must be a finite number of at most 1e",
    ),
    "mass": (link("a", mass="1e300"), "link 'a': mass is '1e300'"),
    "centre of mass": (
        link("a", origin='<origin xyz="0 0 1e99"/>'),
        "link 'a': inertial origin xyz is '1e99'",
    ),
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("case", NUMBERS)
def test_numbers_that_are_none(tmp_path, case):
    inside, message = NUMBERS[case]
    with pytest.raises(ModelError, match=f"^tiny.urdf: .*{message}") as caught:
        load(written(tmp_path, inside))
    assert "\n" not in str(caught.value)


MJCF = {
    "damping": ('damping="-1"', "joint 'hip': damping is -1.0, must be finite and not negative"),
    "stiffness": ('stiffness="-5"', "joint 'hip': stiffness is -5.0"),
    "armature": ('armature="-.1"', "joint 'hip': armature is -0.1"),
    "endless damping": ('damping="inf"', "joint 'hip': damping is inf"),
    "large stiffness": (
        'stiffness="1e300"',
        r"joint 'hip': stiffness is 1e\+300, must be at most 1e\+12",
    ),
    "anchor": ('pos="0 nan 0"', "joint 'hip': position has the entry nan"),
    "reference": ('ref="inf"', "joint 'hip': reference is inf"),
}


@pytest.mark.parametrize("case", MJCF)
def test_numbers_of_an_mjcf(tmp_path, case):
    attributes, message = MJCF[case]
    path = tmp_path / "tiny.xml"
    hip = f'<joint name="hip" {attributes}/>'
    path.write_text(
        f'<mujoco><worldbody><body name="a">{hip}<geom size=".1"/></body></worldbody></mujoco>'
    )
    with pytest.raises(ModelError, match=f"^tiny.xml: .*{message}"):
        load(path)


def test_endless_ranges_of_an_mjcf(tmp_path):
    path = tmp_path / "tiny.xml"
    hip = '<joint name="hip" range="-inf 90"/>'
    motor = '<actuator><motor joint="hip" ctrlrange="-inf inf"/></actuator>'
    path.write_text(
        f'<mujoco><worldbody><body name="a">{hip}<geom '
        f'size=".1"/></body></worldbody>{motor}</mujoco>'
    )
    robot = load(path)
    assert (robot.lower[0], robot.torque_limit[0]) == (-NONE, NONE)
    assert robot.upper[0] == pytest.approx(math.pi / 2)


def dog(tmp_path, foot, trunk=""):
    legs = ""
    for name, x, y in (("fl", 0.2, 0.1), ("fr", 0.2, -0.1), ("hl", -0.2, 0.1), ("hr", -0.2, -0.1)):
        mesh = f'<collision><geometry><mesh filename="{foot.format(name)}"/></geometry></collision>'
        hip = joint('<limit lower="-1" upper="1" effort="9" velocity="9"/>', origin=f"{x} {y} 0")
        legs += link(f"{name}_foot", mesh) + hip.replace('"j"', f'"{name}_hip"').replace(
            '"b"', f'"{name}_foot"'
        )
    return written(tmp_path, link("a", trunk) + legs, "dog.urdf")


@pytest.mark.parametrize(
    ("foot", "reason"),
    [
        ("package://dog/{}.dae", "octo reads .stl, .obj, .msh"),
        ("package://dog/{}.stl", "the file is missing"),
        ("meshes/{}.obj", "the file is missing"),
        ("file:///nowhere/{}.STL", "the file is missing"),
        ("{}.glb", "octo reads"),
    ],
)
def test_meshes_that_cannot_be_read_are_named(tmp_path, foot, reason):
    said = lost_shapes(load(dog(tmp_path, foot)))
    assert said.startswith("collision meshes are left out and nothing touches there: ")
    for name in ("fl", "fr", "hl", "hr"):
        assert f"{foot.format(name)} of links {name}_foot: {reason}" in said


def test_octo_solve_says_which_feet_are_missing(tmp_path, capsys):
    """In place of asking for a pose."""
    path = dog(tmp_path, "package://dog/{}.dae")
    assert main(["solve", str(path), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert (
        said.count("fl.dae of links fl_foot: octo reads .stl, .obj, .msh") == 2
    )  # as it is read, and as it does not stand
    assert "does not stand" in said
    assert "--pose" not in said


def test_a_body_of_an_mjcf_without_its_mesh(tmp_path):
    assets = '<asset><mesh name="sole" file="sole.stl"/></asset>'
    inertial = '<inertial pos="0 0 0" mass="2" diaginertia="1 1 1"/>'
    body = f'<body name="foot"><freejoint/>{inertial}<geom type="mesh" mesh="sole"/></body>'
    path = tmp_path / "foot.xml"
    path.write_text(f"<mujoco>{assets}<worldbody>{body}</worldbody></mujoco>")
    assert "of bodies foot, mesh sole.stl: the file is missing" in lost_shapes(load(path))
