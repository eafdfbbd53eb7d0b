"""Motions whose limits hold: strides with each of the natural limits priced and hard, walks and
turns from rest to rest with all of them hard, and ways to a place.

    python -m benchmarks.limits strides|walks|turns|places [--only ROBOT …] [--starts 5]
        [--json FILE]

Bounds of walks and turns are computed anew from the motion's arrays, not with octo's constraints.
Times are processor time of one thread, without code generation; iterations are those of all passes.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

import octo
from benchmarks.cycles import clock, journey_checks, load
from octo.goals import Goal
from octo.motions.journey import Journey
from octo.problem.hard import SOFT, beside
from octo.result.solution import Solution
from octo.solve import solve_all

ROBOTS = ("mammal", "go2", "biped", "spider", "anymal_c")
SPEED, SLOW, RATE = 0.5, 0.3, 0.3  # m/s, of a spider, rad/s
SECONDS, MU, FAST = 4.0, 0.6, 12.0  # s, friction, rad/s
PLACES = ((1.0, 0.0, 0.0), (-0.6, 0.0, 0.0), (0.0, 0.5, 0.0), (0.0, 0.0, 1.0), (1.0, 0.5, 1.57))
BY = 1e-6  # of itself: what a bound may be missed by


def strides(name: str, starts: int) -> Iterator[dict[str, Any]]:
    """A stride of natural terms: all limits priced, one of them hard, all hard."""
    robot = load(name)
    journey = Journey(robot, (SLOW if name == "spider" else SPEED, 0.0), 0.0, 10.0)
    periods, hard = journey.periods(), octo.limits(robot, MU)
    plain = journey.cycle(periods[len(periods) // 2])
    priced = {term.__name__ for term in SOFT}
    for told, constraints in {
        "soft": [],
        **{one.label: [one] for one in hard},
        "all hard": hard,
    }.items():
        costs = beside(constraints, plain.costs)
        problem = plain.replace(costs=costs, constraints=constraints)
        solve_all(problem, max_iterations=1, device="cpu")  # compiles
        began = time.process_time()
        found = solve_all(problem, seeds=starts, device="cpu")
        seconds = time.process_time() - began
        common = [
            sum(value for term, value in one.terms.items() if term not in priced) for one in found
        ]
        yield {
            "name": f"{name}, {told}",
            "converged": sum(one.converged and one.passes[-1]["converged"] for one in found),
            "starts": starts,
            "iterations": [one.iterations for one in found],
            "energy": [round(value, 4) for value in common],
            "seconds": round(seconds, 2),
        }


def constraints_of(robot: octo.Character) -> list[octo.Constraint]:
    """Every limit of the robot, with one speed for all joints."""
    kept = [one for one in octo.limits(robot, MU) if not isinstance(one, octo.JointSpeedLimits)]
    return [*kept, octo.JointSpeedLimits(limit=FAST)]


def beyond(motion: Solution) -> dict[str, float]:
    """By what part of itself each bound is missed at most, negative where there is room."""
    robot = motion.character
    assert robot is not None
    joints = robot.actuated
    x, speed = motion.x[2:, joints], np.abs(np.diff(motion.x[1:, joints], axis=0)) / motion.dt
    lower, upper = robot.lower[joints], robot.upper[joints]
    with np.errstate(invalid="ignore"):
        size = np.maximum(np.maximum(abs(lower), abs(upper)), 1e-9)
        places = np.fmax(lower - x, x - upper) / np.where(np.isfinite(size), size, 1.0)
        torques = np.abs(motion.u) / robot.torque_limit - 1.0
    force = motion.contact_force / motion.weight
    load = np.sum(force * motion.contact_normal, axis=-1)
    across = np.sum((force - load[..., None] * motion.contact_normal) ** 2, axis=-1)
    rounding = octo.FrictionCones.ROUNDING
    carried = 0.5 * (load + np.sqrt(load**2 + 4.0 * rounding**2))
    cones = across / (np.sqrt(across + rounding**2) * carried) / MU - 1.0
    standing = motion.loaded[:8].any(axis=0) | motion.loaded[-8:].any(axis=0)
    found = {"torque": torques, "joint": places, "speed": speed / FAST - 1.0}
    found["cone"] = cones[:, standing]
    return {key: float(np.nanmax(np.where(np.isinf(v), -1.0, v))) for key, v in found.items()}


def walks(name: str, starts: int) -> Iterator[dict[str, Any]]:
    """Walks from rest to rest with every limit hard."""
    return journeys(name, Goal("walk", SLOW if name == "spider" else SPEED), starts)


def turns(name: str, starts: int) -> Iterator[dict[str, Any]]:
    """The same of turns on the spot."""
    return journeys(name, Goal("turn", RATE), starts)


def journeys(name: str, goal: Goal, starts: int) -> Iterator[dict[str, Any]]:
    robot, folder = load(name), Path("build/limits")
    folder.mkdir(parents=True, exist_ok=True)
    must: dict[str, Any] = {"constraints": constraints_of(robot)}
    for start in range(starts):
        find = getattr(octo, goal.kind)
        with clock() as running:
            motion = find(robot, goal.speed, SECONDS, seed=10 * start, device="cpu", **must)
        off, checks = beyond(motion), journey_checks(motion, goal)
        motion.save(folder / f"{name}_{goal.kind}_{start}.npz")
        yield {
            "name": f"{name} {goal.kind}, start {start}",
            "status": motion.status.label,
            "converged": motion.converged,
            "bounds hold": max(off.values()) <= BY,
            "beyond": {key: float(f"{value:.3g}") for key, value in off.items()},
            "iterations": motion.iterations,
            "seconds": round(running.seconds, 1),
            "figures": {
                check.name: None if check.value is None else float(f"{check.value:.3g}")
                for check in checks
            },
            "missed": [check.name for check in checks if not check.met],
        }


def places(name: str, starts: int) -> Iterator[dict[str, Any]]:
    """Straight on, backwards, sideways, round, along an arc: with limits priced and hard."""
    robot = load(name)
    for place in PLACES:
        for limits in ("soft", "hard"):
            with clock() as running:
                motion = octo.go_to(robot, place, starts=starts, constraints=limits, device="cpu")
            yield {
                "name": f"{name} to {place}, {limits}",
                "status": motion.status.label,
                "converged": motion.converged,
                "off": float(f"{motion.asked[0].off:.2g}"),
                "time": round(motion.steps * motion.dt, 3),
                "seconds": round(running.seconds, 1),
                "touchdowns": motion.gait and motion.gait.touchdowns,
                "slip": round(motion.slip, 3),
            }


SECTIONS = {"strides": strides, "walks": walks, "turns": turns, "places": places}


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("section", choices=SECTIONS)
    parser.add_argument("--only", nargs="+", default=ROBOTS)
    parser.add_argument("--starts", type=int, default=5)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args(words)
    records = []
    for name in arguments.only:
        for record in SECTIONS[arguments.section](name, arguments.starts):
            print(json.dumps(record), flush=True)
            records.append(record)
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(records, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
