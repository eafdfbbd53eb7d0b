"""Free time: the duration of a motion is an unknown of its problem, beside its configurations.

dt is a run-time parameter, one number for all steps, or for those of a phase. So that the KKT
matrix stays block-tridiagonal each unit has a copy of τ = log(dt/dt_0) behind its other unknowns,
and one more row, τ_k = τ_{k−1}. These rows are linear and hold at the start, so that all copies
move as one: of d²L/dτ² and of d²L/dτ dv only the sums over all units matter, and each unit takes
what stands in its own block.

Derivatives along τ are central differences of what the generated code gives (E, C and rows, and the
gradient for d²L/dτ dv): no law and no term has to know about it. They are right to 1e-9.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array
from octo.problem.block_nlp import BlockNLP
from octo.problem.compiled import CompiledProblem
from octo.problem.duration import BEYOND
from octo.problem.evaluation import Evaluation, Model
from octo.problem.phased import Compiled, PhasedProblem, compiled_of, parts_of
from octo.problem.phases import Described
from octo.solver.blocks import transposed_times
from octo.solver.clocks import Clock, with_times

# of τ, the step of the differences. Numbers go like τ⁻⁴ at most, so that its square is the error;
# terms may turn sharply (a joint's power where it changes its sign): with 5e-4 they stalled
STEP = 2e-5
Around = tuple[Evaluation, Evaluation]
Weights = tuple[Array, Array, Array]  # D, d and y of the bounded rows


def timed(placed: BlockNLP, beyond: float = BEYOND) -> BlockNLP:
    """The batch as a solver is to see it: with the duration among its unknowns where it is free.

    beyond: times the longest, or the shortest over it: durations beyond are refused at sight.
    """
    if placed.problems[0].duration is None:  # a batch is alike in this
        return placed
    assert isinstance(placed, (CompiledProblem, PhasedProblem)), "a device refuses a free duration"
    own = placed.take(np.arange(placed.batch))  # its numbers change with dt
    clocks: list[Clock | None] = []
    for part in parts_of(own):
        free = part.problems[0].duration is not None
        clocks.append(Clock.of(part, beyond) if free else None)
    return FreeTime(own, tuple(clocks))


@dataclass(eq=False)
class TimedModel(Model):
    """With the slopes (phases, batch, N, rows) of the bounded rows along each τ."""

    along: Array | None = None


class FreeTime:
    """A batch as a :class:`~octo.problem.block_nlp.BlockNLP` whose units have a copy of τ as their
    last unknown, and a row that ties it to the one before as their last row.

    Parameters
    ----------
    inner: the same with a fixed duration; its dt is changed in place. clocks: of each phase, or of
        the one problem; None of a phase whose duration is fixed.
    """

    def __init__(
        self, inner: Compiled, clocks: tuple[Clock | None, ...], weights: Weights | None = None
    ):
        self.inner, self.clocks, self._weights = inner, clocks, weights
        self.batch, self.K, self.steps, self.n = inner.batch, inner.K, inner.steps, inner.n
        self.nc, self.ma, self.m = inner.nc + 1, inner.ma + 1, inner.m
        self.weight, self.threads = inner.weight, inner.threads
        self.problems: tuple[Described, ...] = tuple(inner.problems)
        # the units with copies of each τ; a last unit that is no unknown at all has none
        if isinstance(inner, PhasedProblem):
            self.units = [slice(a, b) for a, b in pairwise(inner.first_steps)]
        else:
            self.units = [slice(0, inner.K - int(inner.plan.carries_rows))]
        self.free = [k for k, clock in enumerate(clocks) if clock is not None]

    def take(self, members: Any) -> FreeTime:
        """A batch of some members, by index."""
        own = self._weights
        weights = None if own is None else (own[0][members], own[1][members], own[2][members])
        clocks = (None if clock is None else clock.select(members) for clock in self.clocks)
        return FreeTime(self.inner.take(members), tuple(clocks), weights)

    def dt(self, unknowns: Array) -> Array:
        """(phases, batch) s, of unknowns (batch, K, nc)."""
        made = np.array([[one.dt for one in part.problems] for part in parts_of(self.inner)])
        for k, clock, tau in self._taus(self._tau(unknowns)):
            made[k] = clock.dt_at(tau)
        return made

    def _tau(self, unknowns: Array) -> Array:
        """(phases, batch) τ, or a step of it; zero where it is fixed."""
        made = np.zeros((len(self.clocks), self.batch))
        for k in self.free:
            made[k] = unknowns[:, self.units[k], -1].mean(axis=1)
        return made

    def _taus(self, tau: Array) -> list[tuple[int, Clock, Array]]:
        """Of each free phase its number, clock and τ (batch,)."""
        own = enumerate(zip(self.clocks, tau, strict=True))
        return [(k, clock, each) for k, (clock, each) in own if clock is not None]

    def _set(self, tau: Array) -> None:
        """Give all phases their dt."""
        parts = parts_of(self.inner)
        for k, clock, own in self._taus(tau):
            place = parts[k].dynamics.layout.index("dt")
            clock.put(parts[k].data, place, clock.dt_at(own))
        if isinstance(self.inner, PhasedProblem):
            self.inner.retime()

    def widened(self, lam: Array | None) -> Array | None:
        """Multipliers of the batch with a fixed duration, with those of the rows that tie the
        copies."""
        return None if lam is None else np.pad(lam, ((0, 0), (0, 0), (0, 1)))

    def ended(self, at: Evaluation) -> tuple[Compiled, Evaluation]:
        """The batch with the durations of an iterate, now fixed numbers, and the iterate there."""
        dt = self.dt(at.unknowns)
        problems = [with_times(one, dt[:, k]) for k, one in enumerate(self.problems)]
        compiled = compiled_of(problems, self.threads, like=self.inner)
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
        tau, wild = self._tau(unknowns), np.zeros(self.batch, dtype=bool)
        for _, clock, own in self._taus(tau):
            dt = clock.dt_at(own)
            wild |= (dt < clock.shortest) | (dt > clock.longest)
        self._set(tau)
        at = self.inner.evaluate(np.ascontiguousarray(unknowns[..., :-1]))
        C = np.pad(at.C, ((0, 0), (0, 0), (0, 1)))
        C[wild] = np.inf  # no step leads there
        for k in self.free:
            units = self.units[k]
            C[:, units.start + 1 : units.stop, -1] = np.diff(unknowns[:, units, -1], axis=1)
        return Evaluation.of(unknowns, at.nodes, at.fd, at.terms, at.rows, C)

    def term_values(self, at: Evaluation) -> Array:
        """(batch, terms) the parts of E."""
        return self.inner.term_values(self._inside(at))

    def gradient(self, at: Evaluation) -> tuple[Array, Array]:
        """As :meth:`CompiledProblem.gradient`."""
        tau = self._tau(at.unknowns)
        around = [self._around(at, tau, k) for k in self.free]
        self._set(tau)
        b, A = self.inner.gradient(self._inside(at))
        return self._with_tau(b, [self._along(own)[0] for own in around]), self._rows(A, around)

    def linearize(
        self, at: Evaluation, lam: Array | None, curved: NDArray[np.bool_] | None = None
    ) -> Model:
        """As :meth:`CompiledProblem.linearize`, with exact second derivatives along τ."""
        inside, tau = self._inside(at), self._tau(at.unknowns)
        own = None if lam is None else np.ascontiguousarray(lam[..., :-1])
        around = [self._around(at, tau, k) for k in self.free]
        pairs = zip(self.free, around, strict=True)
        cross = [self._cross(tau, own, k, sides) for k, sides in pairs]
        self._set(tau)
        model = self.inner.linearize(inside, own, curved)
        slopes, along = zip(*(self._along(sides) for sides in around), strict=True)
        H = np.zeros((self.batch, self.K, 3, self.nc, self.nc))
        H[..., :-1, :-1] = model.H
        H[:, :, 0, -1, -1] = 1.0
        middle = self._lagrangian(inside, own)
        beside = [[self._lagrangian(each, own) for each in sides] for sides in around]
        for k, own_cross, rows, (before, after) in zip(
            self.free, cross, along, beside, strict=True
        ):
            bend = ((after - middle) - (middle - before)) / STEP**2
            if self._weights is not None:
                weighted = self._weights[0] * rows
                own_cross = own_cross + self.inner.row_forces(model, weighted)
                bend = bend + (weighted * rows).sum(axis=(1, 2))
            self._bend(k, bend, own_cross, H)
        for j, (k, behind) in enumerate(pairwise(self.free)):
            if behind == k + 1:  # its first steps look back at phase k
                values = [*self._corners(at, tau, own, k), 2.0 * middle]
                values += [-each for sides in beside[j : j + 2] for each in sides]
                twist = np.stack(values).sum(axis=0) / (2.0 * STEP**2)
                if self._weights is not None:
                    twist = twist + (self._weights[0] * along[j] * along[j + 1]).sum(axis=(1, 2))
                H[:, self.units[k].stop, 1, -1, -1] = twist
        b, A = self._with_tau(model.b, list(slopes)), self._rows(model.A, around)
        return TimedModel(H, A, b, at.C, model.R, np.stack(along))

    def row_products(self, model: Model, delta: Array) -> Array:
        """As :meth:`CompiledProblem.row_products`."""
        products = self.inner.row_products(model, np.ascontiguousarray(delta[..., :-1]))
        assert isinstance(model, TimedModel) and model.along is not None
        for tau, rows in zip(self._tau(delta)[self.free], model.along, strict=True):
            products = products + rows * tau[:, None, None]
        return products

    def row_forces(self, model: Model, weights: Array) -> Array:
        """As :meth:`CompiledProblem.row_forces`."""
        assert isinstance(model, TimedModel) and model.along is not None
        forces = self.inner.row_forces(model, weights)
        return self._with_tau(forces, [(weights * rows).sum(axis=(1, 2)) for rows in model.along])

    # -- along τ -----------------------------------------------------------------------------------

    def _inside(self, at: Evaluation) -> Evaluation:
        """The iterate as the batch with a fixed duration sees it."""
        unknowns, C = (np.ascontiguousarray(a[..., :-1]) for a in (at.unknowns, at.C))
        return Evaluation(unknowns, at.nodes, at.fd, at.terms, at.rows, C, at.summary)

    def _at(self, at: Evaluation, tau: Array, *moved: tuple[int, float]) -> Evaluation:
        """The same configurations where some phases' τ are ``moved``."""
        other = tau.copy()
        for k, by in moved:
            other[k] += by
        self._set(other)
        return self.inner.evaluate(np.ascontiguousarray(at.unknowns[..., :-1]))

    def _around(self, at: Evaluation, tau: Array, k: int) -> Around:
        """The same configurations a step to both sides of phase k's τ."""
        return self._at(at, tau, (k, -STEP)), self._at(at, tau, (k, STEP))

    def _cross(self, tau: Array, lam: Array | None, k: int, around: Around) -> Array:
        """(batch, K, nc − 1) d/dτ of ∇E + Aᵀlam + Rᵀy over the other unknowns."""
        if self._weights is not None:
            D, _, y = self._weights
            self.inner.set_row_weights(D, y)
        sides = []
        for side, each in zip((-STEP, STEP), around, strict=True):
            other = tau.copy()
            other[k] += side
            self._set(other)
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
        before, after = around
        slope = _slope(before.terms, after.terms).sum(axis=(1, 2))
        rows = _slope(before.rows, after.rows)
        if self._weights is not None:
            D, d, _ = self._weights
            rows = np.where(D != 0.0, rows, 0.0)
            slope = slope + (d * rows).sum(axis=(1, 2))
        return slope, rows

    def _corners(self, at: Evaluation, tau: Array, lam: Array | None, k: int) -> list[Array]:
        """(batch,) E + lamᵀC + yᵀr where τ of phase k and of the one behind it are both a step
        more, and both a step less."""
        sides = (((k, step), (k + 1, step)) for step in (STEP, -STEP))
        return [self._lagrangian(self._at(at, tau, *moved), lam) for moved in sides]

    # -- where it stands in the blocks -------------------------------------------------------------

    def _with_tau(self, values: Array, along: list[Array]) -> Array:
        """(batch, K, nc) of values of the other unknowns, and of each τ (batch,), shared out over
        its copies."""
        made = np.pad(values, ((0, 0), (0, 0), (0, 1)))
        for k, own in zip(self.free, along, strict=True):
            units = self.units[k]
            made[:, units, -1] = own[:, None] / (units.stop - units.start)
        return made

    def _bend(self, k: int, bend: Array, cross: Array, H: Array) -> None:
        """d²L/dτ² (batch,), shared out over the copies, and d²L/dτ dv (batch, K, nc − 1), with the
        copy in the same unit; what the phases beside see of it with the copy that is nearest."""
        units = self.units[k]
        first, end = units.start, units.stop
        H[:, units, 0, -1, -1] = bend[:, None] / (end - first)
        H[:, units, 0, -1, :-1] = H[:, units, 0, :-1, -1] = cross[:, units]
        for lag in range(1, 3):
            if first >= lag:
                H[:, first, lag, -1, :-1] = cross[:, first - lag]
            if end - 1 + lag < self.K:
                H[:, end - 1 + lag, lag, :-1, -1] = cross[:, end - 1 + lag]

    def _rows(self, A: Array, around: list[Around]) -> Array:
        """(batch, K, 3, ma, nc) with dC/dτ, and the rows that tie the copies of τ."""
        made = np.zeros((self.batch, self.K, 3, self.ma, self.nc))
        made[..., :-1, :-1] = A
        for k, (before, after) in zip(self.free, around, strict=True):
            along, units = _slope(before.C, after.C), self.units[k]
            first, end = units.start, units.stop
            made[:, units, 0, :-1, -1] = along[:, units]
            if end < self.K:  # a unit without a copy of this τ looks at the one before it
                made[:, end, 1, :-1, -1] = along[:, end]
            made[:, first + 1 : end, 0, -1, -1], made[:, first + 1 : end, 1, -1, -1] = 1.0, -1.0
        return made


def _slope(before: Array, after: Array) -> Array:
    """Along τ, of values a step to both sides."""
    return np.asarray((after - before) / (2.0 * STEP))
