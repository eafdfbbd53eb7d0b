"""Torques that a controller may send."""

from __future__ import annotations

import numpy as np

from octo.model.quantities import Array
from octo.problem.at import shares
from octo.problem.limits import TorqueLimits
from octo.problem.problem import Problem


def torque_bounds(problem: Problem) -> Array:
    """(nu,) N m or N, infinite where there is none: those of the robot, and of the problem's hard
    torque limits at its first step."""
    robot = problem.character
    assert robot is not None
    least = robot.torque_limit
    for term in problem.terms:
        if isinstance(term, TorqueLimits) and _first(term, problem):
            least = np.minimum(least, term.limits(problem.setting))
    return least


def _first(term: TorqueLimits, problem: Problem) -> bool:
    """Whether it acts at the first step."""
    at = shares(f"{term.label}.at", term.at, int(problem.steps), problem.dt)
    return bool(at[0] > 0.0)
