"""Fig. 10 and its table: one walk of the mammal in every formulation and optimiser of section 8.4.

    python -m benchmarks.formulations [--steps 400] [--only WAY …] [--iterations 3000]
        [--json FILE] [--plot FILE]

From one start: the static pose with smooth noise. "ours" is E and C of this package with soft
constraints, "cio" contact-invariant optimisation. Times are processor time of one thread, without
code generation.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

import octo
from octo.reference import contact_invariant, ipopt
from octo.result.solution import Solution

DT, SPEED = 0.025, 0.5  # s, m/s
PENALTY = 10.0  # of C in mg
INTERACTION = 1000.0  # weight of E_int
WAYS = ("lm-ours", "lbfgs-ours", "lm-cio", "lbfgs-cio", "algorithm-1", "default", "ipopt")
SOFT = {"lm": "levenberg_marquardt", "lbfgs": "lbfgs"}


def task(steps: int) -> octo.Problem:
    """E of Eq. 17 and the effort, nothing else."""
    costs = [octo.CenterOfMassVelocity((SPEED, 0.0, 0.0)), octo.Effort()]
    return octo.Problem(octo.gallery.mammal(), steps=steps, dt=DT, costs=costs)


def solve(problem: octo.Problem, way: str, iterations: int) -> tuple[Solution, float]:
    """The solution, and newtons in one unit of its violation."""
    if way == "ipopt":
        limit = octo.SqpOptions(max_iterations=iterations)
        return ipopt(problem, options=limit).solution, 1.0
    optimiser, _, formulation = way.partition("-")
    unit = 1.0
    if formulation == "cio":
        unit, problem = problem.weight, contact_invariant(problem, weight=INTERACTION).problem
    if way == "algorithm-1":
        options = octo.SqpOptions.paper()
    elif way == "default":
        options = octo.SqpOptions()
    else:
        step: Any = SOFT[optimiser]
        options = octo.SqpOptions(step=step, hessian="gauss_newton", penalty=PENALTY)
    how: dict[str, Any] = {"options": options, "passes": 1, "device": "cpu"}
    return octo.solve(problem, max_iterations=iterations, **how), unit


def record(way: str, found: Solution, unit: float) -> dict[str, Any]:
    """What is known of one way, with its convergence."""
    history = found.history
    rows = np.unique(np.geomspace(1, max(len(history["energy"]), 1), 200).astype(int)) - 1
    return {
        "way": way,
        "status": found.status.label,
        "iterations": found.iterations,
        "seconds": round(found.processor_seconds, 2),
        "energy": found.energy - found.terms.get("Interaction", 0.0),
        "violation": unit * found.violation,
        "curve": {
            "iteration": rows.tolist(),
            "energy": history["energy"][rows].tolist(),
            "violation": (unit * history["violation"][rows]).tolist(),
        },
    }


def draw(records: Sequence[dict[str, Any]], path: Path) -> None:
    """E and ‖C‖∞ against iterations."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for own in records:
        curve = own["curve"]
        for axes, name in ((left, "energy"), (right, "violation")):
            axes.loglog(np.array(curve["iteration"]) + 1, curve[name], label=own["way"])
    left.set(xlabel="iteration", ylabel="E")
    right.set(xlabel="iteration", ylabel="‖C‖∞ (N)")
    right.legend(fontsize="small")
    figure.savefig(path, dpi=120)


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--iterations", type=int, default=3000)
    parser.add_argument("--only", nargs="+", default=WAYS, choices=WAYS)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--plot", type=Path)
    asked = parser.parse_args(words)
    problem, records = task(asked.steps), []
    for way in asked.only:
        began = time.perf_counter()
        found, unit = solve(problem, way, asked.iterations)
        own = record(way, found, unit)
        records.append(own)
        shown = {key: value for key, value in own.items() if key != "curve"}
        print(json.dumps(shown), f"{time.perf_counter() - began:.0f} s in all", flush=True)
        if asked.json is not None:
            asked.json.write_text(json.dumps(records, indent=1) + "\n")
    if asked.plot is not None:
        draw(records, asked.plot)
    return 0


if __name__ == "__main__":
    sys.exit(main())
