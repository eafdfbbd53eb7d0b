"""The moments of a body's mass, in the blocks that its inertia is used in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from octo.checks import Array
from octo.soft.body import Body


@dataclass(frozen=True, eq=False)
class Moments:
    """M = ∫ρ Y Yᵀ by the functions φ_0 = X, φ_1, …, φ_r of the rest shape; K = r+1 of them.

    Attributes
    ----------
    second: (K, K, 3, 3) S_kl = ∫ρ φ_k φ_lᵀ; kg m², or kg^½ m, or 1.
    first: (K, 3) m_k = ∫ρ φ_k; kg m, or kg^½.
    mass: kg.
    """

    second: Array
    first: Array
    mass: float

    @classmethod
    def of(cls, body: Body) -> Moments:
        last = len(body.inertia) - 1
        count = last // 3
        second = body.inertia[:last, :last].reshape(count, 3, count, 3).swapaxes(1, 2)
        first = body.inertia[:last, last].reshape(count, 3)
        return cls(np.ascontiguousarray(second), first.copy(), float(body.inertia[last, last]))

    @property
    def modal(self) -> Array:
        """(r, r) ∫ρ φ_k·φ_l: the identity where the modes are mass-normalised."""
        return np.asarray(np.einsum("klii->kl", self.second[1:, 1:]), dtype=float)

    def blocks(self, weights: Array) -> Array:
        """Σ_k w_k S_kl (…, K, 3, 3) of weights (…, K)."""
        return np.asarray(np.einsum("...k,klij->...lij", weights, self.second), dtype=float)
