"""E, C and their model without a compiler: CasADi's virtual machine for the derivatives, NumPy for
the blocks.

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
from octo.interrupts import postponed
from octo.problem.contact_model import BLOCKS

if TYPE_CHECKING:
    from octo.problem.compiled import CompiledProblem, Evaluation

Array = NDArray[np.float64]


class Interpreted:
    """Residuals of all terms over all steps, their derivatives, and the blocks of Eq. 9."""

    def __init__(self, problem: CompiledProblem):
        self.problem = problem

    @cached_property
    @postponed()
    def _symbols(self) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """z (3n,) of (x_next, x, x_prev), u, p, q of one step."""
        owner = self.problem
        sizes = {
            "z": 3 * owner.n,
            "u": owner.nu,
            "p": owner.dynamics.layout.size,
            "q": owner.q.shape[-1],
        }
        z, u, p, q = (ca.SX.sym(name, size) for name, size in sizes.items())
        return z, u, p, q

    @property
    def _nodes(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        z, n = self._symbols[0], self.problem.n
        return z[:n], z[n : 2 * n], z[2 * n :]

    @cached_property
    @postponed()
    def _contacts(self) -> list[tuple[int, list[symbolic.Pose], list[ca.SX], Array]]:
        """Of each contact that has a term: its body, that body's poses, the inputs of the terms'
        functions, and ``use``."""
        dynamics, functions = self.problem.dynamics, self.problem.functions
        _, _, p, q = self._symbols
        if functions.contact is None or not isinstance(dynamics, RobotDynamics):
            return []
        robot, made = dynamics.character, []
        poses = [symbolic.body_poses(robot, node) for node in self._nodes]
        for k, index in enumerate(functions.contact.spheres):
            sphere = robot.contacts[index]
            own = [pose[sphere.body] for pose in poses]
            columns = [ca.vertcat(ca.vec(rotation.T), position) for rotation, position in own]
            inputs = [*columns, ca.vertcat(ca.DM(sphere.position), sphere.radius), p, q]
            made.append((sphere.body, own, inputs, functions.contact.use[k].astype(float)))
        return made

    @cached_property
    @postponed()
    def _values(self) -> tuple[ca.Function, NDArray[np.intp], Array]:
        """All residuals of one step, with the term of each and its mask."""
        functions = self.problem.functions
        z, u, p, q = self._symbols
        parts, terms = [functions.state(*self._nodes, u, p, q)], [*functions.state_terms]
        mask = [1.0] * len(terms)
        for _, _, inputs, use in self._contacts:
            assert functions.contact is not None
            parts.append(functions.contact.value(*inputs))
            terms += functions.contact.terms
            mask += use.tolist()
        r = ca.densify(ca.vertcat(*parts))
        return (
            ca.Function("residuals", [z, u, p, q], [r], {"cse": True}),
            np.array(terms, dtype=np.intp),
            np.array(mask),
        )

    @cached_property
    @postponed()
    def _slopes(self) -> ca.Function:
        """Residuals over the state and their derivatives to (z, u)."""
        z, u, p, q = self._symbols
        r = self.problem.functions.state(*self._nodes, u, p, q)
        return ca.Function(
            "slopes", [z, u, p, q], [r, ca.densify(ca.jacobian(r, ca.vertcat(z, u)))], {"cse": True}
        )

    @postponed()
    def _touch(self, exact: bool) -> ca.Function:
        """(z, u, p, q) -> gradient (3n,) and second derivative (3n, 3n) of the terms over
        contacts."""
        owner, functions = self.problem, self.problem.functions
        gradient, hess = ca.SX(3 * owner.n, 1), ca.SX(3 * owner.n, 3 * owner.n)
        for body, poses, inputs, use in self._contacts:
            assert functions.contact is not None and isinstance(owner.dynamics, RobotDynamics)
            function = functions.contact.exact if exact else functions.contact.model
            made = function(*inputs, ca.DM(use))
            path = [int(j) for j in owner.dynamics.character.path[body]]
            twists = [
                _twists(pose, node, path) for pose, node in zip(poses, self._nodes, strict=True)
            ]
            places = [[node * owner.n + j for j in path] for node in range(3)]
            for node in range(3):
                gradient[places[node]] += twists[node].T @ made[6 * node : 6 * node + 6]
            for k, (a, b) in enumerate(BLOCKS):
                block = (
                    twists[a].T @ ca.reshape(made[18 + 36 * k : 54 + 36 * k], 6, 6).T @ twists[b]
                )
                if a == b:  # rows are ancestors
                    block = ca.triu2symm(ca.triu(block))
                hess[places[a], places[b]] += block
                if a != b:
                    hess[places[b], places[a]] += block.T
        return ca.Function(
            "touch", list(self._symbols), [ca.densify(gradient), ca.densify(hess)], {"cse": True}
        )

    @cached_property
    def _touches(self) -> dict[bool, ca.Function]:
        """By whether they are exact."""
        return {}

    def _arguments(self, k: int, nodes: Array, fd: Array) -> list[Any]:
        owner = self.problem
        z = np.concatenate([nodes[k, 2:], nodes[k, 1:-1], nodes[k, :-2]], axis=1).T
        return [
            z,
            fd[k][:, owner.dynamics.actuated].T,
            np.repeat(owner.p[k][:, None], owner.steps, axis=1),
            owner.q[k].T,
        ]

    def terms(self, nodes: Array, fd: Array) -> Array:
        """(batch, N, terms) coefficient·|r|²."""
        owner = self.problem
        value, terms, mask = self._values
        out = np.zeros((owner.batch, owner.steps, len(owner.functions.references.terms)))
        for k in range(owner.batch):
            r = np.asarray(value.map(owner.steps)(*self._arguments(k, nodes, fd))).T.reshape(
                owner.steps, len(terms)
            )
            coefficient = owner.q[k][:, terms] * mask
            weighted = coefficient * np.where(coefficient != 0.0, r, 0.0) ** 2
            for t in range(out.shape[-1]):
                out[k, :, t] = weighted[:, terms == t].sum(axis=1)
        return out

    def linearize(
        self,
        at: Evaluation,
        lam: Array | None,
        out: tuple[Array, Array, Array, Array],
        curved: NDArray[np.bool_] | None = None,
    ) -> None:
        """Fills H, A, b, C."""
        owner = self.problem
        n, steps = owner.n, owner.steps
        terms = np.array(owner.functions.state_terms, dtype=np.intp)
        r = np.empty((owner.batch, steps, len(terms)))
        jac = np.empty((owner.batch, steps, len(terms), 3 * n + owner.nu))
        for k in range(owner.batch):
            value, flat = self._slopes.map(steps)(*self._arguments(k, at.nodes, at.fd))
            r[k] = np.asarray(value).T.reshape(steps, len(terms))
            jac[k] = (
                np.asarray(flat).reshape(len(terms), steps, 3 * n + owner.nu).transpose(1, 0, 2)
            )
        coefficient = 2.0 * owner.q[:, :, terms]
        r = np.where(coefficient != 0.0, r, 0.0)
        jac = np.where(coefficient[..., None] != 0.0, jac, 0.0)
        full = np.zeros((owner.batch, steps, n))
        full[..., owner.dynamics.actuated] = np.einsum(
            "kir,kir,kirj->kij", coefficient, r, jac[..., 3 * n :]
        )
        if lam is not None:
            rows = np.matmul(
                owner._test_matrix.T, lam.reshape(owner.batch, len(owner._test_matrix), owner.m)
            )
            full[..., owner.dynamics.unactuated] = rows * owner.row_scale[:, None]
        fd, fd_jac, hess = owner.dynamics.evaluate(at.nodes, owner.p, full, 1 if lam is None else 2)
        assert fd_jac is not None
        chained = jac[..., : 3 * n] + jac[..., 3 * n :] @ fd_jac[:, :, owner.dynamics.actuated]
        step_hess = np.einsum("kir,kira,kirb->kiab", coefficient, chained, chained)
        if hess is not None:
            step_hess += hess
        gradient = np.einsum("kir,kir,kira->kia", coefficient, r, chained)
        if self._contacts:
            whole = (
                np.ones(owner.batch, dtype=bool)
                if curved is None
                else np.asarray(curved, dtype=bool)
            )
            self._add_contacts(at, whole & (lam is not None), gradient, step_hess)
        if owner.carry is not None:
            fd_jac = fd_jac.copy()
            self._carry_back(owner.carry, step_hess, gradient, fd_jac)
        self._scatter(
            step_hess,
            gradient,
            fd_jac[:, :, owner.dynamics.unactuated] * owner.row_scale[:, None, :, None],
            out,
        )
        out[3][:] = owner.reduce(at.fd)

    def _add_contacts(
        self, at: Evaluation, curved: NDArray[np.bool_], gradient: Array, hess: Array
    ) -> None:
        owner, size = self.problem, 3 * self.problem.n
        for k, exact in enumerate(curved.tolist()):
            if exact not in self._touches:
                self._touches[exact] = self._touch(exact)
            slope, flat = self._touches[exact].map(owner.steps)(
                *self._arguments(k, at.nodes, at.fd)
            )
            gradient[k] += np.asarray(slope).T
            hess[k] += np.asarray(flat).reshape(size, owner.steps, size).transpose(1, 0, 2)

    def _carry_back(self, carry: Array, hess: Array, gradient: Array, jac: Array) -> None:
        """A cycle's first two steps: slopes with respect to x_{-1} and x_0 become those with
        respect to what they are made of."""
        n = self.problem.n
        for i in (0, 1):
            for node in range(1 + i, 3):
                own = slice(node * n, (node + 1) * n)
                gradient[:, i, own] = np.matmul(gradient[:, i, None, own], carry)[:, 0]
                jac[:, i, :, own] = np.matmul(jac[:, i, :, own], carry)
                hess[:, i, :, own] = np.matmul(hess[:, i, :, own], carry)
                hess[:, i, own] = np.matmul(np.swapaxes(carry, 1, 2), hess[:, i, own])

    def _scatter(
        self, hess: Array, gradient: Array, rows: Array, out: tuple[Array, Array, Array, Array]
    ) -> None:
        H, A, b, _ = out
        owner, s, n, m = self.problem, self.problem.stencil, self.problem.n, self.problem.m
        H[:], A[:], b[:] = 0.0, 0.0, 0.0
        for i in range(owner.steps):
            slots = [
                (
                    node,
                    int(s.unit[i + 2 - node, k]),
                    int(s.part[i + 2 - node, k]) * n,
                    s.coefficient[i + 2 - node, k],
                )
                for node in range(3)
                for k in range(s.unit.shape[1])
                if s.unit[i + 2 - node, k] >= 0
            ]
            for node, unit, at, value in slots:
                b[:, unit, at : at + n] += value * gradient[:, i, node * n : (node + 1) * n]
                for node2, unit2, at2, value2 in slots:
                    if unit2 <= unit:
                        block = hess[:, i, node * n : (node + 1) * n, node2 * n : (node2 + 1) * n]
                        H[:, unit, unit - unit2, at : at + n, at2 : at2 + n] += (
                            value * value2 * block
                        )
                for k in range(s.test_row.shape[1]):
                    row = int(s.test_row[i, k])
                    if row >= 0:
                        to = int(s.test_part[i, k]) * m
                        block = rows[:, i, :, node * n : (node + 1) * n]
                        A[:, row, row - unit, to : to + m, at : at + n] += (
                            s.test_coefficient[i, k] * value * block
                        )


def _twists(pose: symbolic.Pose, x: ca.SX, path: list[int]) -> ca.SX:
    """(6, path) twists (ω, v of the point at the world's origin) of the joints that carry a body at
    ``pose``."""
    rotation, position = pose
    turns = ca.jacobian(ca.vec(rotation), x)[:, path]
    columns = []
    for k, j in enumerate(path):
        spin = ca.inv_skew(ca.reshape(turns[:, k], 3, 3) @ rotation.T)
        columns.append(ca.vertcat(spin, ca.jacobian(position, x[j]) - ca.cross(spin, position)))
    return ca.horzcat(*columns) if columns else ca.SX(6, 0)
