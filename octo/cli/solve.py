"""``octo solve``: a robot and a goal in, a folder with the motion out."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from octo.cli.arguments import (
    add_limits_arguments,
    add_options,
    add_robot_arguments,
    add_solver_arguments,
    check_limits,
    law_of,
    limits_of,
    number,
    numbers_of,
    pose_of,
    positive,
    robot_of,
    solver_options,
    steps_of,
)
from octo.cli.output import OutputFolder, folder_of
from octo.cli.push import add_object_argument, check_push, pushed, target_of
from octo.cli.soft import folder_word, is_soft
from octo.cli.soft_solve import check_soft, soft_solved
from octo.cli.world import check_covered, ground_of_words
from octo.cli.written import FILES, say_written, write
from octo.errors import ProblemError, UsageError
from octo.goals import Goal
from octo.model.character import Character
from octo.problem.hard import beside
from octo.problem.joint_costs import Effort
from octo.problem.problem import Problem
from octo.result.solution import Solution
from octo.solver.status import Status

SECONDS = 10.0  # of motion, where none are asked for …
RISING = 3.0  # … of getting up
# goals that natural terms reach with a stride that repeats
COMPOSED = ("walk", "stride", "turn", "to")
GOALS = (
    "walk, stride (sideways), turn, to X,Y,YAW, jump, up, push BODY X,Y or stand; of a soft body "
    "jump, roll or crawl"
)
PLACED = {"to": 1, "push": 2}  # goals that words follow, and how many


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_goal_arguments(parser, costs=None, seeds=None)
    stride = "s, of the stride of a natural motion (default: of several the best)"
    add_options(
        parser,
        ("--period", positive, None, stride),
        ("--out", None, None, "folder of the four files (default ./octo-ROBOT-GOAL)", "DIR"),
        ("--accept-missed", bool, False, "exit with 0 also when the goal is missed"),
    )
    add_object_argument(parser)
    parser.set_defaults(run=run)


def add_goal_arguments(
    parser: argparse.ArgumentParser,
    device: str = "auto",
    costs: str | None = "paper",
    seeds: int | None = 1,
) -> None:
    """What is solved and how, without where it is written; what is None follows from the goal."""
    add_robot_arguments(parser)
    terms = (
        "natural: a motion to keep, from rest to rest; paper: a speed and effort, nothing else; "
        "robot: a plan that a plant should follow (default "
        f"{costs or 'natural, with --basis hermite paper'}); a jump has its own"
    )
    add_options(
        parser,
        ("--goal", None, "walk", GOALS),
        ("--speed", number, 0.5, "m/s; rad/s for turn, its sign the side"),
        ("--distance", number, None, "m, of a jump (default 0.5; a soft body's from its size)"),
        ("--height", number, None, "m, of the centre of mass gained by a jump (default 0.2)"),
        (
            "--seconds",
            positive,
            None,
            "s, of motion (default 10, up 3; a jump takes what it needs)",
        ),
        ("--basis", None, "nodes", "nodes or hermite (segments of 10 steps; default nodes)"),
        ("--costs", None, costs, terms),
    )
    add_limits_arguments(parser)
    starts = None if seeds else "3 of each period of a stride, 5 of a push, 1 of others"
    add_solver_arguments(parser, device, seeds, starts)


def run(arguments: argparse.Namespace) -> int:
    """Everything that can be refused is refused before anything is compiled."""
    began = time.perf_counter()
    if is_soft(arguments.robot):
        check_soft(arguments)
        folder = folder_of(arguments.out, folder_word(arguments.robot), arguments.goal, FILES)
        moved = soft_solved(arguments, began)
        return ended(folder, moved, arguments.goal, arguments.accept_missed)
    arguments.costs = costs_of(arguments)
    goal = goal_of(arguments)
    composed = goal.preset == "natural" and goal.kind in COMPOSED
    check(arguments, composed)
    steps = asked_steps(goal, arguments)
    folder = folder_of(arguments.out, arguments.robot, goal.kind, FILES)
    start = None if arguments.start is None else Solution.load(arguments.start)
    robot = robot_of(arguments)
    goal.check(robot)
    check_way(goal, arguments)
    # after the checks: it takes longer to import than they take
    from octo.devices import resolve_device

    resolve_device(arguments.device)
    if composed:
        solution = from_rest_to_rest(robot, goal, arguments, began)
    elif goal.kind == "push":
        solution = pushed(robot, goal, arguments, began)
    elif goal.kind == "up":
        solution = got_up(robot, start, arguments, began)
    else:
        problem = described(robot, goal, steps, arguments)
        solution = as_one_problem(problem, goal, start, arguments, began)
    return ended(folder, goal.said(solution), goal.kind, arguments.accept_missed)


def ended(folder: OutputFolder, solution: Solution, goal: str, accept_missed: bool) -> int:
    """Write a motion, say how it went and what came of the goal that alone was asked; the exit
    code."""
    (asked,) = solution.asked
    write(folder, solution, lambda: report(solution, goal))
    print(solution)
    if asked.met:
        print(f"  {asked}")
    say_written(folder, solution)
    if solution.status is Status.INTERRUPTED:
        return 130
    return 0 if solution.converged and (accept_missed or asked.met) else 1


def goal_of(arguments: argparse.Namespace) -> Goal:
    kind, *place = str(arguments.goal).split(" ", 1)
    given: dict[str, Any] = {"kind": kind}
    if kind == "push":
        given["body"], given["place"] = target_of(" ".join(place))
    elif place or kind == "to":
        given["place"] = place_of(" ".join(place))
    sizes = {"distance": arguments.distance, "height": arguments.height}
    given |= {name: value for name, value in sizes.items() if value is not None}
    return Goal(**given, speed=arguments.speed, preset=arguments.costs)


def place_of(word: str) -> tuple[float, ...]:
    """m, m and rad of ``--goal to X,Y,YAW``."""
    found = numbers_of(word)
    if len(found) != 3:
        raise UsageError(
            f"--goal to is followed by {word!r}, must be X,Y,YAW: m ahead, m to the left, rad to "
            "the left"
        )
    return found


def with_place(words: Sequence[str]) -> list[str]:
    """The words of a command with those of ``--goal to X,Y,YAW``, or ``push BODY X,Y``, as one: a
    number may begin with a minus."""
    made, left = [""], 0
    for word in words:
        if made[-1] == "--goal" and word in PLACED:
            made[-1], left = f"--goal={word}", PLACED[word]
        elif left and not word.startswith("--"):
            made[-1], left = f"{made[-1]} {word}", left - 1
        else:
            made.append(word)
            left = PLACED.get(word.removeprefix("--goal="), 0) if "=" in word else 0
    return made[1:]


def costs_of(arguments: argparse.Namespace) -> str:
    """The list of terms: as asked for, else natural ones, which the Hermite basis cannot have."""
    if arguments.costs is None:
        return "natural" if arguments.basis == "nodes" or arguments.goal == "jump" else "paper"
    return str(arguments.costs)


def check(arguments: argparse.Namespace, composed: bool) -> None:
    """Refuse options that the motion has no use for.

    Raises
    ------
    UsageError: one line that names the option and what it goes with.
    """
    check_limits(arguments)
    check_push(arguments, arguments.goal.split(" ")[0] == "push")
    if composed:
        for name in ("passes", "start"):
            if getattr(arguments, name) is not None:
                raise UsageError(
                    f"--{name} is of one problem, a {arguments.goal} of natural terms is several: "
                    "add --costs paper"
                )
    elif arguments.period is not None:
        goes = f"it goes with --costs natural and --goal {', '.join(COMPOSED)}"
        raise UsageError(f"--period is of a stride: {goes}")
    if arguments.goal == "up" and arguments.basis != "nodes":
        raise UsageError(f"getting up is solved in nodes: --basis is {arguments.basis!r}")
    if arguments.costs == "natural" and arguments.goal != "jump" and arguments.basis == "hermite":
        raise UsageError(
            "natural terms are solved in nodes: --basis is 'hermite', must be 'nodes', or add "
            "--costs paper"
        )


def from_rest_to_rest(
    robot: Character, goal: Goal, arguments: argparse.Namespace, began: float
) -> Solution:
    """A walk, a stride or a turn, around a stride that repeats itself."""
    from octo import motions

    own = {"max_iterations", "time_limit", "tolerance", "device", "threads", "seed", "period", "dt"}
    given = {name: getattr(arguments, name) for name in own if getattr(arguments, name) is not None}
    if arguments.seeds is not None:
        given["starts"] = arguments.seeds
    seconds = SECONDS if arguments.seconds is None else arguments.seconds
    where = surroundings(robot, arguments) | {"constraints": limits_of(robot, arguments)}
    prepared = time.perf_counter() - began
    solution: Solution
    if goal.kind == "to":
        way: dict[str, Any] = {"seconds": arguments.seconds, "speed": goal.speed}
        solution = motions.go_to(robot, goal.place, progress=True, **way, **where, **given)
    else:
        find = getattr(motions, goal.kind)
        solution = find(robot, goal.speed, seconds, progress=True, **where, **given)
    return replace(solution, setup_seconds=solution.setup_seconds + prepared)


def as_one_problem(
    problem: Problem,
    goal: Goal,
    start: Solution | None,
    arguments: argparse.Namespace,
    began: float,
) -> Solution:
    """All other motions."""
    from octo.jump import solve_jump
    from octo.solve import solve

    prepared = time.perf_counter() - began
    found = solve_jump if goal.kind == "jump" else solve
    options = {**solver_options(arguments), "seeds": arguments.seeds or 1}
    solution = found(problem, start=start, progress=True, **options)
    return replace(solution, setup_seconds=solution.setup_seconds + prepared)


def got_up(
    robot: Character, start: Solution | None, arguments: argparse.Namespace, began: float
) -> Solution:
    """From a pose that lies to one that stands."""
    from octo.get_up import LYING, get_up_problems, solve_get_up

    word = f"{LYING}0" if arguments.pose is None else str(arguments.pose)
    pose = word if word.startswith(LYING) else pose_of(robot, word)
    assert pose is not None
    problems = get_up_problems(
        robot,
        pose,
        RISING if arguments.seconds is None else arguments.seconds,
        dt=arguments.dt,
        terrain=ground_of_words(arguments),
        law=law_of(arguments.friction),
        constraints=limits_of(robot, arguments),
    )
    prepared = time.perf_counter() - began
    options = {**solver_options(arguments), "seeds": arguments.seeds or 4}
    solution = solve_get_up(problems, start=start, progress=True, **options)
    return replace(solution, setup_seconds=solution.setup_seconds + prepared)


def check_way(goal: Goal, arguments: argparse.Namespace) -> None:
    """Refuse a ground that ends before the motion does."""
    seconds = SECONDS if arguments.seconds is None else arguments.seconds
    way = [seconds * speed for speed in goal.velocity[:2]]
    if goal.kind == "push":
        return
    if goal.kind in ("to", "jump"):
        way = [*goal.place[:2]] if goal.kind == "to" else [goal.distance, 0.0]
    check_covered(ground_of_words(arguments), way)


def asked_steps(goal: Goal, arguments: argparse.Namespace) -> int | None:
    """N of --seconds and --dt; None for a jump, or a place, that takes what it needs."""
    if arguments.seconds is None and goal.kind in ("jump", "to", "push"):
        return None
    usual = RISING if goal.kind == "up" else SECONDS
    return steps_of(usual if arguments.seconds is None else arguments.seconds, arguments.dt)


def surroundings(robot: Character, arguments: argparse.Namespace) -> dict[str, Any]:
    """Ground, contact law and pose, as a Problem calls them."""
    return {
        "terrain": ground_of_words(arguments),
        "law": law_of(arguments.friction),
        "pose": pose_of(robot, arguments.pose),
    }


def described(
    robot: Character, goal: Goal, steps: int | None, arguments: argparse.Namespace
) -> Problem:
    """The one problem of a goal."""
    dt, where = arguments.dt, surroundings(robot, arguments)
    held = limits_of(robot, arguments)
    if goal.kind == "jump":
        from octo.jump import jump_problem

        if arguments.basis != "nodes":
            raise ProblemError(
                f"a jump is solved in the nodes basis: basis is {arguments.basis!r}, must be "
                "'nodes'"
            )
        where |= {"seconds": None if steps is None else steps * dt, "constraints": held}
        return jump_problem(robot, goal.height, goal.distance, dt=dt, **where)
    if goal.kind in ("up", "push"):
        name = {"up": "get_up", "push": "push"}[goal.kind]
        raise UsageError(f"--goal {goal.kind} goes with octo solve, and octo.{name} in Python")
    if goal.kind == "to":
        raise UsageError(
            "--goal to is reached in strides: it goes with octo solve, --costs natural and --basis "
            "nodes"
        )
    assert steps is not None
    if goal.preset == "natural" and where["pose"] is None:
        where["pose"] = "balanced"
    problem = Problem(robot, steps=steps, dt=dt, costs=[Effort()], basis=arguments.basis, **where)
    costs = beside(held, goal.costs(problem.length, dt * np.arange(1, steps + 1)))
    problem = problem.replace(costs=costs, constraints=held)
    if goal.preset == "natural" and goal.kind == "stand":
        return problem.replace(displacement=np.zeros(robot.nx))  # at rest where it began
    return problem


def report(solution: Solution, goal: str) -> dict[str, Any]:
    """report.json: the best start, how near it came to its goal, and a record of each start."""
    (asked,) = solution.asked
    return {
        **solution.report(),
        "goal": goal,
        "goal_error": asked.error,
        "goal_met": asked.met,
        "starts": [dict(record) for record in solution.starts],
    }
