"""Free time: the duration of a motion is an unknown of its problem, beside its configurations.

dt is a run-time parameter, one number for all steps. So that the KKT matrix stays block-tridiagonal
each unit has a copy of τ = log(dt/dt_0) behind its other unknowns, and one more row, τ_k = τ_{k−1}.
These rows are linear and hold at the start, so that all copies move as one: of d²L/dτ² and of
d²L/dτ dv only the sums over all units matter, and each unit takes what stands in its own block.

Derivatives along τ are central differences of what the generated code gives (E, C and rows, and the
gradient for d²L/dτ dv): no law and no term has to know about it. They are right to 1e-9.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array
from octo.errors import ProblemError
from octo.problem.block_nlp import BlockNLP
from octo.problem.compiled import CompiledProblem
from octo.problem.data import Data, lowered
from octo.problem.evaluation import Evaluation, Model
from octo.problem.problem import Problem
from octo.solver.blocks import transposed_times

# of τ, the step of the differences. Numbers go like τ⁻⁴ at most, so that its square is the error;
# terms may turn sharply (a joint's power where it changes its sign): with 5e-4 they stalled
STEP = 2e-5
BEYOND = 1.2
Around = tuple[Evaluation, Evaluation]
Weights = tuple[Array, Array, Array]  # D, d and y of the bounded rows


def timed(placed: BlockNLP, beyond: float = BEYOND) -> BlockNLP:
    """The batch as a solver is to see it: with the duration among its unknowns where it is free.

    beyond: times the longest, or the shortest over it: durations beyond are refused at sight.

    Raises
    ------
    ProblemError: it is free for some of the problems only.
    """
    free = [problem.duration is not None for problem in placed.problems]
    if any(free) and not all(free):
        raise ProblemError("duration must be free for every problem of a batch or for none")
    if not all(free):
        return placed
    assert isinstance(placed, CompiledProblem), "a device refuses a free duration"
    own = placed.take(np.arange(placed.batch))  # its numbers change with dt
    return FreeTime(own, Times.of(own, beyond))


def lasting(problem: Problem, dt: float) -> Problem:
    """The problem with steps of ``dt`` s, of a cycle with the period that they make."""
    if problem.cycle is None:
        return problem.replace(dt=dt)
    period = dt * int(problem.steps) * (2.0 if problem.cycle.mirrored else 1.0)
    return problem.replace(cycle=replace(problem.cycle, period=period))


@dataclass(frozen=True, eq=False)
class Times:
    """How the numbers of a batch depend on dt: all are linear in it.

    Attributes
    ----------
    dt: (batch,) s, where τ is zero. shortest, longest: (batch,) s, what is beyond is refused.
    constant, q: of :class:`~octo.problem.data.Data`, there.
    constant_slope, q_slope: by how much they grow with dt, 1/s.
    """

    dt: Array
    shortest: Array
    longest: Array
    constant: Array
    constant_slope: Array
    q: Array
    q_slope: Array

    @classmethod
    def of(cls, compiled: CompiledProblem, beyond: float) -> Times:
        """Of a batch; ``beyond`` as of :func:`timed`."""
        short = {id(one): lasting(one, 0.5 * one.dt) for one in compiled.problems}
        other = lowered([short[id(one)] for one in compiled.problems], compiled.functions)[1]
        dt, data = np.array([one.dt for one in compiled.problems]), compiled.data
        references = compiled.functions.references

        def slope(name: str) -> Array:
            change = getattr(data, name) - getattr(other, name)
            return np.asarray(change / (0.5 * dt[:, None, None]))

        q_slope = slope("q")
        # scales of terms stay, and what a solver gives the rows is not of the problem
        q_slope[:, :, : len(references.terms)] = q_slope[:, :, references.size :] = 0.0
        strides = [
            2.0 if one.closure and one.closure.mirrored else 1.0 for one in compiled.problems
        ]
        ends = np.array([one.duration for one in compiled.problems], dtype=float)
        ends /= (np.array(strides) * compiled.steps)[:, None]
        return cls(
            dt,
            ends[:, 0] / beyond,
            ends[:, 1] * beyond,
            data.constant.copy(),
            slope("constant"),
            data.q.copy(),
            q_slope,
        )

    def select(self, members: Any) -> Times:
        """Those of some members, by index."""
        return Times(*(getattr(self, field.name)[members] for field in fields(self)))

    def put(self, data: Data, place: int, dt: Array) -> None:
        """Write the numbers of steps of ``dt`` (batch,) s over those of ``data``."""
        more = (dt - self.dt)[:, None, None]
        data.p[:, place] = dt
        data.constant[...] = self.constant + more * self.constant_slope
        if self.q_slope.any():
            moved = self.q_slope != 0.0
            data.q[moved] = (self.q + more * self.q_slope)[moved]


@dataclass(eq=False)
class TimedModel(Model):
    """With the slopes (batch, N, rows) of the bounded rows along τ."""

    along: Array | None = None


class FreeTime:
    """A batch as a :class:`~octo.problem.block_nlp.BlockNLP` whose units have a copy of τ as their
    last unknown, and a row that ties it to the one before as their last row.

    Parameters
    ----------
    inner: the same with a fixed duration; its dt is changed in place. times: how.
    """

    def __init__(self, inner: CompiledProblem, times: Times, weights: Weights | None = None):
        self.inner, self.times, self._weights = inner, times, weights
        self.batch, self.K, self.steps, self.n = inner.batch, inner.K, inner.steps, inner.n
        self.nc, self.ma, self.m = inner.nc + 1, inner.ma + 1, inner.m
        self.weight, self.threads, self.q = inner.weight, inner.threads, inner.q
        self.functions, self.problems = inner.functions, inner.problems
        # a last unit that is no unknown at all has no copy
        self.units = inner.K - int(inner.plan.carries_rows)
        self._place = inner.dynamics.layout.names.index("dt")

    def take(self, members: Any) -> FreeTime:
        """A batch of some members, by index."""
        own = self._weights
        weights = None if own is None else (own[0][members], own[1][members], own[2][members])
        return FreeTime(self.inner.take(members), self.times.select(members), weights)

    def dt(self, unknowns: Array) -> Array:
        """(batch,) s, of unknowns (batch, K, nc)."""
        return self.times.dt * np.exp(self._shift(unknowns))

    def _shift(self, unknowns: Array) -> Array:
        """(batch,) τ."""
        return np.asarray(unknowns[:, : self.units, -1].mean(axis=1))

    def _set(self, shift: Array) -> None:
        self.times.put(self.inner.data, self._place, self.times.dt * np.exp(shift))

    def widened(self, lam: Array | None) -> Array | None:
        """Multipliers of the batch with a fixed duration, with those of the rows that tie the
        copies."""
        return None if lam is None else np.pad(lam, ((0, 0), (0, 0), (0, 1)))

    def ended(self, at: Evaluation) -> tuple[CompiledProblem, Evaluation]:
        """The batch with the durations of an iterate, now fixed numbers, and the iterate there."""
        found = zip(self.problems, self.dt(at.unknowns).tolist(), strict=True)
        problems = [lasting(problem, dt) for problem, dt in found]
        compiled = CompiledProblem(problems, self.threads, like=self.inner)
        return compiled, compiled.evaluate(np.ascontiguousarray(at.unknowns[..., :-1]))

    # -- what a solver calls -----------------------------------------------------------------------

    @property
    def row_bounds(self) -> tuple[Array, Array]:
        """As :attr:`CompiledProblem.row_bounds`."""
        return self.inner.row_bounds

    def set_row_weights(
        self, weights: Array, shifts: Array, multipliers: Array | None = None
    ) -> None:
        """As :meth:`CompiledProblem.set_row_weights`."""
        self._weights = (weights, shifts, shifts if multipliers is None else multipliers)
        self.inner.set_row_weights(*self._weights)

    def unknowns(self, nodes: Array) -> Array:
        """(batch, K, nc) unknowns of a trajectory (batch, N+2, n), with steps of the problems'
        dt."""
        return np.pad(self.inner.unknowns(nodes), ((0, 0), (0, 0), (0, 1)))

    def evaluate(self, unknowns: Array) -> Evaluation:
        """E and C at ``unknowns`` (batch, K, nc)."""
        own = self.times
        dt = own.dt * np.exp(np.clip(self._shift(unknowns), -700.0, 700.0))
        wild = (dt < own.shortest) | (dt > own.longest)
        self._set(self._shift(unknowns))
        at = self.inner.evaluate(np.ascontiguousarray(unknowns[..., :-1]))
        C = np.pad(at.C, ((0, 0), (0, 0), (0, 1)))
        C[wild] = np.inf  # no step leads there
        C[:, 1 : self.units, -1] = np.diff(unknowns[:, : self.units, -1], axis=1)
        return Evaluation.of(unknowns, at.nodes, at.fd, at.terms, at.rows, C)

    def term_values(self, at: Evaluation) -> Array:
        """(batch, terms) the parts of E."""
        return self.inner.term_values(at)

    def gradient(self, at: Evaluation) -> tuple[Array, Array]:
        """As :meth:`CompiledProblem.gradient`."""
        around = self._around(at)
        self._set(self._shift(at.unknowns))
        b, A = self.inner.gradient(self._inside(at))
        return self._with_tau(b, self._along(around)[0]), self._rows(A, around)

    def linearize(
        self, at: Evaluation, lam: Array | None, curved: NDArray[np.bool_] | None = None
    ) -> Model:
        """As :meth:`CompiledProblem.linearize`, with exact second derivatives along τ."""
        inside, around, shift = self._inside(at), self._around(at), self._shift(at.unknowns)
        own = None if lam is None else np.ascontiguousarray(lam[..., :-1])
        cross = self._cross(shift, own, around)
        self._set(shift)
        model = self.inner.linearize(inside, own, curved)
        slope, along = self._along(around)
        before, middle, after = (self._lagrangian(e, own) for e in (around[0], inside, around[1]))
        curvature = ((after - middle) - (middle - before)) / STEP**2
        if self._weights is not None:
            D = self._weights[0]
            cross = cross + self.inner.row_forces(model, D * along)
            curvature = curvature + (D * along**2).sum(axis=(1, 2))
        H = np.zeros((self.batch, self.K, 3, self.nc, self.nc))
        H[..., :-1, :-1] = model.H
        H[:, :, 0, -1, -1] = 1.0
        H[:, : self.units, 0, -1, -1] = curvature[:, None] / self.units
        H[:, :, 0, -1, :-1] = H[:, :, 0, :-1, -1] = cross
        b, A = self._with_tau(model.b, slope), self._rows(model.A, around)
        return TimedModel(H, A, b, at.C, model.R, along)

    def row_products(self, model: Model, delta: Array) -> Array:
        """As :meth:`CompiledProblem.row_products`."""
        products = self.inner.row_products(model, np.ascontiguousarray(delta[..., :-1]))
        assert isinstance(model, TimedModel) and model.along is not None
        return np.asarray(products + model.along * self._shift(delta)[:, None, None])

    def row_forces(self, model: Model, weights: Array) -> Array:
        """As :meth:`CompiledProblem.row_forces`."""
        assert isinstance(model, TimedModel) and model.along is not None
        forces = self.inner.row_forces(model, weights)
        return self._with_tau(forces, (weights * model.along).sum(axis=(1, 2)))

    # -- along τ -----------------------------------------------------------------------------------

    def _inside(self, at: Evaluation) -> Evaluation:
        """The iterate as the batch with a fixed duration sees it."""
        unknowns, C = (np.ascontiguousarray(a[..., :-1]) for a in (at.unknowns, at.C))
        return Evaluation(unknowns, at.nodes, at.fd, at.terms, at.rows, C, at.summary)

    def _around(self, at: Evaluation) -> Around:
        """The same configurations a step to both sides of τ."""
        unknowns, shift = np.ascontiguousarray(at.unknowns[..., :-1]), self._shift(at.unknowns)
        made = []
        for side in (-STEP, STEP):
            self._set(shift + side)
            made.append(self.inner.evaluate(unknowns))
        return made[0], made[1]

    def _cross(self, shift: Array, lam: Array | None, around: Around) -> Array:
        """(batch, K, nc − 1) d/dτ of ∇E + Aᵀlam + Rᵀy over the other unknowns."""
        if self._weights is not None:
            D, _, y = self._weights
            self.inner.set_row_weights(D, y)
        sides = []
        for side, each in zip((-STEP, STEP), around, strict=True):
            self._set(shift + side)
            b, A = self.inner.gradient(each)
            sides.append(b if lam is None else b + transposed_times(A, lam))
        if self._weights is not None:
            self.inner.set_row_weights(*self._weights)
        return _slope(sides[0], sides[1])

    def _lagrangian(self, at: Evaluation, lam: Array | None) -> Array:
        """(batch,) E + lamᵀC + yᵀr."""
        total = at.terms.sum(axis=(1, 2))
        if lam is not None:
            total = total + (lam * at.C).sum(axis=(1, 2))
        if self._weights is not None:
            D, _, y = self._weights
            total = total + (y * np.where(D != 0.0, at.rows, 0.0)).sum(axis=(1, 2))
        return np.asarray(total)

    def _along(self, around: Around) -> tuple[Array, Array]:
        """(batch,) d/dτ of E and of the rows with their shifts; (batch, N, rows) of the rows."""
        slope, rows = (
            _slope(getattr(around[0], n), getattr(around[1], n)) for n in ("terms", "rows")
        )
        slope = slope.sum(axis=(1, 2))
        if self._weights is not None:
            D, d, _ = self._weights
            rows = np.where(D != 0.0, rows, 0.0)
            slope = slope + (d * rows).sum(axis=(1, 2))
        return slope, rows

    def _with_tau(self, values: Array, along: Array) -> Array:
        """(batch, K, nc) of values of the other unknowns, and (batch,) along τ shared out over its
        copies."""
        made = np.pad(values, ((0, 0), (0, 0), (0, 1)))
        made[:, : self.units, -1] = along[:, None] / self.units
        return made

    def _rows(self, A: Array, around: Around) -> Array:
        """(batch, K, 3, ma, nc) with dC/dτ, and the rows that tie the copies of τ."""
        made = np.zeros((self.batch, self.K, 3, self.ma, self.nc))
        made[..., :-1, :-1] = A
        along, last = _slope(around[0].C, around[1].C), self.units
        made[:, :last, 0, :-1, -1] = along[:, :last]
        made[:, last:, 1, :-1, -1] = along[:, last:]  # its own unit has no copy
        made[:, 1:last, 0, -1, -1], made[:, 1:last, 1, -1, -1] = 1.0, -1.0
        return made


def _slope(before: Array, after: Array) -> Array:
    """Along τ, of values a step to both sides."""
    return np.asarray((after - before) / (2.0 * STEP))
