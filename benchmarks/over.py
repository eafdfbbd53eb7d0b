"""Walks over worlds that a robot has to climb, step over or balance on, from several starts, with
every limit of the robot held.

    python -m benchmarks.over [--only CASE …] [--seeds 0 1 2 3 4] [--soft]
        [--json FILE] [--pictures DIR]

A case is ROBOT-WORLD, such as ``mammal-stairs``. Nothing of a gait is given: speed and seconds
alone. Each start has its own seed. With ``--soft`` limits are priced. Bounds are computed anew from
the motion's arrays (benchmarks/limits.py). Times are processor time of one thread, without code
generation.
"""

from __future__ import annotations

import argparse
import json
import logging
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import octo
from benchmarks.cycles import load
from benchmarks.limits import BY, MU, beyond, constraints_of
from octo.result.solution import Solution

SPEED, SLOW = 0.5, 0.3  # m/s, of a spider
FAR = {"stairs": 4.4, "high": 4.4, "gap": 1.6, "block": 1.6, "beam": 3.4, "rubble": 3.0}  # m
ROBOTS = ("mammal", "go2", "spider")


def world_of(name: str, robot: octo.Character) -> octo.World:
    """The world of a case; the block is half as high as the robot's base over its feet."""
    if name == "stairs":
        return octo.worlds.stairs(rise=0.1, run=0.3, n=5)
    if name == "high":
        return octo.worlds.stairs(rise=0.17, run=0.3, n=5)
    if name == "gap":
        return octo.worlds.gap(width=0.25)
    if name == "beam":
        return octo.worlds.beam(width=0.2)
    if name == "rubble":
        return octo.worlds.rubble(seed=0)
    length = octo.Problem(robot, steps=1, dt=0.025, costs=octo.costs.natural()).length
    return octo.worlds.blocks(height=0.5 * length, length=3.0)  # it ends on top


def walk(case: str, seed: int, hard: bool) -> tuple[Solution, dict[str, Any]]:
    """One start of a case, and what came of it."""
    name, place = case.split("-")
    robot = load(name)
    speed = SLOW if name == "spider" else SPEED
    how: dict[str, Any] = {"starts": 1, "seed": seed, "device": "cpu", "threads": 1}
    if hard:
        how["constraints"] = constraints_of(robot)
    began = time.process_time()
    seconds = round(FAR[place] / speed, 1)
    motion = octo.walk(robot, speed, seconds, terrain=world_of(place, robot), **how)
    spent, gait, worst = time.process_time() - began, motion.gait, beyond(motion)
    assert gait is not None
    return motion, {
        "seed": seed,
        "status": motion.status.name,
        "converged": motion.converged,
        "iterations": motion.iterations,
        "energy": round(motion.energy, 4),
        "seconds": round(spent, 1),
        "held": max(worst.values()) <= BY,
        "worst": {key: round(value, 6) for key, value in worst.items()},
        "travel": round(float(motion.x[-1, 0] - motion.x[1, 0]), 3),
        "shortest_swing": gait.shortest_swing,
        "shortest_stance": gait.shortest_stance,
        "clearance": None if gait.clearance is None else round(gait.clearance, 4),
        "joint_speed": None if gait.joint_speed is None else round(gait.joint_speed, 2),
    }


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    cases = [f"{robot}-{place}" for place in FAR for robot in ROBOTS]
    parser.add_argument("--only", nargs="+", default=cases, choices=cases)
    parser.add_argument("--seeds", type=int, nargs="+", default=range(5))
    parser.add_argument("--soft", action="store_true", help=f"limits priced; friction {MU} too")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--pictures", type=Path, help="a folder for a still of each motion")
    asked = parser.parse_args(words)
    logging.basicConfig(format="%(message)s")
    logging.getLogger("octo").setLevel(logging.INFO)
    found: dict[str, list[dict[str, Any]]] = {}
    if asked.json is not None and asked.json.exists():
        found = json.loads(asked.json.read_text())
    for case in asked.only:
        label = f"{case}, soft" if asked.soft else case
        for seed in asked.seeds:
            motion, said = walk(case, seed, not asked.soft)
            others = [one for one in found.get(label, []) if one["seed"] != seed]
            found[label] = sorted([*others, said], key=lambda one: int(one["seed"]))
            print(label, json.dumps(said), flush=True)
            if asked.pictures is not None:
                asked.pictures.mkdir(parents=True, exist_ok=True)
                octo.filmstrip(motion, asked.pictures / f"{case}_{seed}.png", moments=10)
            if asked.json is not None:
                asked.json.write_text(json.dumps(found, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
