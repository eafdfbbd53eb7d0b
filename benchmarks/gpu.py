"""octo on a GPU, measured: ``python benchmarks/gpu.py`` writes benchmarks/gpu.json and benchmarks/gpu.png.

Needs a CUDA GPU, CuPy and NVRTC (pip install -e '.[cuda13,view]' or cuda12), and for "kkt", octo's reduction beside cuBLAS and
cuSOLVER (gpu_kkt.py), those (pip install 'cupy-cuda13x[ctk]'); nothing is downloaded. On a machine without
one, ``--emulate`` runs the same kernels on the CPU, which says whether this script works and nothing about speed.
``--once`` solves one small problem for three iterations and measures nothing: for compute-sanitizer (docs/gpu.md).
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import platform
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import gpu_kkt
import numpy as np

import octo
from octo import arrays
from octo.gpu import bound, cuda, nvrtc
from octo.gpu.backend import DeviceBackend
from octo.gpu.emulator import EmulatedDevice
from octo.problem.compiled import CompiledProblem
from octo.solve import first_nodes
from octo.solver import sqp
from octo.solver.options import SqpOptions

FOLDER = Path(__file__).parent
DT = 0.025
GROUPS = {  # kernels by what they do
    "derivatives": "kin_of_nodes jacobian curvature cost_derivatives",
    "products": "step_model gather_hessian gather_constraints",
    "factorisation": "kkt_blocks kkt_finite kkt_equilibrate kkt_scale kkt_pivots kkt_couple kkt_complement kkt_verdict",
    "solution": "negative kkt_join kkt_part kkt_fold kkt_unfold kkt_last kkt_residual largest kkt_check",
    "trial": "step_numbers advance nodes value terms summary constraints unit_sizes",
}


class Timed:
    """A kernel that waits for itself and adds up its seconds."""

    def __init__(self, kernel: Any, name: str, device: Any, seconds: dict[str, float]):
        self.kernel, self.name, self.device, self.seconds = kernel, name, device, seconds

    def __call__(self, *arguments: Any, **named: Any) -> None:
        self.device.synchronize()
        began = time.perf_counter()
        self.kernel(*arguments, **named)
        self.device.synchronize()
        self.seconds[self.name] = self.seconds.get(self.name, 0.0) + time.perf_counter() - began


class TimedModule:
    def __init__(self, module: Any, device: Any, seconds: dict[str, float]):
        self.kernel = lambda name: Timed(module.kernel(name), name, device, seconds)


def timed(device: Any, seconds: dict[str, float]) -> Any:
    """The same device, whose kernels add up their time in ``seconds``: each is launched on its own."""
    made = object.__new__(type(device))
    made.__dict__.update(device.__dict__, graphs=False)
    made.module = lambda text: TimedModule(device.module(text), device, seconds)
    return made


def walk(robot: octo.Character, steps: int, basis: str) -> octo.Problem:
    return octo.Problem(robot, steps=steps, dt=DT, costs=octo.costs.paper(), basis=basis)


class Bench:
    """Everything that is measured on one device."""

    def __init__(self, device: Any, short: bool):
        self.device, self.short, self.backend = device, short, DeviceBackend(device)
        self.mammal = octo.gallery.mammal()
        self.iterations = 6 if short else 30

    def run(self, problem: octo.Problem, seeds: int, options: SqpOptions, backend: Any = None, threads: int = 0) -> sqp.Result:
        """``threads`` > 0: on the CPU with that many."""
        compiled = CompiledProblem([problem] * seeds, max(threads, 1))
        nodes = np.stack([first_nodes(problem, seed, None) for seed in range(seeds)])
        if threads:
            compiled.prepare()
            return sqp.run(compiled, compiled.unknowns(nodes), None, options)
        backend = backend or self.backend
        backend.prepare(compiled, options)
        placed = backend.place(compiled)
        return sqp.run(placed, placed.unknowns(nodes), None, options, None, backend)

    def milliseconds(self, problem: octo.Problem, seeds: int = 1, threads: int = 0) -> float:
        """Of one iteration, warmed up by a first run and, for what is captured there, by the first iterations."""
        options = SqpOptions(max_iterations=self.iterations)
        self.run(problem, seeds, replace(options, max_iterations=2), threads=threads)
        return milliseconds_of(self.run(problem, seeds, options, threads=threads))

    def launching(self, problem: octo.Problem) -> dict[str, dict[str, float]]:
        """ms of one iteration and what is launched and waited for in it, with CUDA graphs and kernel by kernel."""
        device, out = self.device, {}
        had, options = device.graphs, SqpOptions(max_iterations=self.iterations)
        for name, graphs in (("graphs", had), ("kernel_by_kernel", False)):
            device.graphs = graphs
            self.run(problem, 1, replace(options, max_iterations=2))
            before, copies = replace(device.counts), arrays.copies
            result = self.run(problem, 1, options)
            copies, count = arrays.copies - copies, max(1, int(result.iterations[0]))
            spent = {key: value - getattr(before, key) for key, value in vars(device.counts).items()}
            out[name] = {
                "captured": device.graphs, "ms": milliseconds_of(result), "copies": copies / count,
                "factorisations": float(result.factorizations[0]) / count, "kernels": spent["launches"] / count,
                "kernels_in_graphs": spent["replayed"] / count, "graphs": spent["graphs"] / count,
                "captures": spent["captures"], "capture_ms": 1e3 * spent["capture_seconds"],
            }  # fmt: skip
        device.graphs = had and out["graphs"]["captured"]
        return out

    def stages(self, problem: octo.Problem) -> dict[str, Any]:
        """ms of one iteration by what its kernels do, each kernel waited for; factorisations and trials an iteration."""
        seconds: dict[str, float] = {}
        backend = DeviceBackend(timed(self.device, seconds))
        options = SqpOptions(max_iterations=self.iterations)
        self.run(problem, 1, replace(options, max_iterations=2), backend)
        seconds.clear()
        result = self.run(problem, 1, options, backend)
        count = max(1, int(result.iterations[0]))
        known = {f"octo_{name}": group for group, names in GROUPS.items() for name in names.split()}
        out = dict.fromkeys([*GROUPS, "projections and products"], 0.0)
        for name, value in seconds.items():
            out[known.get(name, "projections and products")] += 1e3 * value / count
        return {**out, "factorisations": float(result.factorizations[0]) / count}

    def bounds(self, problem: octo.Problem) -> dict[str, float]:
        """ms, of docs/gpu.md."""
        return {name: 1e3 * value for name, value in bound.bound(CompiledProblem([problem])).seconds(bound.H200).items()}

    def plans(self, problem: octo.Problem, count: int) -> dict[str, Any]:
        """A batch to its end."""
        result = self.run(problem, count, SqpOptions(max_iterations=4 if self.short else 1500))
        converged = sum(status.converged for status in result.status)
        return {"plans": count, "seconds": result.seconds, "plans_a_second": count / result.seconds, "converged": converged}


WARM = 3  # iterations: in the first sequences are launched kernel by kernel, in the second they are captured


def milliseconds_of(result: sqp.Result) -> float:
    """Of one iteration, the first ones aside."""
    times = max((history["seconds"] for history in result.history), key=len)
    first = min(WARM, len(times)) - 1
    return 1e3 * float(times[-1] - times[first]) / max(1, len(times) - 1 - first)


def measure(bench: Bench, ipopt: bool, say: Callable[[str], None]) -> dict[str, Any]:
    short, cores = bench.short, len(os.sched_getaffinity(0))
    steps = 40 if short else 400
    problems = {basis: walk(bench.mammal, steps, basis) for basis in ("hermite", "nodes")}
    out: dict[str, Any] = {}
    say("one iteration")
    out["iteration_ms"] = {basis: bench.milliseconds(problem) for basis, problem in problems.items()}
    out["launching"] = {basis: bench.launching(problem) for basis, problem in problems.items()}
    out["stages"] = {basis: bench.stages(problem) for basis, problem in problems.items()}
    out["bound_ms"] = {basis: bench.bounds(problem) for basis, problem in problems.items()}
    out["measured_over_bound"] = {basis: out["iteration_ms"][basis] / max(out["bound_ms"][basis].values()) for basis in problems}
    say("steps")
    counts = (20, 40) if short else (50, 100, 200, 400, 800, 1600)
    out["steps"] = [{"steps": N, "ms": bench.milliseconds(walk(bench.mammal, N, "nodes"))} for N in counts]
    say("degrees of freedom")
    links = (3,) if short else range(3, 13)
    out["dof"] = [
        {"dof": 4 + 2 * k, "ms": bench.milliseconds(walk(octo.gallery.chain(k), steps, "hermite"))} for k in links
    ]  # fmt: skip
    say("batches")
    sizes = (1, 2) if short else (1, 4, 16, 64, 256, 1024)
    out["batch"] = []
    for size in sizes:
        row = {"batch": size, "ms": bench.milliseconds(problems["nodes"], size)}
        if size <= 64:  # beyond, the CPU's time an iteration grows in proportion
            row["cpu_ms"], row["cores"] = bench.milliseconds(problems["nodes"], size, threads=cores), cores
            row["ratio"] = row["cpu_ms"] / row["ms"]
        out["batch"].append(row)
    say("the chain of 40 s")
    chain = walk(octo.gallery.chain(), 40 if short else 1600, "hermite")
    out["chain_40s"] = {"iteration_ms": bench.milliseconds(chain), **bench.plans(chain, 1)}
    say("the KKT matrix by other ways")
    out["kkt"] = {basis: gpu_kkt.measure(bench.device, problem, short) for basis, problem in problems.items()}
    say("many plans")
    out["plans"] = bench.plans(problems["nodes"], 2 if short else 1024)
    if ipopt:
        say("IPOPT")
        out["ipopt"] = against_ipopt(bench, problems["nodes"])
    return out


def against_ipopt(bench: Bench, problem: octo.Problem) -> dict[str, float]:
    """Total time to octo's tolerance from one start, and both objectives."""
    from octo import reference

    options = SqpOptions(max_iterations=4 if bench.short else 1500)
    other = reference.Ipopt(problem, options=options).solve(first_nodes(problem, 0, None), None, 0).solution
    own = bench.run(problem, 1, options)
    return {
        "ipopt_seconds": other.seconds, "octo_seconds": own.seconds, "ratio": other.seconds / own.seconds,
        "ipopt_energy": other.energy, "octo_energy": float(own.at.energy[0]),
    }  # fmt: skip


def draw(found: dict[str, Any], path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 7.4), layout="constrained")
    figure.suptitle(f"{found['hardware']['device']}, {found['date']}", x=0.01, ha="left", fontsize=9.5)
    stages, steps, dof, batch = figure.subplots(2, 2).ravel()
    bottom = np.zeros(len(found["stages"]))
    for name in [*GROUPS, "projections and products"]:
        values = np.array([row[name] for row in found["stages"].values()])
        stages.bar(list(found["stages"]), values, bottom=bottom, label=name)
        bottom += values
    stages.set_ylabel("ms an iteration, kernel by kernel")
    stages.legend(fontsize=7)
    for axes, name, key, word in ((steps, "steps", "steps", "steps N"), (dof, "dof", "dof", "degrees of freedom")):
        axes.plot([row[key] for row in found[name]], [row["ms"] for row in found[name]], marker="o")
        axes.set_xlabel(word)
        axes.set_ylabel("ms an iteration")
    batch.loglog(
        [row["batch"] for row in found["batch"]], [row["ms"] / row["batch"] for row in found["batch"]], marker="o", label="GPU"
    )
    beside = [row for row in found["batch"] if "cpu_ms" in row]
    cores = beside[0]["cores"]
    batch.loglog(
        [row["batch"] for row in beside],
        [row["cpu_ms"] / row["batch"] for row in beside],
        marker="s",
        label=f"CPU, {cores} threads",
    )
    batch.set_xlabel("problems in a batch")
    batch.set_ylabel("ms an iteration and problem")
    batch.legend(fontsize=7)
    figure.savefig(path, dpi=110)


def once(device: Any) -> None:
    """Three iterations of each rule of a small problem, every kernel: launched, captured and replayed."""
    for options in (SqpOptions(max_iterations=3), SqpOptions.paper(max_iterations=3)):
        bench = Bench(device, short=True)
        print(bench.run(walk(octo.gallery.mammal(), 8, "nodes"), 2, options).at.energy)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--short", action="store_true", help="small sizes: whether it works, not how fast")
    parser.add_argument("--emulate", action="store_true", help="run the kernels on the CPU; writes only where --out says")
    parser.add_argument("--once", action="store_true", help="three iterations of a small problem, and nothing measured")
    parser.add_argument("--no-ipopt", action="store_true", help="leave IPOPT out")
    parser.add_argument("--out", type=Path, help="the JSON; the figure is beside it (default benchmarks/gpu.json)")
    arguments = parser.parse_args()
    why = None if arguments.emulate else cuda.reason()
    if why is not None:
        print(f"benchmarks/gpu.py: {why}; --emulate runs the kernels on the CPU", file=sys.stderr)
        return 2
    if (arguments.emulate or arguments.short) and arguments.out is None and not arguments.once:
        print("benchmarks/gpu.py: --emulate and --short need --out: their figures are no measurement of a GPU", file=sys.stderr)
        return 2
    device: Any = EmulatedDevice() if arguments.emulate else cuda.device()
    if arguments.once:
        once(device)
        return 0
    name = "emulated on the CPU" if arguments.emulate else f"{device.name} ({device.architecture})"
    cores = f"{platform.machine()}, {len(os.sched_getaffinity(0))} cores"
    found = {
        "hardware": {"device": name, "cpu": cores, "nvrtc": nvrtc.version()},
        "date": datetime.date.today().isoformat(),
        **measure(Bench(device, arguments.short), not arguments.no_ipopt, lambda word: print(f"measuring: {word}", flush=True)),
    }
    path = arguments.out or FOLDER / "gpu.json"
    path.write_text(json.dumps(found, indent=1) + "\n")
    try:
        draw(found, path.with_suffix(".png"))
    except ImportError:
        print("no figure: matplotlib is not installed", file=sys.stderr)
    said = ("iteration_ms", "launching", "measured_over_bound", "chain_40s", "plans")
    print(json.dumps({name: found[name] for name in said}, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
