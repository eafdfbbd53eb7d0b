"""A small robot with everything a cost can look at, a problem with every cost, and the derivative helper."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest

from octo import costs
from octo.model.character import Body, Character, ContactSphere, Joint, floating_base
from octo.problem.basis import Hermite
from octo.problem.compiled import CompiledProblem
from octo.problem.problem import Problem

STEPS, DT = 24, 0.05
BASES = {"nodes": "nodes", "hermite": Hermite(3)}
Y, Z = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])


@lru_cache
def _robot() -> Character:
    """A base with a leg of two links and a slide on top; its first sphere does not touch the terrain."""
    inertia = np.diag([0.02, 0.03, 0.025])
    hip = Joint("hip", "hinge", Y, lower=-1.0, upper=1.0, torque_limit=8.0)
    knee = Joint("knee", "hinge", Y, lower=-1.5, upper=0.2, torque_limit=6.0, armature=0.01)
    mast = Joint("mast", "slide", Z, lower=-0.1, upper=0.1, damping=0.5)
    bodies = (
        Body("base", -1, floating_base(), mass=2.0, inertia=inertia, com=np.array([0.02, 0.0, 0.01])),
        Body("thigh", 0, (hip,), np.array([0.0, 0.1, -0.05]), mass=0.5, inertia=0.2 * inertia, com=np.array([0, 0, -0.1])),
        Body("shank", 1, (knee,), np.array([0.0, 0.0, -0.2]), mass=0.3, inertia=0.1 * inertia, com=np.array([0, 0, -0.1])),
        Body("mast", 0, (mast,), np.array([0.0, 0.0, 0.1]), mass=0.2, inertia=0.1 * inertia),
    )
    places = (
        ("top", 3, (0.0, 0.0, 0.1)), ("foot", 2, (0.0, 0.0, -0.2)), ("front", 0, (0.2, 0.0, -0.42)),
        ("back", 0, (-0.2, 0.1, -0.39)),
    )  # fmt: skip
    spheres = tuple(ContactSphere(n, b, np.array(at), 0.03, touches_terrain=n != "top") for n, b, at in places)
    return Character("walker", bodies, spheres, pairs=((0, 1),))


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
        costs.BaseOrientation(roll_pitch_yaw=rows[:, 3:6], axes=(1.0, 0.5, 2.0)),
        costs.BaseHeight(height=0.3 + rows[:, 6]),
        costs.BaseAngularVelocity(velocity=(0.0, 0.2, 0.5), axes=(1.0, 0.2, 0.7), body="shank"),
        costs.PointPosition(body="shank", point=(0.0, 0.0, -0.2), target=rows[:, :3], axes=(1.0, 1.0, 0.0)),
        costs.PointVelocity(body="mast", point=(0.1, 0.0, 0.2), velocity=(0.2, 0.0, 0.0), weight=per_step),
        costs.Posture(reference=rows[:, :9], joints=(1.0, 0.5, 2.0)),
        costs.JointVelocity(velocity=rows[:, 3:6]),
        costs.JointAcceleration(weight=1e-3),
        costs.Effort(),
        costs.TorqueLimit(margin=0.02),
        costs.PoseTarget(target=rows[0, :9], coordinates=np.linspace(0.1, 1.0, 9)),
        costs.CustomCost(_custom, {"gain": 0.7}, steps="last"),
        costs.NeighbourCost(_neighbour, {"gain": 0.5 + rows[:, :1]}, weight=per_step),
        costs.Slip(length=0.03),
        costs.FootLift(height=0.01, contacts=("foot", "front")),
        costs.Clearance(length=0.05),
        costs.FrictionCone(mu=0.1, contacts=("foot",)),
        costs.LoadSharing(weight=per_step),
        costs.ForceRate(),
    ]


START = np.array([0.02, -0.01, 0.44, 0.1, 0.05, -0.04, 0.3, -0.4, 0.01])  # front and foot in the ground, back above


@lru_cache
def _compiled(basis: str, threads: int = 1, steps: int = STEPS) -> CompiledProblem:
    problem = Problem(
        _robot(), steps=steps, dt=DT, costs=_every_cost(steps), basis=BASES[basis], x0=START, v0=0.2 * np.ones(9),
        parameters={"contact.onset": 0.004},
    )  # fmt: skip
    made = CompiledProblem([problem, problem.replace(x0=START + 0.03, v0=None)], threads)
    made.evaluate(_wiggle(made))  # loads the native code, so that problems made like this one share it
    return made


@pytest.fixture
def robot() -> Character:
    return _robot()


@pytest.fixture
def compiled() -> Callable[..., CompiledProblem]:
    """Two problems with every cost, native code where there is a compiler."""
    return _compiled


def _wiggle(problem: CompiledProblem, seed: int = 0) -> np.ndarray:
    """(batch, K, nc) unknowns of a motion close to the ground that starts at the start."""
    random = np.random.default_rng(seed)
    times = np.linspace(0.0, 1.0, problem.steps + 2)[:, None]
    waves = sum(np.sin((k + 1) * times) * random.uniform(-0.06, 0.06, (problem.batch, 1, problem.n)) for k in range(4))
    return problem.unknowns(problem.start[:, None] + waves)


@pytest.fixture
def every_cost() -> Callable[..., list[costs.Cost]]:
    return _every_cost


@pytest.fixture
def wiggle() -> Callable[..., np.ndarray]:
    return _wiggle


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
