"""What the residuals of two steps in a row depend on, over x: for IPOPT, which pays for every
nonzero."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from octo.problem.compiled import CompiledProblem
from octo.problem.step_pairs import WINDOW
from octo.reference.patterns import pattern_of, torque_pattern


def pair_rows(
    c: CompiledProblem, nodes: sparse.csr_array, windows: sparse.csr_array
) -> sparse.csr_array:
    """(rows of all steps, x) pattern: their squares couple what stands in one row, and their
    curvature no more.

    nodes: ((N+2)·n, x) what x_{-1} … x_N are made of. windows: (N·3n, x) the same of each step's
    x_next, x, x_prev.
    """
    assert c.functions.pairs is not None
    slopes, n, first = pattern_of(c.functions.pairs.sparsity), c.n, int(c.carry is None)
    torques, nu = torque_pattern(c.dynamics), c.nu
    own, before = slopes[:, WINDOW * n : -nu] @ torques, slopes[:, -nu:] @ torques
    each, size = np.arange(n), 3 * n
    if c.carry is not None:
        oldest = sparse.csr_array(c.carry[0] != 0.0) @ nodes[(c.steps - 1) * n : c.steps * n]
        nodes = sparse.vstack([oldest, nodes]).tocsr()
    steps = np.arange(c.steps - first)
    window = steps[:, None, None] + np.arange(WINDOW - 1, -1, -1)[:, None]
    earlier = [sparse.csr_array(before)] * (c.steps - 1)
    if c.carry is not None:  # before the first step comes the last one, carried back
        motors = np.ix_(c.dynamics.actuated, c.dynamics.actuated)
        seam = slopes[:, -nu:] @ (c.carry[0][motors] != 0.0) @ torques
        earlier.insert(0, sparse.csr_array(seam))
        windows_before = sparse.vstack([windows[-size:], windows[:-size]])
    else:
        windows_before = windows[:-size]
    made = [
        sparse.kron(sparse.eye(len(steps)), slopes[:, : WINDOW * n])
        @ nodes[(window * n + each).ravel()],
        sparse.kron(sparse.eye(len(steps)), own) @ windows[first * size :],
        sparse.block_diag(earlier) @ windows_before,
    ]
    return sparse.csr_array(made[0] + made[1] + made[2])
