"""E of one step with exact first and second derivatives, as small CasADi functions that nlp.c
chains together.

A step's cost is a function of its three configurations z and of w: the torques u, and the centre of
mass at x_next and at x. The derivatives of w come from the tree pass, so that nothing here grows
with the number of bodies. A contact's cost is a function of the three poses of its body,
differentiated along twists.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.symbolic import perturbed
from octo.interrupts import postponed
from octo.problem.compiled import CompiledProblem
from octo.problem.contact_costs import ContactCost
from octo.problem.costs import NeighbourCost, StepPairCost
from octo.problem.symbols import StepSymbols
from octo.reference.program import has_neighbours

OPTIONS = {"cse": True}


def _with_centers(step: StepSymbols, now: ca.SX, before: ca.SX) -> StepSymbols:
    """The step with symbols (3,) m for its centre of mass at x_next and at x, in place of
    expressions of its coordinates."""
    step.__dict__.update(com=now, com_velocity=(now - before) / step.dt)
    return step


@dataclass(frozen=True, eq=False)
class ExactCosts:
    """Functions octo_exact{0,1,2}(x_next, x, x_prev, w, p, q) and octo_touch{0,1,2}(T_next, T,
    T_prev, sphere, p, q, use).

    Orders: E; its derivatives to z and w, or to the three twists (18); the nonzeros of the upper
    triangle of the second derivatives to (z, w), at ``sparsity``, or the 18×18 numbers
    ∂²E/∂outer∂inner of two twists after another.
    """

    step: tuple[ca.Function, ...]
    sparsity: ca.Sparsity
    centers: int  # numbers of w after u: 6, or 0 without bodies
    contact: tuple[ca.Function, ...]


@postponed()
def exact_costs(compiled: CompiledProblem) -> ExactCosts:
    """Of the terms that a single step sees."""
    dynamics = compiled.dynamics
    references = compiled.functions.references
    n, nu, robot = compiled.n, compiled.nu, isinstance(compiled.dynamics, RobotDynamics)
    nodes = [ca.SX.sym(name, n) for name in ("x_next", "x", "x_prev")]
    w, p = ca.SX.sym("w", nu + (6 if robot else 0)), ca.SX.sym("p", dynamics.layout.size)
    q = ca.SX.sym("q", compiled.q.shape[2])
    step = StepSymbols(
        nodes[0],
        nodes[1],
        nodes[2],
        w[:nu],
        dynamics.layout.view(p),
        dynamics.actuated,
        dynamics if isinstance(dynamics, RobotDynamics) else None,
    )
    if robot:
        step = _with_centers(step, w[nu : nu + 3], w[nu + 3 :])
    energy, between = ca.SX(0), has_neighbours(compiled)
    for k, term in enumerate(references.terms):
        view = references.view(q, k)
        elsewhere = isinstance(term, (ContactCost, StepPairCost))
        if not (elsewhere or (between and isinstance(term, NeighbourCost))):
            energy += q[k] * ca.sumsqr(term.shaped(term.residual(step, view), view))
    z = ca.vertcat(*nodes)
    whole, gradient = ca.hessian(energy, ca.vertcat(z, w))
    upper = ca.triu(whole)
    first, second = ca.densify(gradient[: 3 * n]), ca.densify(gradient[3 * n :])
    out = [energy, first, second, ca.vertcat(*upper.nonzeros()) if upper.nnz() else ca.SX(0, 1)]
    step_functions = tuple(
        ca.Function(f"octo_exact{order}", [*nodes, w, p, q], out[: (1, 3, 4)[order]], OPTIONS)
        for order in (0, 1, 2)
    )
    return ExactCosts(step_functions, upper.sparsity(), w.numel() - nu, _contact(compiled))


def _contact(compiled: CompiledProblem) -> tuple[ca.Function, ...]:
    """∂²/∂a∂b of E(exp(â) exp(b̂) T) at zero is what an ancestor's twist a and a descendant's b
    make of it."""
    own = compiled.functions.contact
    if own is None:
        return ()
    columns = [ca.SX.sym(f"T{k}", 12) for k in range(3)]
    sphere, p = ca.SX.sym("sphere", 4), ca.SX.sym("p", compiled.dynamics.layout.size)
    q, use = ca.SX.sym("q", compiled.q.shape[2]), ca.SX.sym("use", len(own.terms))
    outer, inner = ca.SX.sym("outer", 18), ca.SX.sym("inner", 18)
    moved = [
        perturbed(perturbed(T, inner[6 * k : 6 * k + 6]), outer[6 * k : 6 * k + 6])
        for k, T in enumerate(columns)
    ]
    r = own.value(*moved, sphere, p, q)
    energy = ca.dot(ca.vertcat(*[q[t] for t in own.terms]) * use, r**2)
    twists, still = ca.vertcat(outer, inner), ca.SX.zeros(36)
    gradient = ca.gradient(energy, inner)
    # column by column: row a of ∂/∂outer_a
    out = [energy, gradient, ca.vec(ca.jacobian(gradient, outer))]
    out = [ca.densify(ca.substitute(value, twists, still)) for value in out]
    inputs = [*columns, sphere, p, q, use]
    return tuple(
        ca.Function(f"octo_touch{order}", inputs, out[: order + 1], OPTIONS) for order in (0, 1, 2)
    )


@postponed()
def patterns(
    compiled: CompiledProblem, costs: ExactCosts
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """What may be nonzero: (3n, 3n) of ∇²(E + lamᵀFD) and (m, 3n) of the unactuated rows, to
    (x_next, x, x_prev)."""
    dynamics, n, nu = compiled.dynamics, compiled.n, compiled.nu
    z, p, lam = ca.SX.sym("z", 3 * n), ca.SX.sym("p", dynamics.layout.size), ca.SX.sym("lam", n)
    fd = dynamics.symbolic(z[:n], z[n : 2 * n], z[2 * n :], p)
    pull = ca.gradient(ca.dot(lam, fd), z)
    rows = _pattern(ca.Function("fd", [z, p], [fd]).jac_sparsity(0, 0))
    hessian = _pattern(ca.Function("pull", [z, p, lam], [ca.densify(pull)]).jac_sparsity(0, 0))
    w = np.zeros((nu + costs.centers, 3 * n), dtype=bool)
    w[:nu] = rows[dynamics.actuated]
    robot = dynamics.character if isinstance(dynamics, RobotDynamics) else None
    if robot is not None:
        w[nu : nu + 3, :n] = w[nu + 3 :, n : 2 * n] = True
        for k in costs.contact and compiled.functions.contact_spheres:
            at = np.zeros(3 * n, dtype=bool)
            path = list(robot.path[robot.contacts[k].body])
            at[[t * n + j for t in range(3) for j in path]] = True
            hessian |= np.outer(at, at)
    upper = _pattern(costs.sparsity)
    whole = upper | upper.T
    chain = np.concatenate([np.eye(3 * n, dtype=bool), w])
    used = np.asarray(whole.any(axis=0))[3 * n + nu :]
    if robot is not None and used.any():
        for t in (0, 1):
            hessian[t * n : (t + 1) * n, t * n : (t + 1) * n] |= bool(used[3 * t : 3 * t + 3].any())
    hessian |= (chain.T.astype(int) @ whole.astype(int) @ chain.astype(int)) > 0
    return hessian | hessian.T, rows[dynamics.unactuated]


def _pattern(sparsity: ca.Sparsity) -> NDArray[np.bool_]:
    out = np.zeros(sparsity.shape, dtype=bool)
    out[np.array(sparsity.row(), dtype=int), np.array(sparsity.get_col(), dtype=int)] = True
    return out
