"""Fig. 9a: one iteration of the chain of Fig. 8, split into what it computes."""

from __future__ import annotations

from typing import Any

import numpy as np

import octo
from benchmarks import world
from benchmarks.paper.fig8 import chain
from benchmarks.paper.page import Row, number, seconds
from benchmarks.paper.timed import WAYS, iteration
from octo.bench.dynamics import TreeSweep
from octo.bench.timing import interleaved
from octo.dynamics.evaluate import RobotDynamics
from octo.starts import first_nodes

TITLE = "One iteration by its parts (Fig. 9a)"
PANELS = 1
BOXES = 100
PARTS = {
    "derivatives": "derivatives of FD",
    "detection": "collision detection",
    "products": "matrix products",
    "kkt": "the KKT system: factors, solves, subproblem",
    "trial": "the trial point",
}
COLOURS = ("#2f6db2", "#4f9a57", "#d0703c", "#e3b04b", "#8c8c8c")


def derivatives(problem: octo.Problem, order: int, rounds: int) -> float:
    """s of FD and its Jacobian (order 1), or with its curvature (2), at all nodes of the start."""
    dynamics, nodes, p = problem.dynamics, first_nodes(problem, 0, None), problem.p.copy()
    assert isinstance(dynamics, RobotDynamics)
    sweep = TreeSweep(dynamics, nodes, p)
    return interleaved({"sweep": sweep.run(order)}, rounds)["sweep"].least


def detection(problem: octo.Problem, boxes: int, order: int, rounds: int) -> float:
    """s of the look-ups of an iteration's derivatives in a world of a ground and so many boxes."""
    ground = octo.World([octo.shapes.Ground(), *world.boxes(boxes)])
    robot = problem.character
    assert robot is not None
    nodes = np.repeat(problem.start[None], world.STEPS + 2, axis=0)
    task = world.detection(robot, ground, np.ascontiguousarray(nodes))
    with_looks, without = world.least(rounds, task(order, 1), task(order, 0))
    return (with_looks - without) * problem.steps / world.STEPS


def measure(short: bool) -> dict[str, Any]:
    """s of each part of one iteration, of both ways."""
    steps, count, repeats, rounds = (80, 5, 1, 3) if short else (800, 40, 3, 20)
    problem, ways = chain(steps), []
    for way in WAYS:
        order = 1 if way == "algorithm-1" else 2
        found = iteration(problem, way, count, repeats)
        parts = {name: found["seconds"] * part for name, part in found["stages"].items()}
        own = derivatives(problem, order, rounds)
        looks = detection(problem, BOXES, order, rounds)
        ways.append(
            {
                "way": way,
                "derivatives": own,
                "detection": looks,
                "products": max(0.0, parts["linearize"] - own),
                "kkt": parts["factor"] + parts["solve"],
                "trial": parts["evaluate"],
                "linearize": parts["linearize"],
                "whole": found["seconds"],
            }
        )
    return {"steps": steps, "boxes": BOXES, "ways": ways}


def _shares(one: dict[str, Any]) -> dict[str, float]:
    """Of an iteration in a world, whose detection is not part of the one on a plane."""
    whole = sum(one[name] for name in PARTS)
    return {name: one[name] / whole for name in PARTS}


def draw(records: dict[str, Any], axes: Any) -> None:
    """One bar for each way."""
    names = [one["way"] for one in records["ways"]]
    left = np.zeros(len(names))
    for (name, label), colour in zip(PARTS.items(), COLOURS, strict=True):
        wide = np.array([100.0 * _shares(one)[name] for one in records["ways"]])
        axes[0].barh(names, wide, left=left, label=label, color=colour, height=0.5)
        left += wide
    axes[0].set(xlabel="% of an iteration", ylim=(-0.5, 2.9))


def rows(records: dict[str, Any]) -> list[Row]:
    """The paper has a plot without numbers, and one sentence."""
    paper, default = records["ways"]
    first, other = _shares(paper), _shares(default)
    found = [
        Row(
            label,
            "in the plot alone",
            f"{100.0 * first[name]:.0f} %, default {100.0 * other[name]:.0f} %",
            {
                "derivatives": "the default's with their curvature",
                "detection": f"a ground and {records['boxes']} boxes; on a plane it is none of its "
                "own",
                "products": "E's derivatives, and H, A, b and C of them",
                "trial": "FD, E and C where a step ends",
            }.get(name, "octo eliminates, a GPU reduces cyclically"),
        )
        for name, label in PARTS.items()
    ]
    most = sorted(PARTS, key=lambda name: -first[name])[:2]
    return [
        *found,
        Row(
            "what costs most",
            "“the derivative computation and the matrix factorization are the most costly "
            "substeps”",
            "; ".join(PARTS[name] for name in most),
            f"of Algorithm 1, {seconds(paper['whole'])} an iteration of N = {records['steps']} on "
            f"a plane; the default's is {number(1e3 * default['whole'])} ms",
        ),
    ]
