"""The runs behind docs/compare.md: five starts that nothing was chosen on, in both bases, octo
beside IPOPT and fatrop.

    python -m benchmarks.compare run [--only TEXT]     some or all of it (minutes); merges into
    benchmarks/results/compare.json python -m benchmarks.compare table                 the tables of
    docs/compare.md

Times are processor time of one thread, the two solvers one after the other on every start.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from octo.bench.timing import processor

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results" / "compare.json"
SEEDS = range(10, 15)  # no constant of the solver was chosen on these starts
KEPT = (
    "solver",
    "robot",
    "basis",
    "steps",
    "dt",
    "seed",
    "pass",
    "status",
    "converged",
    "iterations",
    "energy",
    "violation",
    "processor_seconds",
    "seconds",
    "compiled",
)
Record = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """One call of octo compare."""

    robot: str
    basis: str
    others: str = "ipopt"

    @property
    def name(self) -> str:
        return f"{self.robot} {self.basis}"

    def words(self, count: int | None = None) -> list[str]:
        own = ["--dt", "0.05"] if self.robot == "chain" else []
        seeds = ["--seeds", str(count or len(SEEDS)), "--seed", str(SEEDS[0])]
        return [
            "compare",
            self.robot,
            "--seconds",
            "10",
            *own,
            *seeds,
            "--basis",
            self.basis,
            "--with",
            self.others,
        ]

    def holds(self, record: Record) -> bool:
        return bool((record["robot"], record["basis"]) == (self.robot, self.basis))


CASES = (
    Case("mammal", "nodes", "ipopt,fatrop"),
    Case("mammal", "hermite"),
    Case("chain", "nodes"),
    Case("chain", "hermite"),
)


def read(path: Path = RESULTS) -> list[Record]:
    return list(json.loads(path.read_text())["records"]) if path.exists() else []


def compared(words: Sequence[str], folder: Path, quiet: bool = False) -> list[Record]:
    """The records of one octo compare; its picture stays in ``folder``."""
    file = folder.resolve() / "compare.json"
    command = [sys.executable, "-m", "octo", *words, "--json", str(file)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=quiet)
    return [{name: record[name] for name in KEPT} for record in json.loads(file.read_text())]


def run(case: Case) -> None:
    """Replace the case's records; the picture goes to docs/."""
    with tempfile.TemporaryDirectory() as scratch:
        made = compared(case.words(), Path(scratch))
        picture = Path(scratch) / "compare.png"
        (ROOT / "docs" / f"compare_{case.robot}_{case.basis}.png").write_bytes(picture.read_bytes())
    records = [record for record in read() if not case.holds(record)] + made
    order = {known.name: k for k, known in enumerate(CASES)}
    records.sort(
        key=lambda record: next(order[known.name] for known in CASES if known.holds(record))
    )
    content = {
        "date": time.strftime("%Y-%m-%d"),
        "processor": f"{processor()}, one thread a solver",
        "records": records,
    }
    RESULTS.write_text(json.dumps(content, indent=1) + "\n")


# -- what the records say --------------------------------------------------------------------------


def by_solver(records: Sequence[Record], case: Case) -> dict[str, dict[int, Record]]:
    """Records by solver and seed, octo first."""
    names = ("octo", *case.others.split(","))
    return {
        name: {r["seed"]: r for r in records if case.holds(r) and r["solver"] == name}
        for name in names
    }


def medians(records: Sequence[Record]) -> dict[str, float]:
    """Of one solver's converged runs."""
    values = {
        "iterations": [r["iterations"] for r in records],
        "E": [r["energy"] for r in records],
        "time an iteration": [r["processor_seconds"] / max(r["iterations"], 1) for r in records],
        "time": [r["processor_seconds"] for r in records],
    }
    return {name: float(np.median(column)) for name, column in values.items()}


def ratios(records: Sequence[Record], case: Case, other: str = "ipopt") -> dict[str, float]:
    """octo's medians over another solver's, over the starts where both converged; the count is
    among them."""
    own, their = by_solver(records, case)["octo"], by_solver(records, case)[other]
    both = [
        seed
        for seed in own
        if seed in their and own[seed]["converged"] and their[seed]["converged"]
    ]
    if not both:
        return {"starts": 0.0}
    one, two = medians([own[seed] for seed in both]), medians([their[seed] for seed in both])
    return {"starts": float(len(both)), **{name: one[name] / two[name] for name in one}}


def tables(records: Sequence[Record]) -> str:
    """Markdown."""
    shown = {"octo": "octo", "ipopt": "IPOPT", "fatrop": "fatrop"}
    lines = [
        "| medians | solver | converged | iterations | s | ms an iteration | E |",
        "|" + " --- |" * 7,
    ]
    for case in CASES:
        label = f"{case.robot}, {case.basis}"
        for solver, found in by_solver(records, case).items():
            done = [record for record in found.values() if record["converged"]]
            row = f"| {label} | {shown[solver]} | {len(done)} of {len(found)} |"
            m = medians(done) if done else {}
            row += (
                f" {m['iterations']:.0f} | {m['time']:.2g} | {1e3 * m['time an iteration']:.2g} | "
                f"{m['E']:.3g} |"
                if m
                else ""
            )
            lines.append(row)
            label = ""
    lines += ["", "| octo over | iterations | E | time an iteration | time |", "|" + " --- |" * 5]
    for case in CASES:
        for solver in case.others.split(","):
            ratio = ratios(records, case, solver)
            values = [
                f"{ratio[name]:.2f}"
                for name in ("iterations", "E", "time an iteration", "time")
                if name in ratio
            ]
            lines.append(
                f"| {shown[solver]}, {case.name}, {ratio['starts']:.0f} starts | "
                f"{' | '.join(values)} |"
            )
    return "\n".join(lines)


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("run", "table"))
    parser.add_argument("--only", default="", help="the cases whose name contains this text")
    arguments = parser.parse_args(words)
    if arguments.what == "run":
        for case in CASES:
            if arguments.only in case.name:
                run(case)
    print(tables(read()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
