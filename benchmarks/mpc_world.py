"""Control on worlds, measured: go2 in MuJoCo over steps and rubble, with the map and without it.

Run ``python -m benchmarks.mpc_world [WALK …]``; what is in ``benchmarks/results/mpc_world.json``
already is not run again, so it may be stopped at any time. ``--again`` runs the named walks anew.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.mpc import robot_of
from octo import worlds
from octo.mpc import Controller, VelocityCommand, run, walking_problem
from octo.plant import MujocoPlant
from octo.world.world import World

RESULTS = Path(__file__).parent / "results" / "mpc_world.json"
SEEDS = range(10)
SPEED = 0.3  # m/s
SECONDS = 25.0  # s, within which the way must be done


@dataclass(frozen=True)
class Walk:
    """Over which world, how far (m), and whether the controller knows it."""

    kind: str
    sizes: dict[str, float]
    way: float
    blind: bool = False

    def world(self, seed: int) -> World:
        seeded = {"seed": seed} if self.kind == "rubble" else {}
        return worlds.WORLDS[self.kind](**self.sizes, **seeded)


WALKS = {
    "steps of 10 cm": Walk("stairs", {"rise": 0.1}, 4.5),
    "steps of 5 cm": Walk("stairs", {"rise": 0.05}, 4.5),
    "steps of 5 cm, blind": Walk("stairs", {"rise": 0.05}, 4.5, blind=True),
    "rubble of 5 cm": Walk("rubble", {"height": 0.05}, 4.0),
}


class Arrived(KeyboardInterrupt):
    """Ends a loop early, as Ctrl-C does: what was logged is kept."""


def over(walk: Walk, seed: int, name: str = "go2") -> dict[str, Any]:
    """One walk from a start that the seed moves a little; it ends with the way or with a fall."""
    robot, world = robot_of(name), walk.world(seed)
    ground: dict[str, Any] = {"gait": True} if walk.blind else {"terrain": world}
    problem = walking_problem(robot, **ground)
    rng = np.random.default_rng(seed)
    x = problem.start.copy()
    x[robot.actuated] += 0.02 * rng.standard_normal(robot.nu)
    x[2] += 0.02
    plant = MujocoPlant(robot, terrain=world, seed=seed)
    plant.reset_chart(x)
    controller = Controller(problem, guide=VelocityCommand((SPEED, 0.0), feel=walk.blind))

    def look(t: float, _: Controller) -> None:
        if plant.base_place[0] >= walk.way or plant.time < t - 0.1:  # put back after a fall
            raise Arrived

    log = run(controller, plant, SECONDS, each=look, seed=seed)
    seconds = float(log.falls[0] if log.falls else log.t[-1])
    last = min(int(seconds / log.tick), len(log.x)) - 1
    calls = 1e3 * log.seconds[np.isfinite(log.seconds)]
    place = log.x[last, robot.base_coordinate : robot.base_coordinate + 3]
    return {
        "arrived": bool(not log.falls and place[0] >= walk.way - 0.02),
        "fell": bool(log.falls),
        "place": [float(v) for v in place],
        "seconds": seconds,
        "foot_lift": log.foot_lift,
        "slip_mean": log.report()["slip_mean"],
        "p50_ms": float(np.percentile(calls, 50)),
        "p99_ms": float(np.percentile(calls, 99)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("walks", nargs="*", choices=[*WALKS, []], default=[])
    parser.add_argument("--again", action="store_true")
    arguments = parser.parse_args()
    found = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    for name in arguments.walks or WALKS:
        known = found.setdefault(name, {})
        for seed in SEEDS:
            if str(seed) in known and not arguments.again:
                continue
            known[str(seed)] = over(WALKS[name], seed)
            RESULTS.write_text(json.dumps(found, indent=1) + "\n")
            print(f"{name}, seed {seed}: {json.dumps(known[str(seed)])}", flush=True)
        arrived = sum(one["arrived"] for one in known.values())
        print(f"{name}: {arrived} of {len(known)} arrive, without a fall", flush=True)


if __name__ == "__main__":
    main()
