"""``octo bench``: what octo costs on this machine, as numbers, beside those of a baseline."""

from __future__ import annotations

import argparse
from pathlib import Path

from octo.cli.output import OutputFolder


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", metavar="FILE", help="write the records here")
    parser.add_argument("--baseline", metavar="FILE", help="records of another run to compare with")
    parser.add_argument("--quick", action="store_true", help="without the symbolic form and cold compilation")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """0 where every limit holds, else 1."""
    path = None if arguments.json is None else Path(arguments.json)
    if path is not None:
        OutputFolder(path.parent).check((path.name,))
    from octo.bench.speed import measure  # after the checks: it takes longer to import than they take

    baseline = None if arguments.baseline is None else Path(arguments.baseline)
    return 0 if measure(path, baseline, arguments.quick) else 1
