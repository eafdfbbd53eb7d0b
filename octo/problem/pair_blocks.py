"""Terms over two steps in a row without a compiler: the formulas of step_pairs.c in NumPy.

The steps with one before them are i = 1 … N−1, or of a cycle all of them: there the last step,
carried back by a stride, comes before the first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array
from octo.problem.basis import WINDOW, block, scatter, slots_of
from octo.problem.data import Data
from octo.problem.mapped import add_bends, by_term, live_rows, rows_over, squares
from octo.problem.plan import Plan
from octo.problem.step_pairs import PairFunctions


@dataclass(frozen=True, eq=False)
class PairSlopes:
    """Of all steps with one before them; what a step leaves out is zero.

    Attributes
    ----------
    weight, shift: (batch, steps, rows) D and d, 2c and 2cr: the model has D r' r'ᵀ and d r'.
    jac: (batch, steps, rows, 4n + 2nu) dr/d of the four nodes, and of u_i and u_{i−1}.
    given: each member's arguments. curved: the members that have second derivatives.
    """

    weight: Array
    shift: Array
    jac: Array
    given: list[list[Array]]
    curved: NDArray[np.bool_]


class PairTerms:
    """E and its blocks of the terms over two steps in a row.

    Parameters
    ----------
    actuated: (nu,) the rows of FD that are torques.
    """

    def __init__(self, functions: PairFunctions, plan: Plan, actuated: NDArray[np.intp]):
        self.functions, self.plan, self.actuated = functions, plan, actuated
        self.terms = np.array(functions.terms, dtype=np.intp)

    def add_values(self, data: Data, nodes: Array, fd: Array, terms: Array) -> None:
        """Adds each step's share of each term to ``terms`` (batch, N, terms)."""
        first = self._first(data)
        for member, arguments in enumerate(self._arguments(data, nodes, fd)):
            r = rows_over(self.functions.value, arguments, self.plan.steps - first)
            own = squares(data.q[member, first:][:, self.terms], r)
            terms[member, first:] += by_term(own, self.terms, terms.shape[-1])

    def slopes(self, data: Data, nodes: Array, fd: Array, curved: NDArray[np.bool_]) -> PairSlopes:
        """Residuals and their derivatives at an iterate; second ones of the members ``curved``."""
        own, given = self.functions, self._arguments(data, nodes, fd)
        weight = 2.0 * data.q[:, self._first(data) :][:, :, self.terms]
        r, jac = live_rows(own.slopes, own.sparsity, given, weight)
        return PairSlopes(weight, weight * r, jac, given, curved)

    def pull(self, data: Data, slopes: PairSlopes) -> Array:
        """(batch, N, nu) dE/du: of a step's own residual, and of that of the step after it."""
        nu, batch = len(self.actuated), len(slopes.jac)
        torques = slopes.jac[..., -2 * nu :].reshape(*slopes.jac.shape[:3], 2, nu)
        own = np.einsum("kir,kirtj->ktij", slopes.shift, torques)
        pull = np.zeros((batch, self.plan.steps, nu))
        pull[:, self._first(data) :] += own[:, 0]
        if data.carry is not None:
            pull[:, -1] += (own[:, 1, :1] @ self._carried(data))[:, 0]
            own = own[:, :, 1:]
        pull[:, :-1] += own[:, 1]
        return pull

    def add_blocks(self, data: Data, slopes: PairSlopes, fd_jac: Array, H: Array, b: Array) -> None:
        """Adds 2 JᵀJ, the curvature of exact terms, and 2 Jᵀr to H (batch, K, 3, nc, nc) and b
        (batch, K, nc).

        fd_jac: (batch, N, n, 3n) slopes of FD.
        """
        first = self._first(data)
        chain = self._chain(data, fd_jac[:, :, self.actuated])
        chained = slopes.jac @ chain
        gradient = np.einsum("kir,kira->kia", slopes.shift, chained)
        hess = np.einsum("kir,kira,kirb->kiab", slopes.weight, chained, chained)
        if self.functions.curvature is not None:
            own = self.functions.curvature
            add_bends(own, slopes.given, slopes.curved, chain, hess)
        for i in range(first, self.plan.steps):
            slots = slots_of(self.plan.stencil, i, WINDOW)
            scatter(slots, self.plan.n, hess[:, i - first], gradient[:, i - first], H, b)

    def _first(self, data: Data) -> int:
        """The first step with one before it."""
        return int(data.carry is None)

    def _carried(self, data: Data) -> Array:
        """(batch, nu, nu) what the last torques are multiplied with to be those before a cycle."""
        assert data.carry is not None
        carried: Array = data.carry[:, self.actuated][:, :, self.actuated]
        return carried

    def _arguments(self, data: Data, nodes: Array, fd: Array) -> list[list[Array]]:
        """Of each member, for the functions mapped over the steps with one before them."""
        u, first = fd[:, :, self.actuated], self._first(data)
        steps = self.plan.steps - first
        if data.carry is not None:
            gone = nodes[:, -3:-2] - nodes[:, -2:-1]  # x_{N−2} − x_{N−1}, which is carried back
            oldest = nodes[:, :1] + gone @ np.swapaxes(data.carry, 1, 2)
            nodes = np.concatenate([oldest, nodes], axis=1)
            u = np.concatenate([u[:, -1:] @ np.swapaxes(self._carried(data), 1, 2), u], axis=1)
        made = []
        for member in range(len(nodes)):
            window = [nodes[member, 3 - k : 3 - k + steps].T for k in range(WINDOW)]
            p = np.repeat(data.p[member][:, None], steps, axis=1)
            torques = [u[member, 1:].T, u[member, :-1].T]
            q = data.q[member, first:, : self.functions.value.size1_in(7)]
            made.append([*window, *torques, p, q.T])
        return made

    def _chain(self, data: Data, torques: Array) -> Array:
        """(batch, steps, 4n + 2nu, 4n) d(window, u, u_before)/d what the window's nodes are made
        of.

        torques: (batch, N, nu, 3n) slopes of the torques.
        """
        n, nu, first = self.plan.n, len(self.actuated), self._first(data)
        batch, width = len(torques), WINDOW * n
        chain = np.zeros((batch, self.plan.steps - first, width + 2 * nu, width))
        chain[:, :, :width] = np.eye(width)
        chain[:, :, width:-nu, : 3 * n] = torques[:, first:]
        chain[:, 1 - first :, -nu:, n:] = torques[:, :-1]
        if data.carry is not None:
            for i in range(WINDOW - 1):  # their oldest nodes are carried
                for node in range(i + 1, WINDOW):
                    own = block(node, n)
                    chain[:, i, :, own] = chain[:, i, :, own] @ data.carry
            chain[:, 0, -nu:, n:] = self._carried(data) @ torques[:, -1]
        return chain
