"""A small quadruped and its controller, made once."""

from __future__ import annotations

import numpy as np
import pytest

import octo
from octo.mpc import Controller, VelocityCommand, walking_problem
from octo.plant import MujocoPlant


@pytest.fixture(scope="session")
def robot():
    return octo.load("mammal")


@pytest.fixture(scope="session")
def problem(robot):
    return walking_problem(robot, steps=20)


@pytest.fixture(scope="session")
def shared(problem):
    return Controller(problem, guide=VelocityCommand((0.0, 0.0)))


@pytest.fixture
def controller(shared):
    shared.reset()
    shared.budget = None
    return shared


@pytest.fixture
def plant(robot, problem):
    made = MujocoPlant(robot)
    made.reset_chart(problem.start)
    return made


@pytest.fixture
def stand(controller, plant):
    """Ticks of 10 ms from where the plant is; a list of commands."""

    def walk(ticks: int, first: int = 0):
        commands = []
        for k in range(first, first + ticks):
            t = 0.01 * k
            commands.append(controller.step(t, plant.q, plant.v))
            for j in range(5):
                plant.step(controller.command(t + 0.002 * j, plant.q, plant.v))
        return commands

    return walk


def inside(u: np.ndarray, limit: np.ndarray) -> bool:
    return bool(np.isfinite(u).all() and (np.abs(u) <= limit + 1e-12).all())
