"""The plant: one state in two conventions, and MuJoCo's physics as asked for."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import octo
from octo.errors import ShapeError, ValueRangeError
from octo.model.mass_matrix import mass_matrix
from octo.plant import MujocoPlant, from_chart, to_chart

STANDING = 20.0  # N m/rad, with 0.3 N m s/rad: more damping than a shank of 0.8 g m² takes at 2 ms


@pytest.fixture(scope="module")
def mammal():
    return octo.load("mammal")


def hold(plant: MujocoPlant, pose: np.ndarray, seconds: float) -> None:
    joints = plant.character.actuated
    for _ in range(round(seconds / plant.timestep)):
        x, rate = plant.chart()
        plant.step(STANDING * (pose - x)[joints] - 0.3 * rate[joints])


@pytest.mark.parametrize("name", ["mammal", "humanoid", "chain"])
def test_state_goes_there_and_back(name):
    robot = octo.load(name)
    rng = np.random.default_rng(1)
    for _ in range(20):
        x, rate = rng.uniform(-1.2, 1.2, robot.nx), rng.normal(size=robot.nx)
        x[3] += 2.0 * np.pi * rng.integers(-2, 3)  # yaw, unwrapped
        again, same_rate = to_chart(robot, *from_chart(robot, x, rate), near=x + 0.1)
        np.testing.assert_allclose(again, x, atol=1e-9)
        np.testing.assert_allclose(same_rate, rate, atol=1e-8)


def test_angles_follow_a_fall_through_a_pitch_of_ninety_degrees(mammal):
    x = np.array(mammal.default_pose)
    near = x
    for pitch in np.linspace(0.0, 2.6, 60):
        x[4] = pitch
        near = to_chart(mammal, *from_chart(mammal, x), near=near)[0]
        np.testing.assert_allclose(near[3:6], (0.0, pitch, 0.0), atol=1e-6)


def test_rates_are_mujocos_velocity(mammal):
    rng = np.random.default_rng(2)
    plant, small = MujocoPlant(mammal), 1e-6
    x, rate = rng.uniform(-0.8, 0.8, mammal.nx), rng.normal(size=mammal.nx)
    q, v = from_chart(mammal, x, rate)
    moved = q.copy()
    mujoco.mj_integratePos(plant.model, moved, v, small)
    np.testing.assert_allclose(moved, from_chart(mammal, x + small * rate)[0], atol=1e-10)
    plant.reset(q, v)
    mujoco.mj_energyVel(plant.model, plant.data)
    assert plant.data.energy[1] == pytest.approx(
        0.5 * rate @ mass_matrix(mammal, x) @ rate, rel=1e-9
    )


def test_order_is_the_characters_where_mujoco_numbers_otherwise():
    robot = octo.load("humanoid")
    plant = MujocoPlant(robot)
    x = np.array(robot.default_pose) + np.linspace(0.0, 0.2, robot.nx)
    plant.reset_chart(x)
    np.testing.assert_allclose(plant.x, x, atol=1e-9)
    for j in range(6, robot.nx):
        assert plant.data.joint(robot.joints[j].name).qpos[0] == pytest.approx(x[j])


def test_a_standing_robot_is_carried_by_its_feet_and_a_payload_adds_to_it(mammal):
    for payload in (0.0, 0.2):
        plant = MujocoPlant(mammal, payload=payload)
        plant.reset_chart(mammal.default_pose)
        hold(plant, mammal.default_pose, 2.0)
        weight = 9.81 * (mammal.mass + payload * mammal.bodies[0].mass)
        force, point = plant.contacts()
        assert force[:, 2].sum() == pytest.approx(weight, rel=5e-3)
        np.testing.assert_allclose(np.abs(point[force[:, 2] > 1.0, 2]), 0.0, atol=5e-3)
        assert 0.2 < plant.height < 0.26
        assert plant.time == pytest.approx(2.0)


def test_friction_decides_whether_a_robot_slides_down_a_slope(mammal):
    travel = []
    for friction in (0.1, 1.0):
        plant = MujocoPlant(mammal, terrain=octo.Plane(slope=0.2), friction=friction)
        plant.reset_chart(mammal.default_pose)
        hold(plant, mammal.default_pose, 1.0)
        travel.append(-plant.q[0])
    assert travel[0] > 0.3
    assert travel[1] < 0.15


def test_bumps_carry_feet_and_leave_the_start_free(mammal):
    plant = MujocoPlant(mammal, bumps=0.02, seed=3)
    boxes = [
        g for g in range(plant.model.ngeom) if plant.model.geom_type[g] == mujoco.mjtGeom.mjGEOM_BOX
    ]
    place = plant.model.geom_pos[boxes]
    half = plant.model.geom_size[boxes]
    assert np.max(place[:, 2] + half[:, 2]) <= 0.02 + 1e-9
    assert np.all(np.max(np.abs(place[:, :2]) - half[:, :2], axis=1) > 0.49)
    forces = []
    for box in range(0, len(boxes), 40):
        pose = np.array(mammal.default_pose)
        pose[:2] = place[box, :2] - [0.17, 0.09]
        pose[2] += 0.02
        plant.reset_chart(pose)
        hold(plant, pose, 1.0)
        force, _ = plant.contacts()
        forces.append(force[:, 2])
        assert force[:, 2].sum() == pytest.approx(9.81 * mammal.mass, rel=0.05)
    assert np.min(forces) >= 0.0


def test_torques_are_clipped_and_a_push_pushes(mammal):
    plant = MujocoPlant(mammal, timestep=0.001)
    plant.step(np.full(mammal.nu, 1e3), 0.005)
    assert plant.time == pytest.approx(0.005)
    np.testing.assert_allclose(plant.torque, mammal.torque_limit)
    pose = np.array(mammal.default_pose)
    pose[2] += 1.0
    plant.reset_chart(pose)
    plant.push = np.array([0.0, 20.0, 0.0])
    plant.step(np.zeros(mammal.nu), 0.05)
    mujoco.mj_forward(plant.model, plant.data)
    mujoco.mj_subtreeVel(plant.model, plant.data)
    velocity = plant.data.subtree_linvel[plant.model.body("trunk").id]
    np.testing.assert_allclose(mammal.mass * velocity[:2], (0.0, 1.0), atol=1e-3)


def test_bad_input_is_refused(mammal):
    for options in (
        {"friction": -0.1},
        {"timestep": 0.0},
        {"bumps": -1.0},
        {"payload": -1.5},
        {"friction": np.nan},
    ):
        with pytest.raises(ValueRangeError, match=next(iter(options))):
            MujocoPlant(mammal, **options)
    with pytest.raises(ShapeError, match="q has shape"):
        MujocoPlant(mammal).reset(np.zeros(5))
