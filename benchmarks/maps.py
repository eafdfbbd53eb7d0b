"""What maps and meshes cost: memory, the time to make them, and look-ups beside a plane's.

    python -m benchmarks.maps [--repeats 200] [--fine]

Look-ups are φ with its derivatives up to an order where the four feet of a walk are, 3 to 8 cm
above each shape: processor time of one thread, shapes taking turns, the least of all repeats.
``--fine`` makes the stairs at 1 cm too. The extra ``mesh`` is needed.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Sequence

import numpy as np

from benchmarks.world import feet, least
from octo import World, shapes
from octo.world import query
from octo.world.jet import ORDERS

RISE, RUN, STEPS, WIDTH = 0.15, 0.3, 20, 3.0  # m, of the stairs of a building
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
FACES = np.array([face for a, b, c, d in QUADS for face in ((a, b, c), (a, c, d))])
CORNERS = np.argwhere(np.ones((2, 2, 2)))


def stairs(cell: float) -> shapes.Mesh:
    """A box to each step, side by side."""
    sizes = [(RUN, WIDTH, (k + 1) * RISE) for k in range(STEPS)]
    boxes = [CORNERS * size + [k * RUN, 0.0, 0.0] for k, size in enumerate(sizes)]
    faces = [FACES + len(CORNERS) * k for k in range(STEPS)]
    return shapes.Mesh(np.concatenate(boxes), np.concatenate(faces), cell)


def yard() -> shapes.HeightField:
    """10 × 10 m of heights, a sample every 2 cm."""
    heights = 0.01 * np.random.default_rng(0).normal(size=(501, 501))
    return shapes.HeightField(heights, 0.02, origin=(-5.0, -5.0))


def block() -> shapes.Mesh:
    """A floor of 4 × 4 m as a mesh."""
    return shapes.Mesh((CORNERS - [0.5, 0.5, 1.0]) * [4.0, 4.0, 0.4], FACES)


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=200)
    parser.add_argument("--fine", action="store_true")
    chosen = parser.parse_args(words)
    with tempfile.TemporaryDirectory() as folder:
        os.environ["OCTO_CACHE"] = folder
        large = {"heights, 10 x 10 m at 2 cm": yard(), "stairs, 6 x 3 x 3 m at 2 cm": stairs(0.02)}
        if chosen.fine:
            large["the same at 1 cm"] = stairs(0.01)
        print(f"{'':30s}{'MB':>12s}{'made s':>12s}")
        for name, shape in large.items():
            (seconds,) = least(1, lambda shape=shape: shape.own)
            print(f"{name:30s}{1e-6 * shape.own.nbytes:12.1f}{seconds:12.2f}")
        floor = shapes.Box((4.0, 4.0, 0.4), position=(0.0, 0.0, -0.2))
        flat = {"plane": shapes.Ground(), "box": floor, "heights": yard(), "mesh": block()}
        data, points = [World([shape]).data for shape in flat.values()], feet()
        queries = [
            least(chosen.repeats, *[lambda d=d, k=k: query.compiled(d, points, k) for d in data])
            for k in ORDERS
        ]
    print(f"\n{'':30s}" + "".join(f"{f'order {k} ns':>12s}" for k in ORDERS))
    for name, *each in zip(flat, *queries, strict=True):
        print(f"{name:30s}" + "".join(f"{1e9 * t / len(points):12.1f}" for t in each))
    return 0


if __name__ == "__main__":
    sys.exit(main())
