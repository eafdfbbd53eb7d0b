"""Terms over two steps in a row without a compiler: the formulas of step_pairs.c in NumPy.

Rows i = 1 … N−1 stand at i−1 of every array here.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo.problem.data import Data
from octo.problem.plan import Plan
from octo.problem.step_pairs import WINDOW, PairFunctions

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PairSlopes:
    """Of all steps but the first; what a step leaves out is zero.

    Attributes
    ----------
    r: (batch, N−1, rows). window (batch, N−1, rows, 4n), torques (batch, N−1, 2, rows, nu): dr/d of
        the four nodes, and of u_i and u_{i−1}.
    coefficient: (batch, N−1, rows) what r² is multiplied with in 2E.
    bends: (batch, N−1, 4n + 2nu, 4n + 2nu) what exact terms have beside Gauss and Newton's model;
        None where there is nothing.
    """

    r: Array
    window: Array
    torques: Array
    coefficient: Array
    bends: Array | None

    def pull(self) -> Array:
        """(batch, N, nu) dE/du of every step."""
        own = np.einsum("kir,kir,kitrj->ktij", self.coefficient, self.r, self.torques)
        pull = np.zeros((len(own), own.shape[2] + 1, own.shape[3]))
        pull[:, 1:] += own[:, 0]
        pull[:, :-1] += own[:, 1]
        return pull


class PairTerms:
    """E and its Gauss–Newton blocks of the terms over two steps in a row.

    Parameters
    ----------
    actuated: (nu,) the rows of FD that are torques.
    """

    def __init__(self, functions: PairFunctions, plan: Plan, actuated: NDArray[np.intp]):
        self.functions, self.plan, self.actuated = functions, plan, actuated
        self.terms = np.array(functions.terms, dtype=np.intp)

    @cached_property
    def _value(self) -> ca.Function:
        return self.functions.value.map(self.plan.steps - 1)

    @cached_property
    def _slopes(self) -> ca.Function:
        return self.functions.slopes.map(self.plan.steps - 1)

    def _arguments(self, data: Data, member: int, nodes: Array, fd: Array) -> list[Array]:
        window = [nodes[member, WINDOW - 1 - k : len(nodes[member]) - k].T for k in range(WINDOW)]
        u = fd[member][:, self.actuated].T
        p = np.repeat(data.p[member][:, None], self.plan.steps - 1, axis=1)
        return [*window, u[:, 1:], u[:, :-1], p, data.q[member, 1:].T]

    def add_values(self, data: Data, nodes: Array, fd: Array, terms: Array) -> None:
        """Adds each step's share of each term to ``terms`` (batch, N, terms)."""
        for member in range(len(nodes) if self.plan.steps > 1 else 0):
            r = np.asarray(self._value(*self._arguments(data, member, nodes, fd))).T
            coefficient = data.q[member, 1:][:, self.terms]
            squares = coefficient * np.where(coefficient != 0.0, r, 0.0) ** 2
            for row, term in enumerate(self.terms):
                terms[member, 1:, term] += squares[:, row]

    def slopes(self, data: Data, nodes: Array, fd: Array, curved: NDArray[np.bool_]) -> PairSlopes:
        """Residuals and their derivatives at an iterate; second ones of the members ``curved``."""
        batch, steps, n = len(nodes), self.plan.steps - 1, self.plan.n
        rows, nu = self.functions.rows, len(self.actuated)
        r, jac = np.zeros((batch, steps, rows)), np.zeros((batch, steps, rows, WINDOW * n + 2 * nu))
        sparsity = self.functions.sparsity
        for member in range(batch if steps else 0):
            value, nonzeros = self._slopes(*self._arguments(data, member, nodes, fd))
            r[member] = np.asarray(value).T
            jac[member][:, sparsity.row(), sparsity.get_col()] = np.asarray(nonzeros).T
        coefficient = 2.0 * data.q[:, 1:][:, :, self.terms]
        live = coefficient != 0.0  # a step that a term leaves out may have no finite residual
        r, jac = np.where(live, r, 0.0), np.where(live[..., None], jac, 0.0)
        torques = jac[..., WINDOW * n :].reshape(batch, steps, rows, 2, nu)
        window = jac[..., : WINDOW * n]
        bends = self._bends(data, nodes, fd, curved)
        return PairSlopes(r, window, np.moveaxis(torques, 3, 2), coefficient, bends)

    def _bends(
        self, data: Data, nodes: Array, fd: Array, curved: NDArray[np.bool_]
    ) -> Array | None:
        own, steps = self.functions, self.plan.steps - 1
        if own.bend is None or not steps:
            return None
        size = own.bends.size1()
        bends = np.zeros((len(nodes), steps, size, size))
        rows, columns = own.bends.row(), own.bends.get_col()
        for member in np.flatnonzero(curved).tolist():
            numbers = own.bend.map(steps)(*self._arguments(data, member, nodes, fd))
            bends[member][:, rows, columns] = np.asarray(numbers).T
            bends[member][:, columns, rows] = np.asarray(numbers).T
        return bends

    def add_blocks(self, slopes: PairSlopes, fd_jac: Array, H: Array, b: Array) -> None:
        """Adds 2 JᵀJ and 2 Jᵀr to H (batch, K, 3, nc, nc) and b (batch, K, nc).

        fd_jac: (batch, N, n, 3n) slopes of FD.
        """
        s, n = self.plan.stencil, self.plan.n
        own = fd_jac[:, :, self.actuated]
        chained = slopes.window.copy()
        chained[..., : 3 * n] += slopes.torques[:, :, 0] @ own[:, 1:]
        chained[..., n:] += slopes.torques[:, :, 1] @ own[:, :-1]
        gradient = np.einsum("kir,kir,kira->kia", slopes.coefficient, slopes.r, chained)
        hess = np.einsum("kir,kira,kirb->kiab", slopes.coefficient, chained, chained)
        if slopes.bends is not None:
            nu = len(self.actuated)
            chain = np.zeros((*chained.shape[:2], WINDOW * n + 2 * nu, WINDOW * n))
            chain[:, :, : WINDOW * n] = np.eye(WINDOW * n)
            chain[:, :, WINDOW * n : -nu, : 3 * n] = own[:, 1:]
            chain[:, :, -nu:, n:] = own[:, :-1]
            hess += np.swapaxes(chain, 2, 3) @ slopes.bends @ chain
        for i in range(1, self.plan.steps):
            slots = [
                (slice(node * n, (node + 1) * n), int(s.unit[at, k]), int(s.part[at, k]) * n, at, k)
                for node, at in enumerate(range(i + 2, i + 2 - WINDOW, -1))
                for k in np.flatnonzero(s.unit[at] >= 0)
            ]
            for node, unit, to, at, k in slots:
                value = s.coefficient[at, k]
                b[:, unit, to : to + n] += value * gradient[:, i - 1, node]
                for node2, unit2, to2, at2, k2 in slots:
                    if unit2 <= unit:
                        block = value * s.coefficient[at2, k2] * hess[:, i - 1, node, node2]
                        H[:, unit, unit - unit2, to : to + n, to2 : to2 + n] += block
