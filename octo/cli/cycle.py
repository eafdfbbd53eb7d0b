"""``octo cycle``: a robot and a speed in, a stride that repeats itself out."""

from __future__ import annotations

import argparse
import math
import sys
import time
from dataclasses import replace

from octo.cli.arguments import (
    add_base_arguments,
    add_law_argument,
    add_limits_arguments,
    add_options,
    add_solver_arguments,
    check_limits,
    limits_of,
    number,
    robot_of,
    solver_options,
    whole,
)
from octo.cli.output import folder_of
from octo.cli.solve import surroundings
from octo.cli.written import FILES, say_written, write
from octo.errors import MirrorError
from octo.model.character import Character
from octo.model.mirror import mirror_of
from octo.problem.cycle import Cycle, usual_periods
from octo.problem.hard import beside
from octo.problem.joint_costs import Effort
from octo.problem.presets import natural
from octo.problem.problem import Problem
from octo.result.solution import Solution
from octo.solver.status import Status

PLOTTED = 3  # strides
Period = float | tuple[float, float] | None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_base_arguments(parser)
    add_law_argument(parser)
    periods = (
        "s, of a whole stride; of a range, and of the robot's usual strides, the one of least work "
        "(default 0.8)"
    )
    add_options(
        parser,
        ("--speed", number, 0.5, "m/s along the heading"),
        ("--period", period, 0.8, periods, "T|LOW,HIGH|auto"),
    )
    parser.add_argument(
        "--mirror",
        action=argparse.BooleanOptionalAction,
        help="solve for half a stride, the other half is its mirror image (default: where the "
        "robot and the motion have one)",
    )
    add_options(
        parser,
        ("--turn", number, 0.0, "rad a stride, to the left"),
        ("--sideways", number, 0.0, "m/s, to the left"),
        ("--steps", whole(1), 0, "of what is solved for (default: steps of 0.025 s or less)"),
    )
    add_limits_arguments(parser)
    add_solver_arguments(parser, seeds=5)
    where = "folder of the four files (default ./octo-ROBOT-cycle)"
    add_options(parser, ("--out", None, None, where, "DIR"))
    parser.set_defaults(run=run)


def period(word: str) -> Period:
    """A number of seconds, two of them, or None for "auto"; which numbers are allowed says
    ``octo.Cycle``."""
    if word == "auto":
        return None
    try:
        numbers = [float(part) for part in word.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (1, 2):
        raise argparse.ArgumentTypeError(
            f"is {word!r}, must be a number of seconds, LOW,HIGH or auto"
        )
    return numbers[0] if len(numbers) == 1 else (numbers[0], numbers[1])


def run(arguments: argparse.Namespace) -> int:
    """Everything that can be refused is refused before anything is compiled."""
    began = time.perf_counter()
    check_limits(arguments)
    folder = folder_of(arguments.out, arguments.robot, "cycle", FILES)
    start = None if arguments.start is None else Solution.load(arguments.start)
    robot = robot_of(arguments)
    # after the checks: it takes longer to import than they take
    from octo.devices import resolve_device
    from octo.solve import solve

    resolve_device(arguments.device)
    problem = described(robot, arguments)
    prepared = time.perf_counter() - began
    solution = solve(problem, start=start, progress=True, **solver_options(arguments))
    solution = replace(solution, setup_seconds=solution.setup_seconds + prepared)
    starts = [dict(record) for record in solution.starts]
    write(
        folder,
        solution,
        lambda: {**solution.report(), "starts": starts},
        lambda cycle: cycle.tile(PLOTTED),
    )
    print(solution)
    say_written(folder, solution)
    if solution.status is Status.INTERRUPTED:
        return 130
    return 0 if solution.converged else 1


def described(robot: Character, arguments: argparse.Namespace) -> Problem:
    """The problem of a cycle, with the terms of :func:`octo.costs.natural`."""
    given = arguments.period
    cycle = Cycle(
        speed=arguments.speed,
        period=Cycle().period if given is None else given,
        mirror=_mirrored(robot, arguments),
        turn=arguments.turn,
        sideways=arguments.sideways,
    )
    where = surroundings(robot, arguments)
    problem = Problem(robot, steps=arguments.steps, costs=[Effort()], cycle=cycle, **where)
    if given is None:
        speed = math.hypot(arguments.speed, arguments.sideways)
        low, high = usual_periods(problem.length, speed)
        legs, periods = f"legs of {problem.length:.2g} m", f"periods of {low:.2g} to {high:.2g} s"
        print(f"octo: {legs} at {speed:g} m/s: {periods}", file=sys.stderr)
        cycle = replace(cycle, period=(low, high))
    held = limits_of(robot, arguments)
    costs = beside(held, natural(length=problem.length))
    return problem.replace(cycle=cycle, steps=arguments.steps, costs=costs, constraints=held)


def _mirrored(robot: Character, arguments: argparse.Namespace) -> bool:
    """As asked for; else whether there is a mirror image, with a line where the robot has none."""
    if arguments.mirror is not None:
        return bool(arguments.mirror)
    if arguments.turn != 0.0 or arguments.sideways != 0.0:
        return False
    if robot.base != "floating":
        return True  # refused for that
    try:
        mirror_of(robot)
    except MirrorError as error:
        print(f"octo: {error}: a whole stride is solved for, as with --no-mirror", file=sys.stderr)
        return False
    return True
