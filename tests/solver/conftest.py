"""The cart-pole, for the loop around the linear solvers."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
import pytest

import octo
from octo.solver.blocks import KKTBlocks
from tests.dense import kkt_matrix


@pytest.fixture
def split() -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    """Dense H (batch, K nc, K nc) and A (batch, K ma, K nc) of blocks."""

    def dense_parts(system: KKTBlocks) -> tuple[np.ndarray, np.ndarray]:
        matrix, variables = kkt_matrix(system), system.units * system.nc
        return matrix[:, :variables, :variables], matrix[:, variables:, :variables]

    return dense_parts


@lru_cache
def _cart_pole() -> octo.CustomDynamics:
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

    return octo.CustomDynamics(
        dynamics, nx=2, actuated=[0], parameters={"cart": 1.0, "pole": 0.2, "length": 0.5}
    )


def _balance(**changes: Any) -> octo.Problem:
    near = octo.CustomCost(lambda step, p: step.x_next, name="near")
    costs = [near, octo.Effort(weight=1e-3)]
    return octo.Problem(
        _cart_pole(),
        **{"steps": 40, "dt": 0.05, "x0": np.array([0.0, 0.1]), "costs": costs, **changes},
    )


def _swing_up(**changes: Any) -> octo.Problem:
    place = octo.CustomCost(lambda step, p: step.x_next[0], name="place")
    ends = {"x0": np.array([0.0, np.pi]), "x_end": np.zeros(2), "v_end": np.zeros(2)}
    return _balance(**{**ends, "costs": [octo.Effort(weight=1e-2), place], **changes})


@pytest.fixture
def cart_pole() -> octo.CustomDynamics:
    return _cart_pole()


@pytest.fixture
def balance() -> Callable[..., octo.Problem]:
    """A cart whose pole leans by 0.1 rad: hold it up for 2 s."""
    return _balance


@pytest.fixture
def swing_up() -> Callable[..., octo.Problem]:
    """From hanging to standing in 2 s: both ends are fixed."""
    return _swing_up


@pytest.fixture
def turning() -> np.ndarray:
    """(41, 2) a start for the swing-up: one that hangs still would never see the other side."""
    return np.linspace([0.0, np.pi], [0.0, 0.0], 41)
