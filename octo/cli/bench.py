"""``octo bench``: what octo costs on this machine, as numbers, beside those of a baseline."""

from __future__ import annotations

import argparse
from pathlib import Path

import octo
from octo.bench import plan
from octo.bench.timing import Records, processor, read
from octo.cli.arguments import add_options
from octo.cli.output import OutputFolder, Writer, records_of, say_left_out
from octo.errors import UnknownNameError, UsageError

# of a clone; a wheel has none
COMMITTED = Path(octo.__file__).parents[1] / "benchmarks" / "results" / "bench.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    known = "records of another run to compare with (default: the clone's own)"
    add_options(
        parser,
        ("--json", None, None, "write the records; a figure is written beside them", "FILE"),
        ("--baseline", None, None, known, "FILE"),
        ("--quick", bool, False, "fewer sizes and repetitions, in less than a minute"),
    )
    some = f"some of {', '.join(plan.GROUPS)} (default: all)"
    parser.add_argument("--only", nargs="+", metavar="GROUP", help=some)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Everything that can be refused is refused before anything is compiled."""
    chosen = plan.QUICK if arguments.quick else plan.FULL
    groups = groups_of(arguments.only)
    path = records_of(arguments.json)
    known = COMMITTED if arguments.baseline is None else Path(arguments.baseline)
    baseline = read(known, chosen) if known != COMMITTED or known.exists() else {}
    # after the checks: it takes longer to import than they take
    from octo.bench import run as bench

    records = bench.run(chosen, groups, baseline)
    print(f"{processor()}\n{records.table()}")
    if path is not None:
        write(path, records, chosen)
    return 0


def groups_of(words: list[str] | None) -> tuple[str, ...]:
    """The groups of ``--only``, each once, in the order of a whole run.

    Raises
    ------
    UnknownNameError: no such group. UsageError: none at all.
    """
    if words is None:
        return plan.GROUPS
    names = [name for word in words for name in word.split(",") if name]
    if not names:
        raise UsageError(f"only is {' '.join(words)!r}, must name some of {', '.join(plan.GROUPS)}")
    for name in names:
        if name not in plan.GROUPS:
            raise UnknownNameError("group", name, plan.GROUPS)
    return tuple(name for name in plan.GROUPS if name in names)


def write(path: Path, records: Records, chosen: plan.Plan) -> None:
    """The records, and the figure where matplotlib is."""
    from octo.bench.figure import draw

    writers: dict[str, Writer] = {
        path.name: records.write,
        f"{path.stem}.png": lambda scratch: draw(
            records, chosen, f"octo bench on {processor()}", scratch
        ),
    }
    say_left_out(OutputFolder(path.parent).write(writers))
    print(f"written to {path}")
