"""Plans over shapes: what they are replayed on, and where their feet may push."""

from __future__ import annotations

import numpy as np
import pytest

import octo
from octo import World, shapes
from octo.cli import simulate
from octo.dynamics.simulate import Motion
from octo.plant import MujocoPlant
from octo.problem.problem import Problem
from octo.replay.control import Controller, Gains
from octo.replay.plan import Plan, ground_of
from octo.replay.run import replay
from octo.result.solution import Solution

STEPS, DT = 20, 0.025
LEVEL = World([shapes.Ground(), shapes.Box((0.5, 1.0, 0.2), position=(1.0, 0.0, 0.0))])


@pytest.fixture(scope="module")
def standing() -> Solution:
    """On a world that is level where the robot is, with the forces of standing."""
    problem = Problem(
        octo.gallery.mammal(), steps=STEPS, dt=DT, costs=[octo.Effort()], terrain=LEVEL
    )
    x = np.repeat(problem.start[None], STEPS + 2, axis=0)
    still = Motion(x, np.zeros((STEPS, 12)), DT, np.ones(STEPS, dtype=bool), np.zeros(1))
    return simulate.measured_motion(problem, still, 0.1, 0.2)


def test_a_plan_is_replayed_on_its_world(standing: Solution) -> None:
    assert ground_of(standing) is standing.world is LEVEL
    done = replay(standing)
    assert not done.starts[0].fell
    assert done.motion.world is LEVEL
    np.testing.assert_allclose(done.motion.contact_normal[..., 2], 1.0, atol=1e-9)


def test_on_level_shapes_feet_push_as_on_a_plane(standing: Solution) -> None:
    robot = standing.character
    assert robot is not None
    made = []
    for ground in (LEVEL, octo.Plane()):
        plant = MujocoPlant(robot, terrain=ground)
        plant.reset_chart(standing.x[1])
        gains = Gains.of(standing, friction=0.8)
        controller = Controller(Plan.of(standing, 0.005), gains, plant, standing.length)
        made.append(controller.spread(0, np.array([2.0, 1.0, 3.0, 0.2, -0.3, 0.1])))
    np.testing.assert_allclose(*made, atol=1e-9)


def test_on_a_side_of_a_box_the_pyramid_is_around_its_normal(standing: Solution) -> None:
    robot = standing.character
    assert robot is not None
    plant = MujocoPlant(robot, terrain=World([shapes.Box((2.0, 2.0, 2.0))]))
    gains = Gains.of(standing, friction=0.5)
    controller = Controller(Plan.of(standing, 0.005), gains, plant, standing.length)
    places = np.array([[0.2, 1.02, 0.1], [0.1, 0.2, 1.02]])
    edges = controller._edges(places - plant.base_place)
    assert edges.shape == (6, 8)
    for k, normal in enumerate(np.eye(3)[[1, 2]]):
        own = edges[3 * k : 3 * k + 3, 4 * k : 4 * k + 4]
        np.testing.assert_allclose(normal @ own, 1.0, atol=1e-9)
        across = own - normal[:, None]
        np.testing.assert_allclose(
            np.linalg.norm(across, axis=0), controller.gains.friction, atol=1e-9
        )
