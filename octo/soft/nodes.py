"""What a body's dynamics ask of every configuration alone, of all of a trajectory at once."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from octo.checks import Array
from octo.soft.moments import Moments
from octo.soft.stages import PAIRS, TURNS


@dataclass(frozen=True, eq=False)
class Turns:
    """A matrix by three angles: R of a chart, or R_λ = Σ λ_a ∂_a R.

    Attributes
    ----------
    value: (N, 3, 3).
    slope: (N, 3, 3, 3), the first axis after N is the angle.
    second: (N, 3, 3, 3, 3), the first two axes after N are the angles.
    """

    value: Array
    slope: Array
    second: Array

    @classmethod
    def of(cls, function: ca.Function, *inputs: Array) -> Turns:
        """Of ``stages.turn`` or ``stages.bend``, at inputs (N, 3) each."""
        flat = np.asarray(function(*(one.T for one in inputs)), dtype=float)
        made = flat.T.reshape(-1, TURNS, 3, 3)
        place = np.zeros((3, 3), dtype=np.intp)
        for k, (a, b) in enumerate(PAIRS):
            place[a, b] = place[b, a] = 4 + k
        return cls(made[:, 0], made[:, 1:4], made[:, place])

    def __getitem__(self, part: slice) -> Turns:
        return Turns(self.value[part], self.slope[part], self.second[part])


@dataclass(frozen=True, eq=False)
class Nodes:
    """Configurations of a body.

    Attributes
    ----------
    place: (N, 3) m, t. turns: of R. weights: (N, K), w = (1, z).
    blocks: (N, K, 3, 3), Σ_k w_k S_kl. first: (N, 3), Σ_k w_k m_k.
    """

    place: Array
    turns: Turns
    weights: Array
    blocks: Array
    first: Array

    @classmethod
    def of(cls, moments: Moments, turn: ca.Function, x: Array) -> Nodes:
        """At x (N, 6+r)."""
        weights = np.concatenate([np.ones((len(x), 1)), x[:, 6:]], axis=1)
        turns = Turns.of(turn, x[:, 3:6])
        return cls(x[:, :3], turns, weights, moments.blocks(weights), weights @ moments.first)

    def __getitem__(self, part: slice) -> Nodes:
        place, turns, weights = self.place[part], self.turns[part], self.weights[part]
        return Nodes(place, turns, weights, self.blocks[part], self.first[part])

    def bent(self, force: Array) -> Array:
        """⟨∂²T, F⟩ (N, n, n) of a force on T, F (N, K, 3, 3) of the blocks w_k R."""
        return bent(self.turns, self.weights, force)


def bent(turns: Turns, weights: Array, force: Array) -> Array:
    """⟨∂²(w_k R), F⟩ (N, n, n) of R, w and F (N, K, 3, 3)."""
    steps, count = weights.shape
    made = np.zeros((steps, 5 + count, 5 + count))
    whole = np.einsum("sk,skij->sij", weights, force)
    made[:, 3:6, 3:6] = np.einsum("sabij,sij->sab", turns.second, whole)
    mixed = np.einsum("saij,skij->sak", turns.slope, force[:, 1:])
    made[:, 3:6, 6:] = mixed
    made[:, 6:, 3:6] = mixed.swapaxes(1, 2)
    return made
