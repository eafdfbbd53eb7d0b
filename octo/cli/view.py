"""``octo view``: a picture of a saved solution, or a table of it."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

from octo.checks import ANIMATED, STILLS
from octo.cli.arguments import add_options
from octo.cli.output import OutputFolder
from octo.errors import OctoError, OutputError
from octo.result.solution import Solution
from octo.saved import motion_of


def add_arguments(parser: argparse.ArgumentParser) -> None:
    wrote = "what octo wrote: a solution or log (.npz), or its folder"
    parser.add_argument("solution", metavar="SOLUTION", help=wrote)
    kinds = "motion.html (default), plots as .png, .pdf, .svg, a table as .csv"
    shapes = "draw the robot as the shapes that octo computes with, not as its file does"
    add_options(
        parser, ("--out", None, "motion.html", kinds, "FILE"), ("--contacts", bool, False, shapes)
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    out = Path(arguments.out)
    if out.suffix.lower() in ANIMATED:
        raise OutputError(f"out is {arguments.out!r}: octo export writes {out.suffix} files")
    if out.suffix.lower() not in (".html", ".csv", *STILLS):
        raise OutputError(
            f"out is {arguments.out!r}, must end in .html (moving), {', '.join(STILLS)} (plots) "
            "or .csv (numbers)"
        )
    folder = OutputFolder(out.parent)
    folder.check((out.name,))
    solution, looks = motion_of(arguments.solution), not arguments.contacts
    for error in folder.write({out.name: lambda path: picture(solution, path, looks)}).values():
        if isinstance(error, OctoError):
            raise error
        raise OutputError(f"{out} cannot be drawn: {type(error).__name__}: {error}")
    print(f"written to {out}")
    return 0


def picture(solution: Solution, path: Path, visuals: bool) -> None:
    from octo.plot import plot
    from octo.viewer import view

    writers: dict[str, Callable[[Solution, Path], object]] = {
        ".html": partial(view, visuals=visuals),
        ".csv": Solution.to_csv,
    }
    writers.get(path.suffix.lower(), plot)(solution, path)
