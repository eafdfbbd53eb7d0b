"""Small problems with everything in them, and the CPU in the place of a GPU."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import casadi as ca
import numpy as np
import pytest
from walker import BASES, START, walker, wiggle_near_ground

import octo
from octo.model.mirror import Mirror
from octo.problem.compiled import CompiledProblem
from tests import emulator
from tests.emulator import EmulatedDevice

STEPS, DT = 12, 0.05


@pytest.fixture(autouse=True)
def needs_compiler():
    if emulator.compiler() is None:
        pytest.skip("no C++ compiler")


@lru_cache
def _device(threads: int = 1, crews: int = 1) -> EmulatedDevice:
    return EmulatedDevice(threads, crews)


@pytest.fixture
def device() -> Callable[..., EmulatedDevice]:
    return _device


def _costs(steps: int) -> list[octo.costs.Cost]:
    """Terms of every kind: over the state, the torques, contacts; references that change from step
    to step."""
    rows = np.random.default_rng(3).uniform(-0.4, 0.4, (steps, 12))
    c = octo.costs

    def residual(step, p):
        return step.x_next[4] * step.x[6] - p["gain"] * step.x_prev[7] ** 2 + 0.1 * step.u[0]

    return [
        c.CenterOfMassVelocity(velocity=rows[:, :3], weight=np.linspace(0.5, 1.5, steps)),
        c.BaseOrientation(roll_pitch_yaw=rows[:, 3:6], axes=(1.0, 0.5, 2.0)),
        c.Posture(reference=rows[:, :9], joints=(1.0, 0.5, 2.0)),
        c.JointAcceleration(weight=1e-3),
        c.Effort(),
        c.CustomCost(residual, {"gain": 0.7}, at="last"),
        c.Slip(length=0.03),
        c.FootLift(height=0.01, contacts=("foot", "front")),
        c.FrictionCone(mu=0.1, contacts=("foot",)),
        c.ForceRate(),
        # a cycle has one: texts are shared
        c.PoseTarget(target=START, coordinates=np.linspace(0.5, 1.5, 9), name="Anchor"),
    ]


@lru_cache
def _compiled(basis: str, end: bool = False) -> CompiledProblem:
    problem = octo.Problem(
        walker(),
        steps=STEPS,
        dt=DT,
        costs=_costs(STEPS),
        basis=BASES[basis],
        x0=START,
        v0=0.2 * np.ones(9),
        parameters={"contact.onset": 0.004},
        x_end=START + 0.01 if end else None,
    )
    return CompiledProblem([problem, problem.replace(x0=START + 0.03, v0=None)])


@pytest.fixture
def compiled() -> Callable[..., CompiledProblem]:
    """Two problems with terms of every kind."""
    return _compiled


MIRROR = Mirror(
    np.diag([1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0, 1.0, -1.0]),
    np.linspace(0.0, 0.02, 9),
    {},
    np.arange(4),
)


@lru_cache
def _cycle(kind: str) -> CompiledProblem:
    """Two half strides of 8 or 9 steps with a mirror that the robot does not have, or three strides
    that turn."""
    if kind == "turning":
        steps = 7
        cycles = [
            octo.Cycle(speed=0.4, period=0.35, mirror=False, turn=turn) for turn in (0.4, -0.9, 0.0)
        ]
    else:
        steps = {"even": 8, "odd": 9}[kind]
        cycles = [
            octo.Cycle(speed=speed, period=0.1 * steps, mirror=MIRROR) for speed in (0.4, -0.2)
        ]
    given = {"steps": steps, "costs": _costs(steps), "parameters": {"contact.onset": 0.004}}
    return CompiledProblem([octo.Problem(walker(), cycle=cycle, **given) for cycle in cycles])


@pytest.fixture
def cycle() -> Callable[..., CompiledProblem]:
    """Two or three cycles, of the kinds "even", "odd" and "turning", with terms of every kind."""
    return _cycle


@lru_cache
def _between(end: bool = False) -> CompiledProblem:
    """Two terms over neighbouring controls, one linear, one not even finite where it has no
    weight."""

    def turning(control, following, p):
        return ca.vertcat(
            ca.sin(following[6]) * control[15] - p["gain"], control[7] * following[16] / p["on"]
        )

    first = _compiled("hermite", end).problems[0]
    on = np.repeat([1.0, 0.0, 2.0, 1.0], STEPS // 4)
    rate = octo.costs.NeighbourCost(
        lambda control, following, p: following[9:] - control[9:], name="rate", weight=0.3
    )
    values = {"gain": np.linspace(0.1, 0.4, STEPS)[:, None], "on": on[:, None]}
    bend = octo.costs.NeighbourCost(turning, values, weight=on, name="bend")
    problem = first.replace(costs=[rate, octo.costs.Slip(length=0.03), bend, octo.costs.Effort()])
    return CompiledProblem([problem, problem.replace(x0=problem.start + 0.03, v0=None)])


@pytest.fixture
def between_controls() -> Callable[..., CompiledProblem]:
    """Two problems with terms over neighbouring Hermite controls."""
    return _between


@pytest.fixture
def wiggle() -> Callable[..., np.ndarray]:
    return wiggle_near_ground


@lru_cache
def _no_multiple_of_a_tile() -> CompiledProblem:
    """Four coordinates: the last tile of three has one of them."""
    dynamics = octo.CustomDynamics(
        lambda x_next, x, x_prev, p: ca.sin(x_next) - 2.0 * x + x_prev, 4, [0], {}
    )
    return CompiledProblem(
        [octo.Problem(dynamics, steps=9, dt=0.05, x0=np.zeros(4), costs=[octo.costs.Effort()])]
    )


@lru_cache
def _swing_up() -> tuple[CompiledProblem, np.ndarray]:
    def dynamics(x_next, x, x_prev, p):
        def places(q):
            return ca.vertcat(
                q[0], 0.0, q[0] + p["length"] * ca.sin(q[1]), p["length"] * ca.cos(q[1])
            )

        mass = ca.vertcat(p["cart"], p["cart"], p["pole"], p["pole"])
        acceleration = (places(x_next) - 2.0 * places(x) + places(x_prev)) / p["dt"] ** 2
        return ca.jtimes(
            places(x_next), x_next, mass * (acceleration + ca.vertcat(0.0, 9.81, 0.0, 9.81)), True
        )

    parameters = {"cart": 1.0, "pole": 0.2, "length": 0.5}
    cart_pole = octo.CustomDynamics(dynamics, nx=2, actuated=[0], parameters=parameters)
    place = octo.costs.CustomCost(lambda step, p: step.x_next[0], name="place")
    problem = octo.Problem(
        cart_pole,
        steps=40,
        dt=0.05,
        x0=np.array([0.0, np.pi]),
        x_end=np.zeros(2),
        v_end=np.zeros(2),
        costs=[octo.costs.Effort(weight=1e-2), place],
    )
    turning = np.linspace([0.0, np.pi], [0.0, 0.0], 41)
    paths = [
        turning * (1.0 + 0.1 * k * np.sin(np.linspace(0.0, np.pi, 41)))[:, None] for k in range(3)
    ]
    return CompiledProblem([problem] * 3), np.stack(
        [np.concatenate([path[:1], path]) for path in paths]
    )


@pytest.fixture
def swing_up_batch() -> tuple[CompiledProblem, np.ndarray]:
    """A cart-pole that swings up between two fixed states, from three starts (batch, N+2, n)."""
    return _swing_up()
