"""As dt -> 0 along a smooth trajectory FD is what MuJoCo's inverse dynamics returns for the same
robot file."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import octo
from octo.dynamics.evaluate import RobotDynamics
from octo.model.character import Character
from octo.model.export_mjcf import mjcf_text
from octo.model.kinematics import axis_rotation, body_poses
from octo.model.load import load

mujoco = pytest.importorskip("mujoco")

LEVELS = 5
COARSEST = 8e-3  # s


def numbers(values: Any) -> str:
    return " ".join(f"{v:.12g}" for v in np.atleast_1d(values))


def random_joints(rng: np.random.Generator, body: int) -> str:
    """No, one or two hinges and slides with armature, damping, spring and reference."""
    text = ""
    for k in range(rng.choice([0, 1, 1, 2])):
        kind = rng.choice(["hinge", "hinge", "slide"])
        text += (
            f'<joint name="joint_{body}_{k}" type="{kind}" axis="{numbers(rng.normal(size=3))}"'
            f' pos="{numbers(rng.normal(0.0, 0.1, 3))}" ref="{rng.normal(0.0, 0.3):.6g}" '
            f'springref="{rng.normal(0.0, 0.3):.6g}"'
            f' armature="{rng.uniform(0.0, 0.1):.6g}" damping="{rng.uniform(0.0, 1.0):.6g}"'
            f' stiffness="{rng.uniform(0.0, 5.0):.6g}"/>'
        )
    return text


def random_inertial(rng: np.random.Generator) -> str:
    """Mass and inertia of a cloud of points: never against the triangle inequality."""
    points = rng.normal(0.0, 0.1, (10, 3))
    points -= points.mean(axis=0)
    second = rng.uniform(0.5, 2.0) * np.mean(points[:, :, None] * points[:, None, :], axis=0)
    inertia = np.trace(second) * np.eye(3) - second
    full = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return (
        f'<inertial pos="{numbers(rng.normal(0.0, 0.1, 3))}" '
        f'mass="{rng.uniform(0.5, 2.0):.6g}" fullinertia="{numbers(full)}"/>'
    )


def random_robot(seed: int, floating: bool) -> str:
    """MJCF of a random tree of six bodies without geoms."""
    rng = np.random.default_rng(seed)
    parents = [-1] + [int(rng.integers(0, b)) for b in range(1, 6)]
    children: dict[int, list[int]] = {
        b: [c for c in range(6) if parents[c] == b] for b in range(-1, 6)
    }

    def body(b: int) -> str:
        first = (
            '<joint name="first" type="hinge" axis="0 1 0"/>' if not floating else "<freejoint/>"
        )
        joints = first if b == 0 else random_joints(rng, b)
        place = f'pos="{numbers(rng.normal(0.0, 0.3, 3))}" quat="{numbers(rng.normal(size=4))}"'
        inside = joints + random_inertial(rng) + "".join(body(c) for c in children[b])
        return f'<body name="body_{b}" {place}>{inside}</body>'

    return f'<mujoco><compiler angle="radian"/><worldbody>{body(0)}</worldbody></mujoco>'


class Trajectory:
    """x(t) = center + amplitude sin(frequency t + phase), one sine a coordinate, rad and m."""

    def __init__(self, nx: int, seed: int):
        rng = np.random.default_rng(seed)
        self.center, self.amplitude = rng.normal(0.0, 0.3, nx), rng.uniform(0.2, 0.6, nx)
        self.frequency, self.phase = rng.uniform(1.0, 4.0, nx), rng.uniform(0.0, 6.0, nx)

    def __call__(self, t: float, order: int = 0) -> np.ndarray:
        """The ``order``-th derivative (nx,)."""
        wave = np.sin(self.frequency * t + self.phase + order * np.pi / 2.0)
        return self.amplitude * self.frequency**order * wave + (self.center if order == 0 else 0.0)


def base_rates(robot: Character, x: np.ndarray) -> np.ndarray:
    """B (6, 6): MuJoCo's velocity of a free joint (linear in the world, angular in the body) is B
    times the base's ẋ."""
    body, rates = robot.bodies[0], np.zeros((6, 6))
    rotation = np.asarray(body.rotation)
    columns = []
    for j, joint in enumerate(body.joints):
        columns.append(rotation @ joint.axis)
        if joint.kind == "hinge":
            rotation = rotation @ axis_rotation(joint.axis, x[j] - joint.reference)
    rates[:3, :3] = np.array(columns[:3]).T
    rates[3:, 3:] = rotation.T @ np.array(columns[3:]).T
    return rates


def rates_of(robot: Character, model: Any, x: np.ndarray) -> np.ndarray:
    """B (nv, nx): MuJoCo's q̇ from octo's ẋ."""
    rates = np.zeros((model.nv, robot.nx))
    if robot.base == "floating":
        rates[:6, :6] = base_rates(robot, x)
    for j, joint in enumerate(robot.joints):
        if robot.base == "fixed" or j >= 6:
            rates[model.joint(joint.name).dofadr[0], j] = 1.0
    return rates


def mujoco_inverse(robot: Character, model: Any, at: Trajectory, t: float) -> np.ndarray:
    """Generalised force (nx,) of MuJoCo's inverse dynamics at time t, in octo's coordinates."""
    data, x, v, a = mujoco.MjData(model), at(t), at(t, 1), at(t, 2)
    for j, joint in enumerate(robot.joints):
        if robot.base == "fixed" or j >= 6:
            data.qpos[model.joint(joint.name).qposadr[0]] = x[j]
    if robot.base == "floating":
        rotation, origin = body_poses(robot, x)
        data.qpos[:3] = origin[0]
        mujoco.mju_mat2Quat(data.qpos[3:7], rotation[0].ravel())
    small = 1e-5  # s
    rates = rates_of(robot, model, x)
    change = (rates_of(robot, model, at(t + small)) - rates_of(robot, model, at(t - small))) / (
        2.0 * small
    )
    data.qvel[:] = rates @ v
    data.qacc[:] = rates @ a + change @ v
    mujoco.mj_inverse(model, data)
    return rates.T @ data.qfrc_inverse


def discrete(dynamics: RobotDynamics, at: Trajectory, t: float) -> tuple[np.ndarray, np.ndarray]:
    """Time steps (LEVELS,) s, halved each time, and FD (LEVELS, nx) around t."""
    steps = COARSEST * 0.5 ** np.arange(LEVELS)
    nodes = np.array([[at(t - dt), at(t), at(t + dt)] for dt in steps])
    p = np.array([dynamics.layout.pack(dt=dt) for dt in steps])
    return steps, dynamics.evaluate(nodes, p)[0][:, 0]


def extrapolated(values: np.ndarray) -> np.ndarray:
    """Richardson's limit of values (LEVELS, nx) whose error is a power series in dt, which halves
    from row to row."""
    order = 1
    while len(values) > 1:
        values = (2.0**order * values[1:] - values[:-1]) / (2.0**order - 1.0)
        order += 1
    return values[0]


@pytest.mark.parametrize("floating", [False, True])
@pytest.mark.parametrize("seed", [0, 3])
def test_fd_converges_to_mujocos_inverse_dynamics(tmp_path: Path, seed: int, floating: bool):
    file = tmp_path / "robot.xml"
    file.write_text(random_robot(seed, floating))
    robot = load(file)
    assert robot.base == ("floating" if floating else "fixed")
    model = mujoco.MjModel.from_xml_path(str(file))
    dynamics, at, t = RobotDynamics(robot), Trajectory(robot.nx, seed), 0.3
    expected = mujoco_inverse(robot, model, at, t)
    _, found = discrete(dynamics, at, t)
    size = np.max(np.abs(expected))
    error = np.max(np.abs(found - expected), axis=1) / size
    np.testing.assert_allclose(error[-3:-1] / error[-2:], 2.0, rtol=0.05)  # first order
    np.testing.assert_allclose(extrapolated(found), expected, atol=1e-8 * size)


def test_a_robot_with_objects_converges_too(tmp_path: Path):
    """Several roots: objects are slides and hinges in the file that octo writes."""
    file = tmp_path / "robot.xml"
    file.write_text(random_robot(1, True))
    objects = [
        octo.objects.box((0.2, 0.3, 0.4), 1.5, (1.0, 0.0, 1.0)),
        octo.objects.ball(0.1, 0.4),
        octo.objects.door(mass=2.0, lower=-9.0, upper=9.0, damping=0.3),
    ]
    scene = octo.Scene(load(file), objects, contacts=[]).character
    robot = dataclasses.replace(scene, contacts=(), pairs=())
    assert robot.mass == pytest.approx(load(file).mass) and robot.nx == load(file).nx + 13
    model = mujoco.MjModel.from_xml_string(mjcf_text(robot))
    dynamics, at, t = RobotDynamics(robot), Trajectory(robot.nx, 1), 0.3
    expected = mujoco_inverse(robot, model, at, t)
    _, found = discrete(dynamics, at, t)
    size = np.max(np.abs(expected))
    error = np.max(np.abs(found - expected), axis=1) / size
    np.testing.assert_allclose(error[-3:-1] / error[-2:], 2.0, rtol=0.05)  # first order
    np.testing.assert_allclose(extrapolated(found), expected, atol=1e-8 * size)
