"""The tangents of a cubic Hermite spline from its nodes: those that it was made with, where the
nodes lie on one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from octo.checks import Array

EXACT = 1e-10  # relative: nodes nearer than this to a spline are on it


def hermite_table(steps: int, q: int) -> tuple[NDArray[np.int32], Array]:
    """First control (N+1,) and the four coefficients (N+1, 4), of (x_k, t_k, x_{k+1}, t_{k+1}), of
    nodes 0 … N on segments of q steps."""
    j = np.arange(steps + 1)
    segment, s = j // q, (j % q) / q
    h00, h10 = 2 * s**3 - 3 * s**2 + 1, s**3 - 2 * s**2 + s
    h01, h11 = -2 * s**3 + 3 * s**2, s**3 - s**2
    return segment.astype(np.int32), np.stack([h00, h10, h01, h11], axis=1)


def tangents_of(nodes: Array, q: int) -> Array:
    """(…, Z, n) τ ẋ_1 … τ ẋ_Z of nodes x_{-1} … x_N (…, N+2, n) on segments of q steps: those of
    the spline that the nodes lie on, of others central differences; τ ẋ_0 is q (x_0 − x_{−1})."""
    x = nodes[..., 1:, :]
    steps, (*batch, _, n) = x.shape[-2] - 1, x.shape
    segments = steps // q
    velocity = np.empty((*batch, segments, n))
    velocity[..., :-1, :] = 0.5 * (x[..., q + 1 : -1 : q, :] - x[..., q - 1 : -q - 1 : q, :])
    velocity[..., -1, :] = x[..., -1, :] - x[..., -2, :]
    if q == 2:  # some spline goes through any nodes, however it swings between them
        return q * velocity
    # least squares over the nodes between the knots: tridiagonal normal equations
    h00, h10, h01, h11 = hermite_table(q, q)[1][1:q].T[:, :, None]
    first, last = x[..., :-q:q, None, :], x[..., q::q, None, :]
    between = x[..., :-1, :].reshape(*batch, segments, q, n)[..., 1:, :]
    rest = between - h00 * first - h01 * last
    known = q * (x[..., :1, :] - nodes[..., :1, :])
    rest[..., 0, :, :] -= h10 * known
    own, other = (h11 * rest).sum(axis=-2), (h10 * rest).sum(axis=-2)
    own[..., :-1, :] += other[..., 1:, :]
    band = np.zeros((2, segments))
    band[1] = (h11**2).sum()
    band[1, :-1] += (h10**2).sum()
    band[0, 1:] = (h10 * h11).sum()
    right = np.moveaxis(own, -2, 0).reshape(segments, -1)
    # LAPACK takes no tridiagonal matrix of one row
    solved = solveh_banded(band, right) if segments > 1 else right / band[1]
    found = np.moveaxis(solved.reshape(segments, *batch, n), 0, -2)
    rest -= h11 * found[..., None, :]
    rest[..., 1:, :, :] -= h10 * found[..., :-1, None, :]
    miss = np.abs(rest).max(axis=(-1, -2, -3))
    on_it = miss <= EXACT * (1.0 + np.abs(x).max(axis=(-1, -2)))
    return np.where(on_it[..., None, None], found, q * velocity)
