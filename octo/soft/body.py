"""A reduced deformable body: a surface, its modes, and the matrices that they give."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array


@dataclass(frozen=True, eq=False)
class Body:
    """An elastic body of which a point X of the rest shape moves to R(X + Σ z_k φ_k(X)) + t.

    Attributes
    ----------
    name: of the body.
    points: (P, 3) m, the surface vertices at rest, the centre of mass at the origin.
    faces: (F, 3) the surface's triangles, as indices into ``points``.
    modes: (P, r, 3) φ_k at the surface vertices, mass-normalised: kg^-½.
    inertia: (3r+4, 3r+4) M = ∫ρ Y Yᵀ with Y = (X; φ_1; …; φ_r; 1), kg m², kg^½ m and kg.
    stiffness: (r, r) of the modes, s^-2.
    damping: (alpha, beta) of Rayleigh, 1/s and s.
    mass: kg.
    """

    name: str
    points: Array
    faces: NDArray[np.intp]
    modes: Array
    inertia: Array
    stiffness: Array
    damping: tuple[float, float]
    mass: float
