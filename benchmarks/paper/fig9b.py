"""Fig. 9b: 5000 iterations against the number of steps."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.paper import timed
from benchmarks.paper.fig8 import chain
from benchmarks.paper.page import Row, number, on_gpu
from benchmarks.paper.timed import WAYS, iteration

TITLE = "Growth with the number of steps (Fig. 9b)"
PANELS = 1
SIZES = (100, 200, 400, 800, 1600)
SMALL = (40, 80)
COUNT = 5000  # iterations


def measure(short: bool) -> dict[str, Any]:
    """s of one iteration, of both ways, by N."""
    sizes, count, repeats = (SMALL, 5, 1) if short else (SIZES, 30, 3)
    ways = {}
    for way in WAYS:
        taken = [iteration(chain(steps), way, count, repeats)["seconds"] for steps in sizes]
        power = float(np.polyfit(np.log(sizes), np.log(taken), 1)[0])
        ways[way] = {"seconds": taken, "power": power}
    gpu = [timed.on_gpu(chain(steps), "algorithm-1", count) for steps in sizes]
    return {"steps": list(sizes), "ways": ways, "gpu": gpu}


def draw(records: dict[str, Any], axes: Any) -> None:
    """As in the paper, from the first iterations."""
    for way, own in records["ways"].items():
        axes[0].loglog(records["steps"], COUNT * np.array(own["seconds"]), "o-", label=way)
    axes[0].set(xlabel="steps N", ylabel=f"{COUNT} iterations (s)")


def rows(records: dict[str, Any]) -> list[Row]:
    """One of each N, and the power."""
    paper, default = (records["ways"][way] for way in ("algorithm-1", "default"))
    found = [
        Row(
            f"{COUNT:,} iterations, N = {steps}",
            "in the plot alone",
            f"{number(COUNT * one)} s, default {number(COUNT * other)} s",
        )
        for steps, one, other in zip(
            records["steps"], paper["seconds"], default["seconds"], strict=True
        )
    ]
    return [
        *found,
        Row(
            "growth with N",
            "“increases slowly with the number of timesteps”",
            f"N^{number(paper['power'])}, default N^{number(default['power'])}",
            "one core: a constant of Python, then as N",
        ),
        Row(
            f"Algorithm 1 on a GPU, N = {records['steps'][0]} and {records['steps'][-1]}",
            "in the plot alone",
            "; ".join(dict.fromkeys(on_gpu(records["gpu"][k]) for k in (0, -1))),
        ),
    ]
