"""One iteration of a walk, stage by stage: against steps, degrees of freedom, threads."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np

import octo
from octo.bench import bounds
from octo.bench.plan import Plan
from octo.bench.timing import Records, Say, Timing
from octo.checks import Array
from octo.model.character import Character
from octo.problem.compiled import CompiledProblem
from octo.problem.problem import Problem
from octo.solver import kkt
from octo.solver.blocks import KKTBlocks
from octo.solver.rule import STAGES
from octo.starts import first_nodes

MILLI, MICRO = 1e3, 1e6
Clock = Callable[[], float]


def walk(robot: Character, steps: int, basis: str = "nodes") -> Problem:
    """The paper's walk."""
    costs = [octo.CenterOfMassVelocity((0.5, 0.0, 0.0)), octo.Effort()]
    return octo.Problem(robot, steps=steps, dt=0.025, costs=costs, basis=basis)


class Iteration:
    """Curvature, one factorisation, the KKT step and one trial, from Python, with the seconds of
    every stage; at ``nodes`` (N+2, n), by default at the problem's starts."""

    def __init__(
        self,
        problem: Problem,
        threads: int = 1,
        batch: int = 1,
        clock: Clock = time.thread_time,
        nodes: Array | None = None,
    ):
        self.problem = CompiledProblem([problem] * batch, threads)
        starts = np.stack([first_nodes(problem, k, None) for k in range(batch)])
        if nodes is not None:
            starts[:] = nodes
        self.at = self.problem.evaluate(self.problem.unknowns(starts))
        shape = (batch, self.problem.K, self.problem.ma)
        self.lam = 1e-5 * np.random.default_rng(0).standard_normal(shape)
        self.sigma = self._weights(shape[:2])
        self.clock = clock
        self.seconds: list[Array] = []

    def _weights(self, shape: tuple[int, ...]) -> Array:
        """(batch, K) enough for the right inertia: a factorisation that goes on to its end."""
        model = self.problem.linearize(self.at, self.lam)
        for weight in 10.0 ** np.arange(-1.0, 8.0):
            sigma = np.full(shape, weight)
            factor = kkt.factorize(model.H, model.A, sigma, threads=self.problem.threads)
            if factor.inertia_ok.all():
                return sigma
        n = self.problem.problems[0].dynamics.nx
        raise ArithmeticError(f"no weight gives the KKT matrix of {n} coordinates its inertia")

    def __call__(self) -> None:
        problem, at, marks = self.problem, self.at, [self.clock()]
        model = problem.linearize(at, self.lam)
        marks.append(self.clock())
        factor = kkt.factorize(model.H, model.A, self.sigma, threads=problem.threads)
        marks.append(self.clock())
        step, lam = factor.solve(-model.b, -model.C)
        blocks = KKTBlocks(model.H, model.A, model.b, model.C)
        dual = np.abs(model.b + blocks.constraints_transposed_times(self.lam)).max()
        marks.append(self.clock())
        trial = problem.evaluate(at.unknowns + 1e-3 * step)
        marks.append(self.clock())
        assert factor.inertia_ok.all() and lam.shape == self.lam.shape
        assert np.isfinite(dual) and trial.finite.all()
        self.seconds.append(np.diff(marks))


def sample(runs: Mapping[str, Iteration], rounds: int, burst: int) -> dict[str, Array]:
    """(samples, stages) s of each: interleaved bursts of runs in a row, without the first of each,
    whose caches are cold."""
    for _ in range(rounds):
        for run in runs.values():
            run()
            run.seconds.pop()
            for _ in range(burst):
                run()
    return {name: np.array(run.seconds) for name, run in runs.items()}


def add(records: Records, name: str, seconds: Array, scale: float, unit: str) -> None:
    """The least and the median of the whole, and the least of each stage."""
    total = seconds.sum(axis=1)
    records.add_timing(name, Timing(total.min(), float(np.median(total))), scale, unit)
    for stage, values in zip(STAGES, seconds.T, strict=True):
        records.add(f"{name}.{stage}", values.min() * scale, unit)


# -- groups ----------------------------------------------------------------------------------------


def against_steps(records: Records, plan: Plan, say: Say) -> None:
    """ms of one iteration of the mammal against N, in both bases, with a straight line through
    them."""
    robot = octo.gallery.mammal()
    runs = {}
    for basis, sizes in (("nodes", plan.nodes), ("hermite", plan.hermite)):
        for steps in sizes:
            say(f"{basis}, {steps} steps")
            runs[f"iteration.{basis}.{steps}"] = Iteration(walk(robot, steps, basis))
    say("all of them, interleaved")
    for name, seconds in sample(runs, plan.rounds, plan.burst).items():
        add(records, name, seconds, MILLI, "ms")
    for basis, sizes in (("nodes", plan.nodes), ("hermite", plan.hermite)):
        line(records, f"iteration.{basis}", sizes)
    steps = plan.steps if plan.steps in plan.nodes else plan.nodes[-1]
    run = runs[f"iteration.nodes.{steps}"]
    took = records[f"iteration.nodes.{steps}.factor"] / MILLI  # s
    flops = run.problem.K * bounds.elimination_flops(run.problem.nc, run.problem.ma)
    records.add(f"iteration.nodes.{steps}.factor.rate", flops / took / 1e9, "Gflop/s")
    size = run.problem.K * bounds.model_bytes(run.problem.nc, run.problem.ma)
    records.add(f"iteration.nodes.{steps}.model", size / 1e6, "MB")


def line(records: Records, name: str, sizes: Sequence[int]) -> None:
    """The least relative squares: us a step, us that do not depend on N, and the largest relative
    error."""
    least = np.array([records[f"{name}.{steps}"] for steps in sizes])
    fit = np.polyfit(sizes, least, 1, w=1.0 / least)
    slope, constant = (float(value) for value in fit)
    records.add(f"{name}.slope", slope * MICRO / MILLI, "us/step")
    records.add(f"{name}.constant", constant * MICRO / MILLI, "us")
    error = float(np.abs(np.polyval(fit, sizes) / least - 1.0).max())
    records.add(f"{name}.largest_error_of_fit", error, "")


def against_degrees(records: Records, plan: Plan, say: Say) -> None:
    """us a step of one iteration in nodes, of chains of more and more links and of the gallery's
    robots."""
    runs, degrees = {}, {}
    made = {f"chain{links}": octo.gallery.chain(links) for links in plan.links}
    others = [name for name in plan.staged if name != "chain" or 5 not in plan.links]
    made |= {name: octo.gallery.CHARACTERS[name]() for name in others}
    for name, robot in made.items():
        say(f"{name}, {robot.nx} degrees of freedom")
        runs[f"degrees.{name}"] = Iteration(walk(robot, plan.steps))
        degrees[f"degrees.{name}"] = robot.nx
    say("all of them, interleaved")
    for name, seconds in sample(runs, plan.rounds, plan.burst).items():
        add(records, name, seconds / plan.steps, MICRO, "us/step")
        records.add(f"{name}.dof", degrees[name], "")
    chains = [f"degrees.chain{links}" for links in plan.links]
    for stage in ("", *(f".{stage}" for stage in STAGES)):
        least = [records[name + stage] for name in chains]
        power = np.polyfit(np.log([degrees[name] for name in chains]), np.log(least), 1)[0]
        records.add(f"degrees.power{stage}", power, "")
    records.ratio("degrees.longest/shortest", chains[-1], chains[0])


def over_threads(records: Records, plan: Plan, say: Say) -> None:
    """Seconds of the wall on one thread over those on more: one problem, and a batch of four."""
    robot = octo.gallery.mammal()
    for label, basis, batch in (
        ("nodes", "nodes", 1),
        ("hermite", "hermite", 1),
        ("nodes.batch4", "nodes", 4),
    ):
        say(f"{label}, {plan.steps} steps")
        problem = walk(robot, plan.steps, basis)
        counts, clock = (1, *plan.threads), time.perf_counter
        runs = {str(count): Iteration(problem, count, batch, clock) for count in counts}
        seconds = sample(runs, plan.rounds, plan.burst)
        one = seconds.pop("1")
        for count, values in seconds.items():
            name = f"threads.{count}.{label}"
            records.add(name, one.sum(axis=1).min() / values.sum(axis=1).min(), "x")
            for k, stage in enumerate(STAGES):
                records.add(f"{name}.{stage}", one[:, k].min() / values[:, k].min(), "x")
