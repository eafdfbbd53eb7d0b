"""The joint between two phases, by blocks: x_{-1} and x_0 of a phase are made of the last two nodes
of the one before, a and b,

    x_{-1} = r a + (1 − r) b        x_0 = b        r = dt / dt of the phase before

so that the velocity x_0 − x_{-1} over dt is that of b − a over the other dt. The rest of a phase
knows nothing of it: here are these two nodes of what it is given, and what its blocks become over
the other phase's nodes. r is (batch,). Were dt unknown, r would move x_{-1} by a − b.
"""

from __future__ import annotations

from octo.arrays import Array


def begun(r: Array, values: Array) -> Array:
    """A phase's unknowns, a step of them, or its nodes (batch, K, n): of the same whose first two
    are a and b."""
    made, own = values.copy(), r[:, None]
    made[:, 0] = own * values[:, 0] + (1.0 - own) * values[:, 1]
    return made


def pulled(r: Array, forces: Array) -> None:
    """Forces on a phase's unknowns (batch, K, n), in place: the first two units' on a and b."""
    own = r[:, None]
    forces[:, 1] += (1.0 - own) * forces[:, 0]
    forces[:, 0] *= own


def of_rows(r: Array, A: Array) -> None:
    """∂C/∂v (batch, K, 3, m, n) of a phase, in place: over a and b in place of its first two units,
    whose own rows are empty."""
    own = r[:, None, None]
    if A.shape[1] > 2:
        A[:, 2, 1] += (1.0 - own) * A[:, 2, 2]
        A[:, 2, 2] *= own


def of_hessian(r: Array, H: Array) -> None:
    """Second derivatives (batch, K, 3, n, n) of a phase, in place: over a and b."""
    own = r[:, None, None]
    rest = 1.0 - own
    first, coupled = H[:, 0, 0].copy(), H[:, 1, 1].copy()
    H[:, 0, 0] = own**2 * first
    H[:, 1, 1] = own * (rest * first + coupled)
    H[:, 1, 0] += rest**2 * first + rest * (coupled + coupled.swapaxes(1, 2))
    if H.shape[1] > 2:
        H[:, 2, 1] += rest * H[:, 2, 2]
        H[:, 2, 2] *= own
