"""What each heuristic of the line search is worth: fifteen starts of five problems, with all of
them and with all but one.

    python -m benchmarks.heuristics [--starts 15] [--only TEXT] [--without NAME …]

Prints the table of docs/notes/solver.md, row by row; all of it takes ten minutes.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from dataclasses import dataclass

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

import octo
from benchmarks.cycles import FILES, ROBOTS
from octo.solve import solve_all
from octo.solver.options import HEURISTICS, SqpOptions
from octo.solver.status import Status

SEED, STARTS = 10, 15
ITERATIONS = 600  # of a pass
SAME = 1e-3  # of a number: two that differ by less are the same
HEAD = (
    "| without | problem | iterations | | more : fewer | E | | higher : lower | ended | converged |"
)


def robot(name: str) -> octo.Character:
    if name in FILES:
        return octo.load(str(ROBOTS / FILES[name]))
    return octo.gallery.CHARACTERS[name]()


def walk(name: str, dt: float = 0.025) -> octo.Problem:
    """From a stand, a speed and effort alone."""
    costs = [octo.CenterOfMassVelocity((0.5, 0.0, 0.0)), octo.Effort()]
    return octo.Problem(robot(name), steps=100, dt=dt, costs=costs)


def cycle(name: str) -> octo.Problem:
    """Half a stride with the natural terms."""
    asked = octo.Cycle(speed=0.5, period=0.8)
    return octo.Problem(robot(name), steps=16, costs=octo.costs.natural(), cycle=asked)


CASES: dict[str, Callable[[], octo.Problem]] = {
    "mammal walk": lambda: walk("mammal"),
    "chain walk": lambda: walk("chain", 0.05),
    "go2 walk": lambda: walk("go2"),
    "mammal cycle": lambda: cycle("mammal"),
    "go2 cycle": lambda: cycle("go2"),
}


@dataclass(frozen=True, eq=False)
class Row:
    """Of each start: (starts,) iterations and E, and how it ended."""

    iterations: NDArray[np.float64]
    energy: NDArray[np.float64]
    status: tuple[Status, ...]

    def against(self, base: Row) -> str:
        """Medians, and of how many starts the number is larger : smaller than with everything
        on."""
        cells = []
        for own, other in ((self.iterations, base.iterations), (self.energy, base.energy)):
            median, before = float(np.median(own)), float(np.median(other))
            more, less = (own > other * (1.0 + SAME)).sum(), (own < other * (1.0 - SAME)).sum()
            change = f"{100.0 * (median / before - 1.0):+.1f} % | {more} : {less}"
            cells.append(f"{median:.4g} | {change if self is not base else '|'}")
        ended = sum(status.converged for status in self.status)
        return " | ".join([*cells, str(ended), str(self.status.count(Status.CONVERGED))])


def measure(problem: octo.Problem, heuristics: tuple[str, ...], starts: int) -> Row:
    options = SqpOptions(heuristics=heuristics, max_iterations=ITERATIONS)
    members = solve_all(problem, seeds=starts, seed=SEED, device="cpu", options=options)
    return Row(
        np.array([member.iterations for member in members], dtype=float),
        np.array([member.energy for member in members]),
        tuple(member.status for member in members),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--starts", type=int, default=STARTS)
    parser.add_argument("--only", default="", help="problems whose name has this text")
    parser.add_argument("--without", nargs="*", default=HEURISTICS, choices=HEURISTICS)
    arguments = parser.parse_args()
    print(HEAD, "| --- | --- |" + 8 * " --: |", sep="\n")
    for name, made in CASES.items():
        if arguments.only not in name:
            continue
        problem = made()
        base = measure(problem, HEURISTICS, arguments.starts)
        print(f"| nothing | {name} | {base.against(base)} |", flush=True)
        for gone in arguments.without:
            kept = tuple(other for other in HEURISTICS if other != gone)
            row = measure(problem, kept, arguments.starts)
            print(f"| {gone} | {name} | {row.against(base)} |", flush=True)


if __name__ == "__main__":
    main()
