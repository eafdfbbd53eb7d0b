"""What one core does in one run: the dynamics a step, the symbolic form beside it, compilation, one iteration, threads.

Times are this thread's processor time, the least of interleaved runs (their median beside it); those over threads are
the wall's. ``--quick`` leaves out the symbolic form (minutes of gcc the first time) and cold compilation.
"""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import octo
from octo.bench.monolithic import Monolithic
from octo.bench.timing import Records, Timing, interleaved, processor
from octo.dynamics.evaluate import RobotDynamics
from octo.errors import DeviceError
from octo.problem.compiled import CompiledProblem
from octo.problem.problem import Problem
from octo.solve import smooth_noise
from octo.solver import kkt
from octo.solver.blas import one_thread
from octo.solver.blocks import KKTBlocks

Array = NDArray[np.float64]
CHARACTERS = ("chain", "biped", "bird", "mammal", "spider", "humanoid")
SYMBOLIC = ("spider", "humanoid")
STEPS = 400
SIZES = {"nodes": (20, 100, 200, 400, 800), "hermite": (200, 400, 800)}
STAGES = ("linearize", "factor", "solve", "evaluate")
MICRO, MILLI = 1e6, 1e3
ROUNDS = 40
FACTS = 6.0  # µs/step of the spider's FD + Jacobian on the machine that the limits of an iteration were set on
Clock = Callable[[], float]

# a time or a ratio, its limit, and whether the limit moves with the machine's FD + Jacobian
WANTED = (
    ("spider.fd_jacobian/symbolic", 0.13, False),
    ("humanoid.fd_jacobian/symbolic", 0.22, False),
    ("spider.curvature/fd_jacobian", 2.6, False),
    ("humanoid.curvature/fd_jacobian", 2.6, False),
    ("iteration.nodes.400", 12.0, True),
    ("iteration.hermite.400", 12.0, True),
    ("iteration.nodes.20", 0.8, True),
    ("iteration.nodes.largest_error_of_fit", 0.15, False),
    ("iteration.hermite.largest_error_of_fit", 0.15, False),
    ("compile.cold", 10.0, False),
    ("compile.cached", 0.2, False),
)


def walk(name: str, steps: int, basis: str = "nodes") -> Problem:
    """The paper's walk."""
    costs = [octo.CenterOfMassVelocity((0.5, 0.0, 0.0)), octo.Effort()]
    return octo.Problem(getattr(octo.gallery, name)(), steps=steps, dt=0.025, costs=costs, basis=basis)


def start(problem: Problem, seed: int = 0) -> Array:
    """(N+2, n) the default start of a solve: standing, with smooth noise."""
    nodes = np.repeat(problem.start[None], problem.steps + 2, axis=0)
    nodes[2:, problem.dynamics.actuated] += smooth_noise(problem, seed)
    return nodes


# -- dynamics -----------------------------------------------------------------------------------------------------


class TreeSweep:
    """octo's own dynamics of all steps, written into memory that is in use."""

    def __init__(self, dynamics: RobotDynamics, nodes: Array, p: Array):
        if dynamics._library is None:
            raise DeviceError("octo bench needs a C compiler: gcc, cc, clang or the one that CC names")
        self.library, self.steps, n = dynamics._library, len(nodes) - 2, dynamics.nx
        lam = np.random.default_rng(0).standard_normal((self.steps, n))
        self.fd, self.jac = np.zeros((self.steps, n)), np.zeros((self.steps, n, 3 * n))
        self.held = (nodes, p, lam, self.fd, self.jac, np.zeros((self.steps, dynamics.curvature_blocks, n, n)))
        self.pointers = [ctypes.c_void_p(array.ctypes.data) for array in self.held]

    def run(self, order: int) -> Callable[[], None]:
        return lambda: self.library.octo_batch(1, self.steps, order, 1, *self.pointers)


def measure_dynamics(records: Records, name: str, symbolic: bool) -> None:
    problem = walk(name, STEPS)
    dynamics, nodes, p = problem.dynamics, start(problem), np.ascontiguousarray(problem.p)
    assert isinstance(dynamics, RobotDynamics)
    tree = TreeSweep(dynamics, nodes, p)
    runs = {f"{name}.{label}": tree.run(order) for order, label in enumerate(("fd", "fd_jacobian", "curvature"))}
    forms = {}
    for label, plain in (("symbolic", False), ("symbolic_plain", True)) if symbolic else ():
        form = Monolithic(dynamics, plain)
        forms[label] = (form, *form.sweep(nodes, p))
        runs[f"{name}.{label}"] = forms[label][-1]
    for label, timing in interleaved(runs, ROUNDS).items():
        records.add_timing(label, timing.per(STEPS), MICRO, "us/step")
    records.ratio(f"{name}.curvature/fd_jacobian", f"{name}.curvature", f"{name}.fd_jacobian")
    for label, (form, fd, jac, _) in forms.items():
        error = max(np.abs(fd - tree.fd).max() / np.abs(fd).max(), np.abs(form.dense(jac) - tree.jac).max() / np.abs(jac).max())
        if not error < 1e-11:
            raise ArithmeticError(f"{name}: the tree pass and the symbolic form differ by {error:.1e}")
        records.add(f"{name}.{label}.operations", form.operations, "")
        records.ratio(f"{name}.fd_jacobian/{label}", f"{name}.fd_jacobian", f"{name}.{label}")


def measure_compilation(records: Records, cold: bool) -> None:
    """Every part in a process of its own, with an empty cache and again with what the first one left."""
    with tempfile.TemporaryDirectory() as folder:
        for label in ("cold", "cached"):
            if label == "cached" or cold:
                command = [sys.executable, "-m", "octo.bench.compile_time"]
                environment = {**os.environ, **({"OCTO_CACHE": folder} if cold else {})}
                done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
                parts = json.loads(done.stdout)
                for part, seconds in parts.items():
                    records.add(f"compile.{label}.{part}", seconds, "s")
                records.add(f"compile.{label}", sum(parts.values()), "s")


# -- one iteration ------------------------------------------------------------------------------------------------


class Iteration:
    """Curvature, one factorisation, the KKT step and one trial, from Python, with the seconds of every stage."""

    def __init__(self, basis: str, steps: int, threads: int = 1, batch: int = 1, clock: Clock = time.thread_time):
        problem = walk("mammal", steps, basis)
        self.problem = CompiledProblem([problem] * batch, threads)
        self.at = self.problem.evaluate(self.problem.unknowns(np.stack([start(problem, k) for k in range(batch)])))
        shape = (batch, self.problem.K, self.problem.ma)
        self.lam = 1e-5 * np.random.default_rng(0).standard_normal(shape)
        self.sigma = np.full(shape[:2], 0.1)  # enough for the right inertia: the factorisation is a whole one
        self.clock = clock
        self.seconds: list[Array] = []

    def __call__(self) -> None:
        problem, at, marks = self.problem, self.at, [self.clock()]
        model = problem.linearize(at, self.lam)
        marks.append(self.clock())
        factor = kkt.factorize(model.H, model.A, self.sigma, threads=problem.threads)
        marks.append(self.clock())
        step, lam = factor.solve(-model.b, -model.C)
        dual = np.abs(model.b + KKTBlocks(model.H, model.A, model.b, model.C).constraints_transposed_times(self.lam)).max()
        marks.append(self.clock())
        trial = problem.evaluate(at.unknowns + 1e-3 * step)
        marks.append(self.clock())
        assert factor.inertia_ok.all() and np.isfinite(dual) and trial.finite.all() and lam.shape == self.lam.shape
        self.seconds.append(np.diff(marks))


def measure_iterations(records: Records) -> None:
    runs = {(basis, steps): Iteration(basis, steps) for basis, sizes in SIZES.items() for steps in sizes}
    for (basis, steps), run in runs.items():  # each by itself, as a solve does: its memory stays in the caches
        interleaved({f"{basis}.{steps}": run}, ROUNDS * max(1, 400 // steps))
        seconds = np.array(run.seconds[1:])
        total = seconds.sum(axis=1)
        records.add_timing(f"iteration.{basis}.{steps}", Timing(total.min(), float(np.median(total))), MILLI, "ms")
        for stage, values in zip(STAGES, seconds.T, strict=True):
            records.add(f"iteration.{basis}.{steps}.{stage}", values.min() * MILLI, "ms")
    for basis, sizes in SIZES.items():
        least = [records[f"iteration.{basis}.{steps}"] for steps in sizes]
        slope, constant = np.polyfit(sizes, least, 1, w=1.0 / np.array(least))
        error = np.abs(np.polyval([slope, constant], sizes) / least - 1.0).max()
        records.add(f"iteration.{basis}.slope", slope * 1e3, "us/step")
        records.add(f"iteration.{basis}.constant", constant * 1e3, "us")
        records.add(f"iteration.{basis}.largest_error_of_fit", error, "")


def measure_threads(records: Records) -> None:
    """Seconds of the wall: one problem, and a batch of four, on one and on two threads."""
    for label, basis, batch in (("nodes.400", "nodes", 1), ("hermite.400", "hermite", 1), ("nodes.400.batch4", "nodes", 4)):
        runs = {count: Iteration(basis, 400, count, batch, time.perf_counter) for count in (1, 2)}
        interleaved({str(count): run for count, run in runs.items()}, ROUNDS)
        least = {count: np.array(run.seconds[1:]).min(axis=0) for count, run in runs.items()}
        for k, stage in enumerate(STAGES):
            records.add(f"threads2.{label}.{stage}", least[1][k] / least[2][k], "x")
        totals = {count: np.array(run.seconds[1:]).sum(axis=1).min() for count, run in runs.items()}
        records.add(f"threads2.{label}", totals[1] / totals[2], "x")


# -- the table ----------------------------------------------------------------------------------------------------


def verdicts(records: Records) -> str:
    """The limits, and those that move with the machine in proportion to its FD + Jacobian."""
    share = records["spider.fd_jacobian"] / FACTS
    lines = []
    for name, limit, moves in WANTED:
        if name not in records:
            continue
        value = records[name]
        line = f"{name:36s} {value:8.3g}  wanted <= {limit:<6g} {'met' if value <= limit else 'NOT MET'}"
        if moves:
            line += f"; in proportion <= {limit * share:.3g} {'met' if value <= limit * share else 'NOT MET'}"
        lines.append(line)
    return "\n".join(lines)


def measure(path: Path | None, baseline: Path | None, quick: bool) -> bool:
    """Run all of it, print the table, write ``path``; whether every limit holds."""
    records = Records(baseline)
    with one_thread():
        for name in CHARACTERS:
            measure_dynamics(records, name, symbolic=name in SYMBOLIC and not quick)
        measure_iterations(records)
        measure_threads(records)
        measure_compilation(records, cold=not quick)
    said = verdicts(records)
    print(f"{processor()}, one core\n{records.table()}\n\n{said}")
    if path is not None:
        records.write(path)
    return not any("NOT MET" in line.split(";")[0] for line in said.splitlines())
