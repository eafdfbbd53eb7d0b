"""Limits that a controller keeps without an iteration: of the torques it sends, and of the friction
it plans with."""

from __future__ import annotations

import numpy as np

from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.laws import Coulomb
from octo.model.quantities import Array
from octo.problem.at import always, shares
from octo.problem.limits import FrictionCones, TorqueLimits
from octo.problem.problem import Problem

MU = "contact.mu"  # of the parameters of FD


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


def held_by_the_ground(problem: Problem) -> tuple[Problem, float]:
    """The problem without its friction cones, on ground that has no more friction than they allow,
    and how much that is.

    Coulomb's law pulls no more than μ times the load, so the forces of every plan are inside, at
    any iteration. Rows of friction bend too much for one: of a mammal's they left 5 % of the forces
    outside a cone of 0.3, where 8 % are without. Another law, or a cone of some steps, keeps them.
    """
    held = [
        term for term in problem.constraints if isinstance(term, FrictionCones) and always(term.at)
    ]
    law = problem.dynamics.law if isinstance(problem.dynamics, RobotDynamics) else None
    if not held or not isinstance(getattr(law, "friction", None), Coulomb):
        return problem, np.inf
    for term in held:
        term.bounds(problem.setting)  # refuses a mu that is none
    most = min(float(term.mu) for term in held)
    least = min(problem.values[MU], most)
    rest = [term for term in problem.constraints if term not in held]
    return problem.replace(constraints=rest, parameters={**problem.parameters, MU: least}), most


def _first(term: TorqueLimits, problem: Problem) -> bool:
    """Whether it acts at the first step."""
    at = shares(f"{term.label}.at", term.at, int(problem.steps), problem.dt)
    return bool(at[0] > 0.0)
