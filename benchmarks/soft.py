"""A soft ball and a soft beam, of 16 coordinates each (§3.3, Fig. 2), jump, roll and crawl:
docs/soft.md.

    python -m benchmarks.soft [--only CASE …] [--seeds 0 1 2] [--no-ipopt] [--json FILE]
        [--plots DIR]

Three seconds, N = 120. The motors of the modes have limits that must hold; no contact is named.
IPOPT solves the ball's jump from the same start. Times are processor time of one thread.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import casadi as ca
import numpy as np

import octo
from octo.reference.interior_point import ipopt

RESULTS = Path(__file__).parent / "results" / "soft.json"
STEPS, DT = 120, 0.025  # 3 s
LAST = octo.At(np.arange(2.775, 3.01, DT))  # s: it stays where it came to
MOMENTS = 8  # of a picture
SWING = 0.02  # kg^½ m, of modes of a first guess
Array = np.ndarray[Any, np.dtype[np.float64]]
Costs = list[octo.costs.Cost]


def place(step: Any, p: Any) -> ca.SX:
    return (step.x_next[:3] - p["target"]) / 0.1


def still(step: Any, _: Any) -> ca.SX:
    return 0.3 * (step.x_next - step.x) / step.dt


def low(step: Any, p: Any) -> ca.SX:
    return 5.0 * (step.x_next[2] - p["height"])


def ahead(step: Any, _: Any) -> ca.SX:
    return 0.5 * step.x_next[3:6]


def rolled(step: Any, p: Any) -> ca.SX:
    return step.x_next[5] + step.x_next[1] / p["radius"]


def jump(start: Array, size: float) -> tuple[Costs, Array | None]:
    """By its own length to the left, a quarter of a metre up."""
    apex, end = start[:3] + [-0.5 * size, 0.0, 0.25], start[:3] + [-size, 0.0, 0.0]
    return [
        octo.CustomCost(place, {"target": apex}, name="Apex", at=octo.At(0.5 * STEPS * DT)),
        octo.CustomCost(place, {"target": end}, name="End", at=LAST),
    ], None


def roll(start: Array, _: float) -> tuple[Costs, Array | None]:
    """By 1 m, from the first guess of a rigid ball."""
    s = np.linspace(0.0, 1.0, STEPS + 1)
    guess = np.tile(start, (STEPS + 1, 1))
    guess[:, 1] += 3.0 * s**2 - 2.0 * s**3
    guess[:, 5] = -guess[:, 1] / start[2]
    return [
        octo.CustomCost(place, {"target": start[:3] + [0.0, 1.0, 0.0]}, name="End", at=LAST),
        octo.CustomCost(rolled, {"radius": start[2:3]}, name="Rolled"),
        octo.CustomCost(low, {"height": start[2:3]}, name="Low"),
    ], guess


def crawl(start: Array, _: float) -> tuple[Costs, Array | None]:
    """By half a metre along itself, without leaving the ground."""
    return [
        octo.CustomCost(place, {"target": start[:3] + [0.5, 0.0, 0.0]}, name="End", at=LAST),
        octo.CustomCost(low, {"height": start[2:3]}, name="Low"),
        octo.CustomCost(ahead, name="Ahead"),
    ], None


@dataclass(frozen=True)
class Case:
    """What a body does, and the most that a motor may do, N kg^-½."""

    body: str
    task: Callable[[Array, float], tuple[Costs, Array | None]]
    limit: float

    def problem(self) -> tuple[octo.Problem, Array | None]:
        """With a first guess, if the task has one."""
        body = getattr(octo.soft, self.body)()
        dynamics = octo.soft.SoftDynamics(body)
        start = dynamics.rest(dynamics.layout.pack())
        costs, guess = self.task(start, float(body.size[0]))
        costs += [
            octo.CustomCost(still, name="Still", at="last"),
            octo.Effort(weight=0.02, reference=100.0),
        ]
        limits = [octo.TorqueLimits(self.limit)]
        given: dict[str, Any] = {"costs": costs, "constraints": limits, "x0": start}
        return octo.Problem(dynamics, steps=STEPS, dt=DT, **given), guess


CASES = {
    "ball, jump": Case("ball", jump, 300.0),
    "ball, roll": Case("ball", roll, 60.0),
    "beam, jump": Case("beam", jump, 200.0),
    "beam, crawl": Case("beam", crawl, 80.0),
}


def figures(problem: octo.Problem, motion: octo.Solution) -> dict[str, Any]:
    """Of one solve."""
    dynamics = problem.dynamics
    assert isinstance(dynamics, octo.soft.SoftDynamics)
    touches = dynamics.touches(motion.x, problem.p)
    bent = np.einsum("nk,pkj->npj", motion.x[1:, 6:], dynamics.body.modes)
    loaded = np.unique(touches.step[np.linalg.norm(touches.force, axis=1) > 0.0])
    return {
        "status": motion.status.label,
        "iterations": motion.iterations,
        "energy": motion.energy,
        "violation": motion.violation,
        "seconds": motion.processor_seconds,
        "limit_used": float(np.abs(motion.u).max()),
        "held": all(bound.held for bound in motion.bounds),
        "way": (motion.x[-1, :3] - motion.x[1, :3]).tolist(),
        "top": float(motion.x[1:, 2].max() - motion.x[1, 2]),
        "in_the_air": DT * (STEPS - len(loaded)),
        "largest_angles": np.abs(motion.x[1:, 3:6]).max(axis=0).tolist(),
        "bends": float(np.linalg.norm(bent, axis=2).max()),
        "sinks": float(touches.depth.max()),
    }


def _bent(guess: Array, seed: int) -> Array:
    """A first guess whose modes swing once, by another amount for each seed but 0."""
    rng, s = np.random.default_rng(seed), np.linspace(0.0, np.pi, len(guess))
    swing = np.outer(np.sin(s), SWING * rng.standard_normal(guess.shape[1] - 6))
    return guess + np.pad((seed != 0) * swing, ((0, 0), (6, 0)))


def compared(problem: octo.Problem, guess: Array | None) -> dict[str, Any]:
    """IPOPT, from octo's own start."""
    return figures(problem, ipopt(problem, start=guess).solution)


def draw(case: Case, motion: octo.Solution, path: Path) -> None:
    """The surface at some moments, seen from the side."""
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure

    body = getattr(octo.soft, case.body)()
    across = 1 if case.task is roll else 0  # the axis that it goes along
    figure = Figure(figsize=(2.0 * MOMENTS, 2.2), layout="constrained")
    panels = figure.subplots(1, MOMENTS, sharex=True, sharey=True)
    for axes, node in zip(panels, np.linspace(1, STEPS + 1, MOMENTS).astype(int), strict=True):
        x = motion.x[node]
        points = body.deformed(x[6:]) @ turned(x[3:6]).T + x[:3]
        corners = points[body.faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        away = normal[:, 1 - across] * (1.0 if across else -1.0)
        seen = away > 0.0
        light = 0.45 + 0.5 * np.clip(0.6 * normal[seen, 2] + 0.8 * away[seen], 0.0, 1.0)
        quarters = np.prod(body.points[body.faces].mean(axis=1)[:, 1:], axis=1)[seen] > 0.0
        light = light * np.where(quarters, 1.0, 0.8)  # how it is turned
        color = np.stack([0.25 * light, 0.55 * light, light], axis=1)
        axes.add_collection(PolyCollection(corners[seen][:, :, [across, 2]], facecolors=color))
        axes.axhline(0.0, color="black", linewidth=0.8)
        axes.set_title(f"{(node - 1) * DT:.2f} s", fontsize=8)
        axes.set_aspect("equal")
    places = motion.x[1:, across]
    half = 0.6 * float(body.size.max())
    panels[0].set_xlim(places.min() - half, places.max() + half)
    panels[0].set_ylim(-0.05, motion.x[1:, 2].max() + half)
    figure.savefig(path, dpi=90, bbox_inches="tight")


def turned(angles: Array) -> Array:
    """(3, 3) of the chart zyx."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("ZYX", angles).as_matrix())


def measured(
    names: Sequence[str],
    seeds: Sequence[int],
    plots: Path | None = None,
    other: bool = True,
    most: int = 1500,
) -> dict[str, Any]:
    """The figures of these cases from these starts, pictures of the first one into a folder, and
    IPOPT's of the ball's jump.

    most: iterations.
    """
    found: dict[str, Any] = {}
    for name in names:
        case = CASES[name]
        problem, guess = case.problem()
        how: dict[str, Any] = {"device": "cpu", "threads": 1}
        octo.solve(problem, max_iterations=1, **how)  # what is compiled
        own: dict[str, Any] = {"limit": case.limit, "starts": {}}
        for seed in seeds:
            start = None if guess is None else _bent(guess, seed)
            motion = octo.solve(problem, start=start, seed=seed, max_iterations=most, **how)
            own["starts"][str(seed)] = figures(problem, motion)
            print(name, seed, json.dumps(own["starts"][str(seed)]), flush=True)
            if seed == seeds[0] and plots is not None:
                draw(case, motion, plots / f"soft_{name.replace(', ', '_')}.png")
        if name == "ball, jump" and other:
            own["ipopt"] = compared(problem, guess)
            print("IPOPT", json.dumps(own["ipopt"]), flush=True)
        found[name] = own
    return found


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="+", default=list(CASES), choices=list(CASES))
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--no-ipopt", action="store_true")
    parser.add_argument("--json", type=Path, default=RESULTS)
    parser.add_argument("--plots", type=Path, default=Path("docs"))
    asked = parser.parse_args(words)
    known = json.loads(asked.json.read_text()) if asked.json.exists() else {}
    known |= measured(asked.only, asked.seeds, asked.plots, not asked.no_ipopt)
    asked.json.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
