"""Rows between bounds, lower ≤ r(v) ≤ upper, by a primal-dual interior point on the blocks of
Eq. 12.

Slacks s stand strictly inside the bounds; of

    min E(v) − μ Σ log(s − lower) − μ Σ log(upper − s)   subject to   C(v) = 0,  r(v) = s

Newton's step is Eq. 12 once slacks and multipliers z of the bounds are eliminated, with weights D
and shifts d of the rows (``set_row_weights``), R = ∂r/∂v:

    D = z_l/(s − lower) + z_u/(upper − s)        d = D (r − s) − μ/(s − lower) + μ/(upper − s)
    Δs = R Δ + r − s                             Δz_l = (μ − z_l Δs)/(s − lower) − z_l, Δz_u alike

(Wächter and Biegler 2006, §2; Nocedal and Wright, §19.3). A row whose bounds are equal is a
constraint: D = 1/δ and d = y + (r − bound)/δ make its Newton step, of the KKT matrix with −δ in the
place of its zero. So the pattern of H, the inertia test and the filter stay what they are without
bounds; the filter sees E with its barrier, and ‖C‖ with the residuals of the rows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from octo.arrays import Array, Numbers, array_module, host, hosts, largest, like, some
from octo.problem.block_nlp import BlockNLP
from octo.problem.bounds import SAME as SAME_BOUND
from octo.problem.evaluation import Evaluation, Model
from octo.solver.acceptance import Mask
from octo.solver.blocks import KKTBlocks
from octo.solver.bounds import Bounds, Moved, Slacks
from octo.solver.elastic import Elastic
from octo.solver.limits import PART, Limits

# of a step, tried whatever rows it would carry beyond their bounds: there a slack stays inside and
# the filter sees what its row is off. Rows that bend (friction) say changes a hundred times too
# large, and one after the other they would shorten steps to a thousandth. Without it one of four
# walks of a mammal under all limits stalls (with it none), a cart-pole's swing-up takes 805
# iterations for 590 over 18 starts, and of eight cycles one stalls with and without it
LEAST = 0.1
# a jam, out of which an elastic phase leads: so many steps in a row that bounds would make shorter
# than that, of matrices whose weight sigma is so large; once, and only where nothing was eased
# before. A walk of 400 steps from a stand breaks no limit after 100 iterations, for one by 0.3 of a
# row. With 1 for 1e5 a phase begins in cycles and short walks too, half of which it helps; and a
# cart-pole swings up with 17 short steps in a row, of matrices whose weight is zero
JAM, HEAVY, JAMS = 10, 1e5, 1
# elastic phases of a member and the width of their prices
PHASES, WIDTH = 2, 1e-2
# one begins a solve where this part of the rows is so far from the slacks: a cart-pole's 18 swings
# from rest, of which single rows are far, take 605 iterations, for 805 if they began with one
MANY, FAR = 0.05, 0.5
SAFEGUARD = 1e10  # by which a multiplier may differ from μ/(s − bound)
EQUAL = 1e-7  # δ of rows whose bounds are equal
ROUNDED = 1e-9  # an equality missed by less is met: of δ z it is, where a multiplier moves by z
# μ falls to the smaller one of LINEAR μ and μ^POWER where errors are below so many μ (§2.1, Eq. 7)
LINEAR, POWER, ERRORS = 0.2, 1.5, 10.0
# N μ: of a start; of one with multipliers or behind an elastic phase (1e-2 there: go2 149 for 126)
FIRST, AGAIN = 1e-2, 1e-3
SAME = 1e-6  # of rows from slacks that are known: they are kept, and their μ
# N μ of an end, in parts of the dual tolerance, and of the mean of N z where that is above LARGE
# (Wächter and Biegler 2006, Eq. 6)
LAST, LARGE = 0.1, 100.0


@dataclass(frozen=True, eq=False)
class RowStep:
    """A whole step of slacks and multipliers, and the part of that of the latter (batch,)."""

    lower: Array
    upper: Array
    equal: Array
    length: Numbers


class Barrier(Bounds):
    """Slacks and multipliers of a batch.

    Parameters
    ----------
    limits: of the rows. at: where the solve begins. tolerance: of the dual infeasibility.
    slacks: of an end of another solve, for a warm start.
    """

    def __init__(
        self, limits: Limits, at: Evaluation, tolerance: float, slacks: Slacks | None = None
    ):
        xp, rows = array_module(at.rows), at.rows
        steps = rows.shape[1]
        self.limits, self._end = limits, LAST * tolerance / steps
        self.last: Numbers = np.full(len(rows), self._end)
        self._least: Numbers = np.zeros(len(rows))
        self._most: Numbers = np.zeros(len(rows))
        self._lowered = np.zeros(len(rows), dtype=bool)
        self._phases = np.zeros(len(rows), dtype=int)
        self._again = np.zeros(len(rows), dtype=bool)
        self._short = np.zeros(len(rows), dtype=bool)  # the step at hand
        self._jam = np.zeros(len(rows), dtype=int)  # short and heavy ones in a row
        own = self._first(rows) if slacks is None else self._warm(rows, slacks)
        self._placed: tuple[Numbers, Array] = (own.mu, _spread(own.mu, rows))
        self._hold(own)
        none = xp.zeros_like(rows)
        self._step = RowStep(none, none, none, np.ones(len(rows)))
        far = xp.where(abs(limits.residual(rows, own.s)) > FAR, 1.0 / (steps * rows.shape[2]), 0.0)
        parts = far.reshape(len(rows), -1).sum(axis=1)
        *products, part = hosts(*self._products(), parts)
        self._learn(*products)
        self._weighted = self._weights(rows)  # D, d and multipliers of the last linearisation
        self._outside = (part > MANY) & (slacks is None)

    def _first(self, rows: Array, weight: float = FIRST) -> Slacks:
        """Next to the rows, with multipliers μ/(s − bound)."""
        xp, limits = array_module(rows), self.limits
        mu = np.full(len(rows), weight / rows.shape[1])
        s, own = limits.inside(rows), _spread(mu, rows)
        below, above = limits.gaps(s)
        lower = xp.where(limits.low, own / below, 0.0)
        upper = xp.where(limits.high, own / above, 0.0)
        return Slacks(s, lower, upper, xp.zeros_like(rows), mu)

    def _warm(self, rows: Array, slacks: Slacks) -> Slacks:
        """Those of the end of another solve where the rows are still there; else multipliers that
        are there stay and those of idle bounds rise."""
        xp, limits, new = array_module(rows), self.limits, self._first(rows, AGAIN)
        s, lower, upper, equal = (
            like(part, rows) for part in (slacks.s, slacks.lower, slacks.upper, slacks.equal)
        )
        room = xp.minimum(*limits.gaps(s))
        off = xp.where(room > 0.0, abs(limits.residual(rows, s)), np.inf)
        self._again = host(largest(off)) <= SAME
        same = like(self._again.reshape(-1, 1, 1), rows)
        return Slacks(
            xp.where(same, s, new.s),
            xp.where(same, lower, xp.maximum(lower, new.lower)),
            xp.where(same, upper, xp.maximum(upper, new.upper)),
            equal,
            np.where(self._again, slacks.mu, new.mu),
        )

    def _hold(self, slacks: Slacks) -> None:
        """Take over slacks, and what is often asked of them."""
        self.slacks, self.gaps = slacks, self.limits.gaps(slacks.s)
        self._box = self.limits.box(slacks, self._mu, self.gaps)

    @property
    def ended(self) -> Mask:
        return np.asarray((self.slacks.mu <= self.last) & (self._off() <= ERRORS * self.last))

    def within(self, at: Evaluation) -> Mask:
        return np.asarray(host(self.limits.beyond(at.rows)) <= SAME_BOUND)

    @property
    def lowered(self) -> NDArray[np.intp]:
        return np.flatnonzero(self._lowered)

    def state(self, member: int) -> Slacks | None:
        return self.slacks.select(slice(member, member + 1)).on_host()

    def take(self, members: NDArray[np.intp]) -> None:
        self.limits = self.limits.select(members)
        self._hold(self.slacks.select(members))
        self._least, self._most = self._least[members], self._most[members]
        self.last = self.last[members]
        self._phases, self._outside = self._phases[members], self._outside[members]
        self._again = self._again[members]
        self._short, self._jam = self._short[members], self._jam[members]

    # -- the problem at hand -----------------------------------------------------------------------

    @property
    def _mu(self) -> Array:
        """μ (batch, 1, 1), where the rows are."""
        if self._placed[0] is not self.slacks.mu:
            self._placed = self.slacks.mu, _spread(self.slacks.mu, self.slacks.s)
        return self._placed[1]

    def _products(self) -> tuple[Array, Array, Array]:
        """(batch,) the least and the most (s − bound) z, ±inf where there is no bound, and the mean
        of N z."""
        xp, own, limits = array_module(self.slacks.s), self.slacks, self.limits
        low, high = (gap * z for gap, z in zip(self.gaps, (own.lower, own.upper), strict=True))
        ends = []
        for one_of, none in ((xp.minimum, np.inf), (xp.maximum, -np.inf)):
            both = one_of(xp.where(limits.low, low, none), xp.where(limits.high, high, none))
            ends.append(both.reshape(len(both), -1))
        total = (own.lower + own.upper).reshape(len(own.s), -1).sum(axis=1)
        mean = total * (own.s.shape[1] / limits.sides)
        return ends[0].min(axis=1), ends[1].max(axis=1), mean

    def _learn(self, least: Numbers, most: Numbers, mean: Numbers) -> None:
        """Take over what is known on the host."""
        self._least, self._most = least, most
        self.last = self._end * np.maximum(1.0, mean / LARGE)

    def _off(self) -> Numbers:
        """(batch,) the largest |(s − bound) z − μ|."""
        mu = self.slacks.mu
        return np.maximum(np.maximum(self._most - mu, mu - self._least), 0.0)

    def _push(self, mu: Array, below: Array, above: Array) -> Array:
        """∂/∂s of the barrier."""
        xp = array_module(below)
        return xp.where(self.limits.high, mu / above, 0.0) - xp.where(
            self.limits.low, mu / below, 0.0
        )

    def _weights(self, rows: Array) -> tuple[Array, Array, Array]:
        """D, d and multipliers of the rows."""
        xp, own, limits = array_module(rows), self.slacks, self.limits
        below, above = self.gaps
        weight = xp.where(limits.equal, 1.0 / EQUAL, own.lower / below + own.upper / above)
        push = self._push(self._mu, below, above)
        shift = weight * limits.residual(rows, own.s) + push + own.equal
        return weight, shift, own.equal + own.upper - own.lower

    def weigh(self, problem: BlockNLP, at: Evaluation) -> None:
        self._weighted = self._weights(at.rows)
        problem.set_row_weights(*self._weighted)

    def _seen(self, at: Evaluation, s: Array, *beside: Array) -> tuple[Evaluation, list[Numbers]]:
        """With slacks ``s``; its numbers, and (batch,) others, come to the host in one copy."""
        xp, batch = array_module(s), len(s)
        below, above = self.limits.gaps(s)
        logs = (xp.log(below) + xp.log(above)).reshape(batch, -1).sum(axis=1)
        off = self.limits.residual(at.rows, s)
        residuals = (at.C, xp.where(self.limits.equal & (abs(off) < ROUNDED), 0.0, off))
        sizes = [abs(part).reshape(batch, -1) for part in residuals]
        total = sum(size.sum(axis=1) for size in sizes)
        square = sum((size**2).sum(axis=1) for size in sizes)
        most = xp.maximum(*map(largest, residuals))
        objective = at.terms.sum(axis=(1, 2))
        numbers = [objective - self._mu.reshape(-1) * logs, total, most, square]
        found = hosts(*numbers, objective, *beside)
        own = np.stack(found[:4], axis=1), found[4]
        return at.summarised(xp.stack(numbers, axis=1), *own), found[5:]

    def objective(self, at: Evaluation) -> Numbers:
        return at.objective

    def seen(self, at: Evaluation) -> Evaluation:
        return self._seen(at, self.slacks.s)[0]

    def _after(self, at: Evaluation, trial: Evaluation, length: Numbers | float) -> Array:
        """Slacks after a step of ``length``: on the row itself as far as that is inside, but for
        what the step leaves of the residual."""
        s = self.slacks.s
        rest = np.broadcast_to(1.0 - np.minimum(length, 1.0), len(s))
        left = _spread(rest, s) * self.limits.residual(at.rows, s)
        return array_module(s).clip(trial.rows - left, *self._box)

    def tried(self, at: Evaluation, trial: Evaluation, length: Numbers | float) -> Evaluation:
        return self._seen(trial, self._after(at, trial, length))[0]

    # -- a step ------------------------------------------------------------------------------------

    def aimed(
        self,
        problem: BlockNLP,
        at: Evaluation,
        lam: Array,
        model: Model,
        blocks: Callable[[Model], KKTBlocks],
    ) -> tuple[Evaluation, Model, Numbers | None]:
        """With the next μ wherever the problem of this one is solved well enough; the dual
        infeasibility is that of the multipliers, ‖∇E + Aᵀlam + Rᵀ(z_u − z_l + y)‖∞."""
        steps = at.rows.shape[1]
        _, shift, multipliers = self._weighted
        gradient = model.b + problem.row_forces(model, multipliers - shift)
        dual = host(largest(gradient + blocks(model).constraints_transposed_times(lam)))
        error, self._lowered = np.maximum(dual, at.largest), np.zeros(len(dual), dtype=bool)
        if some(self._again):  # of a warm start, to that weight whose problem is as far from solved
            most = np.minimum(AGAIN, error / ERRORS) / steps
            mu = np.where(self._again, np.maximum(self.slacks.mu, most), self.slacks.mu)
            self._lowered = mu > self.slacks.mu
            self._hold(replace(self.slacks, mu=mu))
            self._again = np.zeros_like(self._again)
        while True:
            mu = self.slacks.mu
            small = np.maximum(error, steps * self._off()) <= ERRORS * steps * mu
            lower = small & (mu > self.last)
            if not some(lower):
                break
            less = np.minimum(LINEAR * mu, (steps * mu) ** POWER / steps)
            mu = np.where(lower, np.maximum(self.last, less), mu)
            self._hold(replace(self.slacks, mu=mu))
            self._lowered |= lower
        if some(self._lowered):
            self._weighted = self._weights(at.rows)
            change = self._weighted[1] - shift
            model.b += problem.row_forces(model, change)  # in place: a device has its address
            at = self.seen(at)
        return at, model, dual

    def pull(self, problem: BlockNLP, at: Evaluation, model: Model) -> Array:
        residual = self.limits.residual(at.rows, self.slacks.s)
        return problem.row_forces(model, self._weighted[0] * residual)

    def shortened(
        self, problem: BlockNLP, at: Evaluation, model: Model, delta: Array, slope: Numbers
    ) -> tuple[Numbers | float, Numbers]:
        xp, own, limits = array_module(at.rows), self.slacks, self.limits
        (below, above), mu = self.gaps, self._mu
        products, residual = problem.row_products(model, delta), limits.residual(at.rows, own.s)
        change = xp.where(limits.equal, 0.0, products + residual)
        change = xp.where(limits.low | limits.high, change, 0.0)
        lower = xp.where(limits.low, (mu - own.lower * change) / below - own.lower, 0.0)
        upper = xp.where(limits.high, (mu + own.upper * change) / above - own.upper, 0.0)
        equal = xp.where(limits.equal, (products + residual) / EQUAL, 0.0)
        # bᵀΔ has dᵀR Δ in it, the barrier's slope is that of the slacks
        push = self._push(mu, below, above)
        more = push * change - self._weighted[1] * products
        falls = _fall(lower, own.lower), _fall(upper, own.upper)
        parts = (*falls, -change / below, change / above)
        most = (part.reshape(len(slope), -1).max(axis=1) for part in parts)
        *far, rest = hosts(*most, more.reshape(len(slope), -1).sum(axis=1))
        self._step = RowStep(lower, upper, equal, _longest(*far[:2]))
        longest = _longest(*far[2:])
        self._short = longest < LEAST
        return np.maximum(longest, LEAST), slope + rest

    def moved(self, at: Evaluation, after: Evaluation, by: Moved) -> Evaluation:
        """Members that found no step begin anew, with slacks next to their rows."""
        xp, own, limits, step = array_module(after.rows), self.slacks, self.limits, self._step
        jams = by.accepted & self._short & (by.sigma > HEAVY)
        self._jam = np.where(jams, self._jam + 1, 0)
        taken, anew = (like(mask.reshape(-1, 1, 1), own.s) for mask in (by.accepted, by.lost))
        s = xp.where(taken, self._after(at, after, by.length), own.s)
        if some(by.lost):
            s = xp.where(anew, limits.inside(after.rows), s)
        mu, whole = self._mu, ~by.still
        first, second = _spread(step.length * whole, s), _spread(by.length * whole, s)

        def kept(old: Array, change: Array, gap: Array, has: Array) -> Array:
            new = old + xp.where(taken, first * change, 0.0)
            new = xp.where(anew, mu / gap, new)
            return xp.where(has, xp.clip(new, mu / gap / SAFEGUARD, SAFEGUARD * mu / gap), 0.0)

        below, above = limits.gaps(s)
        lower = kept(own.lower, step.lower, below, limits.low)
        upper = kept(own.upper, step.upper, above, limits.high)
        equal = own.equal + xp.where(taken, second * step.equal, 0.0)
        self._hold(Slacks(s, lower, upper, equal, own.mu))
        after, known = self._seen(after, s, *self._products())
        self._learn(*known)
        return after

    @property
    def outside(self) -> Mask:
        return self._outside

    @property
    def jammed(self) -> Mask:
        return np.asarray((self._jam >= JAM) & (self._phases < JAMS))

    def eased(self, members: Mask) -> Mask:
        self._phases = self._phases + members
        return members & (self._phases <= PHASES)

    def elastic(self, problem: BlockNLP) -> Bounds:
        return Elastic(*problem.row_bounds, WIDTH)

    def anew(self, at: Evaluation, members: Mask) -> Evaluation:
        first = AGAIN / at.rows.shape[1]
        self.slacks = replace(self.slacks, mu=np.where(members, first, self.slacks.mu))
        none = np.zeros(len(members), dtype=bool)
        return self.moved(at, at, Moved(np.ones(len(members)), none, members, none, none))

    def blamed(self, refused: Mask, mended: Mask) -> Mask:
        """Not where a correction helps: blamed again and again, at every third iteration, units
        converge linearly (a cart-pole's swing-up in 131 iterations, 28 without)."""
        return refused & ~mended


def _spread(values: Numbers, rows: Array) -> Array:
    """(batch,) as (batch, 1, 1), where ``rows`` is."""
    return like(np.asarray(values).reshape(-1, 1, 1), rows)


def _fall(change: Array, value: Array) -> Array:
    """By what part of itself each number falls, zero where it is zero."""
    xp = array_module(value)
    return xp.where(value > 0.0, -change / xp.where(value > 0.0, value, 1.0), 0.0)


def _longest(*most: Numbers) -> Numbers:
    """(batch,) the length in (0, 1] with which nothing goes further than ``PART``, ``most`` being
    how far a whole step goes at most."""
    return np.minimum(1.0, PART / np.maximum(np.maximum(*most), 1e-300))


def bounds_of(
    problem: BlockNLP, at: Evaluation, tolerance: float, slacks: Slacks | None = None
) -> Bounds:
    """Of the rows of a problem that begins at ``at``; see :class:`Barrier`."""
    lower, upper = problem.row_bounds
    if lower.size == 0:
        return Bounds()
    return Barrier(Limits(lower, upper), at, tolerance, slacks)
