"""What a solver sees of a problem: unknowns in K units of nc numbers, E, C and their model by
blocks.

:class:`~octo.problem.compiled.CompiledProblem` is one on a CPU, octo.gpu's DeviceProblem on a
device; their arrays live there.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from octo.problem.codegen import CostFunctions
from octo.problem.evaluation import Evaluation, Model
from octo.problem.phases import Described
from octo.problem.problem import Problem

Array = Any  # of NumPy, or of a device


class BlockNLP(Protocol):
    """Minimise E(v) subject to C(v) = 0, of a batch of problems of one structure.

    Attributes
    ----------
    batch: problems. K: units. nc, ma: unknowns and rows of C of a unit.
    steps: N. n, m: coordinates and unactuated rows of a step.
    weight: N, of the robot, whose parts C is in. threads: of a CPU.
    problems: what the batch was made from.
    """

    batch: int
    K: int
    nc: int
    ma: int
    steps: int
    n: int
    m: int
    weight: float
    threads: int

    @property
    def problems(self) -> Sequence[Described]: ...

    def take(self, members: Array) -> BlockNLP:
        """Some members, by index."""
        ...

    def unknowns(self, nodes: Array) -> Array:
        """(batch, K, nc) unknowns of a trajectory (batch, N+2, n) of the host; fixed ones are
        zero."""
        ...

    def evaluate(self, unknowns: Array) -> Evaluation:
        """E and C at ``unknowns`` (batch, K, nc)."""
        ...

    def term_values(self, at: Evaluation) -> Array:
        """(batch, terms) the parts of E."""
        ...

    def gradient(self, at: Evaluation) -> tuple[Array, Array]:
        """∇E (batch, K, nc) and A = ∂C/∂v (batch, K, 3, ma, nc), without second derivatives."""
        ...

    @property
    def row_bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds (batch, N, rows) of the bounded rows, infinite where there is
        none; (batch, N, 0) where there are no such rows, or nothing bounds them."""
        ...

    def set_row_weights(
        self, weights: Array, shifts: Array, multipliers: Array | None = None
    ) -> None:
        """What the bounded rows add to the model from now on, D r' r'ᵀ and d r'."""
        ...

    def row_products(self, model: Model, delta: Array) -> Array:
        """R Δ (batch, N, rows)."""
        ...

    def row_forces(self, model: Model, weights: Array) -> Array:
        """Rᵀ w (batch, K, nc)."""
        ...

    def linearize(self, at: Evaluation, lam: Array | None, curved: Array | None = None) -> Model:
        """Eq. 9; with multipliers ``lam`` (batch, K, ma) the curvature of lamᵀC and of the torques
        too, and of the terms over contacts for the members ``curved`` (batch,)."""
        ...


class WeighedNLP(BlockNLP, Protocol):
    """One whose terms may be weighed anew, as a rule that scales E itself does.

    Attributes
    ----------
    q: (batch, N, NQ) coefficients and references of the terms; changing them in place changes E.
    functions: of the terms.
    """

    q: Array
    functions: CostFunctions

    @property
    def problems(self) -> Sequence[Problem]: ...

    def take(self, members: Array) -> WeighedNLP: ...
