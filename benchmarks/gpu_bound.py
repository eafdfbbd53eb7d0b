"""What one iteration cannot be faster than on a GPU (docs/gpu.md)."""

from __future__ import annotations

from dataclasses import dataclass

from octo.problem.compiled import CompiledProblem


@dataclass(frozen=True)
class Gpu:
    """A GPU's own limits: float64 operations and bytes a second, and s of one dependent step."""

    name: str
    flops: float
    bandwidth: float
    step: float  # a trip to shared memory and a barrier
    launch: float  # from the end of a kernel to the begin of the next


# NVIDIA's data sheets (float64 without tensor cores); 100 cycles at 1.8 GHz; a CUDA graph's node to
# node.
H100 = Gpu("H100", 34e12, 3.35e12, 55e-9, 1.3e-6)
H200 = Gpu("H200", 34e12, 4.8e12, 55e-9, 1.3e-6)
STEPS_OF_A_PIVOT = 5  # choose (2), exchange (2), eliminate
KERNELS = 12  # of an iteration beside the reduction: model 8, products and record 4


@dataclass(frozen=True)
class Bound:
    """Of one iteration: linearise, factor, solve with one refinement, one trial."""

    operations: float
    bytes: float
    pivots: int  # that wait for one another
    kernels: int  # that wait for one another

    def seconds(self, gpu: Gpu) -> dict[str, float]:
        """By operations, by bytes, by dependent steps; an iteration takes at least the largest."""
        waiting = self.pivots * STEPS_OF_A_PIVOT * gpu.step + self.kernels * gpu.launch
        return {
            "operations": self.operations / gpu.flops,
            "bytes": self.bytes / gpu.bandwidth,
            "waiting": waiting,
        }


def bound(problem: CompiledProblem) -> Bound:
    """Of a batch; every array is written once and read once."""
    n, N, K, nc, ma = problem.n, problem.steps, problem.K, problem.nc, problem.ma
    D, B = -(-K // 2), 2 * (nc + ma)
    levels = (D - 1).bit_length()
    rows, slots = problem.functions.rows, (problem.stencil.unit >= 0).sum(axis=1)
    pairs = int(((slots[2:] + slots[1:-1] + slots[:-2]) ** 2).sum())  # of parts that a step adds to
    # blocks times twists; entries of related degrees of freedom
    step = 12 * n * 36 * 2 + 150 * n * n / 2
    products = 6 * n * n * rows * 2
    gathered = n * n * pairs  # 2 for half of them: H is symmetric
    reduction = D * B**3 * (1 + 2 * 2 + 3 * 2)  # pivots, two couplings, three complements
    solves = 2 * D * B * B * 4 * 2
    operations = problem.batch * (N * (step + products) + gathered + reduction + solves)
    squares = 3 + problem.dynamics.curvature_blocks + 6  # jac, curvature, hess of a step
    numbers = N * squares * n * n + K * 3 * nc * (nc + ma) + D * B * B * (2 + 2 + 3)
    waits, kernels = 2 * levels + 1, KERNELS + (problem.carry is not None)
    return Bound(
        operations,
        16.0 * problem.batch * numbers,
        (levels + 1) * B,
        kernels + 3 * levels + 1 + 2 * (waits + 3),
    )
