"""What the rules ask of the place where the large arrays live: NumPy and native code here, a device in octo.gpu."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo.arrays import Array, Numbers, host, inner, largest
from octo.problem.compiled import CompiledProblem, Model
from octo.solver import kkt
from octo.solver.blocks import KKTBlocks
from octo.solver.kkt import KKTFactor
from octo.solver.normal import NormalFactor
from octo.solver.options import SqpOptions


class Backend:
    """The CPU's products, factorisations and projections."""

    name = "cpu"

    def place(self, problem: CompiledProblem) -> Any:
        """``problem`` where the arrays live: what ``sqp.run`` is given."""
        return problem

    def array(self, values: NDArray[np.float64] | None) -> Array | None:
        """NumPy ``values`` where the arrays live."""
        return values

    def prepare(self, problem: CompiledProblem, options: SqpOptions) -> None:
        """Generate and compile what is not there yet: set-up, not solving."""
        problem.prepare()
        kkt.prepare(problem.nc, problem.ma, options.linear_solver)

    def finish(self) -> None:
        """At the end of a stage of an iteration: wait for the device, where stages are timed."""

    def blocks(self, model: Model) -> KKTBlocks:
        """Eq. 12 with its products."""
        return KKTBlocks(model.H, model.A, model.b, model.C)

    def step_numbers(self, blocks: KKTBlocks, delta: Array, lam: Array) -> tuple[Numbers, Numbers, Numbers]:
        """‖Δ‖∞ of each unit (batch, K), ‖b + Aᵀlam‖∞ (batch,) and bᵀΔ (batch,), on the host."""
        dual = largest(blocks.b + blocks.constraints_transposed_times(lam))
        return host(abs(delta).max(axis=2)), dual, inner(blocks.b, delta)

    def factorize(self, H: Array, A: Array, sigma: Array, options: SqpOptions, threads: int) -> KKTFactor:
        """[[H + diag(sigma), Aᵀ], [A, 0]] factored, sigma (batch, K) in NumPy."""
        return kkt.factorize(H, A, sigma, method=options.linear_solver, threads=threads)

    def normal(self, A: Array, threads: int = 1) -> NormalFactor:
        """AAᵀ factored."""
        return NormalFactor(A, threads=threads)


CPU = Backend()
