"""Controls of motions and of problems, and the nodes that controls make."""

from __future__ import annotations

import numpy as np

from octo.checks import Array
from octo.problem.basis import Hermite, node_values
from octo.problem.problem import Problem
from octo.problem.splines import tangents_of
from octo.result.solution import Solution


def controls(solution: Solution) -> Array:
    """(Z + 1, 2 nx) the controls of a motion: (x_i, x_i − x_{i−1}) of nodes, (x_k, τ ẋ_k) of a
    Hermite spline."""
    x = solution.x
    if solution.basis != Hermite.name:
        return np.concatenate([x[1:], np.diff(x, axis=0)], axis=1)
    q = (len(x) - 2) // (len(solution.unknowns) - 1)
    first = q * (x[1:2] - x[:1])
    return np.concatenate([x[1::q], np.concatenate([first, tangents_of(x, q)])], axis=1)


def first_control(problem: Problem) -> Array:
    """(2 nx,) that a problem begins with."""
    basis, change = problem.basis_object, float(problem.dt) * problem.start_velocity
    q = basis.steps_per_segment if isinstance(basis, Hermite) else 1
    return np.concatenate([problem.start, q * change])


def count_of(problem: Problem) -> int:
    """Of the controls behind the first one."""
    basis, steps = problem.basis_object, int(problem.steps)
    return steps // basis.steps_per_segment if isinstance(basis, Hermite) else steps


def nodes_of(problem: Problem, made: Array) -> Array:
    """x_0 … x_N (N+1, nx) of a problem's controls (Z + 1, 2 nx)."""
    basis, steps, n = problem.basis_object, int(problem.steps), problem.dynamics.nx
    if not isinstance(basis, Hermite):
        return made[:, :n]
    unknowns = np.vstack([made[1:], np.zeros((1, 2 * n))])[None]
    x, change = made[None, 0, :n], made[None, 0, n:] / basis.steps_per_segment
    constant = basis.constant(steps, x, x - change)
    return np.asarray(node_values(basis.stencil(steps), unknowns, constant)[0, 1:])
