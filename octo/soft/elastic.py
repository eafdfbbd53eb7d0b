"""Elastic forces and Rayleigh's damping of a body's modes, over all steps at once, in NumPy.

Linear elasticity has the energy ½ zᵀΛz; St. Venant–Kirchhoff's is ½ wᵀGw with w = (z, z_i z_j). The
same sums are in elastic.c, over time steps in lanes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from octo.checks import Array
from octo.soft import stvk
from octo.soft.body import Body
from octo.soft.moments import Moments


@dataclass(frozen=True, eq=False)
class Elastic:
    """Of one body with its run-time parameters.

    Attributes
    ----------
    stiffness: (r, r) s^-2, of small z. damping: (r, r) s^-2, over dt. gram: (m, m) G, or None.
    """

    stiffness: Array
    damping: Array
    gram: Array | None

    @classmethod
    def of(cls, body: Body, moments: Moments, values: Mapping[str, float]) -> Elastic:
        """values: the run-time parameters by name."""
        factor = values["elastic.stiffness"]
        stiffness = factor * body.stiffness
        damping = values["elastic.alpha"] * moments.modal + values["elastic.beta"] * stiffness
        gram = None if body.stvk is None else factor * body.stvk
        return cls(stiffness, damping / values["dt"], gram)

    def force(self, z_next: Array, z: Array) -> Array:
        """(N, r) N kg^-½ m, of z (N, r)."""
        damped = (z_next - z) @ self.damping.T
        if self.gram is None:
            return np.asarray(z_next @ self.stiffness.T + damped)
        return np.asarray(stvk.force(self.gram, z_next) + damped)

    def tangent(self, z_next: Array) -> Array:
        """(N, r, r) to z_next, without damping."""
        if self.gram is None:
            return np.broadcast_to(self.stiffness, (len(z_next), *self.stiffness.shape))
        return stvk.tangent(self.gram, z_next)

    def curvature(self, z_next: Array, lam: Array) -> Array:
        """∂²(lam·force)/∂z_next² (N, r, r) of lam (N, r)."""
        if self.gram is None:
            return np.zeros((len(z_next), *self.stiffness.shape))
        return stvk.curvature(self.gram, z_next, lam)
