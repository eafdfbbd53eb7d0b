"""The same motion under the contact law of another one: a robot that stands higher has larger and
softer contacts, by parts of a thousand for most, by four times where a spider rises to walk."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping

import numpy as np

from octo.checks import Array
from octo.errors import ProblemError, StaticPoseError
from octo.motions.path import ground_law
from octo.problem.hard import Held, held, standing
from octo.problem.joint_costs import PoseTarget
from octo.problem.problem import Problem
from octo.replay.plan import ground_of
from octo.result.solution import Solution
from octo.solve import solve

FAR = 10.0  # times, by which numbers of two laws may differ
SAME = 1e-9
RESTS = 1e-9  # m/s and rad/s


def under_one_law(motion: Solution, like: Solution, constraints: Held, name: str) -> Solution:
    """The motion nearest to one that is given under the law of ``like``, within the same
    constraints: from and to the same states, or as deep in the ground as the other law carries the
    robot where it rests.

    Raises
    ------
    ProblemError: there is none, or the laws differ too much; it names the motion.
    """
    own, wanted = ground_law(motion), ground_law(like)
    robot, x, dt = motion.character, motion.x, motion.dt
    assert robot is not None
    if _apart(own, wanted, name) <= SAME:
        return motion
    problem = Problem(
        robot,
        steps=motion.steps,
        dt=dt,
        costs=[PoseTarget(target=x[2:], at="all")],
        terrain=ground_of(motion),
        x0=x[1],
        v0=(x[1] - x[0]) / dt,
        x_end=x[-1],
        v_end=(x[-1] - x[-2]) / dt,
        parameters=wanted,
    )
    ends = {"x0": _carried(problem, x[1], x[0]), "x_end": _carried(problem, x[-1], x[-2])}
    problem = problem.replace(**ends)
    limits = [
        standing(one.placed(problem.setting), problem.start) for one in held(robot, constraints)
    ]
    found = solve(problem.replace(constraints=limits), start=x[1:], passes=1, device="cpu")
    if not found.converged:
        raise ProblemError(f"motion {name!r} under the contact law of the others: {found.sentence}")
    return found


def _apart(own: Mapping[str, float], wanted: Mapping[str, float], name: str) -> float:
    """By which part of itself a number of two laws differs at most."""
    if own.keys() != wanted.keys():
        lists = [", ".join(law) or "none" for law in (own, wanted)]
        raise ProblemError(
            f"motion {name!r} is of another contact law than the others: its numbers are "
            f"{lists[0]}, theirs {lists[1]}"
        )
    for key, there in wanted.items():
        here = own[key]
        if here != there and not 1.0 / FAR < (here / there if there else 0.0) < FAR:
            raise ProblemError(
                f"motion {name!r} is of another contact law than the others: {key} is {here:.3g}, "
                f"theirs {there:.3g}, must be within {FAR:g} times"
            )
    return max((abs(own[k] - wanted[k]) / abs(wanted[k]) for k in own if wanted[k]), default=0.0)


def _carried(problem: Problem, x: Array, beside: Array) -> Array:
    """A state of a motion that rests there, as the law of the problem carries it; any other as it
    is, and one that finds no balance."""
    if np.abs(x - beside).max() > RESTS * problem.dt:
        return x
    with contextlib.suppress(StaticPoseError):
        return problem.replace(x0=None, pose=x).start
    return x
