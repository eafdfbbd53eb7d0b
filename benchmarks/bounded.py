"""Strides whose limits must hold, by octo and by IPOPT from the same starts: docs/compare.md.

    python -m benchmarks.bounded [--seeds 3]

With limits that leave room, and with tight ones that hold a motion back. Times are processor time
of one thread.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import octo
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


CASES = {"wide": limits(1.0, 12.0, 0.6), "tight": limits(0.15, 7.0, 0.3)}


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    seeds = parser.parse_args(words).seeds
    for name, constraints in CASES.items():
        problem = octo.Problem(
            octo.gallery.mammal(),
            steps=STEPS,
            costs=octo.costs.natural(),
            constraints=constraints,
            cycle=octo.Cycle(speed=0.5, period=0.8),
        )
        print(f"{name} limits\n{HEAD}{'bounds':>10s}", flush=True)
        entries = []
        for entry in Contest(problem, ("ipopt",), OPTIONS).run(range(FIRST, FIRST + seeds)):
            entries.append(entry)
            print(row(entry), flush=True)
        print("\n".join(summary(entries, ("ipopt",), 1)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
