"""Fig. 8: a chain of five links moves for 40 s, by Algorithm 1 and by octo's default."""

from __future__ import annotations

from typing import Any

import octo
from benchmarks.paper import timed
from benchmarks.paper.curves import converging, thinned
from benchmarks.paper.page import Row, ending, number, on_gpu, seconds
from benchmarks.paper.timed import WAYS, solved

TITLE = "A chain of five links, 40 s (Fig. 8)"
PANELS = 2
DT, SPEED = 0.05, 0.5  # s, m/s
LIMIT = 3000  # iterations


def chain(steps: int, basis: str = "hermite", links: int = 5) -> octo.Problem:
    """E of Eq. 17 and the effort; the speed wanted is not in the paper."""
    costs = octo.costs.paper((SPEED, 0.0, 0.0))
    robot = octo.gallery.chain(links)
    return octo.Problem(robot, steps=steps, dt=DT, costs=costs, basis=basis)


def measure(short: bool) -> dict[str, Any]:
    """Both ways from one start: the static pose with smooth noise."""
    steps, limit = (80, 40) if short else (800, LIMIT)
    problem, found = chain(steps), []
    for way, options in WAYS.items():
        how: dict[str, Any] = {"options": options, "passes": 1, "device": "cpu"}
        one = octo.solve(problem, max_iterations=limit, **how)
        along = float(one.com[-1, 0] - one.com[0, 0])
        curve = thinned(one.history, ("energy", "violation"))
        found.append({"way": way, **solved(one), "travel": along, "curve": curve})
    segments = problem.basis_object.units(steps)
    return {
        "steps": steps,
        "controls": int(segments),
        "degrees": problem.dynamics.nx,
        "seconds": steps * DT,
        "iteration_limit": limit,
        "ways": found,
        "gpu": timed.on_gpu(problem, "algorithm-1", limit),
    }


def draw(records: dict[str, Any], axes: Any) -> None:
    """As Fig. 8a."""
    converging(axes, {one["way"]: one["curve"] for one in records["ways"]})


def rows(records: dict[str, Any]) -> list[Row]:
    """What the text of section 8.3 says of the full horizon."""
    paper, default = records["ways"]
    size = f"{records['degrees']} DOF, N = {records['steps']}, Z = {records['controls']}"

    def each(one: dict[str, Any]) -> str:
        return seconds(one["seconds"] / one["iterations"])

    return [
        Row(
            "the problem",
            "14 DOF, 40 s, N = 800, Z = 80",
            size,
            "segments of ten steps, with a control at each end",
        ),
        Row(
            "Algorithm 1: how it ends",
            "“converges in 2200 iterations”",
            f"{ending(paper)}, E {number(paper['energy'], 3)}, ‖C‖∞ {number(paper['violation'])} N",
            f"travels {number(paper['travel'])} m of {number(SPEED * records['seconds'])} m",
        ),
        Row("its time", "110 s on a GPU", seconds(paper["seconds"]), "one core"),
        Row("of one iteration", "48 ms on a GPU", each(paper), "one core"),
        Row("Algorithm 1 on a GPU", "110 s", on_gpu(records["gpu"])),
        Row(
            "octo's default: how it ends",
            "–",
            f"{ending(default)}, E {number(default['energy'], 3)}, ‖C‖∞ "
            f"{number(default['violation'])} N",
            f"travels {number(default['travel'])} m",
        ),
        Row(
            "its time, and of one iteration", "–", f"{seconds(default['seconds'])}, {each(default)}"
        ),
    ]
