"""Ball joints in MJCF files: a motor's gear vector acts on its axis, as MuJoCo's qfrc_actuator
says."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from octo.errors import ModelError
from octo.model.character import Array, Character
from octo.model.kinematics import axis_rotation
from octo.model.load import load

CASES = Path(__file__).parent / "cases"
BODY = (
    '<body name="a"><joint name="j" type="ball"{}/><geom type="capsule" size=".02" '
    'fromto="0 0 0 0 0 -.5" mass="1"/></body>'
)


def written(tmp_path, actuators, joint=""):
    path = tmp_path / "ball.xml"
    path.write_text(
        f"<mujoco><worldbody>{BODY.format(joint)}</worldbody><actuator>{actuators}</actuator></mujoco>"
    )
    return path


def turn_of(robot: Character, x: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) of the ball and its angular velocity in the child's axes per unit of the
    hinges' rates (3, 3)."""
    turn, rates = np.eye(3), np.zeros((3, 3))
    for k in reversed(range(3)):
        rates[:, k] = turn.T @ robot.joints[k].axis
        turn = axis_rotation(robot.joints[k].axis, x[k]) @ turn
    return turn, rates


def difference(path: Path, x: Array, share: float = 1.0) -> tuple[float, Character]:
    """Of the hinges' torques at ``share`` of all limits from MuJoCo's generalised force, in N m."""
    robot, model = load(path), mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    turn, rates = turn_of(robot, x)
    mujoco.mju_mat2Quat(data.qpos, turn.ravel())
    data.ctrl[:] = share * model.actuator_ctrlrange[:, 1]
    mujoco.mj_forward(model, data)
    torque = [
        np.sign(joint.gear) * share * joint.torque_limit if joint.actuated else 0.0
        for joint in robot.joints
    ]
    return float(np.abs(rates.T @ data.qfrc_actuator - torque).max()), robot


ONE = {
    "x": '<motor joint="j" gear="1 0 0" ctrlrange="-5 5"/>',
    "y": '<motor joint="j" gear="0 3 0" ctrlrange="-5 5"/>',
    "z, reversed": '<motor joint="j" gear="0 0 -2" ctrlrange="-5 5"/>',
    "between two axes": '<motor joint="j" gear="1 1 0" ctrlrange="-5 5"/>',
    "any axis": '<motor joint="j" gear=".3 -.5 .8" ctrlrange="-5 5"/>',
    "force range": '<general joint="j" gear="0 2 0" gainprm="10" ctrlrange="-1 1" '
    'forcerange="-10 10"/>',
    "z of the parent": '<motor jointinparent="j" gear="0 0 1" ctrlrange="-5 5"/>',
    "any axis of the parent": '<motor jointinparent="j" gear="1 2 -.4" ctrlrange="-5 5"/>',
    "two about one axis": '<motor joint="j" gear="0 1 0" ctrlrange="-5 5"/><motor '
    'joint="j" gear="0 2 0" ctrlrange="-1 1"/>',
}


@pytest.mark.parametrize("motor", ONE)
def test_one_axis(tmp_path, motor):
    error, robot = difference(written(tmp_path, ONE[motor]), np.zeros(3), share=0.7)
    assert error < 1e-12
    assert robot.nu == 1
    assert any("where it is not turned" in note for note in robot.dropped)


@pytest.mark.parametrize("motor", ["x", "between two axes", "any axis"])
def test_the_innermost_axis_stays_the_childs(tmp_path, motor):
    """Where the middle hinge is at zero, whatever the others are."""
    for seed in range(3):
        outer, inner = np.random.default_rng(seed).uniform(-1.5, 1.5, 2)
        assert difference(written(tmp_path, ONE[motor]), np.array([outer, 0.0, inner]))[0] < 1e-12


SEVERAL = {
    "x and y": ("1 0 0", "0 4 0"),
    "y and z": ("0 2 0", "0 0 1"),
    "z and x": ("0 0 2", "-1 0 0"),
    "all three": ("1 0 0", "0 2 0", "0 0 3"),
    "skew, at right angles": ("1 1 0", "1 -1 0"),
}


@pytest.mark.parametrize("gears", SEVERAL)
def test_several_axes(tmp_path, gears):
    motors = "".join(
        f'<motor joint="j" gear="{gear}" ctrlrange="-5 5"/>' for gear in SEVERAL[gears]
    )
    error, robot = difference(written(tmp_path, motors), np.zeros(3))
    assert error < 1e-12
    assert robot.nu == len(SEVERAL[gears])


def test_the_case_of_one_motor():
    error, robot = difference(CASES / "ball_with_one_motor.xml", np.array([0.4, 0.0, 0.9]))
    assert error < 1e-12
    assert [joint.actuated for joint in robot.joints] == [False, False, True]
    np.testing.assert_array_equal(robot.joints[2].axis, (1.0, 0.0, 0.0))
    assert robot.torque_limit.tolist() == [5.0]


def test_oblique_axes_are_said(tmp_path):
    robot = load(written(tmp_path, ONE["x"] + ONE["between two axes"]))
    assert robot.torque_limit.tolist() == [5.0, 10.0]  # about y, about x
    assert any("oblique axes" in note for note in robot.dropped)


def test_a_ball_without_motors_is_free(tmp_path):
    assert load(written(tmp_path, "")).nu == 0


def test_a_motor_without_a_limit_or_a_gear(tmp_path):
    free = load(written(tmp_path, '<motor joint="j" gear="0 1 0"/>'))
    assert free.torque_limit.tolist() == [math.inf]
    idle = load(written(tmp_path, '<motor name="m" joint="j" gear="0 0 0" ctrlrange="-5 5"/>'))
    assert idle.nu == 0
    assert any(
        "gear is zero of actuators, which then drive nothing: m" in note for note in idle.dropped
    )
    with pytest.raises(ModelError, match=r"ball.xml: actuator 'm': gear is .*nan"):
        load(written(tmp_path, '<motor name="m" joint="j" gear="0 nan 0" ctrlrange="-5 5"/>'))


def test_only_the_first_number_of_a_gear_acts_on_a_hinge(tmp_path):
    path = tmp_path / "hinge.xml"
    body = BODY.format("").replace('type="ball"', "")
    motor = '<motor joint="j" gear="2 3 4" ctrlrange="-1 1"/>'
    path.write_text(f"<mujoco><worldbody>{body}</worldbody><actuator>{motor}</actuator></mujoco>")
    joint, model = load(path).joints[0], mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.ctrl[:] = 1.0
    mujoco.mj_forward(model, data)
    assert (joint.torque_limit, joint.gear) == (2.0, 2.0)
    assert joint.torque_limit == data.qfrc_actuator[0]


def test_a_cone_limit_is_said(tmp_path):
    robot = load(written(tmp_path, ONE["y"], ' range="0 50"'))
    assert any("cone limit" in note for note in robot.dropped)


@pytest.mark.parametrize("motor", ["", *ONE.values()])
def test_poses_and_motions_are_mujocos(tmp_path, motor):
    """Keyframes of the file, and qpos of a motion, whatever the axes of the hinges are."""
    quat = np.array([0.8, 0.3, -0.4, 0.2]) / np.linalg.norm([0.8, 0.3, -0.4, 0.2])
    path = tmp_path / "ball.xml"
    key = f'<keyframe><key name="bent" qpos="{" ".join(map(repr, quat.tolist()))}"/></keyframe>'
    path.write_text(
        f"<mujoco><worldbody>{BODY.format('')}</worldbody><actuator>{motor}</actuator>{key}</mujoco>"
    )
    robot = load(path)
    turn, expected = turn_of(robot, robot.poses["bent"])[0], np.zeros(9)
    mujoco.mju_quat2Mat(expected, quat)
    np.testing.assert_allclose(turn.ravel(), expected, atol=1e-12)
