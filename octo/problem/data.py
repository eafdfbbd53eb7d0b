"""The numbers of a batch: what may differ between problems of one structure, each with a batch
axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array
from octo.errors import ProblemError
from octo.problem.basis import node_values
from octo.problem.bounds import Fixed, bounds_of
from octo.problem.codegen import CostFunctions
from octo.problem.plan import Plan
from octo.problem.problem import Problem


@dataclass(frozen=True, eq=False)
class Data:
    """Of a batch of problems.

    Attributes
    ----------
    p: (batch, NP) run-time parameters of FD. q: (batch, N, NQ) coefficients and references of the
        terms, and a weight D, a shift d and a multiplier y of each bounded row.
    lower, upper: (batch, N, bounded rows) what the bounded rows must stay between, infinite where
        nothing is asked of them; the same of an equality.
    row_scale: (batch, m) of C's rows, 1/(mg) or 1/(mg·ℓ).
    start: (batch, n) x_0, rad and m.
    constant: (batch, N+2, n) the part of the nodes that no unknown moves.
    ends: (batch, K, nc) values of the pinned units, zero elsewhere.
    carry: (batch, n, n) of cycles: x_0 = carry x_N + constant; else None.
    """

    p: Array
    q: Array
    lower: Array
    upper: Array
    row_scale: Array
    start: Array
    constant: Array
    ends: Array
    carry: Array | None

    def select(self, members: NDArray) -> Data:
        """Those of some members, by index."""
        whole = {field.name: getattr(self, field.name) for field in fields(self)}
        return replace(
            self, **{k: np.ascontiguousarray(v[members]) for k, v in whole.items() if v is not None}
        )


def lowered(problems: Sequence[Problem], functions: CostFunctions) -> tuple[Plan, Data]:
    """Plan and numbers of problems of one structure; weights and the like of bounded rows are 0.

    Raises
    ------
    ProblemError: some have a fixed end and others not.
    """
    first = problems[0]
    basis, steps, dynamics = first.basis_object, int(first.steps), first.dynamics
    start = np.stack([problem.start for problem in problems])
    dt = np.array([problem.dt for problem in problems])[:, None]
    before = start - dt * np.stack([problem.start_velocity for problem in problems])
    constant = basis.constant(steps, start, before)
    closures = [problem.closure for problem in problems if problem.closure is not None]
    if closures:
        constant[:, 1] = constant[:, 0] = np.stack([closure.constant for closure in closures])
    pinned = _pinned(problems)
    plan = Plan.of(basis, steps, dynamics.nx, len(dynamics.unactuated), pinned[0])
    ends = np.zeros((len(problems), plan.K, plan.nodal))
    for member, values in enumerate(pinned):
        for unit, value in values.items():
            ends[member, unit] = value
    if pinned[0]:
        constant = node_values(basis.stencil(steps), ends, constant)
    rows = len(functions.bounded)
    data = Data(
        np.stack([problem.dynamics.bound(problem.p) for problem in problems]),
        np.zeros((len(problems), steps, functions.numbers)),
        np.empty((len(problems), steps, rows)),
        np.empty((len(problems), steps, rows)),
        np.stack([problem.row_scale for problem in problems]),
        start,
        constant,
        ends,
        np.stack([closure.matrix for closure in closures]) if closures else None,
    )
    fill(data, plan, problems, functions)
    return plan, data


def fill(data: Data, plan: Plan, problems: Sequence[Problem], functions: CostFunctions) -> None:
    """References, weights and bounds of the problems' terms; weights and shifts of bounded rows
    stay.

    Raises
    ------
    OctoError: bounds that contradict each other or a fixed state.
    """
    references = functions.references
    for member, problem in enumerate(problems):
        data.q[member, :, : references.size] = references.pack(problem.terms, problem.setting)
        if functions.bounded:
            lower, upper = bounds_of(problem, functions)
            if data.carry is None:
                fixed = Fixed.of(plan, data.constant[member], data.p[member], data.q[member])
                if problem.duration is not None:  # states that move are elsewhere in another time
                    fixed.known[[0, -2]] &= ~_moving(problem)
                fixed.take_out(problem, functions, lower, upper)
            data.lower[member], data.upper[member] = lower, upper


def _moving(problem: Problem) -> NDArray[np.bool_]:
    """(2,) whether the first and the last state have a velocity."""
    last = np.zeros(1) if problem.v_end is None else problem.v_end
    return np.array([problem.start_velocity.any(), last.any()])


def _pinned(problems: Sequence[Problem]) -> list[dict[int, Array]]:
    """Of each problem, the values of the units that its fixed last state pins."""
    ends = [problem.end is not None for problem in problems]
    if any(ends) and not all(ends):
        raise ProblemError("x_end must be given for every problem of a batch or for none")
    made: list[dict[int, Array]] = []
    for problem in problems:
        if problem.end is None:
            made.append({})
            continue
        v_end = np.zeros_like(problem.end) if problem.v_end is None else problem.v_end
        basis, steps = problem.basis_object, int(problem.steps)
        made.append(basis.fixed_end(steps, problem.end, v_end, problem.dt))
    return made
