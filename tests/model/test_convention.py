"""The chart of a base that turns and falls, against rotation matrices built hinge by hinge."""

from __future__ import annotations

import numpy as np
import pytest

import octo
from octo.errors import UnknownNameError
from octo.model.chart import angles_of, body_axes, rotation_of_angles
from octo.model.convention import Convention
from octo.model.kinematics import axis_rotation, body_poses
from octo.model.quaternions import quaternions, rotation_of

ORDER = {"zyx": (2, 1, 0), "zxy": (2, 0, 1)}


def product(angles, chart):
    turns = [
        axis_rotation(np.eye(3)[axis], np.asarray(angle))
        for axis, angle in zip(ORDER[chart], angles, strict=True)
    ]
    return turns[0] @ turns[1] @ turns[2]


@pytest.mark.parametrize("chart", ["zyx", "zxy"])
def test_angles_and_rotations_agree(chart):
    rng = np.random.default_rng(0)
    for angles in rng.uniform(-9.0, 9.0, (300, 3)):
        rotation = product(angles, chart)
        np.testing.assert_allclose(rotation_of_angles(angles, chart), rotation, atol=1e-12)
        np.testing.assert_allclose(angles_of(rotation, chart, angles + 0.05), angles, atol=1e-9)
        np.testing.assert_allclose(
            rotation_of(quaternions(rotation[None])[0]), rotation, atol=1e-12
        )


@pytest.mark.parametrize("chart", ["zyx", "zxy"])
@pytest.mark.parametrize("middle", [0.5 * np.pi, -0.5 * np.pi])
def test_the_singular_rotation_keeps_its_outer_angle(chart, middle):
    angles = np.array([0.3, middle, -0.8])
    found = np.array(angles_of(product(angles, chart), chart, angles))
    np.testing.assert_allclose(product(found, chart), product(angles, chart), atol=1e-9)
    assert abs(found[0] - 0.3) < 1e-9


@pytest.mark.parametrize("chart", ["zyx", "zxy"])
def test_rates_give_the_angular_velocity_in_body_axes(chart):
    rng, h = np.random.default_rng(1), 1e-6
    for _ in range(50):
        angles, rates = rng.uniform(-3.0, 3.0, 3), rng.normal(size=3)
        turned = (
            product(angles, chart).T
            @ (product(angles + h * rates, chart) - product(angles - h * rates, chart))
            / (2 * h)
        )
        spin = np.array([turned[2, 1], turned[0, 2], turned[1, 0]])
        np.testing.assert_allclose(body_axes(angles, chart) @ rates, spin, atol=1e-6)


def test_unwrapped_through_two_turns_and_a_fall():
    """Yaw grows past 4π while the robot rolls over its side and its back; no coordinate may ever
    jump."""
    robot = octo.load("mammal")
    convention, near = Convention(robot), np.zeros(robot.nx)
    near[3:6] = (0.0, 0.0, 0.0)
    last = near.copy()
    for k in range(1, 2001):
        yaw, roll = 4.2 * np.pi * k / 2000, 2.2 * np.pi * k / 2000
        rotation = product((yaw, 0.2 * np.sin(0.01 * k), roll), "zyx")
        q = np.zeros(robot.nx + 1)
        # both signs are the same rotation
        q[3:7] = (-1.0 if k % 3 else 1.0) * quaternions(rotation[None])[0]
        x, before = convention.to_octo(q, np.zeros(robot.nx), 0.04, last)
        assert np.abs(x - last).max() < 0.05
        np.testing.assert_allclose(rotation_of_angles(x[3:6], "zyx"), rotation, atol=1e-9)
        np.testing.assert_allclose(before, x, atol=1e-12)
        last = x
    assert abs(last[3] - 4.2 * np.pi) < 1e-6 and abs(last[5] - 2.2 * np.pi) < 1e-6


@pytest.mark.parametrize("name", ["mujoco", "pinocchio"])
def test_there_and_back(name):
    robot = octo.load("mammal")
    convention, rng, dt = Convention(robot, name), np.random.default_rng(2), 1e-6
    for _ in range(50):
        x, rate = rng.uniform(-1.2, 1.2, robot.nx), rng.normal(size=robot.nx)
        q, v = convention.from_octo(x, rate)
        again, before = convention.to_octo(q, v, dt, x + 0.1)
        np.testing.assert_allclose(again, x, atol=1e-9)
        np.testing.assert_allclose((again - before) / dt, rate, atol=1e-4)
        np.testing.assert_allclose(convention.tangent(x) @ v, rate, atol=1e-6)


def test_the_two_conventions_say_the_same_motion():
    robot, rng = octo.load("mammal"), np.random.default_rng(3)
    x, rate = rng.uniform(-1.0, 1.0, robot.nx), rng.normal(size=robot.nx)
    q, v = Convention(robot, "mujoco").from_octo(x, rate)
    p, w = Convention(robot, "pinocchio").from_octo(x, rate)
    rotation = body_poses(robot, x)[0][robot.base_body]
    np.testing.assert_allclose(p[[6, 3, 4, 5]], q[3:7], atol=1e-12)
    np.testing.assert_allclose(rotation @ w[:3], v[:3], atol=1e-12)
    np.testing.assert_allclose(w[3:], v[3:], atol=1e-12)
    for found, turned in zip((p, w), Convention(robot, "pinocchio").of_mujoco(q, v), strict=True):
        np.testing.assert_allclose(turned, found, atol=1e-12)
    assert Convention(robot).of_mujoco(q, v)[0] is q


def test_unknown_convention():
    with pytest.raises(UnknownNameError, match="convention"):
        Convention(octo.load("mammal"), "ros")
