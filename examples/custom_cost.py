"""A term of one's own: the trunk squats to a beat; then deeper, without compiling anything again.

A term says its residual for one step in CasADi; its references are numbers, constant or one row a
step, that may depend on the start. ``--short`` solves one second instead of four.
"""

import sys
from dataclasses import dataclass

import numpy as np

import octo

SECONDS, DT = (1.0 if "--short" in sys.argv else 4.0), 0.025


@dataclass(frozen=True, eq=False)
class Squat(octo.Cost):
    """Height (m) of the trunk against its height at the start less ``depth``, once a second."""

    depth: float = 0.04

    def references(self, setting):
        times = setting.dt * np.arange(1, setting.steps + 1)
        start = setting.point("trunk", np.zeros(3))[2]
        return {"height": (start - self.depth * 0.5 * (1.0 - np.cos(2.0 * np.pi * times)))[:, None]}

    def scale(self, setting):
        return self.depth**2

    def residual(self, step, p):
        return step.pose("trunk")[1][2] - p["height"]


def squats(depth):
    return [Squat(depth=depth), octo.CenterOfMassVelocity(weight=0.01), octo.Effort(weight=0.002)]


problem = octo.Problem(octo.gallery.mammal(), steps=round(SECONDS / DT), dt=DT, costs=squats(0.04))
solution = octo.solve(problem, progress=True)
deeper = octo.solve(problem.replace(costs=squats(0.06)), progress=True)

for depth, found in ((0.04, solution), (0.06, deeper)):
    travel = np.ptp(found.x[1:, 2])
    print(found)
    print(f"asked for {1e3 * depth:.0f} mm, the trunk goes {1e3 * travel:.0f} mm up and down")
    assert found.converged and abs(travel - depth) < 0.2 * depth
