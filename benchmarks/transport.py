"""What it costs to walk at each speed when a stride may choose its own period: docs/free_time.md.

    python -m benchmarks.transport [--seeds 5] [--robots mammal,go2,biped] [--picture FILE]

Cost of transport: power of the joints, on the way and back, over weight and speed.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from typing import NamedTuple

import octo
from benchmarks.cycles import FILES, ROBOTS
from octo.model.quantities import GRAVITY
from octo.problem.cycle import usual_period
from octo.result.gait import flaws

SPEEDS = (0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0)  # m/s
RANGE = (0.25, 1.5)  # s, of a period
STEPS, FIRST = 20, 10
WORK = 0.3  # of the cost of transport in E


class Point(NamedTuple):
    """The best stride of a robot at a speed."""

    speed: float
    period: float
    transport: float
    energy: float
    status: str
    flaws: int  # of its gait
    converged: int  # starts
    iterations: int
    touchdowns: float | None


def best(robot: octo.Character, speed: float, seeds: int) -> Point:
    """From the period of an animal with such legs at that speed."""
    pull = robot.mass * GRAVITY * speed  # W for a cost of transport of one
    costs = [*octo.costs.natural(speed), octo.JointPower(weight=WORK, reference=pull)]
    cycle = octo.Cycle(speed=speed, period=RANGE)
    length = octo.Problem(robot, steps=STEPS, costs=costs, cycle=cycle).length
    first = min(max(usual_period(length, speed), 1.02 * RANGE[0]), 0.98 * RANGE[1])
    problem = octo.Problem(
        robot, steps=STEPS, costs=costs, cycle=octo.Cycle(speed=speed, period=first), duration=RANGE
    )
    found = octo.solve(problem, seeds=seeds, seed=FIRST)
    assert found.cycle is not None
    return Point(
        speed=speed,
        period=found.cycle.period,
        transport=found.power / pull,
        energy=found.energy,
        status=found.status.label,
        flaws=flaws(found.gait, found.length),
        converged=sum(bool(own["converged"]) for own in found.starts),
        iterations=found.iterations,
        touchdowns=None if found.gait is None else found.gait.touchdowns,
    )


def draw(points: dict[str, list[Point]], path: str) -> None:
    """Cost of transport and period against speed; hollow: a gait that has a flaw."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name, own in points.items():
        for axes, key in ((left, "transport"), (right, "period")):
            values = [getattr(point, key) for point in own]
            (line,) = axes.plot([point.speed for point in own], values, label=name)
            for point, value in zip(own, values, strict=True):
                face = line.get_color() if point.flaws == 0 else "white"
                axes.plot(point.speed, value, "o", color=line.get_color(), mfc=face)
    for axes, label in ((left, "cost of transport"), (right, "period (s)")):
        axes.set(xlabel="speed (m/s)", ylabel=label, ylim=(0.0, None))
    left.legend()
    figure.savefig(path, dpi=80)


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--robots", default="mammal,go2,biped")
    parser.add_argument("--picture", default="")
    asked = parser.parse_args(words)
    points: dict[str, list[Point]] = {}
    for name in asked.robots.split(","):
        robot = (
            octo.load(str(ROBOTS / FILES[name]))
            if name in FILES
            else octo.gallery.CHARACTERS[name]()
        )
        print(f"{name}\n  m/s      s    CoT      E  touchdowns/s  flaws  starts  iterations")
        for speed in SPEEDS:
            p = best(robot, speed, asked.seeds)
            points.setdefault(name, []).append(p)
            print(
                f"{p.speed:5.1f}{p.period:7.3f}{p.transport:7.3f}{p.energy:7.3f}"
                f"{p.touchdowns or 0.0:14.1f}{p.flaws:7d}{p.converged:5d}/{asked.seeds}"
                f"{p.iterations:12d}  {p.status}",
                flush=True,
            )
        if asked.picture:
            draw(points, asked.picture)
    return 0


if __name__ == "__main__":
    sys.exit(main())
