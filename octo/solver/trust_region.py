"""The paper's step (§6.1): JᵀJ, two directions in a trust region, the merit Φ = μ/2‖C‖² + E,
verbatim.

A direction, the step of Eq. 10 within a radius, and an acceptance, the paper's merit or the user's:
the radius grows where it says yes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from octo.arrays import Array, Numbers, array_module, choose, host, inner, largest, like
from octo.problem.block_nlp import BlockNLP, WeighedNLP
from octo.problem.evaluation import Evaluation, Model
from octo.problem.joint_costs import Effort
from octo.solver.acceptance import Acceptance, Mask, Step
from octo.solver.backend import CPU, Backend
from octo.solver.options import SqpOptions
from octo.solver.regularisation import Regularisation
from octo.solver.rule import Clock, Move
from octo.solver.search import Line, Trials, search
from octo.solver.subproblem import Directions, minimize

UNBOUNDED = 1e150  # its square is still a number
GROW, SHRINK = 1.2, 0.8  # of the radius; of ‖Δ‖ where it was refused
OFTEN = 200  # refusals in a row of one member, before it counts as stalled
EFFORT = 1e-4  # of ‖u‖², §8
RHO = 0.3  # of Eq. 11, as in Nocedal and Wright (18.36)


class MeritAcceptance(Acceptance):
    """The paper's: Φ must fall, and the step end with small constraints. μ follows Eq. 11 with the
    (1 − ρ) of its source, after the relaxation of C: monotone.

    Parameters
    ----------
    most: of ‖C‖∞, in mg: a step that ends above it is refused unless it reduces ‖C‖∞.
    """

    mu: Numbers  # (batch,)

    def __init__(self, most: float):
        self.most = most

    def start(self, at: Evaluation) -> None:
        self.mu = np.zeros(len(at.energy))

    def merit(self, at: Evaluation) -> Numbers:
        return at.energy + 0.5 * self.mu * at.square

    def accepts(self, at: Evaluation, trial: Evaluation, step: Step) -> Mask:
        """Where nothing is left to do, a step of length zero is taken too."""
        gain = 0.5 * (at.square - step.left(at) ** 2)
        needed = step.predicted / ((1.0 - RHO) * np.maximum(gain, 1e-30))
        self.mu = np.maximum(self.mu, np.where(gain > 1e-30, needed, 0.0))
        lower = (self.merit(trial) < self.merit(at)) | (step.largest == 0.0)
        small = (trial.largest < self.most) | (trial.largest < at.largest)
        return trial.finite & lower & small


@dataclass(frozen=True, eq=False)
class Bounded:
    """A step within the radius. length: (batch,) ‖Δ‖₂. full: ‖·‖∞ of the KKT step. dual: ‖∇E +
    Aᵀlam‖∞. sigma: the weights of the factors. has: where there is one."""

    line: Line
    length: Numbers
    full: Numbers
    dual: Numbers
    sigma: Numbers
    has: Mask


class BoundedDirection:
    """The step of Eq. 10 and its radius: ∞ at first, then ‖Δ‖, × 1.2 where the step was taken,
    0.8‖Δ‖ where it was not."""

    def __init__(self, batch: int, units: int, options: SqpOptions, trials: Trials):
        self.options, self.trials = options, trials
        self.regularisation = Regularisation(batch, units, options)
        self.radius = np.full(batch, np.inf)
        self.refused = np.zeros(batch, dtype=int)

    def take(self, members: NDArray[np.intp]) -> None:
        """Keep some members only."""
        self.regularisation.take(members)
        self.radius, self.refused = self.radius[members], self.refused[members]

    def step(self, at: Evaluation, lam: Array, model: Model) -> Bounded:
        """The model's minimiser within the radius, evaluated: its numbers come with the trial."""
        problem, clock, backend = self.trials.problem, self.trials.clock, self.trials.backend
        blocks = backend.blocks(model)
        dual = largest(model.b + blocks.constraints_transposed_times(lam))
        with clock("factor"):
            factors = backend.factors(problem, model, at, lam, self.options)
            sigma, has = self.regularisation.factorize(factors)
            normal = backend.normal(model.A, problem.threads)
        with clock("solve"):
            full, multipliers = factors.solve(-model.b, -model.C)
            tangential, _ = factors.solve(-model.b, array_module(model.C).zeros_like(model.C))
            directions = Directions(full, tangential, normal.least_norm(-model.C), multipliers)
            radius = np.where(np.isfinite(self.radius), self.radius, UNBOUNDED)
            step = minimize(blocks, directions, normal.project, radius, backend.two_by_two)
            numbers = [
                inner(step.delta, step.delta),
                *(step.slope, step.energy, step.residual),
                *(largest(step.delta), largest(full), dual),
            ]
        with clock("evaluate"):
            unknowns = at.unknowns + step.delta
            trial, numbers = backend.evaluate_with(problem, unknowns, numbers)
        square, slope, energy, residual, moved, most, dual = numbers
        line = Line(step.delta, multipliers, moved, slope, trial, (energy, residual))
        return Bounded(line, np.sqrt(square), most, dual, sigma, has)

    def learn(self, length: Numbers, accepted: Mask) -> None:
        """The radius after a step of ``length`` that was taken, or was not."""
        radius = np.where(np.isfinite(self.radius), self.radius, length)
        self.radius = np.where(accepted, GROW * radius, SHRINK * length)
        self.refused = np.where(accepted, 0, self.refused + 1)


class TrustRegion:
    """The rule of SqpOptions(step="trust_region")."""

    def __init__(
        self,
        problem: BlockNLP,
        at: Evaluation,
        options: SqpOptions,
        clock: Clock,
        backend: Backend = CPU,
    ):
        self.options, self.trials = options, Trials(problem, clock, backend)
        most = options.c_max / problem.weight
        self.acceptance = (options.acceptance or MeritAcceptance(most)).started(at)
        self.direction = BoundedDirection(problem.batch, problem.K, options, self.trials)

    @staticmethod
    def normalised(problem: WeighedNLP, unknowns: Array) -> BlockNLP:
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

    def anew(self, members: NDArray[np.intp]) -> None:
        """Nothing moves members of a trust region but their own steps."""

    def take(self, members: NDArray[np.intp], problem: BlockNLP) -> None:
        """Keep some members only, those of ``problem``."""
        self.trials.problem = problem
        self.acceptance.take(members)
        self.direction.take(members)

    def move(self, at: Evaluation, lam: Array, model: Model, iteration: int) -> Move:
        """One iteration of Algorithm 1, lines 3 to 20."""
        o, merit, step = self.options, self.acceptance.merit, self.direction.step(at, lam, model)
        line, everyone = step.line, np.ones(len(step.has), dtype=bool)
        found = search(self.trials, self.acceptance, at, line, everyone, tries=1)
        accepted = found.accepted
        self.direction.learn(step.length, accepted)
        assert line.first is not None and line.model is not None
        reduction, predicted = merit(at) - merit(line.first), line.model[0]
        left = found.at.largest * self.trials.problem.weight
        with np.errstate(over="ignore"):  # of a step that promises nothing
            ratio = reduction / np.maximum(-predicted, 1e-300)
        small = (line.largest < o.step_tolerance) & (left < o.tolerance)
        return Move(
            at=found.at,
            lam=choose(accepted, line.multipliers, lam),
            accepted=accepted,
            failed=~step.has | (self.direction.refused > OFTEN),
            dual=step.dual,
            step=step.full,
            taken=found.moved,
            ratio=ratio,
            radius=self.direction.radius.copy(),
            sigma=step.sigma,
            factorizations=self.direction.regularisation.factorizations,
            converged=accepted & small,
        )
