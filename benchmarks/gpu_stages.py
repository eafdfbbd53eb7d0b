"""One iteration of benchmarks/gpu.py kernel by kernel: what its kernels do, how long each takes,
and how many they are.

Every kernel is waited for, so that its time has the launch and the waiting in it; those of an empty
kernel are taken off. Contact detection is no kernel of its own: phases.c finds the depth of a
contact sphere, its force and the derivatives of both in one phase, between the bodies and the
products, within octo_curvature. What is said of it here is by how much longer the derivatives take
than those of the same robot without contact spheres, at the same nodes.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
from gpu_bench import WARM, Bench, OneIteration

import octo
from octo.gpu.backend import DeviceBackend

GROUPS = {  # kernels by what they do; octo_kin_of_nodes belongs to what comes after it
    "derivatives": "jacobian curvature cost_derivatives",
    "products": "step_model gather_hessian gather_constraints",
    "factorisation": "kkt_blocks kkt_finite kkt_equilibrate kkt_scale kkt_pivots kkt_couple "
    "kkt_complement kkt_verdict",
    "solution": "negative kkt_join kkt_part kkt_fold kkt_unfold kkt_last kkt_residual kkt_check",
    "trial": "step_numbers advance nodes value terms summary constraints unit_sizes",
}
OTHER = "other"  # kernels that have no group above
CONTACT = "contact detection"
NAMES = ("derivatives", CONTACT, *list(GROUPS)[1:], OTHER)
KNOWN = {f"octo_{name}": group for group, names in GROUPS.items() for name in names.split()}
KIN = "octo_kin_of_nodes"
EMPTY = "octo_work_size"
Log = list[tuple[str, float]]  # kernels and their seconds, in order


class Timed:
    """A kernel that waits for itself and writes down its seconds."""

    def __init__(self, kernel: Any, name: str, device: Any, log: Log):
        self.kernel, self.name, self.device, self.log = kernel, name, device, log

    def __call__(self, *arguments: Any, **named: Any) -> None:
        self.device.synchronize()
        began = time.perf_counter()
        self.kernel(*arguments, **named)
        self.device.synchronize()
        self.log.append((self.name, time.perf_counter() - began))


class TimedModule:
    def __init__(self, module: Any, device: Any, log: Log):
        self.kernel = lambda name: Timed(module.kernel(name), name, device, log)


def timed(device: Any, log: Log) -> Any:
    """The same device, whose kernels write down their time in ``log``: each is launched on its
    own."""
    made = object.__new__(type(device))
    made.__dict__.update(device.__dict__, graphs=False)
    made.module = lambda text: TimedModule(device.module(text), device, log)
    return made


def grouped(log: Log, empty: float) -> tuple[dict[str, float], dict[str, int]]:
    """ms and kernels by group."""
    seconds, kernels = dict.fromkeys((*GROUPS, OTHER), 0.0), dict.fromkeys((*GROUPS, OTHER), 0)
    for place, (name, value) in enumerate(log):
        follows = next((other for other, _ in log[place:] if other != KIN), name)
        group = KNOWN.get(follows if name == KIN else name, OTHER)
        seconds[group] += 1e3 * max(0.0, value - empty)
        kernels[group] += 1
    return seconds, kernels


def middle(
    log: Log, run: Any, empty: float, repeats: int
) -> tuple[dict[str, float], dict[str, int]]:
    """The median over repeated runs of each group's ms, and its kernels."""
    rows: list[dict[str, float]] = []
    kernels: dict[str, int] = {}
    for number in range(WARM + repeats):
        log.clear()
        run()
        if number >= WARM:
            milliseconds, kernels = grouped(log, empty)
            rows.append(milliseconds)
    return {name: float(np.median([row[name] for row in rows])) for name in rows[0]}, kernels


def of_empty(device: Any, placed: Any, log: Log) -> float:
    """s of a launch that does nothing."""
    kernel, size = placed.program.kernel(EMPTY), device.empty((2,), np.int32)
    log.clear()
    for _ in range(100):
        kernel((1,), 1, size)
    value = float(np.median([seconds for _, seconds in log]))
    log.clear()
    return value


def without_contacts(problem: octo.Problem) -> octo.Problem:
    """The same walk, of the same robot without contact spheres."""
    robot = problem.character
    assert robot is not None
    return problem.replace(
        model=replace(robot, contacts=(), pairs=()), x0=problem.start, parameters={}
    )


def measure(bench: Bench, problem: octo.Problem) -> dict[str, Any]:
    """What benchmarks/gpu.json has of one basis under "stages": ms by stage, kernels, and what was
    taken off each of them."""
    iterate, _ = bench.iterate(problem, 1)
    log: Log = []
    backend = DeviceBackend(timed(bench.device, log))
    repeats = min(20, bench.repeats)
    one = OneIteration(backend, bench.compiled(problem, 1), iterate)
    empty = of_empty(bench.device, one.problem, log)
    whole, kernels = middle(log, one, empty, repeats)
    bare = bench.compiled(without_contacts(problem), 1)
    backend = DeviceBackend(timed(bench.device, log))
    backend.prepare(bare, one.options)
    placed = backend.place(bare)
    at, lam = placed.evaluate(bench.device.array(iterate.unknowns)), bench.device.array(iterate.lam)
    alone, _ = middle(log, lambda: backend.linearize(placed, at, lam, True), empty, repeats)
    contact = min(max(0.0, whole["derivatives"] - alone["derivatives"]), whole["derivatives"])
    split = {"derivatives": whole.pop("derivatives") - contact, CONTACT: contact, **whole}
    return {
        "ms": split,
        "sum_ms": sum(split.values()),
        "kernels": kernels,
        "empty_kernel_ms": 1e3 * empty,
    }
