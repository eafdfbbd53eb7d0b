"""Fig. 10 and its table: a walk of 10 s in every formulation and optimiser (section 8.4)."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks import formulations
from benchmarks.paper import timed
from benchmarks.paper.page import NOT_RUN, Row, ending, number, on_gpu

TITLE = "Formulations and optimisers, mammal, 10 s (Fig. 10 and its table)"
PANELS = 2
WORDS = {
    "lm-ours": "LM-Ours",
    "lbfgs-ours": "LBFGS-Ours",
    "lm-cio": "LM-CIO",
    "lbfgs-cio": "LBFGS-CIO",
    "algorithm-1": "TR-Ours (Algorithm 1)",
    "ipopt": "IPOPT-Ours",
    "default": "octo's default",
}


def measure(short: bool) -> dict[str, Any]:
    """The records of benchmarks.formulations; a short run leaves out CIO, which takes minutes to
    compile."""
    steps, iterations = (40, 40) if short else (400, 3000)
    problem = formulations.task(steps)
    found = [
        formulations.record(way, *formulations.solve(problem, way, iterations))
        for way in formulations.WAYS
        if not (short and way.endswith("cio"))
    ]
    gpu = timed.on_gpu(problem, "algorithm-1", iterations)
    return {"steps": steps, "iteration_limit": iterations, "ways": found, "gpu": gpu}


def draw(records: dict[str, Any], axes: Any) -> None:
    """E and ‖C‖∞ against iterations."""
    for own in records["ways"]:
        curve = own["curve"]
        for one, name in zip(axes, ("energy", "violation"), strict=True):
            one.loglog(np.array(curve["iteration"]) + 1, curve[name], label=WORDS[own["way"]])
    axes[0].set(xlabel="iteration", ylabel="E")
    axes[1].set(xlabel="iteration", ylabel="‖C‖∞ (N)")


def rows(records: dict[str, Any]) -> list[Row]:
    """One of each way, and those that a GPU would run."""
    ways = {one["way"]: one for one in records["ways"]}

    def ended(way: str) -> str:
        if way not in ways:
            return NOT_RUN
        one = ways[way]
        return (
            f"{ending(one)}, {number(one['seconds'])} s, E {number(one['energy'], 3)}, "
            f"{number(one['violation'])} N"
        )

    def over(way: str, other: str) -> str:
        return f"{number(ways[way]['seconds'] / ways[other]['seconds'])}"

    soft, hard = ways["lm-ours"], ways["default"]
    return [
        Row(
            WORDS["lm-ours"],
            "124 s on a GPU, ‖C‖∞ 0.012 N",
            ended("lm-ours"),
            f"hard constraints leave {number(hard['violation'])} N (the default)",
        ),
        Row(
            WORDS["lbfgs-ours"],
            "“much slower than that of the LM algorithm”",
            ended("lbfgs-ours"),
            f"E is {number(ways['lbfgs-ours']['energy'] / soft['energy'])} times that of LM after "
            "as many iterations",
        ),
        Row(
            WORDS["lm-cio"],
            "around 3000 iterations, ‖FD‖∞ 0.008 N",
            ended("lm-cio"),
            "E is 1 where the robot stands still",
        ),
        Row(WORDS["lbfgs-cio"], "in Fig. 10 alone", ended("lbfgs-cio"), ""),
        Row(
            WORDS["algorithm-1"],
            "200 s on a GPU, ‖C‖∞ below 10⁻⁵ N",
            ended("algorithm-1"),
            "as printed; `SqpOptions.paper()`",
        ),
        Row(
            WORDS["default"],
            "–",
            ended("default"),
            f"{over('algorithm-1', 'default')} times as fast as Algorithm 1, "
            f"{over('ipopt', 'default')} as IPOPT",
        ),
        Row(
            WORDS["ipopt"],
            "“comparable to our method”; the GPU 30 × faster",
            ended("ipopt"),
            f"iterations over the default's: {number(_iterations(ways, 'ipopt', 'default'))}",
        ),
        Row("Algorithm 1 on a GPU", "200 s, 40 × its CPU", on_gpu(records["gpu"])),
        Row(
            "LM on a GPU",
            "124 s, 80 × its CPU, 101 × CIO's",
            NOT_RUN,
            "octo does not solve soft constraints on a GPU yet",
        ),
    ]


def _iterations(ways: dict[str, Any], way: str, other: str) -> float:
    return float(ways[way]["iterations"] / ways[other]["iterations"])
