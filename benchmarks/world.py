"""How long it takes to detect contact with a world of many shapes: 1 to 1,000 boxes.

    python -m benchmarks.world [--boxes 1 10 100 1000] [--repeats 20] [--json FILE]

Boxes lie on a ground, four a square metre, turned about z; worlds are the same around the middle,
where four feet walk. What is measured is φ with its derivatives up to an order, at 1,600 places of
the feet: processor time of one thread, worlds taking turns, the least of all repeats; beside it,
how long it takes to make a world and to move one shape.
"""

from __future__ import annotations

import argparse
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
from octo.checks import Array
from octo.world import query
from octo.world.jet import ORDERS

STEPS = 400
PHASES = (0.0, 0.5, 0.5, 1.0)  # of the feet's steps


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


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--boxes", type=int, nargs="+", default=[1, 10, 100, 1000])
    parser.add_argument("--repeats", type=int, default=20)
    parser.add_argument("--json", type=Path)
    chosen = parser.parse_args(words)
    scattered, points = boxes(max(chosen.boxes)), feet()
    worlds = [octo.World([octo.shapes.Ground(), *scattered[:n]]) for n in chosen.boxes]
    data = [world.data for world in worlds]
    made = least(3, *[lambda w=w: octo.World(w.shapes).data for w in worlds])
    moved = least(3, *[lambda w=w: w.moved(1, (0.0, 0.0, 0.1)) for w in worlds])
    queries = [
        least(chosen.repeats, *[lambda d=d, k=k: query.compiled(d, points, k) for d in data])
        for k in ORDERS
    ]
    heads = ["made ms", "moved ms", *(f"order {k} ns" for k in ORDERS)]
    print(f"{'boxes':>6s}" + "".join(f"{head:>12s}" for head in heads))
    records = []
    for n, build, move, *each in zip(chosen.boxes, made, moved, *queries, strict=True):
        row = [1e3 * build, 1e3 * move, *(1e9 * seconds / len(points) for seconds in each)]
        print(f"{n:6d}" + "".join(f"{number:12.2f}" for number in row))
        records.append({"boxes": n, **dict(zip(heads, row, strict=True))})
    if chosen.json is not None:
        chosen.json.write_text(json.dumps(records, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
