"""Terms over neighbouring Hermite controls r(c_k, c_{k+1}, p): offset ±1 of H, the pattern does not
change.

Their coefficients and references are those of q: a segment's coefficient is the sum over its steps,
so that E averages over the segments; its references are those of its last step, where c_{k+1}
stands.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from octo.problem.basis import Hermite
from octo.problem.codegen import CostFunctions
from octo.problem.data import Data
from octo.problem.plan import Plan

Array = NDArray[np.float64]


def anchors(plan: Plan, data: Data) -> Array:
    """(batch, Z+1, 2n) c_0, and of c_1 … c_Z what no unknown moves: pinned ends."""
    assert isinstance(plan.basis, Hermite)
    tangent = plan.basis.steps_per_segment * (data.start - data.constant[:, 0])
    first = np.concatenate([data.start, tangent], axis=-1)
    return np.concatenate([first[:, None], data.ends[:, :-1]], axis=1)


def controls_of(plan: Plan, data: Data, unknowns: Array) -> Array:
    """(batch, Z+1, 2n) c_0 … c_Z."""
    controls = anchors(plan, data)
    controls[:, 1:] += unknowns[:, :-1, : plan.nodal]
    return controls


class NeighbourTerms:
    """E and its Gauss–Newton blocks of the terms over (c_k, c_{k+1}), k = 0 … Z−1, in NumPy; c_0
    is fixed.

    functions: ``between`` of :class:`~octo.problem.codegen.CostFunctions`.
    """

    def __init__(self, plan: Plan, functions: CostFunctions):
        assert isinstance(plan.basis, Hermite)
        self.segment = plan.basis.steps_per_segment
        self.segments = plan.K - 1
        self.plan, self.size = plan, plan.nodal
        self.references = max(functions.references.size, 1)
        self._over_segments = [
            (k, function.map(self.segments)) for k, function in functions.between
        ]

    def _parts(self, data: Data, k: int, member: int) -> tuple[Array, Array]:
        """Coefficient of each segment (Z,), and its references at its last step (numbers, Z)."""
        q = data.q[member]
        weight = q[:, k].reshape(self.segments, self.segment).sum(axis=1)
        return weight, q[self.segment - 1 :: self.segment, : self.references].T

    def values(self, data: Data, unknowns: Array, terms: Array) -> None:
        """Writes their share of E into ``terms`` (batch, N, terms), at the last step of each
        segment."""
        for member, controls in enumerate(controls_of(self.plan, data, unknowns)):
            for k, function in self._over_segments:
                weight, rows = self._parts(data, k, member)
                r = function(controls[:-1].T, controls[1:].T, rows)[0].full()
                squares = np.where(weight > 0.0, (r**2).sum(axis=0), 0.0)
                terms[member, self.segment - 1 :: self.segment, k] = weight * squares

    def add(
        self, data: Data, unknowns: Array, curved: NDArray[np.bool_], H: Array, b: Array
    ) -> None:
        """Adds 2 JᵀJ and 2 Jᵀr to the blocks of the units c_1 … c_Z; to JᵀJ of exact terms their
        residuals' curvature, of the members ``curved`` (batch,)."""
        size, last = self.size, self.segments - 1  # unit k is c_{k+1}
        free = ~np.isin(np.arange(self.segments), self.plan.fixed)
        for member, controls in enumerate(controls_of(self.plan, data, unknowns)):
            for k, function in self._over_segments:
                weight, rows = self._parts(data, k, member)
                value, flat, *bend = function(controls[:-1].T, controls[1:].T, rows)
                r = value.full().T
                jac = (
                    flat.full()
                    .reshape(r.shape[1], self.segments, 2 * size)
                    .transpose(1, 0, 2)
                    .copy()
                )
                jac[~free, :, size:] = 0.0  # c_{k+1} is pinned
                r[weight == 0.0], jac[weight == 0.0] = 0.0, 0.0  # it may not be finite there
                gradient = 2.0 * np.einsum("k,kr,kra->ka", weight, r, jac)
                block = 2.0 * np.einsum("k,kra,krb->kab", weight, jac, jac)
                if bend and curved[member]:
                    block += self._bend(2.0 * weight, bend[0].full(), free)
                own_H, own_b = H[member, ..., :size, :size], b[member, :, :size]
                own_H[: self.segments, 0] += block[:, size:, size:]
                own_b[: self.segments] += gradient[:, size:]
                own_H[:last, 0] += block[1:, :size, :size]
                own_b[:last] += gradient[1:, :size]
                own_H[1 : self.segments, 1] += block[1:, size:, :size]

    def _bend(self, weight: Array, flat: Array, free: NDArray[np.bool_]) -> Array:
        """(Z, 2·2n, 2·2n) Σ r ∂²r times ``weight`` (Z,), out of (2·2n, Z·2·2n); a control that is
        not ``free`` (Z,) is pinned."""
        size = self.size
        bend = flat.reshape(2 * size, self.segments, 2 * size).transpose(1, 0, 2).copy()
        bend[~free, size:], bend[~free, :, size:] = 0.0, 0.0
        bend[weight == 0.0] = 0.0
        return np.asarray(weight[:, None, None] * bend)
