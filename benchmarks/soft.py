"""A soft ball and a soft beam, of 16 coordinates each (§3.3, Fig. 2), jump, roll and crawl:
docs/soft.md.

    python -m benchmarks.soft [--only CASE …] [--seeds 0 1 2] [--no-ipopt] [--json FILE]
        [--plots DIR]

Three seconds, N = 120. The motors of the modes have limits that must hold; no contact is named.
IPOPT solves the ball's jump from the same start. Each motion is played back in octo's simulator, in
steps of a tenth. Times are processor time of one thread.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

import octo
from octo.reference.interior_point import ipopt
from octo.soft_motions import Course, soft_course, solve_soft

RESULTS = Path(__file__).parent / "results" / "soft.json"
MOMENTS = 8  # of a picture
SHORTER = 10  # of a replay: steps of the plan over its own
FINER = 0.0125  # s, of a plan that is replayed too, with the same steps


@dataclass(frozen=True)
class Case:
    """What a body does, m, and the most that a motor may do, N kg^-½."""

    body: str
    task: str
    distance: float
    limit: float
    height: float | None = None

    def course(self, dt: float = 0.025) -> Course:
        body = getattr(octo.soft, self.body)()
        given: dict[str, Any] = {"height": self.height, "limit": self.limit, "dt": dt}
        return soft_course(body, self.task, self.distance, **given)


CASES = {
    "ball, jump": Case("ball", "jump", -0.4, 300.0, 0.25),
    "ball, roll": Case("ball", "roll", 1.0, 60.0),
    "beam, jump": Case("beam", "jump", -0.6, 200.0, 0.25),
    "beam, crawl": Case("beam", "crawl", 0.5, 80.0),
}


def figures(motion: octo.Solution) -> dict[str, Any]:
    """Of one solve."""
    flying = ~motion.loaded.any(axis=1)
    (asked,) = motion.asked
    return {
        "status": motion.status.label,
        "met": asked.met,
        "iterations": motion.iterations,
        "energy": motion.energy,
        "violation": motion.violation,
        "seconds": motion.processor_seconds,
        "limit_used": float(np.abs(motion.u).max()),
        "held": all(bound.held for bound in motion.bounds),
        "way": (motion.x[-1, :3] - motion.x[1, :3]).tolist(),
        "top": float(motion.x[1:, 2].max() - motion.x[1, 2]),
        "in_the_air": float(motion.intervals[flying].sum()),
        "largest_angles": np.abs(motion.x[1:, 3:6]).max(axis=0).tolist(),
        "bends": motion.bends,
        "sinks": motion.penetration_max,
    }


def replayed(course: Course, motion: octo.Solution, times: int) -> dict[str, float]:
    """m, how far the centre of mass is from the plan when it is played back in shorter steps: at
    the end, and at most."""
    dynamics = course.problem.dynamics
    assert isinstance(dynamics, octo.soft.SoftDynamics)
    played = octo.soft_replay(motion, dynamics, times)
    off = np.linalg.norm(played.x[1::times, :3] - motion.x[1:, :3], axis=1)
    return {"end": float(off[-1]), "most": float(off.max())}


def compared(course: Course) -> dict[str, Any]:
    """IPOPT, from octo's own start."""
    return figures(course.said(ipopt(course.problem).solution))


def draw(motion: octo.Solution, path: Path) -> None:
    """The surface at some moments, seen from the side."""
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure

    from octo.soft.skin import posed

    assert motion.soft is not None
    size = float(motion.soft.body.size.max())
    figure = Figure(figsize=(2.0 * MOMENTS, 2.2), layout="constrained")
    panels = figure.subplots(1, MOMENTS, sharex=True, sharey=True)
    for axes, k in zip(panels, np.linspace(0, motion.steps, MOMENTS).astype(int), strict=True):
        for surface, shade in posed(motion.soft, motion.x[k + 1]):
            corners = surface.vertices[surface.faces]
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            normal /= np.linalg.norm(normal, axis=1)[:, None]
            seen = normal[:, 1] < 0.0
            light = 0.55 + 0.45 * np.clip(0.6 * normal[seen, 2] - 0.8 * normal[seen, 1], 0.0, 1.0)
            color = np.clip(light[:, None] * shade * 1.2, 0.0, 1.0)
            axes.add_collection(PolyCollection(corners[seen][:, :, [0, 2]], facecolors=color))
        axes.axhline(0.0, color="black", linewidth=0.8)
        axes.set_title(f"{motion.times[k]:.2f} s", fontsize=8)
        axes.set_aspect("equal")
    along = motion.x[1:, 0]
    panels[0].set_xlim(along.min() - 0.6 * size, along.max() + 0.6 * size)
    panels[0].set_ylim(-0.05, motion.x[1:, 2].max() + 0.6 * size)
    figure.savefig(path, dpi=90, bbox_inches="tight")


def measured(
    names: Sequence[str],
    seeds: Sequence[int],
    plots: Path | None = None,
    other: bool = True,
    most: int = 1500,
) -> dict[str, Any]:
    """The figures of these cases from these starts; with ``other`` also IPOPT's of the ball's jump,
    and of the first start's motion what is left of it in steps of a tenth. Pictures of the first
    one into a folder.

    most: iterations.
    """
    found: dict[str, Any] = {}
    how: dict[str, Any] = {"device": "cpu", "threads": 1}
    for name in names:
        case = CASES[name]
        course = case.course()
        solve_soft(course, max_iterations=1, **how)  # what is compiled
        own: dict[str, Any] = {"limit": case.limit, "starts": {}}
        motions = []
        for seed in seeds:
            motions.append(solve_soft(course, seed=seed, max_iterations=most, **how))
            own["starts"][str(seed)] = figures(motions[-1])
            print(name, seed, json.dumps(own["starts"][str(seed)]), flush=True)
        if plots is not None:
            draw(motions[0], plots / f"soft_{name.replace(', ', '_')}.png")
        if other:
            finer = case.course(FINER)
            motion = solve_soft(finer, max_iterations=most, **how)
            own["replay"] = {
                "0.025": replayed(course, motions[0], SHORTER),
                str(FINER): replayed(finer, motion, SHORTER // 2),
            }
            print(name, json.dumps(own["replay"]), flush=True)
        if name == "ball, jump" and other:
            own["ipopt"] = compared(course)
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
