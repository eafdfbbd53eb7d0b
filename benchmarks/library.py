"""A library of walks, and a network trained on it as a start for walks that it does not hold.

    python -m benchmarks.library [--short] [--json FILE] [--plot FILE] [--folder DIR]

The mammal from rest, three seconds in Hermite (twelve segments), at speeds of −0.5 to 0.5 m/s along
its heading and turns of −0.5 to 0.5 rad/s. So that all walks are of one family each starts from one
of five base motions, straight ahead, of which the first one is solved from ``octo.walk`` and each
of the others from its neighbour. Then a transition with speed and turn among its inputs is trained
on the library, and twenty walks of random speeds and turns between are solved from four starts:
the static pose (the default), the nearest motion of the library, with its multipliers and without,
and the network unrolled.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import sys
import time
from collections import Counter
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import casadi as ca
import numpy as np

import octo
from octo.dynamics.forms import axial
from octo.problem.symbols import StepSymbols

STEPS, DT = 120, 0.025  # s
FASTEST, TURN = 0.5, 0.5  # m/s, rad/s
BASES = (0.5, 0.25, 0.0, -0.25, -0.5)  # m/s, in the order in which they are solved
ITERATIONS = 400
SPEED, RATE = "Command.velocity", "Command.turn"
# of the terms for a robot those that hold it to no direction
LEFT_OUT = ("CenterOfMassVelocity", "BaseOrientation", "BaseAngularVelocity")


def command(step: StepSymbols, p: dict[str, ca.SX]) -> ca.SX:
    """m/s along the heading, to the left and up, and rad/s about the vertical, against what is
    wanted."""
    rotation, velocity = step.pose()[0], step.com_velocity
    forward = rotation[:2, 0] / ca.norm_2(rotation[:2, 0])
    along = forward[0] * velocity[0] + forward[1] * velocity[1]
    left = forward[0] * velocity[1] - forward[1] * velocity[0]
    turned = axial(rotation @ step.pose_before()[0].T)[2] / (2.0 * step.dt)
    return ca.vertcat(ca.vertcat(along, left, velocity[2]) - p["velocity"], turned - p["turn"])


def walk(robot: octo.Character, speed: float, turn: float = 0.0) -> octo.Problem:
    """From rest at a speed (m/s) along the heading while turning (rad/s)."""
    values = {"velocity": np.array([speed, 0.0, 0.0]), "turn": np.array([turn])}
    own = [term for term in octo.costs.robot(0.5) if term.label not in LEFT_OUT]
    costs = [
        octo.CustomCost(command, values, weight=4.0, name="Command"),
        octo.Upright(weight=1.0),
        *own,
    ]
    return octo.Problem(robot, steps=STEPS, dt=DT, basis="hermite", costs=costs)


def bases(robot: octo.Character, folder: Path | None) -> dict[float, octo.Solution]:
    """Straight ahead, each from its neighbour; those that the folder has are read."""
    files = [None if folder is None else folder / f"base_{speed:g}.npz" for speed in BASES]
    start: Any = None
    if files[0] is None or not files[0].exists():
        start = octo.walk(robot, speed=BASES[0], seconds=STEPS * DT)
    found = {}
    for speed, file in zip(BASES, files, strict=True):
        if file is not None and file.exists():
            start = octo.Solution.load(file)
        else:
            start = octo.solve(walk(robot, speed), start=start, max_iterations=ITERATIONS)
            if file is not None:
                file.parent.mkdir(parents=True, exist_ok=True)
                start.save(file)
        found[speed] = start
        print(f"base {speed} m/s: {start.status.label}, {start.iterations} iterations", flush=True)
    return found


def grid(robot: octo.Character, speeds: int, turns: int) -> list[octo.Problem]:
    """Of all speeds and turns."""
    pairs = [
        (speed, turn)
        for speed in np.linspace(-FASTEST, FASTEST, speeds).tolist()
        for turn in np.linspace(-TURN, TURN, turns).tolist()
    ]
    return [walk(robot, *pair) for pair in pairs]


def nearest_base(found: dict[float, octo.Solution], problem: octo.Problem) -> octo.Solution:
    speed = float(problem.costs[0].values["velocity"][0])
    return found[min(found, key=lambda other: abs(other - speed))]


def processor() -> float:
    """s, of this process and of those that it waited for."""
    own = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(one.ru_utime + one.ru_stime for one in own)


def made(
    robot: octo.Character, problems: list[octo.Problem], folder: Path | None
) -> tuple[octo.Library, dict[str, Any]]:
    """The library, and what is known of it."""
    found = bases(robot, folder)
    begun = folder is not None and any(folder.glob("batch-*.npz"))
    starts = [nearest_base(found, problem) for problem in problems]
    began, spent = time.perf_counter(), processor()
    how: dict[str, Any] = {"max_iterations": ITERATIONS, "device": "cpu", "progress": True}
    library = octo.library(problems, start=starts, folder=folder, **how)
    return library, {
        "motions": len(library),
        "bases": {
            f"{speed:g}": {"status": own.status.label, "iterations": own.iterations}
            for speed, own in found.items()
        },
        "converged_share": library.share,
        "statuses": dict(Counter(motion.status.label for motion in library)),
        "iterations_median": float(np.median(library.iterations)),
        "violation_largest_converged": max(m.violation for m in library if m.converged),
        # of solves that were done before nothing but their own processor time is known
        "seconds": None if begun else time.perf_counter() - began,
        "processor_seconds": None if begun else processor() - spent,
        "solver_seconds": library.seconds,
        "speeds": library.commands[SPEED][:, 0].tolist(),
        "turns": library.commands[RATE][:, 0].tolist(),
        "converged": library.converged.tolist(),
        "iterations": library.iterations.tolist(),
    }


def trained(library: octo.Library, hidden: Sequence[int], iterations: int) -> Any:
    """A network of all motions that converged."""
    begun = octo.learn.Transition(hidden=tuple(hidden), command=(SPEED, RATE))
    return octo.learn.train(begun, library, loss="recurrent", iterations=iterations, decay=1e-3)


def compared(
    robot: octo.Character, library: octo.Library, network: octo.learn.Transition, count: int
) -> dict[str, Any]:
    """Unseen walks, from each start."""
    random = np.random.default_rng(0)
    pairs = random.uniform((-FASTEST, -TURN), (FASTEST, TURN), (count, 2)).tolist()
    problems = [walk(robot, *pair) for pair in pairs]
    nearest = [library.nearest(problem) for problem in problems]
    starts: dict[str, Any] = {
        "static": None,
        "nearest": nearest,  # with its multipliers
        "nearest_nodes": [motion.x[1:] for motion in nearest],
        "network": network,
    }
    found: dict[str, Any] = {"commands": pairs}
    for name, start in starts.items():
        how: dict[str, Any] = {"max_iterations": ITERATIONS, "device": "cpu"}
        motions = octo.solve(problems, start=start, **how)
        found[name] = {
            "iterations": [motion.iterations for motion in motions],
            "iterations_median": float(np.median([motion.iterations for motion in motions])),
            "converged": sum(motion.converged for motion in motions),
            "statuses": dict(Counter(motion.status.label for motion in motions)),
            "energy": [motion.energy for motion in motions],
            "energy_median": float(np.median([motion.energy for motion in motions])),
            "processor_seconds": motions[0].processor_seconds,
        }
        print(name, {k: v for k, v in found[name].items() if not isinstance(v, list)}, flush=True)
    return found


def draw(record: dict[str, Any], path: Path) -> None:
    """The library by command, and the iterations of the unseen walks by start."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    own = record["library"]
    good, counts = np.array(own["converged"]), np.array(own["iterations"])
    speeds, turns = np.array(own["speeds"]), np.array(own["turns"])
    dots = left.scatter(speeds[good], turns[good], c=counts[good], s=24, cmap="viridis_r")
    left.scatter(speeds[~good], turns[~good], marker="x", color="tab:red", label="not converged")
    figure.colorbar(dots, ax=left, label="iterations")
    left.set(xlabel="speed (m/s)", ylabel="turn (rad/s)", title=f"{len(good)} walks")
    if not good.all():
        left.legend(fontsize="small")
    unseen = record["unseen"]
    names = ["static", "nearest", "nearest_nodes", "network"]
    for k, name in enumerate(names):
        counts = np.sort(unseen[name]["iterations"])
        right.plot(np.full(len(counts), k) + np.linspace(-0.2, 0.2, len(counts)), counts, ".")
        right.hlines(unseen[name]["iterations_median"], k - 0.3, k + 0.3, color="black")
    right.set_xticks(
        range(len(names)), ["static pose", "nearest\nmotion", "its nodes\nalone", "network"]
    )
    right.set(ylabel="iterations", title=f"{len(unseen['commands'])} unseen walks", ylim=(0, None))
    figure.savefig(path, dpi=120)


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--short", action="store_true", help="6 walks, 3 unseen ones")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--plot", type=Path)
    parser.add_argument("--folder", type=Path, help="of the library, to go on from")
    asked = parser.parse_args(words)
    robot = octo.gallery.mammal()
    problems = grid(robot, 3, 2) if asked.short else grid(robot, 20, 10)
    library, of_library = made(robot, problems, asked.folder)
    print(library, flush=True)
    training = trained(library, (32, 32) if asked.short else (64, 64), 60 if asked.short else 600)
    of_training = {
        "motions": int(library.converged.sum()),
        "weights": training.transition.network.count,
        "iterations": training.iterations,
        "unrolled_rms": float(np.sqrt(training.error)),
        "processor_seconds": training.processor_seconds,
        "stopped": training.stopped,
    }
    print(of_training, flush=True)
    record = {
        "date": date.today().isoformat(),
        "machine": f"{platform.machine()}, two cores of a shared machine for the library, one for "
        "the rest",
        "processes": len(os.sched_getaffinity(0)),
        "library": of_library,
        "training": of_training,
        "unseen": compared(robot, library, training.transition, 3 if asked.short else 20),
        "processor_seconds": processor(),
    }
    if asked.json is not None:
        asked.json.write_text(json.dumps(record, indent=1) + "\n")
    if asked.plot is not None:
        draw(record, asked.plot)
    return 0


if __name__ == "__main__":
    sys.exit(main())
