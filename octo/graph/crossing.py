"""A transition between two motions: both ends fixed, in between what costs least effort."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from octo.checks import Array
from octo.graph.similarity import aligned, points_of, windows
from octo.motions.path import blend, ground_law
from octo.problem.constraints import Constraint
from octo.problem.costs import Cost
from octo.problem.joint_costs import Effort
from octo.problem.problem import Problem
from octo.result.solution import Solution


@dataclass(frozen=True)
class Placement:
    """Where the second motion stands for the first: turned by ``yaw`` rad about z, then carried by
    ``shift`` (2,) m."""

    yaw: float
    shift: Array

    def moved(self, x: Array, first: int) -> Array:
        """Configurations (…, nx) of a floating base whose coordinates begin at ``first``."""
        made = x.copy()
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        ground = slice(first, first + 2)
        made[..., ground] = x[..., ground] @ np.array([[c, s], [-s, c]]) + self.shift
        made[..., first + 3] += self.yaw
        return made


def nodes_of(motion: Solution, first: int, count: int) -> Array:
    """(count, nx) nodes x_first … of a motion, held before its start and after its end; a motion
    has nodes −1 … N."""
    at = np.clip(np.arange(first, first + count), -1, motion.steps)
    return motion.x[at + 1]


def crossing(
    one: Solution,
    at: int,
    other: Solution,
    to: int,
    steps: int,
    costs: Sequence[Cost] = (Effort(),),
    constraints: Sequence[Constraint] = (),
    basis: str = "nodes",
) -> tuple[Problem, Array, Placement]:
    """From node ``at`` of one motion to node ``to`` of another in so many steps: the problem, its
    first guess (steps + 1, nx), and where the second motion stands."""
    robot = one.character
    assert robot is not None
    base = robot.base_coordinate
    leaving = nodes_of(one, at - 1, steps + 2)
    coming = nodes_of(other, to - steps - 1, steps + 2)
    clouds = [points_of(robot, x)[None] for x in (leaving[1:], coming[1:])]
    found = aligned(*clouds)
    placed = Placement(float(found.yaw[0, 0]), found.shift[0, 0])
    coming = placed.moved(coming, base)
    dt = one.dt
    problem = Problem(
        robot,
        steps=steps,
        dt=dt,
        costs=costs,
        constraints=constraints,
        basis=basis,
        x0=leaving[1],
        v0=(leaving[1] - leaving[0]) / dt,
        x_end=coming[-1],
        v_end=(coming[-1] - coming[-2]) / dt,
        parameters=ground_law(one),
    )
    guess = blend(leaving[1:], coming[1:])
    guess[-2] = coming[-2]
    return problem, guess, placed


__all__ = ["Placement", "aligned", "crossing", "nodes_of", "windows"]
