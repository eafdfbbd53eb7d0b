"""A device and the runs that benchmarks/gpu.py measures on it.

"One iteration" is always the same: derivatives and curvature, assembly, one factorisation, the
solution and one trial, at an iterate of a real solve, with the weight that the solver's own rule
finds there; on the CPU and on the device alike.
"""

from __future__ import annotations

import gc
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

import octo
from octo import arrays, native
from octo.continuation.schedule import schedule
from octo.gpu.backend import DeviceBackend
from octo.problem.basis import Basis
from octo.problem.compiled import CompiledProblem
from octo.solver import sqp
from octo.solver.backend import CPU, Backend
from octo.solver.options import SqpOptions
from octo.solver.regularisation import FLOOR, Regularisation
from octo.starts import first_nodes

Row = dict[str, Any]
# N = 400: Z = 40
BASES: dict[str, Basis] = {"hermite": octo.Hermite(steps_per_segment=10), "nodes": octo.Nodes()}
# of one iteration; fewer, down to LEAST, where they take over LONGEST s
REPEATS, LEAST, LONGEST = 50, 5, 3.0
# iterations: in the first sequences are launched kernel by kernel, in the second they are captured
WARM = 3


def walk(robot: octo.Character, steps: int, basis: str, dt: float = 0.025) -> octo.Problem:
    """The paper's walk with the contact stiffness of octo's first pass."""
    problem = octo.Problem(robot, steps=steps, dt=dt, costs=octo.costs.paper(), basis=BASES[basis])
    stage = schedule(problem, 1)[0]
    assert stage is not None
    return problem.replace(parameters=stage.parameters(problem.weight))


@dataclass(frozen=True)
class Iterate:
    """Of a real solve, on the host: where one iteration is measured."""

    unknowns: Any
    lam: Any


class Lost(Exception):
    """After an illegal address, for example, CUDA refuses everything: only another process can go
    on."""


def first_line(error: Exception) -> str:
    return f"{type(error).__name__}: {(str(error).strip().splitlines() or ['no words'])[0]}"


class OneIteration:
    """See the top of this file. ``sigma`` (batch,) are the weights that give the KKT matrices the
    right inertia."""

    options = SqpOptions()

    def __init__(self, backend: Backend, compiled: CompiledProblem, iterate: Iterate):
        self.backend, batch = backend, compiled.batch
        self.problem = backend.place(compiled)
        unknowns = backend.array(iterate.unknowns)
        assert unknowns is not None
        self.places = [
            (backend.evaluate(self.problem, unknowns), backend.array(iterate.lam)) for _ in range(2)
        ]
        self.members, self.limit = np.ones(batch, dtype=bool), np.ones(batch)
        self.sigma, has = Regularisation(batch, compiled.K, self.options).factorize(
            self._factors()[0]
        )
        if not has.all():
            raise ArithmeticError("no weight gives the KKT matrix of this iterate its inertia")
        one = np.ones(compiled.K)
        self.weights = [
            np.outer((self.sigma + FLOOR) * factor, one) for factor in (1.0, 1.0 + 1e-12)
        ]

    def _factors(self) -> tuple[Any, Any]:
        """At the same iterate in other arrays: as in a solve, a device copies it to its place, and
        is sent the weights."""
        self.places.reverse()
        at, lam = self.places[0]
        model = self.backend.linearize(self.problem, at, lam, True)
        return self.backend.factors(self.problem, model, at, lam, self.options), -model.C

    def __call__(self) -> None:
        factors, rhs_c = self._factors()
        factors.clear()
        self.weights.reverse()
        good = factors.add(self.members, self.weights[0])
        attempt = factors.attempt(rhs_c, self.limit, self.options.cap)
        units, dual, slope = attempt.numbers
        trial = attempt.trial
        if trial is None:
            length = np.minimum(1.0, self.options.cap / np.maximum(units.max(axis=1), 1e-300))
            trial = self.backend.evaluate(
                self.problem, self.places[0][0].unknowns + arrays.scaled(length, attempt.delta)
            )
        self.trial, numbers = trial, trial.numbers  # of a device, on the host already
        finite = all(np.isfinite(values).all() for values in (units, dual, slope))
        if not (good.all() and numbers.size and finite):
            raise ArithmeticError(
                "the factorisation or the solution of the iteration that is measured went wrong"
            )


def milliseconds(run: Callable[[], None], repeats: int, warm_up: float) -> Row:
    """The median and the least of repeated runs, after ``warm_up`` s: a GPU that was idle has a
    slow clock."""
    began, warm = time.perf_counter(), 0
    while warm < WARM or time.perf_counter() - began < warm_up:
        run()
        warm += 1
    times: list[float] = []
    began = time.perf_counter()
    while len(times) < repeats and (len(times) < LEAST or time.perf_counter() - began < LONGEST):
        before = time.perf_counter()
        run()
        times.append(time.perf_counter() - before)
    return {
        "ms": 1e3 * float(np.median(times)),
        "least_ms": 1e3 * min(times),
        "repeats": len(times),
    }


def of_solve(result: sqp.Result) -> Row:
    """ms of an iteration of a solve, the first ones aside, and its factorisations: several, and all
    the trials of its search."""
    history = max(result.history, key=lambda columns: len(columns["seconds"]))
    times = history["seconds"][min(WARM, len(history["seconds"])) - 1 :]
    each = 1e3 * np.diff(times) if len(times) > 1 else np.array([1e3 * times[-1]])
    count = np.maximum(result.iterations, 1)
    factorisations = float((result.factorizations / count).mean())
    return {
        "mean_ms": float(each.mean()),
        "median_ms": float(np.median(each)),
        "factorisations": factorisations,
    }


class Bench:
    """A device, and the runs that the sections are made of. ``short``: small sizes, which measure
    nothing."""

    def __init__(self, device: Any, short: bool):
        self.device, self.short, self.cores = device, short, len(os.sched_getaffinity(0))
        self.lost = False
        self.renew()
        self.mammal = octo.gallery.mammal()
        self.iterations, self.repeats = (6, 2) if short else (30, REPEATS)
        self.steps, self.warm_up = (20, 0.0) if short else (400, 0.3)
        self.to_the_end = (
            SqpOptions(max_iterations=4)
            if short
            else SqpOptions(max_iterations=1500, time_limit=90.0)
        )

    def renew(self) -> None:
        """Forget what is placed on the device, and give its memory back."""
        self.backend = DeviceBackend(self.device)
        gc.collect()  # graphs and arrays refer to one another
        if self.pool is not None:
            self.pool.free_all_blocks()

    def recover(self) -> None:
        """After something failed; raises Lost where the GPU answers no more."""
        try:
            self.renew()
            self.device.host(self.device.array([0.0]))
        except Exception as error:
            self.lost = True
            raise Lost(f"the GPU is lost to this process: {first_line(error)}") from error

    @property
    def pool(self) -> Any:
        """CuPy's memory; None where the CPU stands in."""
        own = getattr(self.device.xp, "get_default_memory_pool", None)
        return None if own is None else own()

    @cached_property
    def walks(self) -> dict[str, octo.Problem]:
        """Of the mammal, 10 s, by basis."""
        return {basis: walk(self.mammal, self.steps, basis) for basis in BASES}

    def compiled(self, problem: octo.Problem, batch: int, threads: int = 1) -> CompiledProblem:
        return CompiledProblem([problem] * batch, threads)

    def solve(
        self,
        problem: octo.Problem,
        options: SqpOptions,
        seeds: range = range(1),
        backend: Backend | None = None,
        threads: int = 1,
    ) -> sqp.Result:
        """One start a seed, in one batch, on the device unless ``backend`` is another."""
        backend = backend or self.backend
        compiled = self.compiled(problem, len(seeds), threads)
        nodes = np.stack([first_nodes(problem, seed, None) for seed in seeds])
        backend.prepare(compiled, options)
        placed = backend.place(compiled)
        return sqp.run(placed, placed.unknowns(nodes), None, options, None, backend)

    def iterate(self, problem: octo.Problem, batch: int) -> tuple[Iterate, Row]:
        """Where a solve of ``batch`` starts is after some iterations, and how long those took."""
        options = SqpOptions(
            max_iterations=self.iterations if batch <= 64 else min(10, self.iterations)
        )
        result = self.solve(problem, options, range(batch))
        return Iterate(result.at.unknowns, result.lam), of_solve(result)

    def iteration(
        self, problem: octo.Problem, batch: int = 1, threads: tuple[int, ...] = ()
    ) -> Row:
        """One iteration on the device, and on the CPU with each number of ``threads``; the mean of
        real ones beside it."""
        iterate, solved = self.iterate(problem, batch)
        compiled = self.compiled(problem, batch)
        one = OneIteration(self.backend, compiled, iterate)
        row = {
            "steps": compiled.steps,
            "dt": problem.dt,
            "batch": batch,
            "degrees": compiled.n,
            "units": compiled.K,
            "Z": compiled.K - 1 if problem.basis is BASES["hermite"] else None,
            "block": 2 * (compiled.nc + compiled.ma),
            "iterations_before": self.iterations,
            "sigma": float(one.sigma.max()),
            **milliseconds(one, self.repeats, self.warm_up),
            **solved,
        }
        if threads:
            row["cpu"] = self.on_cpu(problem, batch, iterate, threads)
            row["ratio"] = {
                name: cpu["ms"] / row["ms"] for name, cpu in row["cpu"].items() if name.isdigit()
            }
            row["mean_ratio"] = {
                name: cpu["mean_ms"] / row["mean_ms"]
                for name, cpu in row["cpu"].items()
                if name.isdigit()
            }
        return row

    def on_cpu(
        self, problem: octo.Problem, batch: int, iterate: Iterate, threads: tuple[int, ...]
    ) -> Row:
        """The same iteration and the same solve, by number of threads."""
        if native.compiler() is None:
            return {
                "why_not": "no C compiler: the CPU's time would be that of CasADi's virtual machine"
            }
        made: Row = {}
        options = SqpOptions(max_iterations=self.iterations)
        for count in threads:
            compiled = self.compiled(problem, batch, count)
            CPU.prepare(compiled, options)
            own = milliseconds(OneIteration(CPU, compiled, iterate), self.repeats, self.warm_up)
            made[str(count)] = {
                **own,
                **of_solve(self.solve(problem, options, range(batch), CPU, count)),
            }
        return made
