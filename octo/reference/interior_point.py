"""IPOPT on the identical problem: exact Hessian, every callback in compiled code, the same
tolerances as octo."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from octo import native
from octo.checks import Array, instance
from octo.problem.compiled import CompiledProblem
from octo.problem.problem import Problem
from octo.reference.layout import octo_layout
from octo.reference.library import Library
from octo.reference.program import (
    multipliers_of,
    nlp,
    parameter_vector,
    places_of,
    point_of,
    rows_of,
    start_nodes,
    unknowns_of,
)
from octo.reference.rows import complementarity, first_weight, gap, limits
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

WORDS = {
    "Solve_Succeeded": Status.CONVERGED,
    "Solved_To_Acceptable_Level": Status.ACCEPTABLE,
    "Maximum_Iterations_Exceeded": Status.ITERATION_LIMIT,
    "Maximum_CpuTime_Exceeded": Status.TIME_LIMIT,
    "Maximum_WallTime_Exceeded": Status.TIME_LIMIT,
    "Invalid_Number_Detected": Status.NOT_FINITE,
}


class Ipopt:
    """A problem made ready for IPOPT; starts, weights and parameters may differ from solve to
    solve.

    Its Hessian is exact, but for stages of code without second derivatives, which it takes as
    linear where they are called.

    Parameters
    ----------
    options: tolerances and limits. IPOPT stops where octo does: ‖C‖∞ ≤ ``tolerance`` and ‖∇E +
        Aᵀlam‖∞ ≤ ``dual_tolerance``, or by octo's own rule "acceptable", which a compiled function
        watches; of constraints their violation ≤ ``tolerance`` and octo's complementarity too.
    settings: more options of IPOPT, by its own names.
    """

    def __init__(
        self,
        problem: Problem,
        options: SqpOptions = OPTIONS,
        settings: Mapping[str, Any] | None = None,
    ):
        began = time.perf_counter()
        self.problem = instance("problem", problem, Problem, "an octo.Problem")
        self.options = options
        self.compiled = native.compiler() is not None
        self.blocks = CompiledProblem([problem], exact=self.compiled)
        self.blocks.check_squares("IPOPT", bounds=True)
        self.library = Library(self.blocks, octo_layout(self.blocks)) if self.compiled else None
        source = nlp(problem).symbols if self.library is None else self.library.path
        self.settings = {
            "max_iter": options.max_iterations,
            "tol": options.dual_tolerance,
            "dual_inf_tol": options.dual_tolerance,
            "constr_viol_tol": options.tolerance,
            "acceptable_iter": 0,
            "print_level": 0,
            "sb": "yes",
            **(settings or {}),
        }
        self.bounds = limits(self.blocks, places_of(self.blocks))
        if self.blocks.functions.bounded:  # the barrier ends at octo's own weight
            self.settings.setdefault("compl_inf_tol", complementarity(self.blocks.steps, options))
        if np.isfinite(options.time_limit):
            self.settings["max_wall_time"] = options.time_limit
        self.solvers = {warm: self._solver(source, warm) for warm in (False, True)}
        self.setup_seconds = time.perf_counter() - began
        prepare(self.blocks)

    def _told(self, warm: bool) -> dict[str, Any]:
        """The settings of a solve, with multipliers or without."""
        settings = {**self.settings, **({"warm_start_init_point": "yes"} if warm else {})}
        if self.blocks.functions.bounded:
            settings.setdefault("mu_init", first_weight(self.blocks, warm))
        return settings

    def _solver(self, source: dict[str, ca.MX] | str, warm: bool) -> ca.Function:
        """Of expressions or a library; with ``warm``, IPOPT takes over the multipliers that it is
        given."""
        options = {"ipopt": self._told(warm), **QUIET}
        if self.library is not None:
            options["iteration_callback"] = self.library.function("octo_watch")
        return ca.nlpsol("reference", "ipopt", source, options)

    def solve(
        self,
        start: Array | None = None,
        multipliers: Array | None = None,
        seed: int = 0,
        row_multipliers: Array | None = None,
    ) -> Run:
        """From nodes x_{-1} … x_N (N+2, nx), by default as of ``nlp``, and multipliers (K, ma), of
        the rows between bounds too (N, rows), as ``Solution.row_multipliers``."""
        compiled, o = self.blocks, self.options
        first = point_of(compiled, compiled.unknowns(start_nodes(self.problem, start)[None]))
        lower, upper = self.bounds
        p = parameter_vector(compiled)
        arguments: dict[str, Any] = {"x0": first, "p": p, "lbg": lower, "ubg": upper}
        if multipliers is not None:
            arguments["lam_g0"] = rows_of(compiled, multipliers, row_multipliers)
        warm = multipliers is not None
        solver = self.solvers[warm]
        made = timed(solver, self.library, o, arguments)
        stats = solver.stats()
        said = str(stats["return_status"])
        status = WORDS.get(said, Status.STALLED)
        if said == "User_Requested_Stop" and self.library is not None and self.library.settled:
            said, status = "stopped by octo's rule of an acceptable point", Status.ACCEPTABLE
        columns = self._history(stats, made.seconds)
        if made.caught:
            said, status = "stopped by Ctrl-C", Status.INTERRUPTED
        elif not status.converged and settled(
            columns["energy"], columns["violation"] / compiled.weight, o
        ):
            ended = gap(lower, upper, made.found) <= complementarity(compiled.steps, o)
            status = Status.ACCEPTABLE if ended else status
        multipliers = multipliers_of(compiled, made.found["lam_g"])
        solution = solution_of(
            compiled,
            unknowns_of(compiled, made.found["x"]),
            multipliers,
            status,
            made,
            iterations=int(stats["iter_count"]),
            history=columns,
            setup_seconds=self.setup_seconds,
            seed=seed,
        )
        return Run("ipopt", solution, said, self.compiled, self._told(warm))

    def _history(self, stats: dict[str, Any], seconds: float) -> dict[str, Array]:
        """A row an iterate: E, ‖C‖∞ in N and when, as the compiled watch saw them; IPOPT's own
        figures are of scaled rows."""
        told = {
            name: np.asarray(values, dtype=float)
            for name, values in stats.get("iterations", {}).items()
        }
        count = len(told.get("obj", ()))
        if self.library is not None:
            times, energies, violations = self.library.log().T
        else:
            times = np.linspace(0.0, seconds, count)
            energies = told["obj"]
            violations = told["inf_pr"]
        names = {
            "dual": "inf_du",
            "step": "d_norm",
            "ratio": "alpha_pr",
            "sigma": "regularization_size",
        }
        more = {
            name: told[own] for name, own in names.items() if own in told and count == len(energies)
        }
        return history(energies, violations * self.blocks.weight, times, **more)


def ipopt(problem: Problem, start: Array | None = None, **options: Any) -> Run:
    """Solve ``problem`` with IPOPT; see :class:`Ipopt` for ``options`` and ``settings``, its
    ``solve`` for the rest."""
    more = {name: options.pop(name) for name in WARM if name in options}
    return Ipopt(problem, **options).solve(start, **more)
