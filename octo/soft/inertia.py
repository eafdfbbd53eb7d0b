"""Inertia and gravity of a reduced deformable body, over all steps at once, in NumPy.

T = [R, z_1 R, …, z_r R, t] is what the body's points are linear in, so with its change D = T_next −
2 T + T_prev the inertia is the rigid formula, ½/dt² tr(D M Dᵀ): F = D M/dt² − g ⊗ (m; mass) is the
force on T_next, and FD = ⟨∂T, F⟩. The same sums are in step.c, over time steps in lanes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from octo.checks import Array
from octo.soft.moments import Moments
from octo.soft.nodes import Nodes, Turns, bent

SECOND = (1.0, -2.0, 1.0)  # of next, now and previous in the second difference


@dataclass(eq=False)
class Forces:
    """On T_next, to which contacts are added.

    Attributes
    ----------
    blocks: (N, K, 3, 3) N m, on w_k R. total: (N, 3) N, on t.
    """

    blocks: Array
    total: Array

    def rows(self, at: Nodes) -> Array:
        """⟨∂T, F⟩ (N, n)."""
        whole = np.einsum("sk,skij->sij", at.weights, self.blocks)
        turned = np.einsum("saij,sij->sa", at.turns.slope, whole)
        modal = np.einsum("sij,skij->sk", at.turns.value, self.blocks[:, 1:])
        return np.concatenate([self.total, turned, modal], axis=1)


def forces(moments: Moments, window: tuple[Nodes, Nodes, Nodes], dt: float, g: Array) -> Forces:
    """Of inertia and of gravity g (3,) m/s²; ``window``: next, now and previous."""
    next_, now, old = window
    rate = 1.0 / dt**2
    a = rate * (next_.place - 2.0 * now.place + old.place) - g
    blocks = a[:, None, :, None] * moments.first[None, :, None, :]
    total = moments.mass * a
    for factor, node in zip(SECOND, window, strict=True):
        R = factor * rate * node.turns.value
        blocks = blocks + np.einsum("sij,skjl->skil", R, node.blocks)
        total = total + np.einsum("sij,sj->si", R, node.first)
    return Forces(blocks, total)


def coupled(moments: Moments, left: Turns, weights: Array, modal: Array, node: Nodes) -> Array:
    """⟨∂_i, M ∂_j T⟩ (N, n, n): the rows of angles are those of w_k ``left``, of modes of
    ``modal`` (N, 3, 3); rows of t are zero. Columns: those of ``node``."""
    steps, count = weights.shape
    R, made = node.turns.value, np.zeros((steps, 5 + count, 5 + count))
    own = moments.blocks(weights)
    made[:, 3:6, :3] = np.einsum("saij,sj->sai", left.slope, weights @ moments.first)
    whole = np.einsum("sk,skij->sij", weights, node.blocks)
    both = np.einsum("sbij,sjl->sbil", node.turns.slope, whole)
    made[:, 3:6, 3:6] = np.einsum("saij,sbij->sab", left.slope, both)
    turned = np.einsum("saij,sil->sajl", left.slope, R)  # ∂_a(left)ᵀ R
    made[:, 3:6, 6:] = np.einsum("sajl,skjl->sak", turned, own[:, 1:])
    made[:, 6:, :3] = np.einsum("sij,kj->ski", modal, moments.first[1:])
    slopes = np.einsum("sij,sbil->sbjl", modal, node.turns.slope)  # modalᵀ ∂_b R
    made[:, 6:, 3:6] = np.einsum("sbjl,sklj->skb", slopes, node.blocks[:, 1:])
    relative = np.einsum("sij,sil->sjl", modal, R)
    made[:, 6:, 6:] = np.einsum("sij,klij->skl", relative, moments.second[1:, 1:])
    return made


def moved(moments: Moments, node: Nodes) -> Array:
    """The rows of t of ⟨∂T_next, M ∂T⟩ (N, 3, n), columns: those of ``node``."""
    made = np.zeros((len(node.place), 3, 5 + node.weights.shape[1]))
    made[:, :, :3] = moments.mass * np.eye(3)
    made[:, :, 3:6] = np.einsum("sbij,sj->sib", node.turns.slope, node.first)
    made[:, :, 6:] = np.einsum("sij,kj->sik", node.turns.value, moments.first[1:])
    return made


def pulled(moments: Moments, at: Nodes, along: Turns, lam: Array) -> Array:
    """M λ̂ (N, K, 3, 3) on the blocks w_k R of any node, of the displacement λ̂ of T_next that
    ``lam`` (N, n) makes; ``along``: R_λ."""
    modal = np.concatenate([np.zeros((len(lam), 1)), lam[:, 6:]], axis=1)
    made = np.einsum("sij,skjl->skil", along.value, at.blocks)
    made += np.einsum("sij,skjl->skil", at.turns.value, moments.blocks(modal))
    return made + lam[:, None, :3, None] * moments.first[None, :, None, :]


def curved(at: Nodes, along: Turns, lam: Array, force: Array) -> Array:
    """⟨∂²λ̂, F⟩ (N, n, n) of a force on T_next, F (N, K, 3, 3)."""
    modal = np.concatenate([np.zeros((len(lam), 1)), lam[:, 6:]], axis=1)
    made = bent(along, at.weights, force)
    whole = np.einsum("sk,skij->sij", modal, force)
    made[:, 3:6, 3:6] += np.einsum("sabij,sij->sab", at.turns.second, whole)
    return made
