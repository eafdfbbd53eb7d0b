"""``octo learn``: a robot and a goal in, a motion and a network that says it out."""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from octo.cli.arguments import (
    add_limits_arguments,
    add_options,
    add_robot_arguments,
    check_limits,
    number,
    positive,
    robot_of,
    steps_of,
    whole,
)
from octo.cli.output import OutputFolder, Writer, folder_of, say_left_out
from octo.cli.solve import described
from octo.cli.written import say_written, write_page, write_plot
from octo.errors import UsageError
from octo.goals import Goal

GOALS = ("walk", "stride", "turn", "stand")
NUMBERS = ("solution.npz", "transition.npz", "rounds.json")
FILES = (*NUMBERS, "plot.png", "motion.html")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_robot_arguments(parser)
    add_limits_arguments(parser)
    add_options(
        parser,
        ("--goal", None, "walk", ", ".join(GOALS)),
        ("--speed", number, 0.5, "m/s; rad/s for turn"),
        ("--seconds", positive, 10.0, "s, of motion"),
        ("--basis", None, "hermite", "hermite (segments of 10 steps) or nodes"),
        ("--rounds", whole(1), 10, "of a motion and a training each"),
        ("--iterations", whole(1), 200, "of the motion in a round, at most"),
        ("--training", whole(0), 1000, "iterations of L-BFGS in a round, at most"),
        ("--loss", None, "one_step", "one_step (Eq. 14) or recurrent (Eq. 16)"),
        ("--weight", number, 1.0, "λ of the last rounds"),
        ("--decay", number, 0.01, "of the mean square of the weights"),
        ("--hidden", sizes, (128, 128, 128), "numbers of each hidden layer (default 128,128,128)"),
        ("--state", None, "body", "body (no place, no heading) or world"),
        ("--seed", whole(0), 0, "of the first motion and of the weights"),
        ("--threads", whole(1), 1, "of the CPU"),
        ("--resume", None, None, "a folder that this command wrote, to go on from", "DIR"),
        ("--out", None, None, "folder of the five files (default ./octo-ROBOT-learn)", "DIR"),
    )
    parser.set_defaults(run=run)


def sizes(word: str) -> tuple[int, ...]:
    """Whole numbers with commas between them; which are allowed says ``octo.learn.Transition``."""
    try:
        return tuple(int(part) for part in word.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"is {word!r}, must be whole numbers with commas between them"
        ) from None


def run(arguments: argparse.Namespace) -> int:
    """Everything that can be refused is refused before anything is compiled."""
    began = time.perf_counter()
    check_limits(arguments)
    if arguments.goal not in GOALS:
        raise UsageError(f"--goal is {arguments.goal!r}, must be one of {', '.join(GOALS)}")
    goal = Goal(kind=arguments.goal, speed=arguments.speed, preset="paper")
    steps = steps_of(arguments.seconds, arguments.dt)
    folder = folder_of(arguments.out, arguments.robot, "learn", FILES)
    robot = robot_of(arguments)
    goal.check(robot)
    # after the checks: it takes longer to import than they take
    from octo.learn import Learned, Transition, solve

    problem = described(robot, goal, steps, arguments)
    begun = None
    if arguments.resume is None:
        begun = Transition(arguments.hidden, state=arguments.state)
    own = ("rounds", "iterations", "training", "loss", "weight", "decay", "seed", "threads")
    given: dict[str, Any] = {name: getattr(arguments, name) for name in (*own, "resume")}
    prepared = time.perf_counter() - began

    def keep(learned: Learned) -> None:
        folder.write({name: writers(learned)[name] for name in NUMBERS})

    found = solve(problem, begun, device="cpu", progress=True, callback=keep, **given)
    motion = replace(found.motion, setup_seconds=found.motion.setup_seconds + prepared)
    found = replace(found, motion=motion)
    write(folder, found)
    print(found)
    say_written(folder, motion)
    return 130 if found.interrupted else int(not motion.converged)


def writers(learned: Any) -> dict[str, Writer]:
    """Who writes each of the files."""

    def rounds(path: Path) -> None:
        path.write_text(json.dumps(learned.report(), indent=1), encoding="utf-8")

    return {
        "solution.npz": learned.motion.save,
        "transition.npz": learned.transition.save,
        "rounds.json": rounds,
        "plot.png": lambda path: write_plot(learned.motion, path),
        "motion.html": lambda path: write_page(learned.motion, path),
    }


def write(folder: OutputFolder, learned: Any) -> None:
    """All files; a picture that cannot be drawn is left out."""
    say_left_out(folder.write(writers(learned)))
