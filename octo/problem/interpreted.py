"""E, C and their model without a compiler: CasADi's virtual machine for the derivatives, NumPy for the blocks.

The same formulas as assemble.c in slower words; it is also what the native code is tested against.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo.dynamics import symbolic
from octo.dynamics.evaluate import RobotDynamics

if TYPE_CHECKING:
    from octo.problem.compiled import CompiledProblem, Evaluation

Array = NDArray[np.float64]


class Interpreted:
    """Residuals of all terms over all steps, their derivatives, and the blocks of Eq. 9."""

    def __init__(self, problem: CompiledProblem):
        self.problem = problem

    @cached_property
    def _residuals(self) -> tuple[ca.Function, ca.Function, NDArray[np.intp], Array]:
        """r and dr/d(x_next, x, x_prev, u) of one step, with the term of each row and its mask."""
        owner, functions = self.problem, self.problem.functions
        n, dynamics = owner.n, owner.dynamics
        z, u = ca.SX.sym("z", 3 * n), ca.SX.sym("u", owner.nu)
        p, q = ca.SX.sym("p", dynamics.layout.size), ca.SX.sym("q", owner.q.shape[-1])
        x_next, x, x_prev = z[:n], z[n : 2 * n], z[2 * n :]
        parts, terms = [functions.state(x_next, x, x_prev, u, p, q)], [*functions.state_terms]
        mask = [1.0] * len(terms)
        if functions.contact is not None and isinstance(dynamics, RobotDynamics):
            robot = dynamics.character
            poses = [symbolic.body_poses(robot, node) for node in (x_next, x, x_prev)]
            for k, index in enumerate(functions.contact_spheres):
                sphere = robot.contacts[index]
                columns = [ca.vertcat(ca.vec(pose[sphere.body][0].T), pose[sphere.body][1]) for pose in poses]
                parts.append(functions.contact(*columns, ca.vertcat(ca.DM(sphere.position), sphere.radius), p, q))
                terms += functions.contact_terms
                mask += functions.contact_use[k].astype(float).tolist()
        r = ca.densify(ca.vertcat(*parts))
        jac = ca.densify(ca.jacobian(r, ca.vertcat(z, u)))
        inputs = [z, u, p, q]
        value = ca.Function("residuals", inputs, [r], {"cse": True})
        return value, ca.Function("derivatives", inputs, [r, jac], {"cse": True}), np.array(terms, dtype=np.intp), np.array(mask)

    def _arguments(self, k: int, nodes: Array, fd: Array) -> list[Any]:
        owner = self.problem
        z = np.concatenate([nodes[k, 2:], nodes[k, 1:-1], nodes[k, :-2]], axis=1).T
        return [z, fd[k][:, owner.dynamics.actuated].T, np.repeat(owner.p[k][:, None], owner.steps, axis=1), owner.q[k].T]

    def terms(self, nodes: Array, fd: Array) -> Array:
        """(batch, N, terms) coefficient·|r|²."""
        owner = self.problem
        value, _, terms, mask = self._residuals
        out = np.zeros((owner.batch, owner.steps, len(owner.functions.references.terms)))
        for k in range(owner.batch):
            r = np.asarray(value.map(owner.steps)(*self._arguments(k, nodes, fd))).T.reshape(owner.steps, len(terms))
            coefficient = owner.q[k][:, terms] * mask
            weighted = coefficient * np.where(coefficient != 0.0, r, 0.0) ** 2
            for t in range(out.shape[-1]):
                out[k, :, t] = weighted[:, terms == t].sum(axis=1)
        return out

    def linearize(self, at: Evaluation, lam: Array | None, out: tuple[Array, Array, Array, Array]) -> None:
        """Fills H, A, b, C."""
        owner = self.problem
        n, steps = owner.n, owner.steps
        _, derivatives, terms, mask = self._residuals
        r = np.empty((owner.batch, steps, len(terms)))
        jac = np.empty((owner.batch, steps, len(terms), 3 * n + owner.nu))
        for k in range(owner.batch):
            value, flat = derivatives.map(steps)(*self._arguments(k, at.nodes, at.fd))
            r[k] = np.asarray(value).T.reshape(steps, len(terms))
            jac[k] = np.asarray(flat).reshape(len(terms), steps, 3 * n + owner.nu).transpose(1, 0, 2)
        coefficient = 2.0 * owner.q[:, :, terms] * mask
        r, jac = np.where(coefficient != 0.0, r, 0.0), np.where(coefficient[..., None] != 0.0, jac, 0.0)
        full = np.zeros((owner.batch, steps, n))
        full[..., owner.dynamics.actuated] = np.einsum("kir,kir,kirj->kij", coefficient, r, jac[..., 3 * n :])
        if lam is not None:
            rows = np.matmul(owner._test_matrix.T, lam.reshape(owner.batch, len(owner._test_matrix), owner.m))
            full[..., owner.dynamics.unactuated] = rows * owner.row_scale[:, None]
        fd, fd_jac, hess = owner.dynamics.evaluate(at.nodes, owner.p, full, 1 if lam is None else 2)
        assert fd_jac is not None
        chained = jac[..., : 3 * n] + jac[..., 3 * n :] @ fd_jac[:, :, owner.dynamics.actuated]
        step_hess = np.einsum("kir,kira,kirb->kiab", coefficient, chained, chained)
        if hess is not None:
            step_hess += hess
        gradient = np.einsum("kir,kir,kira->kia", coefficient, r, chained)
        if owner.carry is not None:
            fd_jac = fd_jac.copy()
            self._carry_back(owner.carry, step_hess, gradient, fd_jac)
        self._scatter(step_hess, gradient, fd_jac[:, :, owner.dynamics.unactuated] * owner.row_scale[:, None, :, None], out)
        out[3][:] = owner.reduce(at.fd)

    def _carry_back(self, carry: Array, hess: Array, gradient: Array, jac: Array) -> None:
        """A cycle's first two steps: slopes with respect to x_{-1} and x_0 become those with respect to what they are made of."""
        n = self.problem.n
        for i in (0, 1):
            for node in range(1 + i, 3):
                own = slice(node * n, (node + 1) * n)
                gradient[:, i, own] = np.matmul(gradient[:, i, None, own], carry)[:, 0]
                jac[:, i, :, own] = np.matmul(jac[:, i, :, own], carry)
                hess[:, i, :, own] = np.matmul(hess[:, i, :, own], carry)
                hess[:, i, own] = np.matmul(np.swapaxes(carry, 1, 2), hess[:, i, own])

    def _scatter(self, hess: Array, gradient: Array, rows: Array, out: tuple[Array, Array, Array, Array]) -> None:
        H, A, b, _ = out
        owner, s, n, m = self.problem, self.problem.stencil, self.problem.n, self.problem.m
        H[:], A[:], b[:] = 0.0, 0.0, 0.0
        for i in range(owner.steps):
            slots = [
                (node, int(s.unit[i + 2 - node, k]), int(s.part[i + 2 - node, k]) * n, s.coefficient[i + 2 - node, k])
                for node in range(3) for k in range(s.unit.shape[1]) if s.unit[i + 2 - node, k] >= 0
            ]  # fmt: skip
            for node, unit, at, value in slots:
                b[:, unit, at : at + n] += value * gradient[:, i, node * n : (node + 1) * n]
                for node2, unit2, at2, value2 in slots:
                    if unit2 <= unit:
                        block = hess[:, i, node * n : (node + 1) * n, node2 * n : (node2 + 1) * n]
                        H[:, unit, unit - unit2, at : at + n, at2 : at2 + n] += value * value2 * block
                for k in range(s.test_row.shape[1]):
                    row = int(s.test_row[i, k])
                    if row >= 0:
                        to = int(s.test_part[i, k]) * m
                        block = rows[:, i, :, node * n : (node + 1) * n]
                        A[:, row, row - unit, to : to + m, at : at + n] += s.test_coefficient[i, k] * value * block
