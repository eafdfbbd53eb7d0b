"""Motions whose limits must hold, by octo and by IPOPT from the same starts: docs/compare.md.

    python -m benchmarks.bounded [--seeds 3] [--only wide tight go2 ten-seconds]

Half a stride of the mammal with limits that leave room, and with tight ones that hold it back; of
go2; and ten seconds of the mammal from rest, which takes IPOPT minutes. First pass. Times are
processor time of one thread.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import octo
from benchmarks.cycles import FILES, ROBOTS
from octo.bench.contest import Contest
from octo.cli.compare import HEAD, row, summary
from octo.reference.run import OPTIONS

STEPS, FIRST = 16, 40  # constants of the solver were chosen on the starts 10 … 24


def limits(margin: float, speed: float, mu: float) -> list[octo.Constraint]:
    """Torques in parts of the file's limit, rad/s, and a coefficient of friction."""
    return [
        octo.TorqueLimits(margin=margin),
        octo.JointLimits(),
        octo.JointSpeedLimits(limit=speed),
        octo.FrictionCones(mu),
    ]


WIDE = limits(1.0, 12.0, 0.6)


def stride(robot: octo.Character, constraints: Sequence[octo.Constraint]) -> octo.Problem:
    """Half a stride."""
    return octo.Problem(
        robot,
        steps=STEPS,
        costs=octo.costs.natural(),
        constraints=constraints,
        cycle=octo.Cycle(speed=0.5, period=0.8),
    )


def walk(robot: octo.Character, constraints: Sequence[octo.Constraint]) -> octo.Problem:
    """Ten seconds at 0.5 m/s from rest, in nodes."""
    costs = octo.costs.natural(0.5)
    return octo.Problem(robot, steps=400, dt=0.025, costs=costs, constraints=constraints)


CASES = {
    "wide": lambda: stride(octo.gallery.mammal(), WIDE),
    "tight": lambda: stride(octo.gallery.mammal(), limits(0.15, 7.0, 0.3)),
    "go2": lambda: stride(octo.load(str(ROBOTS / FILES["go2"])), WIDE),
    "ten-seconds": lambda: walk(octo.gallery.mammal(), WIDE),
}


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--only", nargs="+", choices=CASES, default=["wide", "tight", "go2"])
    arguments = parser.parse_args(words)
    for name in arguments.only:
        problem = CASES[name]()
        print(f"{name} limits\n{HEAD}{'bounds':>10s}", flush=True)
        entries = []
        seeds = range(FIRST, FIRST + arguments.seeds)
        for entry in Contest(problem, ("ipopt",), OPTIONS).run(seeds):
            entries.append(entry)
            print(row(entry), flush=True)
        print("\n".join(summary(entries, ("ipopt",), 1)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
