"""Robots whose base does not float: an arm with a motor in every joint, and a cart with a pole that
has none."""

from __future__ import annotations

import numpy as np
import pytest

import octo
from octo.errors import ProblemError
from octo.mpc import CommandStatus, Controller, Push, VelocityCommand, run, walking_problem
from octo.plant import MujocoPlant, SimulatorPlant

ARM = """<mujoco model="arm"><worldbody><body name="stand" pos="0 0 0.5" euler="0 0 30">
  <geom type="box" size="0.1 0.1 0.1" mass="5"/>
  <body name="upper" pos="0 0 0.1"><joint name="yaw" axis="0 0 1"/><joint name="shoulder" axis="0
    1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 0.4" size="0.04" mass="2"/>
    <body name="lower" pos="0 0 0.4"><joint name="elbow" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.4" size="0.03"
        mass="1"/></body></body></body></worldbody>
  <actuator><motor joint="yaw" ctrlrange="-30 30"/><motor joint="shoulder" ctrlrange="-60 60"/>
    <motor joint="elbow" ctrlrange="-30 30"/></actuator></mujoco>"""
CART = """<mujoco model="cart"><worldbody><body name="cart" pos="0 0 1"><joint name="rail"
  type="slide" axis="1 0 0"/>
  <geom type="box" size="0.1 0.1 0.05" mass="1" contype="0" conaffinity="0"/>
  <body name="pole"><joint name="pin" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 0.5" size="0.02" mass="0.2" contype="0"
      conaffinity="0"/></body></body></worldbody>
  <actuator><motor joint="rail" ctrlrange="-20 20"/></actuator></mujoco>"""
GOAL = np.array([0.8, 0.6, -0.9])  # rad, of the arm


def loaded(tmp_path_factory, text, name):
    path = tmp_path_factory.mktemp("fixed") / f"{name}.xml"
    path.write_text(text)
    return octo.load(path)


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    robot = loaded(tmp_path_factory, ARM, "arm")
    costs = [
        octo.Posture(reference=GOAL, weight=10.0),
        octo.JointVelocity(weight=0.01),
        octo.Effort(weight=1e-4),
    ]
    return octo.Problem(robot, steps=20, dt=0.04, costs=costs, x0=np.zeros(3))


@pytest.fixture(scope="module")
def cart(tmp_path_factory):
    robot = loaded(tmp_path_factory, CART, "cart")
    costs = [octo.PoseTarget(target=np.zeros(2), at="all", weight=10.0), octo.Effort(weight=1e-3)]
    return octo.Problem(robot, steps=25, dt=0.04, costs=costs, x0=np.array([0.0, 0.3]))


def plant_of(kind, problem):
    plant = kind(problem.character, timestep=0.002)
    plant.reset_chart(problem.start)
    return plant


@pytest.mark.parametrize("kind", [MujocoPlant, SimulatorPlant])
def test_an_arm_goes_where_it_shall(arm, kind):
    log = run(Controller(arm), plant_of(kind, arm), 3.0)
    assert log.statuses == ["solved"] * 300
    np.testing.assert_allclose(log.x[-1], GOAL, atol=1e-3)
    assert (np.abs(log.u) <= arm.character.torque_limit).all()
    assert log.falls == [] and log.solution().steps == 149 and "feet" not in str(log)


@pytest.mark.parametrize("kind", [MujocoPlant, SimulatorPlant])
def test_a_pole_is_balanced_by_its_cart(cart, kind):
    """Upright from 0.3 rad on, and the cart back where it was: nothing but planning ahead does
    that."""
    log = run(Controller(cart), plant_of(kind, cart), 5.0)
    assert np.abs(log.x[:, 0]).max() > 0.05
    np.testing.assert_allclose(log.x[-50:], 0.0, atol=0.01)
    assert log.solution().steps == 249


@pytest.mark.timed
def test_noise_delay_and_real_time(arm):
    log = run(Controller(arm), plant_of(MujocoPlant, arm), 1.5, noise=1.0, delay=1, realtime=True)
    np.testing.assert_allclose(log.x[-1], GOAL, atol=0.05)


@pytest.mark.parametrize("name", ["arm", "cart"])
def test_a_command_has_the_plan_s_next_state_and_its_gains(name, request):
    """K against differences of the torque of FD where x_1 answers by the solver's own gain; x, v
    one tick on in the plan."""
    problem = request.getfixturevalue(name)
    controller, robot = Controller(problem), problem.character
    plant = plant_of(MujocoPlant, problem)
    for k in range(20):
        command = controller.step(0.01 * k, plant.q, plant.v)
        for j in range(5):
            plant.step(controller.command(0.01 * k + 0.002 * j, plant.q, plant.v))
    x, rate, u = controller.plan.at(0.20)
    np.testing.assert_allclose(command.x, x, atol=1e-12)
    np.testing.assert_allclose(command.v, rate, atol=1e-12)
    assert command.status is CommandStatus.SOLVED and command.K.shape == (robot.nu, 2 * robot.nx)
    gain, nodes = controller._gain.copy(), controller._gain_nodes.copy()

    def torque(place, speed):
        before = place - controller.dt * speed
        after = nodes[2] + gain @ np.concatenate([place - nodes[1], before - nodes[0]])
        fd = problem.dynamics.evaluate(
            np.stack([before, place, after])[None], controller.compiled.p
        )[0]
        return fd[0, 0, robot.actuated]

    h, state = 1e-6, np.concatenate([nodes[1], (nodes[1] - nodes[0]) / controller.dt])
    for column, error in enumerate(h * np.eye(2 * robot.nx)):
        up, down = (torque(*np.split(state + side * error, 2)) for side in (1.0, -1.0))
        np.testing.assert_allclose(
            command.K[:, column], (up - down) / (2 * h), atol=1e-4 * np.abs(command.K).max()
        )


def test_both_conventions_are_the_coordinates_themselves(arm):
    one, two = Controller(arm), Controller(arm, convention="pinocchio")
    q, v = np.array([0.1, -0.2, 0.3]), np.array([0.5, 0.6, -0.7])
    np.testing.assert_array_equal(one.step(0.0, q, v).u, two.step(0.0, q, v).u)
    x, before = one.convention.to_octo(q, v, 0.04, np.zeros(3))
    np.testing.assert_array_equal(x, q)
    np.testing.assert_allclose((x - before) / 0.04, v)


def test_a_fixed_base_does_not_fall_nor_is_it_pushed(cart):
    plant = plant_of(MujocoPlant, cart)
    with pytest.raises(
        ProblemError, match="push needs a floating base: the base of 'cart' is fixed"
    ):
        run(Controller(cart), plant, 1.0, push=Push(1.0, start=0.1))


def test_walking_needs_a_floating_base(arm):
    with pytest.raises(ProblemError, match="floating"):
        walking_problem(arm.character)
    with pytest.raises(octo.errors.UnknownNameError, match="CenterOfMassVelocity"):
        Controller(arm, guide=VelocityCommand())
