"""fatrop on the identical problem in the nodes basis: state (x_i, x_{i−1}), control x_{i+1},
U_/FD_i = 0 and what is between bounds at every stage."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from octo.checks import Array, instance
from octo.errors import ProblemError
from octo.problem.basis import Nodes
from octo.problem.compiled import CompiledProblem
from octo.problem.problem import Problem
from octo.problem.step_pairs import refuse_step_pairs
from octo.reference.layout import rows_of_stages, stage_layout
from octo.reference.library import Library
from octo.reference.program import parameter_vector, start_nodes
from octo.reference.rows import complementarity, gap, limits
from octo.reference.run import (
    OPTIONS,
    QUIET,
    WARM,
    Run,
    history,
    prepare,
    settled,
    solution_of,
    timed,
)
from octo.solver.options import SqpOptions
from octo.solver.status import Status


class Fatrop:
    """A problem made ready for fatrop. ``options`` and ``settings`` as of
    :class:`~octo.reference.interior_point.Ipopt`.

    fatrop has no call-back, so it cannot be stopped by octo's rule "acceptable", nor after a time.

    Raises
    ------
    ProblemError: the basis is not "nodes", or the problem is a cycle. DeviceError: there is no C
        compiler.
    """

    def __init__(
        self,
        problem: Problem,
        options: SqpOptions = OPTIONS,
        settings: Mapping[str, Any] | None = None,
    ):
        instance("problem", problem, Problem, "an octo.Problem")
        if problem.cycle is not None:
            raise ProblemError(
                "fatrop cannot solve a cycle: a stage may see its own state and control only, "
                "and the first stage of a cycle "
                "sees the last one"
            )
        refuse_step_pairs(problem.costs, "a problem for fatrop")
        if not isinstance(problem.basis_object, Nodes):
            raise ProblemError(
                f"fatrop cannot solve in the {problem.basis_object.name} basis: a stage may see "
                "its own state and control only, "
                "and a row of C sums the steps of two segments; must be nodes"
            )
        began = time.perf_counter()
        self.problem, self.options = problem, options
        self.compiled = CompiledProblem([problem], exact=True)
        self.compiled.check_squares("fatrop", bounds=True)
        self.layout = stage_layout(self.compiled)
        self.library = Library(self.compiled, self.layout)
        n, steps = self.compiled.n, self.compiled.steps
        self.bounds = limits(self.compiled, self.layout.bounded_place)
        self.settings = {
            "max_iter": options.max_iterations,
            "tolerance": options.dual_tolerance,
            "constr_viol_tol": options.tolerance,
            "tol_acceptable": options.dual_tolerance,
            "print_level": 0,
            **(settings or {}),
        }
        structure = {
            "structure_detection": "manual",
            "N": steps - 1,
            "nx": [2 * n] * steps,
            "nu": [n] * steps,
            "ng": rows_of_stages(self.compiled).tolist(),
            "equality": (self.bounds[0] == self.bounds[1]).tolist(),
        }
        own = {"fatrop": self.settings, **structure, **QUIET}
        self.solver = ca.nlpsol("reference", "fatrop", self.library.path, own)
        self.setup_seconds = time.perf_counter() - began
        prepare(self.compiled)

    def _bounds(self) -> tuple[Array, Array]:
        """Of every stage's numbers: the first state is given, and so may be the last."""
        c = self.compiled
        free = np.full((c.steps, 3, c.n), np.inf)
        lower, upper = -free, free.copy()
        for bound in (lower, upper):
            bound[0, 0], bound[0, 1] = c.constant[0, 1], c.constant[0, 0]
            for unit in c.fixed:
                bound[unit, 2] = c.ends[0, unit]
        return lower.ravel(), upper.ravel()

    def solve(
        self,
        start: Array | None = None,
        multipliers: Array | None = None,
        seed: int = 0,
        row_multipliers: Array | None = None,
    ) -> Run:
        """From nodes x_{-1} … x_N (N+2, nx), by default x_0 held still; fatrop makes its own
        multipliers."""
        del multipliers, row_multipliers
        c, o = self.compiled, self.options
        nodes = start_nodes(self.problem, start).copy()
        nodes[:2] = c.constant[0, :2]
        first = np.stack([nodes[1:-1], nodes[:-2], nodes[2:]], axis=1)
        lower, upper = self._bounds()
        p, (least, most) = parameter_vector(c), self.bounds
        bounds = {"lbx": lower, "ubx": upper, "lbg": least, "ubg": most}
        given = {"x0": np.clip(first.ravel(), lower, upper), "p": p, **bounds}
        made = timed(self.solver, self.library, o, given)
        stats = self.solver.stats()
        iterations, log = int(stats["iter_count"]), self.library.log()
        columns = history(log[:, 1], log[:, 2] * c.weight, log[:, 0])
        status = Status.CONVERGED if stats["success"] else Status.STALLED
        if not stats["success"] and iterations >= o.max_iterations:
            status = Status.ITERATION_LIMIT
        if made.caught:
            status = Status.INTERRUPTED
        elif not status.converged and len(log) and settled(log[:, 1], log[:, 2], o):
            ended = gap(least, most, made.found) <= complementarity(c.steps, o)
            status = Status.ACCEPTABLE if ended else status
        x = np.asarray(made.found["x"]).reshape(c.steps, 3, c.n)
        unknowns = x[None, :, 2].copy()
        unknowns[:, c.fixed] = 0.0
        solution = solution_of(
            c,
            unknowns,
            np.asarray(made.found["lam_g"]).ravel()[self.layout.of_c].reshape(c.K, c.ma),
            status,
            made,
            iterations=iterations,
            history=columns,
            setup_seconds=self.setup_seconds,
            seed=seed,
        )
        said = (
            "stopped by Ctrl-C" if made.caught else f"return flag {stats['fatrop']['return_flag']}"
        )
        return Run("fatrop", solution, said, True, dict(self.settings))


def fatrop(problem: Problem, start: Array | None = None, **options: Any) -> Run:
    """Solve ``problem`` with fatrop; see :class:`Fatrop`."""
    more = {name: options.pop(name) for name in WARM if name in options}
    return Fatrop(problem, **options).solve(start, **more)
