"""How long it takes to detect contact with a world, and an iteration on it: 1 to 1,000 boxes.

    python -m benchmarks.world [--boxes 1 10 100 1000] [--repeats 20] [--json FILE] [--png FILE]

Boxes lie on a ground, four a square metre, turned about z; worlds are the same around the middle,
where four feet walk. Look-ups are φ with its derivatives up to an order, at 1,600 places of the
feet. Detection and an iteration are those of a mammal that is carried through the middle, N = 400,
one foot 3 mm deep: detection is what the dynamics look up at all nodes, without and with what
second derivatives need. At last an iteration of the mammal's standing start on a plane and on a
floor that is a grid of distances (extra ``mesh``), with two lists of terms. Processor time of one
thread, worlds taking turns, the least of all repeats, of iterations the median too.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from scipy.spatial.transform import Rotation

import octo
from octo import native
from octo.bench.iteration import Iteration, sample
from octo.checks import Array
from octo.dynamics import codegen
from octo.dynamics.evaluate import RobotDynamics
from octo.world import query
from octo.world.jet import ORDERS

STEPS = 400
PHASES = (0.0, 0.5, 0.5, 1.0)  # of the feet's steps
FEET = ("front_left", "front_right", "hind_left", "hind_right")
WAY, DEEP = 0.6, 0.003  # m, how far a mammal is carried, and how deep it touches
# kinematics of all nodes and, with ``looks``, what the world says at the contacts
NODES = """
double octo_nodes(int steps, int order, int looks, const double *nodes, const double *p) {
  octo_lanes *s = aligned_alloc(64, (sizeof(octo_lanes) + 63) / 64 * 64);
  double sum = 0.0;
  octo_lanes_begin(s, nodes, 0, steps + 1);
  for (int node = 0; node < steps + 2; node += STEPS) {
    const double *from[STEPS];
    for (int k = 0; k < STEPS; ++k)
      from[k] = nodes + (size_t)(node + k < steps + 1 ? node + k : steps + 1) * NX;
    octo_gather(from, NX, s->now);
    octo_kin(s->now, s->now + NX);
    if (looks) octo_look(p, order + 1, s->now + NX, &s->looks);
    sum += s->now[NX][0] + LOOKED(s->now + NX, 0)[0][0];
  }
  free(s);
  return sum;
}
"""


def boxes(count: int) -> list[octo.shapes.Shape]:
    """Boxes around the origin, nearest first."""
    rng = np.random.default_rng(0)
    side = 0.5 * np.sqrt(count)
    places = rng.uniform(-side / 2.0, side / 2.0, (count, 2))
    return [
        octo.shapes.Box(
            (0.3, 0.2, rng.uniform(0.1, 0.3)),
            position=(*place, 0.0),
            rotation=Rotation.from_euler("z", rng.uniform(0.0, np.pi)).as_matrix(),
        )
        for place in places[np.argsort(np.linalg.norm(places, axis=1))]
    ]


def feet() -> Array:
    """(4 STEPS, 3) m: where four feet are that walk through the middle."""
    t = np.linspace(0.0, 1.0, STEPS)
    ways = []
    for foot, phase in enumerate(PHASES):
        side = np.full(STEPS, 0.15 if foot % 2 else -0.15)
        lift = 0.03 + 0.05 * np.maximum(0.0, np.sin(2.0 * np.pi * (8.0 * t + phase)))
        ways.append(np.stack([1.4 * t - 0.7, side, lift], axis=1))
    return np.ascontiguousarray(np.concatenate(ways, axis=1).reshape(-1, 3))


def least(repeats: int, *tasks: Callable[[], Any]) -> list[float]:
    """s of processor time of each task; they take turns."""
    best = [np.inf] * len(tasks)
    for _ in range(repeats):
        for k, task in enumerate(tasks):
            began = time.process_time()
            task()
            best[k] = min(best[k], time.process_time() - began)
    return best


def carried(robot: octo.Character, world: octo.World) -> Array:
    """(STEPS + 2, n): standing, and carried through the middle, one foot DEEP in what is there."""
    nodes = np.repeat(robot.start_pose[None], STEPS + 2, axis=0)
    nodes[:, 0] += WAY * np.linspace(-0.5, 0.5, len(nodes))
    own = [robot.contact_index(name) for name in FEET]
    for _ in range(5):
        centers = octo.kinematics.sphere_centers(robot, nodes)[:, own]
        height = world.distance(centers.reshape(-1, 3)).reshape(len(nodes), -1)
        nodes[:, 2] -= (height - [robot.contacts[k].radius for k in own]).min(axis=1) + DEEP
    return nodes


def detection(
    robot: octo.Character, world: octo.World, nodes: Array
) -> Callable[[int, int], Callable[[], Any]]:
    """(order, looks) -> a pass over the nodes, with or without what the world says."""
    dynamics = RobotDynamics(robot, terrain=world)
    library = native.load(dynamics.lanes_text() + codegen.batch_source() + NODES)
    assert library is not None
    library.octo_nodes.restype = ctypes.c_double
    p = dynamics.bound(dynamics.layout.pack()[None])
    places = [ctypes.c_void_p(array.ctypes.data) for array in (nodes, p)]

    def task(order: int, looks: int) -> Callable[[], Any]:
        held = nodes, p  # as long as the task
        return lambda: (library.octo_nodes(STEPS, order, looks, *places), held)[0]

    return task


def problem_of(
    robot: octo.Character, terrain: octo.Plane | octo.World, natural: bool = False
) -> octo.Problem:
    costs = octo.costs.natural(0.5) if natural else octo.costs.paper()
    return octo.Problem(robot, steps=STEPS, dt=0.025, costs=costs, terrain=terrain)


def look_ups(worlds: Sequence[octo.World], repeats: int) -> list[dict[str, float]]:
    """Of each world, ns a point by order, and ms to make it and to move a shape."""
    data, points = [world.data for world in worlds], feet()
    made = least(3, *[lambda w=w: octo.World(w.shapes).data for w in worlds])
    moved = least(3, *[lambda w=w: w.moved(1, (0.0, 0.0, 0.1)) for w in worlds])
    queries = [
        least(repeats, *[lambda d=d, k=k: query.compiled(d, points, k) for d in data])
        for k in ORDERS
    ]
    heads = ["made ms", "moved ms", *(f"order {k} ns" for k in ORDERS)]
    scales = [1e3, 1e3, *(1e9 / len(points) for _ in ORDERS)]
    rows = np.array([made, moved, *queries]).T * scales
    return [dict(zip(heads, map(float, row), strict=True)) for row in rows]


def in_dynamics(worlds: Sequence[octo.World], repeats: int) -> list[dict[str, float]]:
    """Of each world, us a step of detection, for FD and for its curvature, and ms an iteration."""
    robot = octo.gallery.mammal()
    nodes = [carried(robot, world) for world in worlds]
    own = [detection(robot, world, each) for world, each in zip(worlds, nodes, strict=True)]
    kinds = [(order, looks) for order in (0, 2) for looks in (0, 1)]
    seconds = np.reshape(least(repeats, *[o(*kind) for o in own for kind in kinds]), (-1, 2, 2))
    found = 1e6 * (seconds[..., 1] - seconds[..., 0]) / STEPS
    runs = {
        str(k): Iteration(problem_of(robot, world), nodes=each)
        for k, (world, each) in enumerate(zip(worlds, nodes, strict=True))
    }
    totals = [1e3 * each.sum(axis=1) for each in sample(runs, repeats, 1).values()]
    return [
        {
            "detection us": float(us[0]),
            "with curvature us": float(us[1]),
            "iteration ms": float(total.min()),
            "median ms": float(np.median(total)),
        }
        for us, total in zip(found, totals, strict=True)
    ]


def of_grid(repeats: int) -> list[dict[str, Any]]:
    """An iteration on a floor that is a grid of distances over one on a plane."""
    from benchmarks.maps import block

    robot, floor, records = octo.gallery.mammal(), octo.World([block()]), []
    for name in ("paper", "natural"):
        made = [problem_of(robot, ground, name == "natural") for ground in (octo.Plane(), floor)]
        runs = {str(k): Iteration(problem) for k, problem in enumerate(made)}
        plane, grid = (each.sum(axis=1) for each in sample(runs, 2 * repeats, 1).values())
        ratios = {"least": grid.min() / plane.min(), "median": float(np.median(grid / plane))}
        records.append({"terms": name, "plane ms": 1e3 * plane.min(), **ratios})
    return records


def table(records: Sequence[dict[str, Any]]) -> None:
    print("".join(f"{head:>18s}" for head in records[0]))
    for record in records:
        each = (f"{v:18.2f}" if isinstance(v, float) else f"{v:>18}" for v in record.values())
        print("".join(each))


def draw(records: Sequence[dict[str, Any]], path: Path) -> None:
    """Detection and an iteration by the number of boxes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 3.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    boxes = [record["boxes"] for record in records]
    for head, label in (("detection us", "for FD"), ("with curvature us", "and its curvature")):
        left.semilogx(boxes, [record[head] for record in records], "o-", label=label)
    left.set(xlabel="boxes", ylabel="detection, µs a step")
    left.legend()
    right.semilogx(boxes, [record["iteration ms"] for record in records], "o-", color="tab:green")
    right.set(xlabel="boxes", ylabel="an iteration, N = 400, ms")
    for axes in (left, right):
        axes.set_ylim(0.0, 1.1 * max(max(line.get_ydata()) for line in axes.lines))
    figure.savefig(path, dpi=110)


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--boxes", type=int, nargs="+", default=[1, 10, 100, 1000])
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--png", type=Path)
    chosen = parser.parse_args(words)
    scattered = boxes(max(chosen.boxes))
    worlds = [octo.World([octo.shapes.Ground(), *scattered[:n]]) for n in chosen.boxes]
    looked, moving = look_ups(worlds, chosen.repeats), in_dynamics(worlds, chosen.repeats)
    table([{"boxes": n, **own} for n, own in zip(chosen.boxes, looked, strict=True)])
    table([{"boxes": n, **own} for n, own in zip(chosen.boxes, moving, strict=True)])
    records = [
        {"boxes": n, **one, **other}
        for n, one, other in zip(chosen.boxes, looked, moving, strict=True)
    ]
    grid = of_grid(chosen.repeats)
    table(grid)
    if chosen.json is not None:
        chosen.json.write_text(
            json.dumps({"boxes": records, "grid": grid}, indent=1) + "\n", encoding="utf-8"
        )
    if chosen.png is not None:
        draw(records, chosen.png)
    return 0


if __name__ == "__main__":
    sys.exit(main())
