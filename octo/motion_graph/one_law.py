"""The same motion under the contact law of another one: what is found from another pose has another
size of contacts, by parts of a thousand."""

from __future__ import annotations

from octo.errors import ProblemError
from octo.motions.path import ground_law
from octo.problem.hard import Held, held, standing
from octo.problem.joint_costs import PoseTarget
from octo.problem.problem import Problem
from octo.replay.plan import ground_of
from octo.result.solution import Solution
from octo.solve import solve

ALIKE = 0.2  # parts, by which numbers of two laws may differ
SAME = 1e-9


def under_one_law(motion: Solution, like: Solution, constraints: Held, name: str) -> Solution:
    """The motion nearest to one that is given under the law of ``like``, from and to the same
    states, within the same constraints.

    Raises
    ------
    ProblemError: there is none, or the laws differ too much; it names the motion.
    """
    own, wanted = ground_law(motion), ground_law(like)
    robot = motion.character
    assert robot is not None
    off = [abs(own[k] - wanted[k]) / abs(wanted[k]) for k in own if k in wanted and wanted[k]]
    if own.keys() != wanted.keys() or max(off, default=0.0) > ALIKE:
        raise ProblemError(f"motion {name!r} is of another contact law than the others")
    if max(off, default=0.0) <= SAME:
        return motion
    x, dt = motion.x, motion.dt
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
    limits = [
        standing(one.placed(problem.setting), problem.start) for one in held(robot, constraints)
    ]
    found = solve(problem.replace(constraints=limits), start=x[1:], passes=1, device="cpu")
    if not found.converged:
        raise ProblemError(f"motion {name!r} under the contact law of the others: {found.sentence}")
    return found
