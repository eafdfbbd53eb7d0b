"""What benchmarks/gpu.py measures: one generator a section, which yields (name, figures) as soon as
they are there."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import gpu_bound as bound
import gpu_kkt
import gpu_stages
import numpy as np
from gpu_bench import WARM, Bench, Row, first_line, of_solve, walk

import octo
from octo import arrays
from octo.gpu.program import bytes_of
from octo.gpu.sequence import Counts
from octo.problem.compiled import CompiledProblem
from octo.solver.options import SqpOptions
from octo.starts import first_nodes

T = TypeVar("T")
Section = Iterator[tuple[str, Row]]
SEEDS = range(10, 15)  # no constant of the solver was chosen on these starts
MANY = 1024


def each(bench: Bench, items: Mapping[str, T], measured: Callable[[T], Row]) -> Section:
    """A row for each item, or why there is none: one that fails does not take the others with
    it."""
    for name, item in items.items():
        try:
            row = measured(item)
        except Exception as error:
            row = {"why_not": first_line(error)}
        yield name, row
        if "why_not" in row:
            bench.recover()


def _spent(bench: Bench, before: Counts) -> dict[str, float]:
    """What the device was asked for since then."""
    return {
        name: value - getattr(before, name) for name, value in vars(bench.device.counts).items()
    }


def _one_and_all(bench: Bench) -> tuple[int, ...]:
    return (1, bench.cores) if bench.cores > 1 else (1,)


def iteration(bench: Bench) -> Section:
    """One iteration of the mammal, beside the CPU's and what a GPU cannot be faster than
    (docs/gpu.md)."""

    def measured(problem: octo.Problem) -> Row:
        row = bench.iteration(problem, threads=_one_and_all(bench))
        gpu = bound.H100 if "H100" in getattr(bench.device, "name", "") else bound.H200
        seconds = bound.bound(CompiledProblem([problem])).seconds(gpu)
        row["bound_ms"] = {name: 1e3 * value for name, value in seconds.items()}
        row["measured_over_bound"] = row["ms"] / max(row["bound_ms"].values())
        return {**row, "bound_of": gpu.name}

    yield from each(bench, bench.walks, measured)


def stages(bench: Bench) -> Section:
    """One iteration kernel by kernel."""
    yield from each(bench, bench.walks, lambda problem: gpu_stages.measure(bench, problem))


def launching(bench: Bench) -> Section:
    """A solve's iterations with CUDA graphs and kernel by kernel: what is launched and waited
    for."""
    yield from each(bench, bench.walks, lambda problem: _launching(bench, problem))


def _launching(bench: Bench, problem: octo.Problem) -> Row:
    device, out = bench.device, {}
    had, options = device.graphs, SqpOptions(max_iterations=bench.iterations)
    try:
        for name, graphs in (("graphs", had), ("kernel_by_kernel", False)):
            device.graphs = graphs
            bench.solve(problem, replace(options, max_iterations=2))
            before, copies = replace(device.counts), arrays.copies
            result = bench.solve(problem, options)
            copies, count = arrays.copies - copies, max(1, int(result.iterations[0]))
            spent = _spent(bench, before)
            out[name] = {
                "captured": device.graphs,
                **of_solve(result),
                "copies": copies / count,
                "kernels": spent["launches"] / count,
                "kernels_in_graphs": spent["replayed"] / count,
                "graphs": spent["graphs"] / count,
                "captures": spent["captures"],
                "capture_ms": 1e3 * spent["capture_seconds"],
            }
    finally:
        device.graphs = had and out.get("graphs", {}).get("captured", had)
    return out


def chain(bench: Bench) -> Section:
    """The paper's chain of 40 s, Z = 80: one iteration, and solves to their end."""
    problem = walk(octo.gallery.chain(), 20 if bench.short else 800, "hermite", dt=0.05)
    yield from each(
        bench,
        {"iteration": problem},
        lambda problem: bench.iteration(problem, threads=_one_and_all(bench)),
    )
    starts = {
        f"solve from start {seed}": range(seed, seed + 1)
        for seed in SEEDS[: 1 if bench.short else 3]
    }
    yield from each(bench, starts, lambda seeds: _ended(bench, problem, seeds))


def _ended(bench: Bench, problem: octo.Problem, seeds: range) -> Row:
    """A batch to its end."""
    pool = bench.pool
    bench.renew()
    before = replace(bench.device.counts)
    result = bench.solve(problem, bench.to_the_end, seeds)
    spent = _spent(bench, before)
    words = [status.label for status in result.status]
    converged = sum(status.converged for status in result.status)
    row = {
        "plans": len(seeds),
        "seconds": result.seconds,
        "converged": converged,
        "converged_a_second": converged / result.seconds,
        "status": {word: words.count(word) for word in sorted(set(words))},
        "iterations": int(result.iterations.max()),
        "energy": float(np.median(result.at.energy)),
        "time_limit_s": min(bench.to_the_end.time_limit, 1e9),
        "estimated_bytes": bytes_of(bench.compiled(problem, 1)) * len(seeds),
    }
    if pool is not None:
        # the pool was empty before and gives nothing back by itself
        row["peak_bytes"] = int(pool.total_bytes())
    launched = {
        "kernels": spent["launches"],
        "kernels_in_graphs": spent["replayed"],
        "captures": spent["captures"],
    }
    return {**row, **of_solve(result), **launched, "capture_seconds": spent["capture_seconds"]}


def batch(bench: Bench) -> Section:
    """The batch in which a device is compared with all cores of the CPU."""
    size = 2 if bench.short else 64
    walks = {f"{basis} {size}": problem for basis, problem in bench.walks.items()}
    yield from each(bench, walks, lambda problem: bench.iteration(problem, size, (bench.cores,)))


def batches(bench: Bench) -> Section:
    """One iteration against the size of the batch. The CPU's time is measured up to 64, whose cores
    are full long before."""
    problem, per_problem = bench.walks["hermite"], 0.0

    def measured(size: int) -> Row:
        nonlocal per_problem
        row = bench.iteration(problem, size, (bench.cores,) if size <= 64 else ())
        own = row.get("cpu", {}).get(str(bench.cores))
        per_problem = own["ms"] / size if own else per_problem
        return (
            row
            if own or not per_problem
            else {**row, "ratio_to_64": per_problem * size / row["ms"]}
        )

    sizes = (1, 3) if bench.short else (1, 4, 16, 64, 256, MANY)
    yield from each(bench, {f"hermite {size}": size for size in sizes}, measured)


def plans(bench: Bench) -> Section:
    """Many plans of the mammal in one batch, or as many as the memory holds: Hermite takes half of
    what nodes take."""

    def measured(problem: octo.Problem) -> Row:
        bench.renew()
        wanted = 2 if bench.short else MANY
        fit = bench.device.free_bytes() // bytes_of(bench.compiled(problem, 1))
        return {"wanted": wanted, **_ended(bench, problem, range(min(wanted, int(fit))))}

    yield from each(bench, bench.walks, measured)


def ipopt(bench: Bench) -> Section:
    """Total time to octo's tolerance from one start, and both objectives: the first start from
    which both converge."""
    from octo import reference

    options = bench.to_the_end
    for basis, problem in reversed(bench.walks.items()):
        solver = reference.Ipopt(
            problem, options=replace(options, time_limit=3.0 * options.time_limit)
        )
        for seed in SEEDS[: 1 if bench.short else 5]:
            bench.solve(problem, replace(options, max_iterations=WARM), range(seed, seed + 1))
            own = bench.solve(problem, options, range(seed, seed + 1))
            ended = own.status[0].converged
            if not ended and not bench.short:
                yield (
                    f"{basis} from start {seed}",
                    {"octo": own.status[0].label, "why_not": "octo did not converge"},
                )
                continue
            other = solver.solve(first_nodes(problem, seed, None), None, seed).solution
            yield (
                f"{basis} from start {seed}",
                {
                    "basis": basis,
                    "ipopt": other.status.label,
                    "octo": own.status[0].label,
                    "both_converged": bool(ended and other.converged),
                    "ipopt_seconds": other.seconds,
                    "octo_seconds": own.seconds,
                    "ratio": other.seconds / own.seconds,
                    "ipopt_energy": other.energy,
                    "octo_energy": float(own.at.energy[0]),
                    "ipopt_iterations": other.iterations,
                    "octo_iterations": int(own.iterations[0]),
                    "ipopt_compiled": solver.compiled,
                },
            )
            if ended and other.converged:
                break


def dof(bench: Bench) -> Section:
    """Chains of more and more links (Fig. 9)."""
    chains = {f"{links} links": links for links in ((3,) if bench.short else range(3, 13))}
    yield from each(
        bench,
        chains,
        lambda links: bench.iteration(walk(octo.gallery.chain(links), bench.steps, "hermite")),
    )


def steps(bench: Bench) -> Section:
    """Longer and longer walks of the mammal."""
    counts = {
        f"{count} steps": count
        for count in ((10, 20) if bench.short else (50, 100, 200, 400, 800, 1600))
    }
    yield from each(
        bench, counts, lambda count: bench.iteration(walk(bench.mammal, count, "nodes"))
    )


def kkt(bench: Bench) -> Section:
    """The same matrices factored by other ways (gpu_kkt.py)."""
    yield from each(
        bench, bench.walks, lambda problem: gpu_kkt.measure(bench.device, problem, bench.short)
    )


@dataclass(frozen=True)
class Planned:
    """A section, what it is about, and the seconds that it is thought to take; it is stopped after
    three times as many."""

    run: Callable[[Bench], Section]
    words: str
    about: float


SECTIONS = {  # in the order of importance
    "iteration": Planned(iteration, "one iteration of the mammal, beside the CPU", 60.0),
    "stages": Planned(stages, "its split by stage", 30.0),
    "launching": Planned(launching, "graphs, copies and captures of a solve", 15.0),
    "chain": Planned(chain, "the chain of 40 s", 40.0),
    "batch": Planned(batch, "a batch of 64 beside all cores", 45.0),
    "plans": Planned(plans, f"{MANY:,} plans in one batch", 150.0),
    "batches": Planned(batches, "batches", 60.0),
    "ipopt": Planned(ipopt, "IPOPT on the mammal's walk", 150.0),
    "dof": Planned(dof, "degrees of freedom", 100.0),
    "steps": Planned(steps, "steps", 30.0),
    "kkt": Planned(kkt, "the KKT matrix by other ways", 60.0),
}
