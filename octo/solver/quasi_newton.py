"""L-BFGS for soft constraints (§8.4): SciPy's, member by member, on E + ½ρ‖C‖² and its gradient."""

from __future__ import annotations

import time
from dataclasses import fields

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, minimize

from octo.arrays import Array
from octo.problem.block_nlp import BlockNLP
from octo.problem.evaluation import Evaluation
from octo.solver.options import SqpOptions
from octo.solver.rule import Clock
from octo.solver.sqp import Monitor, Result
from octo.solver.status import HISTORY, Status

MEMORY = 20  # pairs of steps and of changes of the gradient
TRIALS = 20  # evaluations of one line search


def run(
    problem: BlockNLP, unknowns: Array, options: SqpOptions, monitor: Monitor | None = None
) -> Result:
    """One pass from ``unknowns`` (batch, K, nc), of a problem without constraints."""
    told, clock = monitor or Monitor(), Clock()
    began, began_processor = time.perf_counter(), time.process_time()
    members = []
    for k in range(problem.batch):
        own = problem.take(np.array([k]))
        left = options.time_limit - (time.perf_counter() - began)
        members.append(_Member(own, options, told, clock, left).run(unknowns[k : k + 1]))
    ends = [member.at for member in members]
    at = Evaluation(*(np.concatenate([getattr(e, f.name) for e in ends]) for f in fields(ends[0])))
    return Result(
        at=at,
        lam=np.zeros((problem.batch, problem.K, problem.ma)),
        slacks=None,
        status=[member.status for member in members],
        iterations=np.array([len(member.rows) for member in members]),
        factorizations=np.zeros(problem.batch, dtype=np.intp),
        history=[member.history() for member in members],
        stages=dict(clock.seconds),
        seconds=time.perf_counter() - began,
        processor_seconds=time.process_time() - began_processor,
    )


class _Member:
    """One start."""

    def __init__(
        self, problem: BlockNLP, options: SqpOptions, monitor: Monitor, clock: Clock, left: float
    ):
        self.problem, self.options, self.monitor, self.clock = problem, options, monitor, clock
        self.began, self.left = time.perf_counter(), left
        self.status = Status.STALLED
        self.rows: list[dict[str, float]] = []
        self.at: Evaluation  # the iterate, and ‖∇‖∞ there
        self.steepest: float
        self.seen: Evaluation  # the last point asked for, and its gradient
        self.slope: NDArray[np.float64]

    def run(self, unknowns: Array) -> _Member:
        shape, start = unknowns.shape, np.ascontiguousarray(unknowns, dtype=float)
        self.at = self.seen = self.problem.evaluate(start)
        if not bool(self.at.finite[0]):
            self.status = Status.NOT_FINITE
            return self
        if self.monitor.stopped:
            self.status = Status.INTERRUPTED
            return self

        self.steepest = float(np.abs(self.problem.gradient(self.at)[0]).max())

        def value(v: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
            with self.clock("evaluate"):
                self.seen = self.problem.evaluate(np.ascontiguousarray(v.reshape(shape)))
            with self.clock("linearize"):
                self.slope = self.problem.gradient(self.seen)[0].ravel()
            energy = float(self.seen.energy[0])
            return (energy, self.slope) if np.isfinite(energy) else (1e300, 0.0 * self.slope)

        o = self.options
        how: dict[str, float] = {"maxiter": o.max_iterations, "maxfun": TRIALS * o.max_iterations}
        how |= {"maxcor": MEMORY, "maxls": TRIALS, "ftol": 0.0, "gtol": o.dual_tolerance}
        try:
            found = minimize(
                value, start.ravel(), method="L-BFGS-B", jac=True, callback=self._told, options=how
            )
        except KeyboardInterrupt:
            self.monitor.stopped, self.status = True, Status.INTERRUPTED
            return self
        if self.status is Status.STALLED and len(self.rows) >= o.max_iterations:
            self.status = Status.ITERATION_LIMIT
        elif self.status is Status.STALLED and np.abs(found.jac).max() <= o.dual_tolerance:
            self.status = Status.CONVERGED
        return self

    def _told(self, intermediate_result: OptimizeResult) -> None:
        """After each iteration."""
        at = intermediate_result.x.reshape(self.at.unknowns.shape)
        if (self.seen.unknowns != at).any():  # it went back to an earlier point of its line
            self.seen = self.problem.evaluate(np.ascontiguousarray(at))
            self.slope = self.problem.gradient(self.seen)[0].ravel()
        moved = float(np.abs(self.seen.unknowns - self.at.unknowns).max())
        seconds = time.perf_counter() - self.began
        self.rows.append(
            {
                "iteration": float(len(self.rows)),
                "energy": float(self.at.objective[0]),
                "violation": float(self.at.largest[0] * self.problem.weight),
                "dual": self.steepest,
                "step": moved,
                "taken": moved,
                "factorizations": 0.0,
                "seconds": seconds,
            }
        )
        self.at, self.steepest = self.seen, float(np.abs(self.slope).max())
        violation = self.at.largest * self.problem.weight
        if self.monitor.show(len(self.rows) - 1, self.at, violation):
            self.status = Status.INTERRUPTED
            raise StopIteration
        if seconds > self.left:
            self.status = Status.TIME_LIMIT
            raise StopIteration

    def history(self) -> dict[str, NDArray[np.float64]]:
        """The columns of HISTORY; NaN is what there is none of."""
        none = np.nan
        return {
            name: np.array([row.get(name, 0.0 if name == "pass" else none) for row in self.rows])
            for name in HISTORY
        }
