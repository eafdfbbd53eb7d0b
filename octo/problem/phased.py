"""E, C and their model of phases: the sum of the phases' own over overlapping units.

Every x_1 … x_N of the whole is a unit. A phase sees its own nodes and, but for the first, the last
two of the phase before (octo.problem.joint), so that its blocks are added to those of the others
where these two stand. Terms, rows with bounds and what is kept of their slopes are tables by step:
each phase has its own in its own steps, the columns that it does not have are empty.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array
from octo.errors import ProblemError
from octo.problem import joint
from octo.problem.compiled import CompiledProblem
from octo.problem.continued import BEFORE
from octo.problem.duration import Duration
from octo.problem.evaluation import Evaluation, Model
from octo.problem.phases import Described, Phases
from octo.problem.problem import Problem
from octo.problem.structure import check_alike


class PhasedProblem:
    """A batch of phases that differ in numbers only: a BlockNLP (octo.problem.block_nlp).

    Parameters
    ----------
    problems: all with as many phases, each like the same one of the others.
    threads: of the native code, which takes one phase after the other.
    like: a batch with the same phases, whose generated code is shared.

    Attributes
    ----------
    parts: a CompiledProblem for each phase, E of which has its share of the whole.
    ratios: (phases, batch) dt over that of the phase before; 1 of the first phase.
    """

    def __init__(
        self, problems: Sequence[Phases], threads: int = 1, like: PhasedProblem | None = None
    ):
        self.problems = tuple(problems)
        phases = list(zip(*(one.problems for one in problems), strict=True))
        known: Sequence[CompiledProblem | None] = [None] * len(phases)
        if like is not None:
            known = like.parts
        self.parts: tuple[CompiledProblem, ...] = tuple(
            CompiledProblem(own, threads, part) for own, part in zip(phases, known, strict=True)
        )
        for k, part in enumerate(self.parts):
            if part.plan.extra or part.plan.extra_rows:
                raise ProblemError(f"phase {k} has unknowns beside its nodes, must have none")
        first, self.first_steps = self.parts[0], self.problems[0].first_steps
        shares = np.stack([one.shares for one in self.problems])
        for part, share in zip(self.parts, shares.T, strict=True):
            part.q[:, :, _shared(part)] *= share[:, None, None]
        self.retime()
        self.batch, self.K, self.steps = first.batch, self.first_steps[-1], self.first_steps[-1]
        self.nc, self.ma, self.n, self.m = first.nc, first.ma, first.n, first.m
        self.weight, self.threads = first.weight, first.threads

    def retime(self) -> None:
        """Join the phases by the dt that they have now; what E of each counts with stays."""
        dt = np.array([part.p[:, part.dynamics.layout.index("dt")] for part in self.parts])
        self.ratios = np.concatenate([np.ones_like(dt[:1]), dt[1:] / dt[:-1]])

    def take(self, members: NDArray) -> PhasedProblem:
        """Some members, by index; everything generated is shared."""
        made: PhasedProblem = object.__new__(PhasedProblem)
        made.__dict__.update(self.__dict__)
        made.problems = tuple(self.problems[int(k)] for k in members)
        made.parts = tuple(part.take(members) for part in self.parts)
        made.ratios, made.batch = self.ratios[:, members], len(members)
        return made

    def check_squares(
        self, solver: str, bounds: bool = False, timed: bool = False, arrays: bool = False
    ) -> None:
        """As that of a CompiledProblem."""
        for part in self.parts:
            part.check_squares(solver, bounds, timed, arrays)

    def prepare(self) -> None:
        """Generate and compile what is not there yet: set-up, not solving."""
        for part in self.parts:
            part.prepare()

    # -- what phases have of the whole -------------------------------------------------------------

    def _steps(self, k: int) -> slice:
        """Phase k's own steps, and the units of their newest nodes."""
        return slice(self.first_steps[k], self.first_steps[k + 1])

    def _units(self, k: int) -> slice:
        """Phase k's units: its own nodes, behind the last two of the phase before."""
        own = self._steps(k)
        return slice(own.start - BEFORE, own.stop) if k else own

    def _own(self, k: int, values: Array) -> Array:
        """Phase k's unknowns, or a step of them, of those of the whole (batch, K, n)."""
        own = values[:, self._units(k)]
        return joint.begun(self.ratios[k], own) if k else np.ascontiguousarray(own)

    def _rows(self, k: int, values: Array, width: int) -> Array:
        """Phase k's part (batch, its steps, width) of a table by step."""
        return np.ascontiguousarray(values[:, self._steps(k), :width])

    def _tables(self, tables: Iterable[Array], fill: float = 0.0) -> Array:
        """The phases' tables by step as one, as wide as the widest."""
        parts = list(tables)
        widest = max(part.shape[2] for part in parts)
        made = np.full((self.batch, self.steps, widest), fill)
        for k, part in enumerate(parts):
            made[:, self._steps(k), : part.shape[2]] = part
        return made

    def evaluations(self, at: Evaluation) -> list[Evaluation]:
        """An iterate as each phase sees it; the summary is still that of the whole."""
        made = []
        for k, part in enumerate(self.parts):
            unknowns, own = self._own(k, at.unknowns), self._steps(k)
            nodes = at.nodes[:, own.start : own.stop + BEFORE]
            if k:
                nodes = joint.begun(self.ratios[k], nodes)
            widths = (self.n, len(part.functions.references.terms), len(part.functions.bounded))
            tables = zip((at.fd, at.terms, at.rows), widths, strict=True)
            rows = at.C[:, self._units(k)].copy()
            rows[:, : part.K - part.steps] = 0.0
            fd, terms, bounded = (self._rows(k, table, width) for table, width in tables)
            made.append(Evaluation(unknowns, nodes, fd, terms, bounded, rows, at.summary))
        return made

    # -- what a solver calls -----------------------------------------------------------------------

    def unknowns(self, nodes: Array) -> Array:
        """(batch, K, nc) unknowns of a trajectory (batch, N+2, n); the pinned ones are zero."""
        unknowns = np.array(nodes[:, 2:], dtype=float)
        last = self.parts[-1]
        unknowns[:, last.fixed + self.K - last.K] = 0.0
        return unknowns

    def evaluate(self, unknowns: Array) -> Evaluation:
        """E and C at ``unknowns`` (batch, K, nc)."""
        found = [part.evaluate(self._own(k, unknowns)) for k, part in enumerate(self.parts)]
        own = [slice(BEFORE if k else 0, None) for k in range(len(found))]
        pairs = list(zip(found, own, strict=True))
        nodes = np.concatenate([at.nodes[:, units] for at, units in pairs], axis=1)
        C = np.concatenate([at.C[:, units] for at, units in pairs], axis=1)
        fd = np.concatenate([at.fd for at in found], axis=1)
        terms, rows = self._tables(at.terms for at in found), self._tables(at.rows for at in found)
        return Evaluation.of(unknowns, nodes, fd, terms, rows, C)

    def term_values(self, at: Evaluation) -> Array:
        """(batch, terms of all phases) the parts of E, one phase after the other."""
        pairs = zip(self.parts, self.evaluations(at), strict=True)
        return np.concatenate([part.term_values(own) for part, own in pairs], axis=1)

    def gradient(self, at: Evaluation) -> tuple[Array, Array]:
        """∇E (batch, K, nc) and A = ∂C/∂v (batch, K, 3, ma, nc) at an evaluated iterate, without
        second derivatives."""
        A, b = np.empty((self.batch, self.K, 3, self.ma, self.nc)), np.empty(at.unknowns.shape)
        for k, (part, own) in enumerate(zip(self.parts, self.evaluations(at), strict=True)):
            slopes, rows = part.gradient(own)
            self._join_first_order(k, slopes, rows, A, b)
        return b, A

    def linearize(
        self, at: Evaluation, lam: Array | None, curved: NDArray[np.bool_] | None = None
    ) -> Model:
        """Eq. 9 at an evaluated iterate: as that of a CompiledProblem."""
        shape = (self.batch, self.K)
        H = np.empty((*shape, 3, self.nc, self.nc))
        A, b = np.empty((*shape, 3, self.ma, self.nc)), np.empty((*shape, self.nc))
        kept = []
        for k, (part, own) in enumerate(zip(self.parts, self.evaluations(at), strict=True)):
            model = part.linearize(own, None if lam is None else lam[:, self._units(k)], curved)
            if k:
                joint.of_hessian(self.ratios[k], model.H)
            self._join(k, model.H, H)
            self._join_first_order(k, model.b, model.A, A, b)
            kept.append(np.zeros((self.batch, part.steps, 0)) if model.R is None else model.R)
        R = self._tables(kept) if any(part.size for part in kept) else None
        return Model(H, A, b, at.C.copy(), R)

    def _join(self, k: int, own: Array, whole: Array) -> None:
        """Put phase k's units behind those of the phases before, in ``whole`` (batch, K, …); what
        it has on the last two of these is added."""
        first = self.first_steps[k]
        whole[:, self._steps(k)] = own[:, BEFORE if k else 0 :]
        if k:
            whole[:, first - BEFORE : first] += own[:, :BEFORE]

    def _join_first_order(self, k: int, slopes: Array, rows: Array, A: Array, b: Array) -> None:
        """The same of phase k's ∇E and ∂C/∂v, which it gives up."""
        if k:
            joint.pulled(self.ratios[k], slopes)
            joint.of_rows(self.ratios[k], rows)
        self._join(k, slopes, b)
        self._join(k, rows, A)

    # -- rows with bounds --------------------------------------------------------------------------

    @property
    def row_bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds (batch, N, rows) of the bounded rows; a phase that has fewer of
        them than another has no bounds in the others."""
        low = self._tables((part.lower for part in self.parts), -np.inf)
        return low, self._tables((part.upper for part in self.parts), np.inf)

    def set_row_weights(
        self, weights: Array, shifts: Array, multipliers: Array | None = None
    ) -> None:
        """What the bounded rows add to the model from now on: as that of a CompiledProblem."""
        for k, part in enumerate(self.parts):
            given = [values for values in (weights, shifts, multipliers) if values is not None]
            width = len(part.functions.bounded)
            part.set_row_weights(*(self._rows(k, values, width) for values in given))

    def row_products(self, model: Model, delta: Array) -> Array:
        """R Δ (batch, N, rows): how the bounded rows change along a step of the unknowns."""
        pairs = enumerate(self._models(model))
        return self._tables(
            self.parts[k].row_products(own, self._own(k, delta)) for k, own in pairs
        )

    def row_forces(self, model: Model, weights: Array) -> Array:
        """Rᵀ w (batch, K, nc): what ``weights`` w (batch, N, rows) are on the unknowns."""
        forces = np.empty((self.batch, self.K, self.nc))
        for k, own in enumerate(self._models(model)):
            part = self.parts[k]
            made = part.row_forces(own, self._rows(k, weights, len(part.functions.bounded)))
            if k:
                joint.pulled(self.ratios[k], made)
            self._join(k, made, forces)
        return forces

    def _models(self, model: Model) -> list[Model]:
        """With the slopes of each phase's bounded rows."""
        made = []
        for k, part in enumerate(self.parts):
            own, kept = None, part.program.kept
            if kept is not None and model.R is not None:
                own = self._rows(k, model.R, kept.size)
            made.append(replace(model, R=own))
        return made


def _shared(part: CompiledProblem) -> list[int]:
    """The costs of a phase that are means over its time, by their place in q."""
    costs = part.problems[0].costs
    return [k for k, term in enumerate(costs) if not isinstance(term, Duration)]


Compiled = CompiledProblem | PhasedProblem


def parts_of(compiled: Compiled) -> tuple[CompiledProblem, ...]:
    """The phases of a batch, or the batch itself."""
    return compiled.parts if isinstance(compiled, PhasedProblem) else (compiled,)


def compiled_of(
    problems: Sequence[Described], threads: int = 1, like: Compiled | None = None
) -> Compiled:
    """A batch of problems, or of phases, of one structure; ``like`` another one of the same.

    Raises
    ------
    OctoError: they differ in more than numbers.
    """
    plain = [one for one in problems if isinstance(one, Problem)]
    joined = [one for one in problems if isinstance(one, Phases)]
    if plain and joined:
        raise ProblemError("problems and phases cannot be solved as one batch: solve them apart")
    if joined:
        return PhasedProblem(joined, threads, like if isinstance(like, PhasedProblem) else None)
    return CompiledProblem(plain, threads, like if isinstance(like, CompiledProblem) else None)


def check_all_alike(problems: Sequence[Described]) -> None:
    """Refuse a batch of problems, or of phases, that differ in more than numbers.

    Raises
    ------
    OctoError: naming what differs.
    """
    plain = [one for one in problems if isinstance(one, Problem)]
    joined = [one for one in problems if isinstance(one, Phases)]
    if plain and joined:
        raise ProblemError("problems and phases cannot be solved as one batch: solve them apart")
    if plain:
        check_alike(plain)
    counts = {len(one.problems) for one in joined}
    if len(counts) > 1:
        raise ProblemError(
            f"one of a batch has {min(counts)} phases and another {max(counts)}, must have as many"
        )
    for own in zip(*(one.problems for one in joined), strict=True):
        check_alike(own)
