"""The KKT matrix of blocks as one array, for tests."""

from __future__ import annotations

from octo.arrays import Array, array_module
from octo.solver.blocks import KKTBlocks, spread_sigma, turned


def kkt_matrix(blocks: KKTBlocks, sigma: Array | None = None) -> Array:
    """The KKT matrix (batch, K(nc+ma), K(nc+ma)), all variables first, then all multipliers."""
    xp, (batch, K) = array_module(blocks.H), (blocks.batch, blocks.units)
    nc, ma = blocks.nc, blocks.ma
    matrix = xp.zeros((batch, K * (nc + ma), K * (nc + ma)))
    for k in range(K):
        own, rows = slice(k * nc, (k + 1) * nc), slice(K * nc + k * ma, K * nc + (k + 1) * ma)
        for o in range(min(k, 2) + 1):
            other = slice((k - o) * nc, (k - o + 1) * nc)
            matrix[:, own, other] = blocks.H[:, k, o]
            matrix[:, other, own] = turned(blocks.H[:, k, o])
            matrix[:, rows, other] = blocks.A[:, k, o]
            matrix[:, other, rows] = turned(blocks.A[:, k, o])
    if sigma is not None:
        diagonal = xp.arange(K * nc)
        matrix[:, diagonal, diagonal] += spread_sigma(sigma, blocks.H).reshape(batch, -1)
    return matrix
