"""What the rules ask of the place where the large arrays live: NumPy and native code here, a device in octo.gpu."""

from __future__ import annotations

from octo.arrays import Array
from octo.problem.compiled import Model
from octo.solver import kkt
from octo.solver.blocks import KKTBlocks
from octo.solver.kkt import KKTFactor
from octo.solver.normal import NormalFactor
from octo.solver.options import SqpOptions


class Backend:
    """The CPU's products, factorisations and projections."""

    name = "cpu"

    def blocks(self, model: Model) -> KKTBlocks:
        """Eq. 12 with its products."""
        return KKTBlocks(model.H, model.A, model.b, model.C)

    def factorize(self, H: Array, A: Array, sigma: Array, options: SqpOptions, threads: int) -> KKTFactor:
        """[[H + diag(sigma), Aᵀ], [A, 0]] factored, sigma (batch, K) in NumPy."""
        return kkt.factorize(H, A, sigma, method=options.linear_solver, threads=threads)

    def normal(self, A: Array, threads: int = 1) -> NormalFactor:
        """AAᵀ factored."""
        return NormalFactor(A, threads=threads)


CPU = Backend()
