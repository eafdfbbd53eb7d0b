"""What one iteration costs in a solve, in processor time of one thread."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import octo
from octo.gpu import cuda

WAYS: Mapping[str, octo.SqpOptions] = {
    "algorithm-1": octo.SqpOptions.paper(),
    "default": octo.SqpOptions(),
}


def iteration(problem: octo.Problem, way: str, count: int, repeats: int) -> dict[str, Any]:
    """s of one of the first ``count`` iterations, the least mean of some solves, and its stages.

    A solve that ends early counts the iterations that it took. The stages are wall time in parts
    of their sum.
    """
    how: dict[str, Any] = {"options": WAYS[way], "passes": 1, "device": "cpu"}
    found = [octo.solve(problem, max_iterations=count, **how) for _ in range(repeats)]
    best = min(found, key=lambda one: one.processor_seconds / one.iterations)
    whole = sum(best.stages.values())
    return {
        "way": way,
        "iterations": best.iterations,
        "seconds": best.processor_seconds / best.iterations,
        "stages": {name: value / whole for name, value in best.stages.items()},
    }


def on_gpu(problem: octo.Problem, way: str, limit: int) -> dict[str, Any] | None:
    """How a solve on this machine's GPU ended, in seconds of the wall; None where there is none."""
    if cuda.reason() is not None:
        return None
    how: dict[str, Any] = {"options": WAYS[way], "passes": 1, "device": "cuda"}
    found = octo.solve(problem, max_iterations=limit, **how)
    return {**solved(found), "seconds": found.seconds, "device": cuda.device().name}


def solved(found: octo.Solution) -> dict[str, Any]:
    """How a solve ended."""
    return {
        "status": found.status.label,
        "converged": bool(found.converged),
        "iterations": found.iterations,
        "seconds": found.processor_seconds,
        "energy": found.energy,
        "violation": found.violation,
    }
