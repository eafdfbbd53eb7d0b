"""What the rules ask of the place where the large arrays live: NumPy and native code here, a device
in octo.gpu."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from octo.arrays import Array
from octo.problem.block_nlp import BlockNLP
from octo.problem.evaluation import Evaluation, Model
from octo.problem.phased import Compiled
from octo.solver import elimination, kkt
from octo.solver.blocks import KKTBlocks
from octo.solver.factors import Factors, HostFactors
from octo.solver.normal import NormalFactor
from octo.solver.options import SqpOptions
from octo.solver.subproblem import Three, Two, two_by_two


class Backend:
    """The CPU's models, trials, factorisations and projections."""

    name = "cpu"

    def place(self, problem: Compiled) -> BlockNLP:
        """``problem`` where the arrays live: what ``sqp.run`` is given."""
        return problem

    def array(self, values: NDArray[np.float64] | None) -> Array | None:
        """NumPy ``values`` where the arrays live."""
        return values

    def prepare(self, problem: Compiled, options: SqpOptions) -> None:
        """Generate and compile what is not there yet: set-up, not solving."""
        problem.prepare()
        more = int(problem.problems[0].duration is not None)  # dt has a copy and a row in each unit
        rows = 0 if options.soft else problem.ma + more
        kkt.prepare(problem.nc + more, rows, options.linear_solver)

    def release(self) -> None:
        """At the end of a solve: give back the memory that was kept for its next iteration."""
        elimination.release()

    def finish(self) -> None:
        """At the end of a stage of an iteration: wait for the device, where stages are timed."""

    def linearize(
        self,
        problem: BlockNLP,
        at: Evaluation,
        lam: Array,
        exact: bool,
        curved: NDArray[np.bool_] | None = None,
    ) -> Model:
        """Eq. 9, with the curvature of lamᵀC and of the torques where ``exact``, and then of the
        terms over contacts of the members ``curved`` (batch,) too, by default of all; it holds
        until the next one is asked for."""
        return problem.linearize(at, lam if exact else None, curved)

    def evaluate(self, problem: BlockNLP, unknowns: Array) -> Evaluation:
        """E and C of the whole batch."""
        return problem.evaluate(unknowns)

    def evaluate_with(
        self, problem: BlockNLP, unknowns: Array, numbers: list[Array]
    ) -> tuple[Evaluation, list[NDArray[np.float64]]]:
        """``evaluate``, and ``numbers`` (batch,) on the host with it."""
        return self.evaluate(problem, unknowns), numbers

    def two_by_two(self, hessian: Three, gradient: Two, radius: Array) -> Two:
        """``subproblem.two_by_two``."""
        return two_by_two(hessian, gradient, radius)

    def together(self, problem: BlockNLP) -> bool:
        """Whether a trial of some members costs no less than that of all of them."""
        return False

    def blocks(self, model: Model) -> KKTBlocks:
        """Eq. 12 with its products."""
        return KKTBlocks(model.H, model.A, model.b, model.C)

    def factors(
        self, problem: BlockNLP, model: Model, at: Evaluation, lam: Array, options: SqpOptions
    ) -> Factors:
        """Where the KKT matrices of this iterate will be factored; ``model`` is the last one."""
        return HostFactors(self.blocks(model), lam, options, problem.threads)

    def normal(self, A: Array, threads: int = 1) -> NormalFactor:
        """AAᵀ factored."""
        return NormalFactor(A, threads=threads)


CPU = Backend()
