"""The linear-quadratic regulator of a linearised motion, from the blocks of its KKT matrix
(Eq. 12).

With every node a unit, row block j of H and A touches the nodes z_j, z_{j−1} and z_{j−2}, so that
what is left to pay behind z_j is a quadratic form P of (z_j, z_{j−1}). From the last node to the
first one it is eliminated (Bellman's principle; Rawlings, Mayne and Diehl, §8.8):

    [[Q, A_0ᵀ], [A_0, 0]] [z_j; lam] = −M [z_{j−1}; z_{j−2}],    z_j = G_j [z_{j−1}; z_{j−2}]

Q is what z_j itself costs, with P of the node before; M what it costs together with the two nodes
before, above the rows A_1, A_2 of the constraint; P of (z_{j−1}, z_{j−2}) is the Schur complement.
"""

from __future__ import annotations

import numpy as np

from octo.checks import Array
from octo.errors import ProblemError

PAST = 2  # nodes that the state is made of


def feedback(H: Array, A: Array, sigma: float) -> Array:
    """(batch, N, n, 2n) how each of x_1 … x_N answers a change of the two nodes before it, the
    nearer one first.

    Parameters
    ----------
    H: (batch, N+2, 3, n, n). A: (batch, N+2, 3, m, n). Both in lag storage, of x_{-1}, x_0 … x_N.
    sigma: added to the diagonal of H, of x_1 … x_N.

    Raises
    ------
    ProblemError: a matrix is singular.
    """
    batch, K, _, n, _ = H.shape
    m = A.shape[3]
    made = np.empty((batch, K - PAST, n, 2 * n))
    after = np.zeros((batch, 2 * n, 2 * n))  # P of (z_j, z_{j−1})
    matrix, M = np.zeros((batch, n + m, n + m)), np.empty((batch, n + m, 2 * n))
    for j in range(K - 1, PAST - 1, -1):
        matrix[:, :n, :n] = H[:, j, 0] + after[:, :n, :n] + sigma * np.eye(n)
        matrix[:, n:, :n] = A[:, j, 0]
        matrix[:, :n, n:] = np.swapaxes(A[:, j, 0], 1, 2)
        M[:, :n, :n], M[:, :n, n:] = H[:, j, 1] + after[:, :n, n:], H[:, j, 2]
        M[:, n:, :n], M[:, n:, n:] = A[:, j, 1], A[:, j, 2]
        try:
            solved = -np.linalg.solve(matrix, M)
        except np.linalg.LinAlgError:
            raise ProblemError(
                f"the motion has no regulator: what step {j - PAST} costs does not say where it "
                "goes; give it a term over torques, as octo.Effort()"
            ) from None
        made[:, j - PAST] = solved[:, :n]
        rest = np.swapaxes(M, 1, 2) @ solved
        rest[:, :n, :n] += after[:, n:, n:]
        after = 0.5 * (rest + np.swapaxes(rest, 1, 2))
    return made
