"""``octo explain``: why a saved solve ended as it did."""

from __future__ import annotations

import argparse

from octo.cli.arguments import add_options
from octo.cli.inspect import as_json
from octo.saved import motion_of


def add_arguments(parser: argparse.ArgumentParser) -> None:
    wrote = "what octo wrote: a solution or log (.npz), or its folder"
    parser.add_argument("solution", metavar="SOLUTION", help=wrote)
    add_options(parser, ("--json", bool, False, "print JSON and nothing else"))
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    explanation = motion_of(arguments.solution).explain()
    print(as_json(explanation.report()) if arguments.json else explanation)
    return 0
