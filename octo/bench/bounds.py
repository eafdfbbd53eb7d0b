"""What the machine can do, and how much of it an iteration must: arithmetic and bytes."""

from __future__ import annotations

import numpy as np

from octo.bench.plan import Plan
from octo.bench.timing import Records, Say, interleaved

SIZE = 512  # of the matrices that are multiplied
LARGE = 64 * 2**20 // 8  # numbers copied: more than the caches hold


def measure(records: Records, plan: Plan, say: Say) -> None:
    """One core's arithmetic (products of matrices in BLAS) and its way to memory (a copy, read and
    written)."""
    say("one core's arithmetic and memory")
    a, b, c = (np.ones((SIZE, SIZE)) for _ in range(3))
    source, target = np.ones(LARGE), np.ones(LARGE)
    runs = {
        "arithmetic": lambda: np.matmul(a, b, out=c),
        "memory": lambda: np.copyto(target, source),
    }
    best = interleaved(runs, plan.rounds)
    records.add("machine.arithmetic", 2.0 * SIZE**3 / best["arithmetic"].least / 1e9, "Gflop/s")
    records.add("machine.memory", 2.0 * source.nbytes / best["memory"].least / 1e9, "GB/s")


def elimination_flops(nc: int, ma: int) -> float:
    """Of one unit: a symmetric elimination of its nc + ma pivots out of a window that ends two
    units later."""
    pivots, window = nc + ma, 3 * nc + ma
    left = window - 1 - np.arange(pivots)
    return float(np.sum(left * (left + 1)))


def model_bytes(nc: int, ma: int) -> float:
    """Of one unit of H, A, b and C, which one stage writes and the next one reads."""
    return 8.0 * (3 * nc * nc + 3 * ma * nc + nc + ma)
