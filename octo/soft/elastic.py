"""Elastic forces and Rayleigh's damping of a body's modes, over all steps at once, in NumPy.

Linear elasticity has the energy ½ zᵀΛz; St. Venant–Kirchhoff's is ½ wᵀGw with w = (z, z_i z_j). The
same sums are in elastic.c, over time steps in lanes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from octo.checks import Array
from octo.soft.body import Body
from octo.soft.moments import Moments
from octo.soft.stvk import products


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
        made = np.einsum("nmk,nm->nk", _slopes(z_next), _products(z_next) @ self.gram)
        return np.asarray(made + damped)

    def tangent(self, z_next: Array) -> Array:
        """(N, r, r) to z_next, without damping."""
        steps, count = z_next.shape
        if self.gram is None:
            return np.broadcast_to(self.stiffness, (steps, count, count))
        slopes = _slopes(z_next)
        made = slopes.swapaxes(1, 2) @ self.gram @ slopes
        return np.asarray(made + _paired(_products(z_next) @ self.gram, count))

    def curvature(self, z_next: Array, lam: Array) -> Array:
        """∂²(lam·force)/∂z_next² (N, r, r) of lam (N, r)."""
        steps, count = z_next.shape
        if self.gram is None:
            return np.zeros((steps, count, count))
        slopes, along = _slopes(z_next), _slopes(lam)
        along[:, :count] = 0.0
        both = along.swapaxes(1, 2) @ self.gram @ slopes
        pull = np.einsum("nmk,nk->nm", slopes, lam) @ self.gram
        return np.asarray(both + both.swapaxes(1, 2) + _paired(pull, count))


def _products(z: Array) -> Array:
    """w (N, m)."""
    first, second = products(z.shape[1])
    return np.concatenate([z, z[:, first] * z[:, second]], axis=1)


def _slopes(z: Array) -> Array:
    """∂w/∂z (N, m, r)."""
    steps, count = z.shape
    first, second = products(count)
    made, each = np.zeros((steps, count + len(first), count)), count + np.arange(len(first))
    made[:, np.arange(count), np.arange(count)] = 1.0
    made[:, each, first] += z[:, second]
    made[:, each, second] += z[:, first]
    return made


def _paired(pull: Array, count: int) -> Array:
    """Σ_ij pull_ij ∂²(z_i z_j) (N, r, r)."""
    first, second = products(count)
    made = np.zeros((len(pull), count, count))
    made[:, first, second] += pull[:, count:]
    made[:, second, first] += pull[:, count:]
    return made
