"""What may be nonzero in the derivatives of one step, for optimisers that pay for every nonzero."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo.dynamics.evaluate import Dynamics, RobotDynamics
from octo.interrupts import postponed
from octo.problem.compiled import CompiledProblem

Pattern = NDArray[np.bool_]


@postponed()
def patterns(compiled: CompiledProblem) -> tuple[Pattern, Pattern]:
    """(3n, 3n) of ∇²(E + lamᵀFD) of a step and (m, 3n) of its unactuated rows, to (x_next, x,
    x_prev).

    A residual's square couples what the residual depends on, and its curvature no more.
    """
    dynamics, functions, n = compiled.dynamics, compiled.functions, compiled.n
    z, p, lam = (ca.SX.sym(*s) for s in (("z", 3 * n), ("p", dynamics.layout.size), ("lam", n)))
    fd = dynamics.symbolic(z[:n], z[n : 2 * n], z[2 * n :], p)
    pull = ca.densify(ca.gradient(ca.dot(lam, fd), z))
    rows = _slopes(dynamics)
    hessian = pattern_of(ca.Function("pull", [z, p, lam], [pull]).jac_sparsity(0, 0))
    terms = pattern_of(functions.state_sparsity)  # to (x_next, x, x_prev, u)
    terms = terms[:, : 3 * n] | (terms[:, 3 * n :] @ rows[dynamics.actuated])
    hessian |= terms.T @ terms
    if isinstance(dynamics, RobotDynamics):
        robot = dynamics.character
        for k in functions.contact_spheres:
            path = np.isin(np.arange(n), robot.path[robot.contacts[k].body])
            hessian |= np.outer(np.tile(path, 3), np.tile(path, 3))
    return hessian | hessian.T, rows[dynamics.unactuated]


@postponed()
def torque_pattern(dynamics: Dynamics) -> Pattern:
    """(nu, 3n) of the torques of a step, to (x_next, x, x_prev)."""
    return _slopes(dynamics)[dynamics.actuated]


def _slopes(dynamics: Dynamics) -> Pattern:
    """(n, 3n) of FD."""
    n = dynamics.nx
    z, p = ca.SX.sym("z", 3 * n), ca.SX.sym("p", dynamics.layout.size)
    fd = dynamics.symbolic(z[:n], z[n : 2 * n], z[2 * n :], p)
    return pattern_of(ca.Function("fd", [z, p], [fd]).jac_sparsity(0, 0))


def pattern_of(sparsity: ca.Sparsity) -> Pattern:
    """Where a matrix may have numbers."""
    out = np.zeros(sparsity.shape, dtype=bool)
    out[np.array(sparsity.row(), dtype=int), np.array(sparsity.get_col(), dtype=int)] = True
    return out
