"""A problem with every cost, and the derivative helper."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial

import numpy as np
import pytest
from walker import BASES, START, walker, wiggle_near_ground

from octo import costs, native
from octo.model.character import Character
from octo.problem.compiled import CompiledProblem
from octo.problem.problem import Problem

STEPS, DT = 24, 0.05


def _custom(step, p):
    turned = step.x_next[4] * step.x[6] - p["gain"] * step.x_prev[7] ** 2
    return turned + 0.1 * step.u[0] * step.dt


def _neighbour(control, following, p):
    return p["gain"] * (following - control) + 0.3 * following[6] * control[:1]


def _every_cost(steps: int = STEPS) -> list[costs.Cost]:
    """One of each, references and weights of one number, of one row, and of one row per step."""
    rows = np.random.default_rng(3).uniform(-0.4, 0.4, (steps, 12))
    per_step = np.linspace(0.5, 1.5, steps)
    return [
        costs.CenterOfMassVelocity(velocity=rows[:, :3], weight=per_step),
        costs.CenterOfMassPosition(target=(0.3, 0.1, 0.4)),
        costs.CenterOfMassDisplacement(displacement=rows[:, 3:6], weight=per_step),
        costs.BaseOrientation(roll_pitch_yaw=rows[:, 3:6], axes=(1.0, 0.5, 2.0)),
        costs.BaseHeight(height=0.3 + rows[:, 6]),
        costs.BaseAngularVelocity(velocity=(0.0, 0.2, 0.5), axes=(1.0, 0.2, 0.7), body="shank"),
        costs.PointPosition(
            body="shank", point=(0.0, 0.0, -0.2), target=rows[:, :3], axes=(1.0, 1.0, 0.0)
        ),
        costs.PointVelocity(
            body="mast", point=(0.1, 0.0, 0.2), velocity=(0.2, 0.0, 0.0), weight=per_step
        ),
        costs.Posture(reference=rows[:, :9], joints=(1.0, 0.5, 2.0)),
        costs.JointVelocity(velocity=rows[:, 3:6]),
        costs.JointAcceleration(weight=1e-3),
        costs.Effort(),
        costs.JointPower(weight=1e-3),
        costs.Duration(weight=0.1),
        costs.TorqueLimit(margin=0.02),
        costs.Upright(body="shank"),
        costs.JointLimit(margin=0.3),
        costs.JointSpeedLimit(margin=0.1, otherwise=1.0),
        costs.PoseTarget(target=rows[0, :9], coordinates=np.linspace(0.1, 1.0, 9)),
        costs.CustomCost(_custom, {"gain": 0.7}, at="last"),
        costs.NeighbourCost(_neighbour, {"gain": 0.5 + rows[:, :1]}, weight=per_step),
        costs.Slip(length=0.03),
        costs.FootLift(height=0.01, contacts=("foot", "front")),
        costs.Clearance(length=0.05),
        costs.FrictionCone(mu=0.1, contacts=("foot",)),
        costs.LoadSharing(weight=per_step),
        costs.BodyLoad(contacts=("foot",)),
        costs.ForceRate(),
        costs.SlipPower(),
        costs.SwingClearance(height=0.08),
    ]


@lru_cache
def _compiled_with(
    flags: tuple[str, ...], basis: str, threads: int = 1, steps: int = STEPS
) -> CompiledProblem:
    del flags  # of the compiler: files have their own
    problem = Problem(
        walker(),
        steps=steps,
        dt=DT,
        costs=_every_cost(steps),
        basis=BASES[basis],
        x0=START,
        v0=0.2 * np.ones(9),
        parameters={"contact.onset": 0.004},
    )
    made = CompiledProblem([problem, problem.replace(x0=START + 0.03, v0=None)], threads)
    # loads the native code, so that problems made like this one share it
    made.evaluate(wiggle_near_ground(made))
    return made


@pytest.fixture
def robot() -> Character:
    return walker()


@pytest.fixture
def compiled() -> Callable[..., CompiledProblem]:
    """Two problems with every cost, native code where there is a compiler."""
    return partial(_compiled_with, native.FLAGS)


@pytest.fixture
def every_cost() -> Callable[..., list[costs.Cost]]:
    return _every_cost


@pytest.fixture
def wiggle() -> Callable[..., np.ndarray]:
    return wiggle_near_ground


def _remainder_slope(value: Callable, derivative: np.ndarray, sizes: np.ndarray) -> float:
    """Order of |f(h) − f(0) − h f'(0)| in h: 2 where the derivative is right, 1 where it is not."""
    start = value(0.0)
    left = np.array([np.linalg.norm(value(h) - start - h * derivative) for h in sizes])
    rounding = 1e-14 * max(float(np.linalg.norm(start)), 1e-300) * np.sqrt(np.size(start))
    if (left <= 10.0 * rounding).all():
        return np.inf  # the function is linear along this line
    return float(np.polyfit(np.log(sizes), np.log(np.maximum(left, 1e-300)), 1)[0])


@pytest.fixture
def remainder_slope() -> Callable[..., float]:
    return _remainder_slope
