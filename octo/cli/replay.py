"""``octo replay``: a saved plan run in MuJoCo, from its own start or from perturbed ones."""

from __future__ import annotations

import argparse
import sys

from octo.checks import one_of
from octo.cli.arguments import add_options, positive, whole
from octo.cli.output import OutputFolder, Writer, default_folder, say_left_out
from octo.cli.written import write_json, write_page
from octo.replay import Replay, replay
from octo.replay.run import FEEDBACKS
from octo.result.solution import Solution

FILES = ("report.json", "motion.html")
PLANTS = ("mujoco",)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "solution", metavar="SOLUTION", help="what `octo solve` wrote: solution.npz or its folder"
    )
    every = "of every joint (default: in proportion to the robot)"
    starts = "perturbed starts (default: the plan's own start, once)"
    wrench = "base: a wrench on the base beside the PD (default), or none"
    add_options(
        parser,
        ("--plant", None, "mujoco", "mujoco (default)"),
        ("--kp", positive, None, f"N m/rad, {every}"),
        ("--kd", positive, None, f"N m s/rad, {every}"),
        ("--friction", positive, 0.8, "sliding coefficient of the plant"),
        ("--starts", whole(1), None, starts),
        ("--seed", whole(0), 0, "of the perturbations"),
        ("--feedback", None, "base", wrench),
        ("--timestep", positive, None, "s, of plant and control (default: about 1 ms)"),
        ("--out", None, None, "folder of the files (default ./octo-ROBOT-replay)", "DIR"),
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    one_of("plant", arguments.plant, PLANTS)
    one_of("feedback", arguments.feedback, FEEDBACKS)
    plan = Solution.load(arguments.solution)
    folder = OutputFolder(arguments.out or default_folder(plan.name, "replay"))
    folder.check(FILES)
    if not plan.converged:
        what = f"the plan is {plan.status.label}"
        print(f"octo: {what}: what a plant makes of it says little", file=sys.stderr)
    names = ("kp", "kd", "friction", "starts", "seed", "feedback", "timestep")
    done = replay(plan, **{name: getattr(arguments, name) for name in names})
    write(folder, done)
    print(done)
    print(f"written to {folder.path}")
    return 0


def write(folder: OutputFolder, done: Replay) -> None:
    """The two files; without the extra 'view' the picture is left out."""
    writers: dict[str, Writer] = {
        "report.json": lambda path: write_json(path, done.report()),
        "motion.html": lambda path: write_page(
            [done.plan, done.motion], path, labels=("plan", "plant")
        ),
    }
    say_left_out(folder.write(writers))
