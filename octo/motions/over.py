"""A motion over a world of shapes: the one on level ground, laid over the world as a first guess.

No stride repeats itself on stairs. So the motion is found where the robot stands, on level ground;
its feet are given footholds on the world (:mod:`octo.motions.footholds`), and the whole is solved
from there as one problem from rest to rest. Nothing of the guess is asked for: footholds, their
times and the way of the body are the solver's.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from octo.errors import StaticPoseError
from octo.model.character import Character
from octo.model.feet import touching
from octo.model.kinematics import sphere_centers
from octo.model.terrain import Plane, World
from octo.motions.budget import Budget, Interrupted, going_on
from octo.motions.footholds import Laid
from octo.motions.journey import Journey
from octo.motions.path import ground_law
from octo.motions.transitions import SUMS
from octo.problem.problem import Problem
from octo.result.solution import Solution
from octo.solve import solve
from octo.solver.status import Status

LOG = logging.getLogger("octo")

# before what must hold does: limits are priced, and the motion need not converge
ITERATIONS = 300


def over(
    journey: Journey, world: World, budget: Budget, on_level: Callable[[Journey], Solution]
) -> Solution:
    """The motion of a journey over a world.

    Parameters
    ----------
    on_level: gives the motion of the same journey on level ground, its limits priced.
    """
    level = level_under(journey, world)
    flat = on_level(replace(journey.priced, terrain=Plane(height=level)))
    if flat.status is Status.INTERRUPTED:
        return flat
    warn_of_its_end(world, journey.robot, flat)
    if _problem(journey, flat).displacement is None:
        LOG.warning("the robot cannot stand where it was sent: its end is left free")
    spent, guess = [flat], Laid(flat, world, level).nodes()
    found: Any = guess
    try:
        for one in [journey.priced, journey] if journey.constraints else [journey]:
            # with the contacts' curvature: without it five steps of 5 cm took 3,000 iterations
            options = budget.left("over the world") | {"passes": None}
            if one is not journey:
                options["max_iterations"] = min(ITERATIONS, options.get("max_iterations", np.inf))
            found = going_on(solve(_problem(one, flat), start=found, **options))
            spent.append(found)
            how, did = "held" if one.constraints else "priced", (found.status, found.iterations)
            LOG.info("over the world, limits %s: %s after %d iterations", how, *did)
    except Interrupted:
        return replace(spent[-1], status=Status.INTERRUPTED)
    sums = {name: sum(getattr(one, name) for one in spent) for name in SUMS}
    return replace(found, seed=flat.seed, starts=flat.starts, **sums)


def warn_of_its_end(world: World, robot: Character, motion: Solution) -> None:
    """Say where a motion leaves the shapes and maps of a world."""
    x, y, nodes = robot.base_coordinate, robot.base_coordinate + 1, motion.x[1:]
    places = np.column_stack([nodes[:, x], nodes[:, y], np.zeros(len(nodes))])
    outside = np.flatnonzero(np.logical_not(world.covers(places)))
    if len(outside):
        first = int(outside[0])
        LOG.warning(
            "the world ends under the motion: from %.2f s on, at x = %.2f m, y = %.2f m, it has no "
            "shape or map above or below the robot",
            *(first * motion.dt, *places[first, :2]),
        )


def level_under(journey: Journey, world: World) -> float:
    """Height (m) of the ground under the feet of a robot that stands on a world."""
    robot, problem = journey.robot, journey.whole
    feet = touching(robot, world, problem.start)
    above = sphere_centers(robot, problem.start)[feet] + [0.0, 0.0, problem.length]
    return float(world.below(above).mean())


def _problem(journey: Journey, flat: Solution) -> Problem:
    """From rest to rest, as stiff as the motion on level ground; where the robot cannot stand at
    the end, its end is free."""
    problem = journey.whole.replace(parameters=ground_law(flat))
    try:
        return problem.replace(costs=journey.terms, displacement=journey.way())
    except StaticPoseError:
        return problem
