"""Small problems that the reference is compared on: a robot with contact, and user-written
dynamics."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import casadi as ca
import numpy as np
import pytest

import octo
from octo import costs
from octo.dynamics.evaluate import RobotDynamics
from octo.problem.basis import Hermite
from octo.problem.problem import Problem


def _fall(x_next: ca.SX, x: ca.SX, x_prev: ca.SX, p: dict[str, ca.SX]) -> ca.SX:
    """(2,) N and N m of a cart's place and its pole's angle, 0 up."""

    def places(q: ca.SX) -> ca.SX:
        return ca.vertcat(q[0], q[0] + p["length"] * ca.sin(q[1]), p["length"] * ca.cos(q[1]))

    mass = ca.vertcat(p["cart"], p["pole"], p["pole"])
    acceleration = (places(x_next) - 2 * places(x) + places(x_prev)) / p["dt"] ** 2 + ca.vertcat(
        0, 0, 9.81
    )
    return ca.jtimes(places(x_next), x_next, mass * acceleration, True)


def _cart_pole(**changes: object) -> Problem:
    """The pole balanced from 0.1 rad: one optimum."""
    dynamics = octo.CustomDynamics(
        _fall, nx=2, actuated=[0], parameters={"cart": 1.0, "pole": 0.2, "length": 0.5}
    )
    near = costs.CustomCost(
        lambda step, p: step.x_next - p["target"], {"target": np.zeros(2)}, name="near"
    )
    terms = [near, costs.Effort(weight=1e-3)]
    return Problem(dynamics, steps=40, dt=0.05, x0=np.array([0.0, 0.1]), costs=terms).replace(
        **changes
    )


@cache
def _dynamics(name: str) -> RobotDynamics:
    """Of a robot of the gallery: what is derived of it is derived once."""
    return RobotDynamics(octo.gallery.CHARACTERS[name]())


def _robot(
    name: str, steps: int, terms: list[costs.Cost], basis: str | Hermite = "nodes"
) -> Problem:
    return Problem(_dynamics(name), steps=steps, dt=0.05, costs=terms, basis=basis)


def _cycle(
    name: str, steps: int, cycle: octo.Cycle, terms: list[costs.Cost] | None = None
) -> Problem:
    """With the natural terms, or others."""
    problem = Problem(_dynamics(name), steps=steps, costs=[costs.Effort()], cycle=cycle)
    return problem.replace(costs=costs.natural(length=problem.length) if terms is None else terms)


@pytest.fixture(scope="session")
def cycle() -> Callable[..., Problem]:
    return _cycle


@pytest.fixture(scope="session")
def cart_pole() -> Callable[..., Problem]:
    return _cart_pole


@pytest.fixture(scope="session")
def robot() -> Callable[..., Problem]:
    return _robot
