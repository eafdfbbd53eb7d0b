"""Random KKT systems in lag storage, for the linear solvers of the CPU and of the GPU."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from octo.solver.blocks import KKTBlocks


def _random_system(
    seed: int,
    batch: int,
    K: int,
    nc: int,
    ma: int,
    *,
    lowered: float = 0.0,
    rows_touch: tuple[int, ...] = (0, 1, 2),
) -> KKTBlocks:
    """H a sum of squares over three neighbouring units plus I, minus a random diagonal in [0,
    lowered).

    Row block k of A touches units k − o for o in rows_touch.
    """
    random = np.random.default_rng(seed)
    H, A = np.zeros((batch, K, 3, nc, nc)), np.zeros((batch, K, 3, ma, nc))
    diagonal = np.arange(nc)
    for k in range(K):
        reach = min(k, 2) + 1
        jacobian = [random.standard_normal((batch, nc, nc)) / np.sqrt(nc) for _ in range(reach)]
        for o in range(reach):
            for p in range(o, reach):
                H[:, k - o, p - o] += np.swapaxes(jacobian[o], -1, -2) @ jacobian[p]
        for o in rows_touch:
            if o < reach:
                A[:, k, o] = random.standard_normal((batch, ma, nc))
    H[:, :, 0, diagonal, diagonal] += 1.0 - lowered * random.random((batch, K, nc))
    return KKTBlocks(
        H, A, random.standard_normal((batch, K, nc)), random.standard_normal((batch, K, ma))
    )


@pytest.fixture
def random_system() -> Callable[..., KKTBlocks]:
    return _random_system
