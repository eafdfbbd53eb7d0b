"""Bounds on rows, lower ≤ r(v) ≤ upper, by a primal-dual interior point on the blocks of Eq. 12.

Slacks s stand strictly inside the bounds; of

    min E(v) − μ Σ log(s − lower) − μ Σ log(upper − s)   subject to   C(v) = 0,  r(v) = s

Newton's step, with slacks and multipliers z of the bounds eliminated, is Eq. 12 with weights and
shifts of the rows (``CompiledProblem.set_row_weights``):

    D = z_l/(s − lower) + z_u/(upper − s)        d = D (r − s) − μ/(s − lower) + μ/(upper − s)
    Δs = R Δ + r − s                             Δz_l = (μ − z_l Δs)/(s − lower) − z_l, Δz_u alike

(Wächter and Biegler 2006, §2; Nocedal and Wright, §19.3). Where both bounds are equal the row is a
constraint: D = 1/δ and d = y + r/δ make its Newton step, of the KKT matrix with −δ in the place of
its zero. The pattern of H, the inertia test and the filter stay what they are without bounds: the
filter sees the barrier's E and, beside ‖C‖₁, ‖r − s‖₁.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from octo.arrays import Array, Numbers, array_module, host, largest, like, some
from octo.problem.block_nlp import BlockNLP
from octo.problem.evaluation import Evaluation, Model
from octo.solver.blocks import KKTBlocks

INSIDE = 1e-2  # of the room between two bounds, or of max(1, |bound|): how far a slack starts from it
TO_THE_BOUNDARY = 0.99  # of the way, at least, that a step may go
MODE = [0, 0]
LEAST = 1e-8
EQUAL = 1e-7  # δ of rows whose bounds are equal
LINEAR, POWER = 0.2, 1.5  # μ falls to the smaller one of LINEAR μ and μ^POWER …
ERROR = 10.0  # … where the errors of the barrier's problem are below so many μ
SAFEGUARD = 1e10  # by which a multiplier may differ from μ/(s − bound)


@dataclass(eq=False)
class Slacks:
    """Of one iterate, (batch, N, rows) each: slacks s of bounded rows, multipliers of the lower and
    of the upper bound, and of equalities; zero where a row has none."""

    s: Array
    lower: Array
    upper: Array
    equal: Array

    def select(self, members: Any) -> Slacks:
        return Slacks(self.s[members], self.lower[members], self.upper[members], self.equal[members])


class Barrier:
    """Slacks and multipliers of a batch, and the weight μ (batch,) of each member's barrier.

    Parameters
    ----------
    lower, upper: (batch, N, rows), ±inf where there is no bound.
    rows: (batch, N, rows) where the solve begins.
    start, end: the first and the last μ times N: a mean over the steps, as the terms of E are.
    """

    def __init__(self, lower: Array, upper: Array, rows: Array, start: float, end: float):
        xp = array_module(rows)
        self.equal = lower == upper
        self.low = xp.isfinite(lower) & ~self.equal
        self.high = xp.isfinite(upper) & ~self.equal
        self.lower, self.upper = lower, upper
        steps = rows.shape[1]
        self.mu, self.last = np.full(len(rows), start / steps), end / steps
        s = self._inside(rows)
        below, above = self._gaps(s)
        mu = self._own(rows)
        self.slacks = Slacks(
            s,
            xp.where(self.low, mu / below, 0.0),
            xp.where(self.high, mu / above, 0.0),
            xp.zeros_like(rows),
        )

    @classmethod
    def of(cls, problem: BlockNLP, at: Evaluation) -> Barrier | None:
        """Of a problem whose rows have bounds; None of another."""
        bounds = getattr(problem, "bounds", None)
        return None if bounds is None else cls(*bounds, at.rows, 0.1, 1e-6)

    def _own(self, rows: Array) -> Array:
        """μ as (batch, 1, 1)."""
        return like(self.mu.reshape(-1, 1, 1), rows)

    def _inside(self, rows: Array) -> Array:
        """Slacks strictly inside the bounds, near ``rows`` (Wächter and Biegler 2006, §3.6)."""
        xp = array_module(rows)
        room = xp.where(self.low & self.high, self.upper - self.lower, np.inf)
        lower, upper = xp.where(self.low, self.lower, 0.0), xp.where(self.high, self.upper, 0.0)
        least = xp.where(
            self.low, lower + xp.minimum(INSIDE * xp.maximum(1.0, abs(lower)), INSIDE * room), -np.inf
        )
        most = xp.where(
            self.high, upper - xp.minimum(INSIDE * xp.maximum(1.0, abs(upper)), INSIDE * room), np.inf
        )
        return xp.where(self.equal, lower * 0.0, xp.clip(rows, least, most))

    def _gaps(self, s: Array) -> tuple[Array, Array]:
        """s − lower and upper − s, 1 where there is no bound."""
        xp = array_module(s)
        return (
            xp.where(self.low, s - self.lower, 1.0),
            xp.where(self.high, self.upper - s, 1.0),
        )

    def residual(self, rows: Array, s: Array) -> Array:
        """r − s of bounded rows, r − bound of equalities, 0 of rows without a bound."""
        xp = array_module(rows)
        to = xp.where(self.equal, xp.where(self.equal, self.lower, 0.0), s)
        return xp.where(self.equal | self.low | self.high, rows - to, 0.0)

    def weights(self, rows: Array) -> tuple[Array, Array, Array]:
        """D, d and multipliers of the rows at an iterate with the values ``rows``."""
        xp, own, mu = array_module(rows), self.slacks, self._own(rows)
        below, above = self._gaps(own.s)
        residual = self.residual(rows, own.s)
        weight = xp.where(self.equal, 1.0 / EQUAL, own.lower / below + own.upper / above)
        force = xp.where(self.high, mu / above, 0.0) - xp.where(self.low, mu / below, 0.0)
        multipliers = own.equal + own.upper - own.lower
        return weight, weight * residual + force + own.equal, multipliers

    def slack(self, rows: Array, before: Array, length: Numbers | float) -> Array:
        """s at a trial with the values ``rows``, after a step of ``length`` (batch,) in (0, 1]: it
        leaves the other part of the residual at the iterate with the values ``before``."""
        xp, s = array_module(rows), self.slacks.s
        rest = np.broadcast_to(1.0 - np.minimum(length, 1.0), len(rows)).reshape(-1, 1, 1)
        left = like(rest, rows) * self.residual(before, s)
        return xp.clip(rows - left, *self._box())

    def _box(self) -> tuple[Array, Array]:
        """Between what the next slacks may be."""
        xp = array_module(self.slacks.s)
        below, above = self._gaps(self.slacks.s)
        part = 1.0 - TO_THE_BOUNDARY
        least = xp.where(self.low, self.lower + xp.maximum(part * below, LEAST), -np.inf)
        most = xp.where(self.high, self.upper - xp.maximum(part * above, LEAST), np.inf)
        return least, most

    def seen(self, at: Evaluation, s: Array) -> Evaluation:
        """An iterate with slacks ``s`` as the filter sees it: E with its barrier, ‖C‖ with the
        residuals of the rows."""
        xp = array_module(at.rows)
        below, above = self._gaps(s)
        size = abs(self.residual(at.rows, s)).reshape(len(s), -1)
        logs = (xp.log(below) + xp.log(above)).reshape(len(s), -1).sum(axis=1)
        summary = at.summary.copy()
        summary[:, 0] = at.terms.sum(axis=(1, 2)) - like(self.mu, logs) * logs
        summary[:, 1] = abs(at.C).reshape(len(s), -1).sum(axis=1) + size.sum(axis=1)
        summary[:, 2] = xp.maximum(
            abs(at.C).reshape(len(s), -1).max(axis=1, initial=0.0), size.max(axis=1)
        )
        summary[:, 3] = (at.C**2).reshape(len(s), -1).sum(axis=1) + (size**2).sum(axis=1)
        return replace(at, summary=summary)

    def aimed(
        self, problem: BlockNLP, at: Evaluation, lam: Array, model: Model, blocks: KKTBlocks
    ) -> tuple[Evaluation, Model, Numbers]:
        """The iterate and the model with the μ of the next step, and ‖∇E + Aᵀlam + Rᵀz‖∞."""
        xp, steps = array_module(at.rows), at.rows.shape[1]
        _, force, multipliers = self.weights(at.rows)
        gradient = model.b + problem.row_forces(model, multipliers - force)
        dual = host(largest(gradient + blocks.constraints_transposed_times(lam)))
        self.lowered = np.zeros(len(dual), dtype=bool)
        own, (below, above) = self.slacks, self._gaps(self.slacks.s)
        products = [xp.where(self.low, own.lower * below, np.nan), xp.where(self.high, own.upper * above, np.nan)]
        base = np.maximum(dual, at.largest)
        for _ in range(8):
            mu = self._own(at.rows)
            off = np.maximum(*(host(xp.nanmax(abs(p - mu).reshape(len(dual), -1), axis=1, initial=0.0)) for p in products))
            error = np.maximum(base, off * steps)
            lower = (error <= ERROR * self.mu * steps) & ~self.ended
            if not some(lower):
                break
            less = np.minimum(LINEAR * self.mu, (self.mu * steps) ** POWER / steps)
            self.mu = np.where(lower, np.maximum(self.last, less), self.mu)
            self.lowered |= lower
        self.off = off * steps
        if some(self.lowered):
            change = self.weights(at.rows)[1] - force
            model = replace(model, b=model.b + problem.row_forces(model, change))
            at = self.seen(at, own.s)
        return at, model, dual

    def step(self, rows: Array, products: Array) -> BarrierStep:
        """The step of slacks and multipliers that goes with R Δ ``products``."""
        xp, own, mu = array_module(rows), self.slacks, self._own(rows)
        below, above = self._gaps(own.s)
        residual = self.residual(rows, own.s)
        move = xp.where(self.low | self.high, products + residual, 0.0)
        lower = xp.where(self.low, (mu - own.lower * move) / below - own.lower, 0.0)
        upper = xp.where(self.high, (mu + own.upper * move) / above - own.upper, 0.0)
        equal = xp.where(self.equal, (products + residual) / EQUAL, 0.0)
        force = mu * (xp.where(self.high, 1.0 / above, 0.0) - xp.where(self.low, 1.0 / below, 0.0))
        # bᵀΔ has d RΔ in it
        slope = force * move - self.weights(rows)[1] * products
        return BarrierStep(
            move,
            lower,
            upper,
            equal,
            _furthest((-move / below, move / above)) if MODE[0] else np.ones(len(rows)),
            _furthest((_shrink(lower, own.lower), _shrink(upper, own.upper))) if MODE[1] else np.ones(len(rows)),
            host(slope.reshape(len(rows), -1).sum(axis=1)),
        )

    @property
    def ended(self) -> Numbers:
        """(batch,) where μ is the last one."""
        return self.mu <= self.last

    def moved(
        self,
        step: BarrierStep,
        at: Evaluation,
        after: Evaluation,
        length: Numbers,
        members: Numbers,
    ) -> Evaluation:
        """Take a step of ``length`` (batch,) of ``members`` (batch,) bool: the iterate ``after``
        it."""
        xp, own, mu = array_module(after.rows), self.slacks, self._own(after.rows)
        taken = like(members.reshape(-1, 1, 1), after.rows)
        s = xp.where(taken, self.slack(after.rows, at.rows, length), xp.clip(after.rows, *self._box()))
        below, above = self._gaps(s)

        def kept(multipliers: Array, change: Array, gap: Array, has: Array) -> Array:
            new = multipliers + xp.where(taken, like(step.dual.reshape(-1, 1, 1), s) * change, 0.0)
            new = xp.maximum(new, (1.0 - TO_THE_BOUNDARY) * multipliers)
            return xp.where(has, xp.clip(new, mu / gap / SAFEGUARD, SAFEGUARD * mu / gap), 0.0)

        self.slacks = Slacks(
            s,
            kept(own.lower, step.lower, below, self.low),
            kept(own.upper, step.upper, above, self.high),
            own.equal + xp.where(taken, like(length.reshape(-1, 1, 1), s) * step.equal, 0.0),
        )
        return self.seen(after, s)

    def complementarity(self) -> Numbers:
        """(batch,) mean of gap times multiplier over the bounds."""
        own = self.slacks
        below, above = self._gaps(own.s)
        total = (own.lower * below + own.upper * above).reshape(len(own.s), -1).sum(axis=1)
        count = (self.low.reshape(len(own.s), -1).sum(axis=1) + self.high.reshape(len(own.s), -1).sum(axis=1))
        return host(total) / np.maximum(host(count), 1)

    def take(self, members: Numbers) -> None:
        """Keep some members only."""
        for name in ("equal", "low", "high", "lower", "upper"):
            setattr(self, name, getattr(self, name)[members])
        self.mu, self.slacks = self.mu[members], self.slacks.select(members)


@dataclass(eq=False)
class BarrierStep:
    """Of slacks and multipliers, (batch, N, rows) each; how far they may go (batch,), and the
    slope of the barrier along it."""

    s: Array
    lower: Array
    upper: Array
    equal: Array
    primal: Numbers
    dual: Numbers
    slope: Numbers


def _shrink(change: Array, value: Array) -> Array:
    """By what part of itself each number falls."""
    xp = array_module(value)
    return xp.where(value > 0.0, -change / xp.where(value > 0.0, value, 1.0), 0.0)


def _furthest(parts: tuple[Array, Array]) -> Numbers:
    """(batch,) the longest step in (0, 1] with which nothing goes further than a part of the way to
    zero, ``parts`` being what a whole step goes of it."""
    most = np.maximum(*(host(p.reshape(len(p), -1).max(axis=1, initial=0.0)) for p in parts))
    return np.minimum(1.0, TO_THE_BOUNDARY / np.maximum(most, 1e-300))
