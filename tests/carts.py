"""Small problems of one structure that differ in what is asked."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

import octo


def hanging(x_next, x, x_prev, p):
    """N m and N: a pendulum on a cart, of which the pendulum has no motor."""
    a, way = (x_next - 2.0 * x + x_prev) / p["dt"] ** 2, x_next[1]
    pole = ca.cos(way) * a[0] + p["length"] * a[1] + 9.81 * ca.sin(way)
    return ca.vertcat(1.3 * a[0] + 0.3 * p["length"] * ca.cos(way) * a[1], 0.15 * pole)


def off(step, p):
    """m and rad, of the cart and the pendulum."""
    return ca.vertcat(step.x_next[0] - p["place"], step.x_next[1])


@lru_cache
def cart() -> octo.CustomDynamics:
    return octo.CustomDynamics(hanging, nx=2, actuated=[0], parameters={"length": 0.5})


def way(place: float, **fields: object) -> octo.Problem:
    """To a place (m), the pendulum at rest."""
    term = octo.CustomCost(off, {"place": np.array([place])}, name="Place")
    costs = [term, octo.Effort(weight=0.01, reference=1.0)]
    usual = {"steps": 30, "dt": 0.05, "costs": costs, "x0": np.zeros(2)}
    return octo.Problem(cart(), **{**usual, **fields})


def ways(count: int = 5, **fields: object) -> list[octo.Problem]:
    """To places from 0.2 to 1 m."""
    return [way(place, **fields) for place in np.linspace(0.2, 1.0, count).tolist()]
