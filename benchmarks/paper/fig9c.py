"""Fig. 9c: one iteration against the number of links."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.paper import timed
from benchmarks.paper.fig8 import chain
from benchmarks.paper.page import Row, number, on_gpu
from benchmarks.paper.timed import WAYS, iteration

TITLE = "Growth with the number of links (Fig. 9c)"
PANELS = 1
LINKS = (3, 4, 5, 6, 8, 10, 12)
FEW = (3, 5)


def measure(short: bool) -> dict[str, Any]:
    """s of one iteration, of both ways, by links."""
    links, steps, count, repeats = (FEW, 80, 5, 1) if short else (LINKS, 800, 20, 3)
    problems = [chain(steps, links=each) for each in links]
    degrees = [problem.dynamics.nx for problem in problems]
    ways = {}
    for way in WAYS:
        taken = [iteration(problem, way, count, repeats)["seconds"] for problem in problems]
        power = float(np.polyfit(np.log(degrees), np.log(taken), 1)[0])
        ways[way] = {"seconds": taken, "power": power}
    gpu = [timed.on_gpu(problem, "algorithm-1", count) for problem in problems]
    own = {"links": list(links), "degrees": degrees}
    return {"steps": steps, **own, "ways": ways, "gpu": gpu}


def draw(records: dict[str, Any], axes: Any) -> None:
    """As in the paper."""
    for way, own in records["ways"].items():
        axes[0].plot(records["links"], 1e3 * np.array(own["seconds"]), "o-", label=way)
    axes[0].set(xlabel="links", ylabel="one iteration (ms)", ylim=(0.0, None))


def rows(records: dict[str, Any]) -> list[Row]:
    """The ends, and the power of the degrees of freedom."""
    paper, default = (records["ways"][way] for way in ("algorithm-1", "default"))
    found = [
        Row(
            f"one iteration, {records['links'][k]} links ({records['degrees'][k]} DOF)",
            "in the plot alone",
            f"{number(1e3 * paper['seconds'][k])} ms, default "
            f"{number(1e3 * default['seconds'][k])} ms",
        )
        for k in (0, -1)
    ]
    return [
        *found,
        Row(
            "growth with |x|",
            "“parallel algorithmic complexity: O(|x|²)”",
            f"|x|^{number(paper['power'])}, default |x|^{number(default['power'])}",
            "the factorisation is O(|x|³) on one core, the rest less",
        ),
        Row(
            f"Algorithm 1 on a GPU, {records['links'][0]} and {records['links'][-1]} links",
            "in the plot alone",
            "; ".join(dict.fromkeys(on_gpu(records["gpu"][k]) for k in (0, -1))),
        ),
    ]
