"""A motion in MuJoCo's and Pinocchio's conventions."""

from __future__ import annotations

import types
from pathlib import Path

import mujoco
import numpy as np
import pytest

import octo
from octo.errors import ProblemError, UnknownNameError
from octo.model.character import Character
from octo.model.kinematics import body_poses
from octo.result import export
from octo.result.solution import Solution

DT, STEPS = 0.02, 30
MJCF = """<mujoco><worldbody><body name="trunk" pos="0 0 1" quat=".9 .1 .2 .3"><freejoint/><geom
  size=".1"/>
<body name="arm" pos=".1 0 0"><joint type="ball" name="shoulder" pos="0 0 .05"/><geom size=".05"/>
<body name="hand" pos=".2 0 0"><joint name="wrist" axis="0 1 0" ref="0.3"/>
<joint name="reach" type="slide"/><geom size=".02"/></body>
</body></body></worldbody></mujoco>"""


def moving(robot: Character) -> Solution:
    """A smooth motion, with turns of the base beyond half a circle; only what the export reads."""
    rng = np.random.default_rng(3)
    times = DT * np.arange(-1, STEPS + 1)[:, None]
    amplitude = rng.uniform(0.2, 0.6, robot.nx)
    x = amplitude * np.sin(3.0 * times + rng.uniform(0, 6, robot.nx))
    if robot.base == "floating":
        x[:, 3] += 8.0 * times[:, 0]
    names = tuple(joint.name for joint in robot.joints)
    actuated = tuple(robot.joints[j].name for j in robot.actuated)
    return types.SimpleNamespace(  # type: ignore[return-value]
        character=robot,
        soft=None,
        units=tuple("rad" if joint.kind == "hinge" else "m" for joint in robot.joints),
        effort_units=tuple(
            "N m" if robot.joints[j].kind == "hinge" else "N" for j in robot.actuated
        ),
        x=x,
        u=np.zeros((STEPS, robot.nu)),
        dt=DT,
        row_intervals=np.full(STEPS + 1, DT),
        times=DT * np.arange(STEPS + 1),
        joint_names=names,
        actuated_names=actuated,
        contact_names=("foot",),
        contact_force=rng.normal(size=(STEPS, 1, 3)),
    )


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "robot.xml"
    path.write_text(MJCF)
    return path


def test_mujoco_puts_the_bodies_where_octo_has_them(file: Path) -> None:
    robot, model = octo.load(file), mujoco.MjModel.from_xml_path(str(file))
    motion, data = moving(robot), mujoco.MjData(model)
    qpos, qvel = export.to_mujoco(motion)
    assert qpos.shape == (STEPS + 1, model.nq) and qvel.shape == (STEPS + 1, model.nv)
    rotation, origin = body_poses(robot, motion.x[1:])
    for i in range(STEPS + 1):
        data.qpos[:] = qpos[i]
        mujoco.mj_kinematics(model, data)
        assert np.allclose(data.xpos[1:], origin[i], atol=1e-12)
        assert np.allclose(data.xmat[1:].reshape(-1, 3, 3), rotation[i], atol=1e-12)


def test_mujoco_integrates_qvel_to_the_next_qpos(file: Path) -> None:
    model = mujoco.MjModel.from_xml_path(str(file))
    qpos, qvel = export.to_mujoco(moving(octo.load(file)))
    for i in range(STEPS):
        moved = qpos[i].copy()
        mujoco.mj_integratePos(model, moved, qvel[i + 1], DT)
        assert np.allclose(moved, qpos[i + 1], atol=1e-12)


def test_pinocchio_has_the_real_part_last_and_velocities_in_the_body(file: Path) -> None:
    motion = moving(octo.load(file))
    qpos, qvel = export.to_mujoco(motion)
    q, v = export.to_pinocchio(motion)
    assert np.allclose(q[:, 3:7], qpos[:, [4, 5, 6, 3]])
    rotation = body_poses(motion.character, motion.x[1:])[0][:, 0]  # type: ignore[arg-type]
    assert np.allclose(np.einsum("ijk,ik->ij", rotation, v[:, :3]), qvel[:, :3])
    assert np.allclose(v[:, 3:], qvel[:, 3:])
    turned, _ = export.to_pinocchio(motion, ("reach", "wrist", "shoulder"))
    assert np.allclose(turned[:, 7], q[:, -1]) and np.allclose(turned[:, 9:], q[:, 7:11])
    with pytest.raises(UnknownNameError, match="'wrists'.*wrist"):
        export.to_pinocchio(motion, ("wrists",))


def test_circular_joints_of_pinocchio_are_cosine_and_sine(file: Path) -> None:
    motion = moving(octo.load(file))
    plain, rate = export.to_pinocchio(motion)
    circular, same = export.to_pinocchio(motion, circular=("wrist",))
    angle = plain[:, 11]
    assert np.allclose(circular[:, 11:13], np.stack([np.cos(angle), np.sin(angle)], axis=1))
    assert np.array_equal(circular[:, 13], plain[:, 12]) and np.array_equal(rate, same)


def test_three_limited_hinges_are_no_ball(tmp_path: Path) -> None:
    """Whatever their names are."""
    hinges = "".join(
        f'<joint name="arm_{c}" axis="{a}" range="-40 40"/>'
        for c, a in (("z", "0 0 1"), ("y", "0 1 0"), ("x", "1 0 0"))
    )
    path = tmp_path / "arm.xml"
    path.write_text(
        f'<mujoco><worldbody><body>{hinges}<geom size=".1"/></body></worldbody></mujoco>'
    )
    assert export.to_mujoco(moving(octo.load(path)))[0].shape[1] == 3


def test_csv(tmp_path: Path) -> None:
    motion = moving(octo.gallery.chain())
    export.to_csv(motion, tmp_path / "motion.csv")
    lines = (tmp_path / "motion.csv").read_text().splitlines()
    names = lines[0].split(",")
    assert (
        names[:2] == ["time (s)", "base_x (m)"]
        and names[4] == "base_yaw (rad)"
        and names[-1] == "force foot z (N)"
    )
    assert names[15] == "torque front_inner_pitch (N m)"
    rows = np.genfromtxt(tmp_path / "motion.csv", delimiter=",", skip_header=1)
    assert rows.shape == (STEPS + 1, 1 + 14 + 8 + 3)
    assert np.allclose(rows[:, 1:15], motion.x[1:], atol=1e-8)
    assert np.isnan(rows[-1, 15:23]).all() and not np.isnan(rows[:-1, 15:23]).any()
    assert np.isnan(rows[0, 23:]).all() and np.allclose(
        rows[1:, 23:], motion.contact_force[:, 0], atol=1e-8
    )


def test_user_written_dynamics_have_no_bodies() -> None:
    with pytest.raises(ProblemError, match="no bodies"):
        export.to_mujoco(types.SimpleNamespace(character=None))  # type: ignore[arg-type]
