"""What may be nonzero in the derivatives of a step, and of two in a row, for optimisers that pay
for every nonzero."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from octo.dynamics.evaluate import Dynamics, RobotDynamics
from octo.interrupts import postponed
from octo.problem.basis import WINDOW
from octo.problem.codegen import CostFunctions
from octo.problem.compiled import CompiledProblem

Pattern = NDArray[np.bool_]


@postponed()
def patterns(compiled: CompiledProblem) -> tuple[Pattern, Pattern]:
    """(3n, 3n) of ∇²(E + lamᵀFD) of a step and (n, 3n) of the slopes of FD, to (x_next, x, x_prev).

    A residual's square couples what the residual depends on, and its curvature no more.
    """
    dynamics, functions, n = compiled.dynamics, compiled.functions, compiled.n
    rows, hessian = _of_dynamics(dynamics)
    terms = pattern_of(functions.state_sparsity)  # to (x_next, x, x_prev, u)
    terms = terms[_bending(functions)]
    terms = terms[:, : 3 * n] | (terms[:, 3 * n :] @ rows[dynamics.actuated])
    hessian |= terms.T @ terms
    if isinstance(dynamics, RobotDynamics):
        robot = dynamics.character
        for k in functions.contact_spheres:
            path = np.isin(np.arange(n), robot.path[robot.contacts[k].body])
            hessian |= np.outer(np.tile(path, 3), np.tile(path, 3))
    return hessian | hessian.T, rows


def _of_dynamics(dynamics: Dynamics) -> tuple[Pattern, Pattern]:
    """(n, 3n) of the slopes of FD and (3n, 3n) of the curvature of lamᵀFD."""
    if dynamics.curvature_pattern is not None:
        return dynamics.jacobian_pattern, dynamics.curvature_pattern
    n = dynamics.nx
    sizes = {"z": 3 * n, "p": dynamics.symbolic.numel_in(3), "lam": n}
    z, p, lam = (ca.SX.sym(*each) for each in sizes.items())
    fd = dynamics.symbolic(z[:n], z[n : 2 * n], z[2 * n :], p)
    pull = ca.densify(ca.gradient(ca.dot(lam, fd), z))
    rows = pattern_of(ca.Function("fd", [z, p], [fd]).jac_sparsity(0, 0))
    return rows, pattern_of(ca.Function("pull", [z, p, lam], [pull]).jac_sparsity(0, 0))


def _bending(functions: CostFunctions) -> NDArray[np.bool_]:
    """(rows over the state,) those with second derivatives of their own: all squares, and bounded
    rows that are not linear."""
    made = np.ones(len(functions.state_terms), dtype=bool)
    count = len(functions.bounded)
    if count and not functions.calls:
        inputs = functions.state.sx_in()
        bounded = functions.state(*inputs)[len(made) - count :]
        state = ca.vertcat(*inputs[:4])
        made[len(made) - count :] = ca.which_depends(bounded, state, 2, True)
    return made


def pair_rows(
    c: CompiledProblem, fd: Pattern, nodes: sparse.csr_array, windows: sparse.csr_array
) -> sparse.csr_array:
    """(rows of all steps, x) pattern: their squares couple what stands in one row, and their
    curvature no more.

    fd: (n, 3n) of its slopes. nodes: ((N+2)·n, x) what x_{-1} … x_N are made of. windows: (N·3n, x)
    the same of each step's x_next, x, x_prev.
    """
    assert c.functions.pairs is not None
    slopes, n, first = pattern_of(c.functions.pairs.sparsity), c.n, int(c.carry is None)
    torques, nu = fd[c.dynamics.actuated], c.nu
    own, before = slopes[:, WINDOW * n : -nu] @ torques, slopes[:, -nu:] @ torques
    each, size = np.arange(n), 3 * n
    if c.carry is not None:
        oldest = sparse.csr_array(c.carry[0] != 0.0) @ nodes[(c.steps - 1) * n : c.steps * n]
        nodes = sparse.vstack([oldest, nodes]).tocsr()
    steps = np.arange(c.steps - first)
    window = steps[:, None, None] + np.arange(WINDOW - 1, -1, -1)[:, None]
    earlier = [sparse.csr_array(before)] * (c.steps - 1)
    if c.carry is not None:  # before the first step comes the last one, carried back
        motors = np.ix_(c.dynamics.actuated, c.dynamics.actuated)
        seam = slopes[:, -nu:] @ (c.carry[0][motors] != 0.0) @ torques
        earlier.insert(0, sparse.csr_array(seam))
        windows_before = sparse.vstack([windows[-size:], windows[:-size]])
    else:
        windows_before = windows[:-size]
    made = [
        sparse.kron(sparse.eye(len(steps)), slopes[:, : WINDOW * n])
        @ nodes[(window * n + each).ravel()],
        sparse.kron(sparse.eye(len(steps)), own) @ windows[first * size :],
        sparse.block_diag(earlier) @ windows_before,
    ]
    return sparse.csr_array(made[0] + made[1] + made[2])


def pattern_of(sparsity: ca.Sparsity) -> Pattern:
    """Where a matrix may have numbers."""
    out = np.zeros(sparsity.shape, dtype=bool)
    out[np.array(sparsity.row(), dtype=int), np.array(sparsity.get_col(), dtype=int)] = True
    return out
