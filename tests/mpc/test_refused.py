"""Whatever is given wrong is refused in one line that names the field."""

from __future__ import annotations

import numpy as np
import pytest

import octo
from octo.errors import OctoError
from octo.mpc import Controller, Push, VelocityCommand, animate, run, walking_problem
from octo.plant import MujocoPlant, SimulatorPlant

NAN = float("nan")


def refused(call, said):
    with pytest.raises(OctoError) as caught:
        call()
    assert str(caught.value).startswith(said) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"stiffness": -5.0}, "stiffness is -5.0, must not be negative"),
        ({"stiffness": [1.0, 2.0]}, "stiffness has shape (2,), expected a number or (12,)"),
        ({"damping": "a"}, "damping is 'a', must be numbers"),
        ({"damping": NAN}, "damping is not finite"),
        ({"guide": 3}, "guide is 3, must be a function"),
        ({"sigma": -1.0}, "sigma is -1.0"),
        ({"iterations": 1.5}, "iterations is 1.5"),
        ({"device": 3}, "device 3 is not known"),
    ],
)
def test_controller(problem, robot, values, said):
    refused(lambda: Controller(problem, **values), said)
    refused(lambda: Controller(robot), "problem is a Character, must be an octo.Problem")


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"pose": [0.0, 0.0]}, "pose has shape (2,), expected (18,)"),
        ({"pose": [NAN] * 18}, "pose is not finite at index 0"),
        ({"friction": 0.0}, "friction is 0.0, must be positive"),
        ({"friction": "a"}, "friction is 'a'"),
        ({"steps": 0}, "steps is 0"),
        ({"dt": -1.0}, "dt is -1.0 s"),
        ({"costs": []}, "costs is chosen by walking_problem"),
        ({"x0": np.zeros(18)}, "x0 is chosen by walking_problem"),
    ],
)
def test_walking_problem(robot, values, said):
    refused(lambda: walking_problem(robot, **values), said)
    refused(
        lambda: walking_problem("go2"), "robot is 'go2', must be a Character: what octo.load gives"
    )


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"velocity": 0.3}, "velocity has shape (), expected (2,)"),
        ({"velocity": (0.3,)}, "velocity has shape (1,)"),
        ({"velocity": ("a", 0.0)}, "velocity is ('a', 0.0), must be numbers"),
        ({"yaw_rate": NAN}, "yaw_rate is not finite"),
        ({"acceleration": 1.0}, "acceleration has shape ()"),
        ({"acceleration": (1.0, -1.0)}, "acceleration is -1.0 rad/s², must be positive"),
    ],
)
def test_velocity_command(values, said):
    refused(lambda: VelocityCommand(**values), said)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"push": (1, 2, 3)}, "push is 'tuple', must be a Push"),
        ({"each": 3}, "each is 'int', must be a function"),
        ({"seed": -1}, "seed is -1"),
        ({"seed": "a"}, "seed is 'a'"),
        ({"delay": 1.5}, "delay is 1.5"),
        ({"noise": "a"}, "noise is 'a'"),
    ],
)
def test_run(controller, plant, problem, values, said):
    refused(lambda: run(controller, plant, 1.0, **values), said)
    refused(lambda: run(controller, None, 1.0), "plant is 'NoneType', must be a MujocoPlant")
    refused(lambda: run(problem, plant, 1.0), "controller is 'Problem', must be a Controller")


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"force": NAN}, "push.force is not finite"),
        ({"force": 1.0, "seconds": -0.2}, "push.seconds is -0.2 s, must be positive"),
        ({"force": 1.0, "degrees": "left"}, "push.degrees is 'left', must be numbers"),
    ],
)
def test_push(values, said):
    refused(lambda: Push(**values), said)


def test_reset_and_warm_start(controller, plant):
    refused(lambda: controller.reset("a"), "q is 'a', must be numbers")
    refused(lambda: controller.reset(plant.q, plant.v[:3]), "v has shape (3,), expected (18,)")
    refused(lambda: controller.reset(plant.q, plant.v, "now"), "t is 'now', must be numbers")
    refused(lambda: controller.reset(plant.q, plant.v, NAN), "t is not finite")
    refused(lambda: controller.warm_start(None), "solution is None, must be a Solution")
    refused(lambda: animate(controller, 1.0), "problem is a Controller, must be an octo.Problem")


@pytest.mark.parametrize("kind", [MujocoPlant, SimulatorPlant])
def test_plants(robot, kind):
    refused(lambda: kind("go2"), "character is 'go2', must be a Character")
    plant = kind(robot)
    refused(lambda: plant.step(np.full(robot.nu, NAN)), "u is not finite at index 0")
    refused(lambda: plant.step([1.0, 2.0]), "u has shape (2,), expected (12,)")
    refused(lambda: plant.step("a"), "u is 'a', must be numbers")


def test_the_ground_and_gravity_of_mujoco(robot):
    refused(lambda: MujocoPlant(robot, gravity=9.81), "gravity has shape (), expected (3,)")
    refused(
        lambda: MujocoPlant(robot, terrain=octo.Terrain(lambda point, p: point[2])),
        "terrain is a Terrain, must be a Plane",
    )
