"""Which vertices of a deforming surface are near the ground: a tree of spheres that bend with it.

A sphere around some vertices of the rest shape moves with the mean of their modes; how far a vertex
can be from its centre grows by |z_k| times the largest difference of its φ_k from that mean (James
and Pai, BD-Tree, 2004, Eq. 7). So no tree is refitted, and what is below a sphere that is out of
reach is skipped.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array
from octo.dynamics.crowd import WIDER, tree_of


@dataclass(frozen=True, eq=False)
class Spheres:
    """In the order of a walk that goes down first; the leaves are the vertices.

    Attributes
    ----------
    shapes: (E, K, 3) φ_0 = the centre (m), φ_1, …, φ_r. around: (E,) m, the radius at rest.
    spread: (E, r) kg^-½, how much the radius grows with |z_k|. skip: (E,) the entry after all that
        are below. member: (E,) which vertex it is, -1 of a sphere around several.
    """

    shapes: Array
    around: Array
    spread: Array
    skip: NDArray[np.intp]
    member: NDArray[np.intp]

    @property
    def rows(self) -> Array:
        """(E, 3K + 1 + r), the numbers of each for the C text."""
        flat = self.shapes.reshape(len(self.shapes), -1)
        return np.concatenate([flat, self.around[:, None], self.spread], axis=1)


def spheres_of(shapes: Array) -> Spheres:
    """Around vertices of ``shapes`` (P, K, 3)."""
    tree = tree_of(shapes[:, 0], np.zeros(len(shapes)))
    made = np.empty((len(tree.skip), *shapes.shape[1:]))
    spread = np.zeros((len(made), shapes.shape[1] - 1))
    for entry, (member, end) in enumerate(zip(tree.member, tree.skip, strict=True)):
        if member >= 0:
            made[entry] = shapes[member]
            continue
        below = tree.member[entry:end]
        modes = shapes[below[below >= 0], 1:]
        middle = 0.5 * (modes.min(axis=0) + modes.max(axis=0))
        made[entry, 0], made[entry, 1:] = tree.centers[entry], middle
        spread[entry] = WIDER * np.linalg.norm(modes - middle, axis=2).max(axis=0)
    return Spheres(made, tree.around, spread, tree.skip, tree.member)
