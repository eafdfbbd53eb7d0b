"""Motions that cost little: a mammal that stands, its knees bent a little."""

from collections.abc import Mapping

import numpy as np

import octo

DT = 0.025
GROUND = {"contact.w_perp": 3e4, "contact.w_par": 3e5, "contact.onset": 0.01}  # as Eq. 6


def standing(
    depth: float,
    away: tuple[float, float, float],
    steps: int = 30,
    law: Mapping[str, float] = GROUND,
) -> octo.Solution:
    """A mammal that stands still, its knees bent by ``depth`` rad, at x, y and yaw ``away``, on
    ground of that law."""
    robot = octo.load("mammal")
    base = robot.base_coordinate
    pose = np.array(octo.Problem(robot, steps=3, dt=DT, costs=[octo.Effort()]).start)
    knees = [k for k, joint in enumerate(robot.joints) if joint.name.endswith("knee")]
    pose[knees] -= depth
    rest = octo.Problem(robot, steps=steps, dt=DT, costs=[octo.Effort()], pose=pose, parameters=law)
    x = rest.start.copy()
    x[[base, base + 1, base + 3]] += away
    still = octo.PoseTarget(target=x, at="all")
    problem = rest.replace(costs=[still], x0=x, v0=0.0 * x, pose=None)
    found = octo.solve(problem, start=np.tile(x, (steps + 1, 1)), passes=1, device="cpu")
    assert found.converged
    return found
