"""Uphill, and over a ground written by the user as a signed distance in CasADi. ``--short`` solves
one second instead of four."""

import sys

import casadi as ca
import numpy as np

import octo

SECONDS, DT = (1.0 if "--short" in sys.argv else 4.0), 0.025
SPEED, SLOPE = 0.4, np.deg2rad(8.0)


def waves(point, p):
    """Signed distance (m) of a ground that waves along x, to first order: (z − h(x))/|∇|."""
    height = p["height"] * ca.sin(2 * np.pi * point[0] / p["length"])
    slope = 2 * np.pi * p["height"] / p["length"] * ca.cos(2 * np.pi * point[0] / p["length"])
    return (point[2] - height) / ca.sqrt(1 + slope**2)


grounds = {
    "uphill": (octo.Plane(slope=SLOPE), (SPEED * np.cos(SLOPE), 0.0, SPEED * np.sin(SLOPE))),
    "waves": (octo.Terrain(waves, {"height": 0.02, "length": 1.0}), (SPEED, 0.0, 0.0)),
}
for name, (terrain, velocity) in grounds.items():
    problem = octo.Problem(
        octo.gallery.mammal(),
        steps=round(SECONDS / DT),
        dt=DT,
        terrain=terrain,
        costs=[octo.CenterOfMassVelocity(velocity), octo.Effort()],
    )
    solution = octo.solve(problem, progress=True)
    print(f"{name}: {solution}")
    octo.view(solution, f"{name}.html")
    travel = solution.com[-1] - solution.com[0]
    assert solution.violation <= 1e-3 * solution.weight
    assert np.linalg.norm(travel / SECONDS - velocity) < 0.1 * SPEED
