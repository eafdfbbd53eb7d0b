"""What octo's own Python holds more after some calls of a control loop than before, by
tracemalloc."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import octo
from octo.mpc import Controller
from octo.plant import MujocoPlant


def held(controller: Controller, plant: MujocoPlant, warm: int, calls: int) -> tuple[int, int]:
    """Bytes and blocks after ``calls`` calls of 10 ms, five commands each; ``warm`` calls and 100
    traced ones come first."""
    own = tracemalloc.Filter(True, str(Path(octo.__file__).parent / "*"))

    def some(first: int, count: int) -> None:
        for k in range(first, first + count):
            controller.step(0.01 * k, plant.q, plant.v)
            for j in range(5):
                plant.step(controller.command(0.01 * k + 0.002 * j, plant.q, plant.v))

    some(0, warm)
    tracemalloc.start()
    try:
        some(warm, 100)
        before = tracemalloc.take_snapshot().filter_traces([own])
        some(warm + 100, calls)
        after = tracemalloc.take_snapshot().filter_traces([own])
    finally:
        tracemalloc.stop()
    difference = after.compare_to(before, "filename")
    return sum(d.size_diff for d in difference), sum(d.count_diff for d in difference)
