"""``octo export``: a saved motion in the formats of animators."""

from __future__ import annotations

import argparse

from octo.checks import ANIMATED, ending
from octo.cli.arguments import add_options, positive, whole
from octo.cli.output import OutputFolder
from octo.export import export
from octo.saved import motion_of

SAID = {
    ".bvh": "the robot's skeleton, in metres and degrees, y up",
    ".glb": "bodies with their meshes, in metres, y up",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    wrote = "what octo wrote: a solution or log (.npz), or its folder"
    parser.add_argument("solution", metavar="SOLUTION", help=wrote)
    kinds = "motion.glb (default), or another name that ends in .glb, .bvh, .mp4 or .gif"
    shapes = "show the robot as the shapes that octo computes with, not as its file does"
    add_options(
        parser,
        ("--out", None, "motion.glb", kinds, "FILE"),
        ("--fps", positive, 30.0, "frames a second"),
        ("--repeat", whole(1), 1, "whole strides of a cycle, one after the other"),
        ("--contacts", bool, False, shapes),
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    out = ending("out", arguments.out, ANIMATED)
    folder = OutputFolder(out.parent)
    folder.check((out.name,))
    motion = motion_of(arguments.solution)
    out.parent.mkdir(parents=True, exist_ok=True)
    export(motion, out, arguments.fps, arguments.repeat, visuals=not arguments.contacts)
    note = SAID.get(out.suffix.lower())
    print(f"written to {out}" + (f": {note}" if note else ""))
    return 0
