"""``octo graph build|info|play|page``: motions, transitions between them, and ways through."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from octo.checks import ending
from octo.cli.arguments import (
    ROBOT,
    add_device_argument,
    add_options,
    check_limits,
    limits_of,
    number,
    positive,
    whole,
)
from octo.cli.output import OutputFolder, Writer, default_folder, say_left_out
from octo.cli.written import write_json, write_page
from octo.errors import UsageError, ValueRangeError
from octo.model.load import load
from octo.problem.hard import MU

FILES = ("solution.npz", "report.json", "motion.html")
GRAPH = "what `octo graph build` wrote"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    doing = parser.add_subparsers(dest="doing", metavar="|".join(DOING), required=True)
    for name, (sentence, add) in DOING.items():
        own = doing.add_parser(name, help=sentence, description=sentence, allow_abbrev=False)
        add(own)
        own.set_defaults(parser=own)


def add_build_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("robot", metavar="ROBOT", help=ROBOT)
    names = "walk, back, left, right, stride_left, stride_right, jump, or NAME=FILE of a motion"
    held = "hard (default): torques, joints, speeds and friction of the robot hold; or soft"
    add_options(
        parser,
        ("--motions", None, "walk,left,right,jump", names, "LIST"),
        ("--seconds", positive, 10.0, "s, of a motion"),
        ("--dt", positive, 0.025, "s, of one step"),
        ("--transitions", positive, 1.0, "s, of a transition"),
        ("--moments", positive, 0.25, "s between moments that are left or reached"),
        ("--every", whole(1), 1, "so many of them are looked at"),
        ("--share", number, 1.0, "of all pairs of moments, the most alike"),
        ("--loops", whole(0), 3, "ways of each motion back into itself"),
        ("--limits", None, "hard", held, "soft|hard"),
        ("--mu", positive, None, f"friction of the ground, of --limits hard (default {MU:g})"),
        ("--batch", whole(1), 64, "transitions that are solved together"),
        ("--max-iterations", whole(1), None, "of one transition"),
        ("--threads", whole(1), 1, "of the CPU, in each process"),
        ("--out", None, None, "the file; what is there already is gone on with", "FILE"),
    )
    add_device_argument(parser, "cpu", "auto, cpu or cuda (default cpu)")
    parser.set_defaults(run=build)


def add_info_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("graph", metavar="GRAPH", help=GRAPH)
    add_options(parser, ("--json", bool, False, "as one JSON object"))
    parser.set_defaults(run=info)


def add_play_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("graph", metavar="GRAPH", help=GRAPH)
    script = "motions with how long each lasts, s: walk:3,left:2,jump:1"
    add_options(
        parser,
        ("--script", None, None, script, "SCRIPT"),
        ("--out", None, None, "folder of the files (default ./octo-ROBOT-play)", "DIR"),
    )
    parser.set_defaults(run=play)


def add_page_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("graph", metavar="GRAPH", help=GRAPH)
    shapes = "draw the robot as the shapes that octo computes with, not as its file does"
    add_options(
        parser,
        ("--out", None, "graph.html", "the page, one file (default graph.html)", "FILE"),
        ("--contacts", bool, False, shapes),
    )
    parser.set_defaults(run=page)


DOING = {
    "build": ("find motions, loops in them and transitions between them", add_build_arguments),
    "info": ("how large a graph is, and how well its motions are reached", add_info_arguments),
    "play": ("do what a script says, as one motion", add_play_arguments),
    "page": ("a page with which the character is steered", add_page_arguments),
}


def build(arguments: argparse.Namespace) -> int:
    """The file grows while it is built: Ctrl-C loses nothing."""
    check_limits(arguments)
    if arguments.out is None:
        raise UsageError("--out is missing: the file of the graph")
    robot, words = load(arguments.robot), arguments.motions.split(",")
    given = dict(word.split("=", 1) for word in words if "=" in word)
    if given and len(given) < len(words):
        raise UsageError("--motions has names and files: it must have names, or NAME=FILE for all")
    out = Path(arguments.out)
    OutputFolder(out.parent).check()
    from octo import motion_graph

    names = "seconds dt transitions moments every share loops batch max_iterations threads device"
    out.parent.mkdir(parents=True, exist_ok=True)
    graph = motion_graph.build(
        robot,
        given or words,
        path=out,
        constraints=limits_of(robot, arguments),
        progress=True,
        **{name: getattr(arguments, name) for name in names.split()},
    )
    print(graph)
    print(f"written to {out}")
    return 0


def info(arguments: argparse.Namespace) -> int:
    from octo.motion_graph import MotionGraph

    graph = MotionGraph(arguments.graph)
    print(json.dumps(graph.report(), indent=1) if arguments.json else graph)
    return 0


def play(arguments: argparse.Namespace) -> int:
    if arguments.script is None:
        raise UsageError("--script is missing, such as walk:3,left:2,jump:1")
    commands = script_of(arguments.script)
    from octo.motion_graph import MotionGraph

    graph = MotionGraph(arguments.graph)
    folder = OutputFolder(arguments.out or default_folder(graph.record["robot"], "play"))
    folder.check(FILES)
    route = graph.route(commands)
    motion = route.motion
    writers: dict[str, Writer] = {
        "solution.npz": motion.save,
        "report.json": lambda path: write_json(path, {**motion.report(), **route.report()}),
        "motion.html": lambda path: write_page(motion, path),
    }
    say_left_out(folder.write(writers))
    print(route)
    print(motion)
    print(f"written to {folder.path}")
    return 0


def page(arguments: argparse.Namespace) -> int:
    from octo.motion_graph import MotionGraph
    from octo.viewer import view

    graph, out = MotionGraph(arguments.graph), ending("out", arguments.out, (".html", ".htm"))
    folder = OutputFolder(out.parent)
    folder.check((out.name,))
    made = view(graph, visuals=not arguments.contacts)
    for error in folder.write({out.name: made.save}).values():
        raise error
    print(f"written to {out}, {len(made.text) / 1e6:.1f} MB")
    return 0


def script_of(word: str) -> list[tuple[str, float]]:
    """(motion, seconds) of each command of ``--script``.

    Raises
    ------
    ValueRangeError: one of them is not NAME:SECONDS.
    """
    made = []
    for part in word.split(","):
        name, _, seconds = part.rpartition(":")
        try:
            made.append((name.strip(), positive(seconds)))
        except argparse.ArgumentTypeError as error:
            raise ValueRangeError(
                f"script has {part!r}: seconds {error}; write NAME:SECONDS, as walk:3"
            ) from None
        if not name.strip():
            raise ValueRangeError(f"script has {part!r}, must be NAME:SECONDS, as walk:3")
    return made
