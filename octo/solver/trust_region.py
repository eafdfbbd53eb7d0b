"""The paper's step (§6.1): JᵀJ, two directions in a trust region, the merit Φ = μ/2‖C‖² + E,
verbatim."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from octo.arrays import Array, Numbers, array_module, choose, host, inner, largest, like
from octo.problem.block_nlp import BlockNLP
from octo.problem.evaluation import Evaluation, Model
from octo.problem.joint_costs import Effort
from octo.solver.backend import CPU, Backend
from octo.solver.options import SqpOptions
from octo.solver.regularisation import Regularisation
from octo.solver.rule import Clock, Move
from octo.solver.subproblem import Directions, minimize

RHO = 0.3  # of Eq. 11, as in Nocedal and Wright (18.36)
UNBOUNDED = 1e150  # its square is still a number
EFFORT = 1e-4  # of ‖u‖², §8


class TrustRegion:
    """The rule of SqpOptions.paper()."""

    def __init__(
        self,
        problem: BlockNLP,
        at: Evaluation,
        options: SqpOptions,
        clock: Clock,
        backend: Backend = CPU,
    ):
        self.problem, self.options, self.clock, self.backend = problem, options, clock, backend
        self.regularisation = Regularisation(problem.batch, problem.K, options)
        self.radius = np.full(problem.batch, np.inf)
        self.mu = np.zeros(problem.batch)
        self.refused = np.zeros(problem.batch, dtype=int)

    @staticmethod
    def normalised(problem: BlockNLP, unknowns: Array) -> BlockNLP:
        """E as §8 scales it: the objective is 1 at the start, effort is 1e-4‖u‖² summed over the
        steps."""
        scaled = problem.take(np.arange(problem.batch))
        values = host(problem.term_values(problem.evaluate(unknowns)))
        terms = problem.problems[0].costs
        effort = np.array([isinstance(term, Effort) for term in terms])
        start = values[:, ~effort].sum(axis=1)
        for k in range(len(terms)):
            if effort[k]:
                place = problem.functions.references.places[k]["inverse_reference"]
                scaled.q[:, :, k] = EFFORT / scaled.q[:, :, place][..., 0] ** 2
            else:
                scaled.q[:, :, k] /= like(np.where(start > 0.0, start, 1.0)[:, None], scaled.q)
        return scaled

    def take(self, members: NDArray[np.intp], problem: BlockNLP) -> None:
        """Keep some members only, those of ``problem``."""
        self.problem = problem
        self.regularisation.take(members)
        self.radius = self.radius[members]
        self.mu = self.mu[members]
        self.refused = self.refused[members]

    def move(self, at: Evaluation, lam: Array, model: Model, iteration: int) -> Move:
        """One iteration of Algorithm 1, lines 3 to 20."""
        blocks = self.backend.blocks(model)
        dual = largest(model.b + blocks.constraints_transposed_times(lam))
        with self.clock("factor"):
            factors = self.backend.factors(self.problem, model, at, lam, self.options)
            sigma, has = self.regularisation.factorize(factors)
            normal = self.backend.normal(model.A, self.problem.threads)
        with self.clock("solve"):
            full, multipliers = factors.solve(-model.b, -model.C)
            tangential, _ = factors.solve(-model.b, array_module(model.C).zeros_like(model.C))
            directions = Directions(full, tangential, normal.least_norm(-model.C), multipliers)
            radius = np.where(np.isfinite(self.radius), self.radius, UNBOUNDED)
            step = minimize(blocks, directions, normal.project, radius, self.backend.two_by_two)
            square, wanted = inner(step.delta, step.delta), inner(model.C, model.C)
            numbers = [
                square,
                wanted,
                step.energy,
                step.residual,
                largest(step.delta),
                largest(full),
                dual,
            ]
        with self.clock("evaluate"):
            trial, numbers = self.backend.evaluate_with(
                self.problem, at.unknowns + step.delta, numbers
            )
        square, wanted, energy, residual, moved, most, dual = numbers
        self._raise_penalty(wanted, energy, residual)
        length = np.sqrt(square)
        self.radius = np.where(np.isfinite(self.radius), self.radius, length)
        weight = self.problem.weight
        violation = trial.largest * weight
        # length 0: nothing is left to do
        ok = trial.finite & ((self._merit(trial) < self._merit(at)) | (length == 0.0))
        ok &= (violation < self.options.c_max) | (violation < at.largest * weight)
        reduction = self._merit(at) - self._merit(trial)
        self.radius = np.where(ok, 1.2 * self.radius, 0.8 * length)
        after = at.replaced(ok, trial)
        lam = choose(ok, multipliers, lam)
        self.refused = np.where(ok, 0, self.refused + 1)
        left = after.largest * weight
        return Move(
            at=after,
            lam=lam,
            accepted=ok,
            failed=~has | (self.refused > 200),
            dual=dual,
            step=most,
            taken=np.where(ok, moved, 0.0),
            ratio=reduction / np.maximum(-energy, 1e-300),
            radius=self.radius.copy(),
            sigma=sigma,
            factorizations=self.regularisation.factorizations,
            converged=ok & (moved < self.options.step_tolerance) & (left < self.options.tolerance),
        )

    def _merit(self, at: Evaluation) -> Numbers:
        return at.energy + 0.5 * self.mu * at.square

    def _raise_penalty(self, square: Numbers, energy: Numbers, residual: Numbers) -> None:
        """Eq. 11 with the (1 − ρ) of its source, after the relaxation of C_0, ``square`` ‖C_0‖₂²:
        monotone."""
        gain = 0.5 * (square - residual**2)
        needed = np.where(gain > 1e-30, energy / ((1.0 - RHO) * np.maximum(gain, 1e-30)), 0.0)
        self.mu = np.maximum(self.mu, needed)
