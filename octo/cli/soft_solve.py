"""``octo solve ball --goal jump``: a soft body jumps, rolls or crawls."""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from octo.checks import one_of
from octo.cli.arguments import law_of, solver_options, steps_of
from octo.cli.soft import body_of
from octo.cli.world import check_covered, ground_of_words
from octo.dynamics.laws import ContactLaw, Smooth, Viscous
from octo.errors import UsageError
from octo.problem.joint_costs import Effort
from octo.problem.problem import Problem
from octo.result.solution import Solution
from octo.soft.body import Body
from octo.soft.dynamics import SoftDynamics, usual_law

if TYPE_CHECKING:
    from octo.soft_motions import Course

GOALS = ("jump", "roll", "crawl")
SECONDS = 3.0
USUAL_SPEED, USUAL_COSTS = 0.5, "paper"  # of the options of octo compare
STARTS = 1


def check_soft(arguments: argparse.Namespace) -> None:
    """Refuse a goal that a soft body has not, and options that are a robot's.

    Raises
    ------
    OctoError: names it and what is allowed.
    """
    one_of("goal of a soft body", arguments.goal, GOALS)
    steps_of(seconds_of(arguments), arguments.dt)
    compares = arguments.command == "compare"
    given = {
        "--speed": arguments.speed != USUAL_SPEED,
        "--base": arguments.base != "auto",
        "--contacts": arguments.contacts != "few",
        "--pose": arguments.pose is not None,
        "--costs": arguments.costs != (USUAL_COSTS if compares else None),
        "--limits": arguments.limits != "soft",
        "--period": arguments.period is not None,
        "--mu": arguments.mu is not None,
        "--object": bool(getattr(arguments, "objects", ())),
        "--cycle": getattr(arguments, "cycle", False),
        "--basis": arguments.basis != "nodes",
    }
    _refuse(arguments, given)
    if arguments.height is not None and arguments.goal != "jump":
        raise UsageError(f"--height is of a jump, the goal is {arguments.goal}")


def _refuse(arguments: argparse.Namespace, given: Mapping[str, bool]) -> None:
    """Options of robots, the first that is given."""
    for option, is_given in given.items():
        if is_given:
            raise UsageError(f"{option} is of a robot, {arguments.robot} is a soft body")


def seconds_of(arguments: argparse.Namespace) -> float:
    return SECONDS if arguments.seconds is None else float(arguments.seconds)


def course_of(arguments: argparse.Namespace) -> Course:
    """The motion that is asked for, as a problem."""
    from octo.soft_motions import TASKS, soft_course

    body, ground = body_of(arguments.robot), ground_of_words(arguments)
    way = TASKS[arguments.goal](body) if arguments.distance is None else arguments.distance
    check_covered(ground, [way, 0.0])
    return soft_course(
        body,
        arguments.goal,
        way,
        height=arguments.height,
        seconds=seconds_of(arguments),
        dt=arguments.dt,
        terrain=ground,
        law=law_with(arguments.friction, body),
    )


def soft_solved(arguments: argparse.Namespace, began: float) -> Solution:
    """The motion that was asked for."""
    start = None if arguments.start is None else Solution.load(arguments.start)
    course = course_of(arguments)
    # after the checks: it takes longer to import than they take
    from octo.devices import resolve_device
    from octo.soft_motions import solve_soft

    resolve_device(arguments.device)
    prepared = time.perf_counter() - began
    options: dict[str, Any] = {**solver_options(arguments), "seeds": arguments.seeds or STARTS}
    solution = solve_soft(course, start=start, progress=True, **options)
    return replace(solution, setup_seconds=solution.setup_seconds + prepared)


def dropped(arguments: argparse.Namespace, steps: int) -> Problem:
    """A body at rest on the ground, or ``--height`` above it, as a problem that nobody solves.

    Raises
    ------
    UsageError: an option that is a robot's.
    """
    given = {
        "--base": arguments.base != "auto",
        "--contacts": arguments.contacts != "few",
        "--pose": arguments.pose is not None,
        "--hold": arguments.hold,
    }
    _refuse(arguments, given)
    body = body_of(arguments.robot)
    law = law_with(arguments.friction, body)
    dynamics = SoftDynamics(body, law, ground_of_words(arguments))
    x0 = dynamics.rest(dynamics.layout.pack(dt=arguments.dt))
    x0[2] += arguments.height
    return Problem(dynamics, steps=steps, dt=arguments.dt, costs=[Effort()], x0=x0)


def law_with(friction: str, body: Body) -> ContactLaw | None:
    """The body's own stiffness and depth, with the friction of ``--friction``."""
    law = law_of(friction)
    if law is None:
        return None
    assert isinstance(law, Smooth)
    own, asked = usual_law(body), law.friction
    if isinstance(asked, Viscous):
        asked = Viscous(w_par=asked.w_par / law.w_perp * own.w_perp)
    return replace(own, friction=asked)
