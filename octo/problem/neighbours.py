"""Terms over neighbouring Hermite controls r(c_k, c_{k+1}, p): offset ±1 of H, the pattern does not change."""

from __future__ import annotations

from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo.problem.costs import NeighbourCost

if TYPE_CHECKING:
    from octo.problem.compiled import CompiledProblem

Array = NDArray[np.float64]


class NeighbourTerms:
    """E and its Gauss–Newton blocks of the terms over (c_k, c_{k+1}), k = 0 … Z−1; c_0 is fixed."""

    def __init__(self, problem: CompiledProblem):
        first = problem.problems[0]
        self.segments, self.size = problem.K - 1, 2 * problem.n
        self.count = len(first.costs)
        q = problem.basis.steps_per_segment if hasattr(problem.basis, "steps_per_segment") else 1
        self.first = np.concatenate([problem.start, q * (problem.start - problem.constant[:, 0])], axis=-1)
        self.functions: list[tuple[int, ca.Function, Array]] = []
        control, following = ca.SX.sym("c", self.size), ca.SX.sym("c_next", self.size)
        for k, term in enumerate(first.costs):
            if not isinstance(term, NeighbourCost):
                continue
            values = {name: ca.SX(ca.DM(np.asarray(v, dtype=float))) for name, v in term.references(first.setting).items()}
            r = ca.densify(ca.vec(term.between(control, following, values)))
            jac = ca.densify(ca.jacobian(r, ca.vertcat(control, following)))
            function = ca.Function("between", [control, following], [r, jac], {"cse": True})
            weight = np.broadcast_to(np.asarray(term.weight, dtype=float), (self.segments,))
            self.functions.append((k, function.map(self.segments), weight / term.scale(first.setting) / self.segments))

    def _controls(self, unknowns: Array) -> Array:
        return np.concatenate([self.first[:, None], unknowns[:, :-1]], axis=1)

    def energy(self, unknowns: Array) -> Array:
        """(batch, terms)."""
        out = np.zeros((len(unknowns), self.count))
        for member, controls in enumerate(self._controls(unknowns)):
            for k, function, weight in self.functions:
                r = np.asarray(function(controls[:-1].T, controls[1:].T)[0])
                out[member, k] += float(weight @ (r**2).sum(axis=0))
        return out

    def add(self, unknowns: Array, H: Array, b: Array) -> None:
        """Adds 2 JᵀJ and 2 Jᵀr to the blocks of the units c_1 … c_Z."""
        size = self.size
        for member, controls in enumerate(self._controls(unknowns)):
            for _, function, weight in self.functions:
                value, flat = function(controls[:-1].T, controls[1:].T)
                r = np.asarray(value).T
                jac = np.asarray(flat).reshape(r.shape[1], self.segments, 2 * size).transpose(1, 0, 2)
                gradient = 2.0 * np.einsum("k,kr,kra->ka", weight, r, jac)
                block = 2.0 * np.einsum("k,kra,krb->kab", weight, jac, jac)
                later = slice(0, self.segments)  # unit k is c_{k+1}
                H[member, later, 0] += block[:, size:, size:]
                b[member, later] += gradient[:, size:]
                H[member, : self.segments - 1, 0] += block[1:, :size, :size]
                b[member, : self.segments - 1] += gradient[1:, :size]
                H[member, 1 : self.segments, 1] += block[1:, size:, :size]
