"""Terms over neighbouring Hermite controls r(c_k, c_{k+1}, p): offset ±1 of H, the pattern does not
change.

Their coefficients and references are those of q: a segment's coefficient is the sum over its steps,
so that E averages over the segments; its references are those of its last step, where c_{k+1}
stands.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from octo.arrays import Array, like
from octo.problem.basis import Hermite, scatter
from octo.problem.codegen import CostFunctions
from octo.problem.data import Data
from octo.problem.plan import Plan


def anchors(plan: Plan, data: Data) -> Array:
    """(batch, Z+1, 2n) c_0, and of c_1 … c_Z what no unknown moves: pinned ends."""
    assert isinstance(plan.basis, Hermite)
    tangent = plan.basis.steps_per_segment * (data.start - data.constant[:, 0])
    first = np.concatenate([data.start, tangent], axis=-1)
    return np.concatenate([first[:, None], data.ends[:, :-1]], axis=1)


def controls_of(plan: Plan, data: Data, unknowns: Array) -> Array:
    """(batch, Z+1, 2n) c_0 … c_Z, where the unknowns are."""
    controls = like(anchors(plan, data), unknowns)
    controls[:, 1:] += unknowns[:, :-1, : plan.nodal]
    return controls


class NeighbourTerms:
    """E and its Gauss–Newton blocks of the terms over (c_k, c_{k+1}), k = 0 … Z−1, in NumPy; c_0
    is fixed.

    functions: ``between`` of :class:`~octo.problem.codegen.CostFunctions`.
    """

    def __init__(self, plan: Plan, functions: CostFunctions):
        assert isinstance(plan.basis, Hermite)
        self.plan, self.segments = plan, plan.K - 1
        self.ends = slice(plan.basis.steps_per_segment - 1, None, plan.basis.steps_per_segment)
        self.references = max(functions.references.size, 1)
        self._over_segments = [
            (k, function.map(self.segments)) for k, function in functions.between
        ]

    def _each(self, data: Data, unknowns: Array) -> Iterator[tuple[int, int, Array, list[Array]]]:
        """Of each member and term: their indices, the coefficient of each segment (Z,), and what
        the term's function gives: r (Z, rows), dr (Z, rows, 2·2n) and of exact ones Σ r ∂²r."""
        for member, controls in enumerate(controls_of(self.plan, data, unknowns)):
            q, both = data.q[member], (controls[:-1].T, controls[1:].T)
            for k, function in self._over_segments:
                weight = q[:, k].reshape(self.segments, -1).sum(axis=1)
                value, *flat = function(*both, q[self.ends, : self.references].T)
                size = 2 * self.plan.nodal
                made = [
                    part.full().reshape(-1, self.segments, size).transpose(1, 0, 2).copy()
                    for part in flat
                ]
                made.insert(0, value.full().T.copy())
                for part in made:
                    part[weight == 0.0] = 0.0  # it may not be finite there
                yield member, k, weight, made

    def values(self, data: Data, unknowns: Array, terms: Array) -> None:
        """Writes their share of E into ``terms`` (batch, N, terms), at the last step of each
        segment."""
        for member, k, weight, (r, *_) in self._each(data, unknowns):
            terms[member, self.ends, k] = weight * (r**2).sum(axis=1)

    def add(
        self, data: Data, unknowns: Array, curved: NDArray[np.bool_], H: Array, b: Array
    ) -> None:
        """Adds 2 JᵀJ and 2 Jᵀr to the blocks of the units c_1 … c_Z; to JᵀJ of exact terms their
        residuals' curvature, of the members ``curved`` (batch,)."""
        size, second = self.plan.nodal, slice(self.plan.nodal, 2 * self.plan.nodal)
        pinned = self.plan.still[: self.segments]
        for member, _, weight, (r, jac, *bend) in self._each(data, unknowns):
            gradient = 2.0 * np.einsum("k,kr,kra->ka", weight, r, jac)
            block = 2.0 * np.einsum("k,kra,krb->kab", weight, jac, jac)
            if bend and curved[member]:
                block += 2.0 * weight[:, None, None] * bend[0]
            gradient[pinned, second] = 0.0
            block[pinned, second], block[pinned, :, second] = 0.0, 0.0
            own = H[member : member + 1], b[member : member + 1]
            for k in range(self.segments):  # unit k is c_{k+1}
                slots = [(0, k - 1, 0, 1.0)] if k else []
                slots.append((1, k, 0, 1.0))
                scatter(slots, size, block[k : k + 1], gradient[k : k + 1], *own)
