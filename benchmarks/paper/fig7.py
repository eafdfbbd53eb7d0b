"""Fig. 7: a biped walks, in three passes of stiffer contact, w_perp = w_par = 3e3, 1e4, 1e5."""

from __future__ import annotations

from typing import Any

import numpy as np

import octo
from benchmarks.paper.curves import converging, every, thinned
from benchmarks.paper.page import Row, ending, number
from benchmarks.paper.timed import WAYS, solved

TITLE = "Three passes of a walk (Fig. 7)"
PANELS = 3
WEIGHTS = (3e3, 1e4, 1e5)  # N/m² and N s/m³, as printed: "3E3, 1E4, 10E4"
DT, SPEED = 0.025, 0.5  # s, m/s
LIMIT = 3000  # iterations of a pass


def task(w: float, steps: int) -> octo.Problem:
    """The biped's walk of section 8.5, on a contact of this stiffness, with no smoothed onset."""
    numbers = {"contact.w_perp": w, "contact.w_par": w, "contact.onset": 0.0}
    costs = octo.costs.paper((SPEED, 0.0, 0.0))
    robot, how = octo.gallery.biped(), {"basis": "hermite", "parameters": numbers}
    return octo.Problem(robot, steps=steps, dt=DT, costs=costs, **how)


def solve(
    w: float, steps: int, way: str, limit: int, before: octo.Solution | None = None
) -> octo.Solution:
    """One pass, from the motion of the one before as much higher as its start is, or from the
    static pose."""
    problem = task(w, steps)
    start = None if before is None else before.x[1:] + (problem.start - before.x[1])
    how: dict[str, Any] = {"options": WAYS[way], "passes": 1, "device": "cpu"}
    return octo.solve(problem, start=start, max_iterations=limit, **how)


def change(one: octo.Solution, other: octo.Solution) -> float:
    """Of the joints, root mean square, rad."""
    joints = slice(6, None)
    return float(np.sqrt(np.mean((one.x[1:, joints] - other.x[1:, joints]) ** 2)))


def passes(way: str, steps: int, limit: int) -> list[dict[str, Any]]:
    """Each from the motion of the one before."""
    records, before = [], None
    for w in WEIGHTS:
        found = solve(w, steps, way, limit, before)
        records.append(
            {
                "w": w,
                **solved(found),
                "penetration": found.penetration,
                "slip": found.slip,
                "travel": float(found.com[-1, 0] - found.com[0, 0]),
                "change": 0.0 if before is None else change(before, found),
                "force": every(found.contact_force[:, :, 2].sum(axis=1), 200),
                "curve": thinned(found.history, ("energy", "violation")),
            }
        )
        before = found
    return records


def measure(short: bool) -> dict[str, Any]:
    """The three passes of both ways; ``alone``: each by the default from the static pose."""
    steps, limit = (40, 30) if short else (400, LIMIT)
    robot = octo.gallery.biped()
    return {
        "steps": steps,
        "seconds": steps * DT,
        "weight": robot.mass * 9.81,
        "ways": {way: passes(way, steps, limit) for way in WAYS},
        "alone": [solved(solve(w, steps, "default", limit)) for w in WEIGHTS],
    }


def draw(records: dict[str, Any], axes: Any) -> None:
    """Contact forces and convergence of octo's default."""
    own = records["ways"]["default"]
    for one in own:
        times = np.linspace(0.0, records["seconds"], len(one["force"]))
        axes[0].plot(times, one["force"], lw=0.8, label=f"w = {number(one['w'])}")
    axes[0].set(xlabel="time (s)", ylabel="vertical contact force (N)")
    converging(axes[1:], {f"w = {number(one['w'])}": one["curve"] for one in own})


def rows(records: dict[str, Any]) -> list[Row]:
    """Three passes, and what the text says of them."""
    paper, default = (records["ways"][way] for way in ("algorithm-1", "default"))
    found = [
        Row(
            f"pass {k}, w⊥ = w∥ = {number(one['w'])}",
            "in the plot alone",
            f"{ending(one)}, {number(one['seconds'])} s, E {number(one['energy'], 3)}, sinks "
            f"{number(1e3 * one['penetration'])} mm, slips {number(one['slip'])} m/s",
            f"from the static pose: {ending(alone)}, E {number(alone['energy'], 3)}",
        )
        for k, (one, alone) in enumerate(zip(default, records["alone"], strict=True), 1)
    ]
    again = [one["iterations"] for one in default]
    verbatim = ", ".join(f"{ending(one)} (E {number(one['energy'], 3)})" for one in paper)
    return [
        *found,
        Row(
            "the later passes",
            "“the speed of convergence is much higher in the second and third passes”",
            f"{number(again[1] / again[0])} and {number(again[2] / again[0])} of the first one's "
            "iterations",
            "octo's default",
        ),
        Row(
            "from pass to pass",
            "“the difference between the second and third pass is very small”",
            f"joints change by {number(default[1]['change'])} rad, then by "
            f"{number(default[2]['change'])} rad",
            "root mean square over the motion",
        ),
        Row("Algorithm 1, the three passes", "in the plot alone", verbatim, "as printed"),
    ]
