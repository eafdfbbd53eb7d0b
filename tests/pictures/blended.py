"""A motion graph that nobody solved: its motions are made up, its transitions blended."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import motions
import numpy as np

from octo.model.gallery import CHARACTERS
from octo.motion_graph import MotionGraph
from octo.motion_graph.crossing import Placement, nodes_of
from octo.motion_graph.file import File
from octo.motion_graph.work import Outcome, Pair
from octo.motions.path import blend
from octo.result.solution import Solution

DT, CROSSING = 0.025, 40
FEET = ("front_left", "front_right", "hind_left", "hind_right")


def made_up(steps: int = 160) -> dict[str, Solution]:
    """It walks ahead, turns left on the spot, and hops."""
    plain = motions.wandering(CHARACTERS["mammal"](), steps, DT)
    feet = np.array([name in FEET for name in plain.contact_names])
    plain = dataclasses.replace(plain, contact_force=plain.contact_force * feet[:, None])
    times = DT * np.arange(-1, steps + 1)
    left, hop = plain.x.copy(), plain.x.copy()
    left[:, 0], left[:, 3] = 0.0, 0.6 * times
    hop[:, 0] = 0.0
    hop[:, 2] += 0.2 * np.sin(3.0 * times) ** 2
    turned = {"walk": plain.x, "left": left, "jump": hop}
    return {name: dataclasses.replace(plain, x=x) for name, x in turned.items()}


def graph(path: Path, given: Mapping[str, Solution], apart: int = 20, seed: int = 0) -> MotionGraph:
    """From each moment one transition to each other motion, and a loop of each motion."""
    random, steps = np.random.default_rng(seed), next(iter(given.values())).steps
    record = {"robot": "mammal", "dt": DT, "moments": apart * DT, "every": 1, "transitions": 1.0}
    with File(path, writes=True) as file:
        file.keep_record(record)
        for name, motion in given.items():
            file.keep_motion(name, motion)
        for one in given:
            for other in given:
                leaving = [steps] if one == other else range(0, steps, apart)
                reaching = range(apart, steps, apart)
                pairs = [Pair(one, at, other, int(random.choice(reaching))) for at in leaving]
                file.keep([_outcome(given, pair, random) for pair in pairs])
    return MotionGraph(path)


def _outcome(given: Mapping[str, Solution], pair: Pair, random: np.random.Generator) -> Outcome:
    one, other = given[pair.one], given[pair.other]
    yaw, (x, y) = random.uniform(-2.0, 2.0), one.x[pair.at + 1, :2] + random.uniform(-0.2, 0.2, 2)
    there = Placement(yaw, np.zeros(2)).moved(other.x[pair.to + 1], 0)
    placed = Placement(yaw, (x, y) - there[:2])
    before = nodes_of(one, pair.at, CROSSING)
    after = placed.moved(nodes_of(other, pair.to - CROSSING, CROSSING), 0)
    step = min(pair.at, one.steps - CROSSING)
    numbers = {"violation": 0.0, "effort": random.uniform(1.0, 2.0), "torque": 0.5}
    numbers |= {"iterations": 1, "seconds": 0.0, "distance": 0.1, "yaw": yaw}
    arrays = {"x": blend(before, after), "u": one.u[step : step + CROSSING]}
    force = one.contact_force[step : step + CROSSING]
    return Outcome(pair, True, "", **numbers, shift=placed.shift, force=force, **arrays)
