"""What a line search asks of whatever keeps rows between their bounds; here, of problems whose rows
have none."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo.arrays import Array, Numbers, array_module, host, like
from octo.problem.block_nlp import BlockNLP
from octo.problem.evaluation import Evaluation, Model
from octo.solver.acceptance import Mask
from octo.solver.blocks import KKTBlocks


@dataclass(frozen=True, eq=False)
class Slacks:
    """Of one iterate, (batch, N, rows): slacks s, on the bound itself of equalities; multipliers of
    the lower and the upper bounds and of equalities, zero where a row has none; and μ (batch,)."""

    s: Array
    lower: Array
    upper: Array
    equal: Array
    mu: Numbers

    def select(self, members: Any) -> Slacks:
        """Those of some members, by index or as a slice."""
        chosen = members if isinstance(members, slice) else like(members, self.s)
        parts = (self.s, self.lower, self.upper, self.equal)
        s, lower, upper, equal = (part[chosen] for part in parts)
        return Slacks(s, lower, upper, equal, self.mu[members])

    def plain(self, member: int) -> dict[str, Array]:
        """Those of one member, (N, rows) each and μ (1,), by name."""
        own = {
            name: getattr(self, name)[member].copy() for name in ("s", "lower", "upper", "equal")
        }
        return own | {"mu": self.mu[member : member + 1].copy()}

    def later(self, steps: int) -> Slacks:
        """As many steps later along the horizon, where nothing is known of the last ones."""
        parts = (self.s, self.lower, self.upper, self.equal)
        rest = array_module(self.s).zeros_like(self.s[:, :steps])
        join = array_module(self.s).concatenate
        s, lower, upper, equal = (join([part[:, steps:], rest], axis=1) for part in parts)
        return Slacks(s, lower, upper, equal, self.mu)

    def on_host(self) -> Slacks:
        """The same in NumPy arrays."""
        return Slacks(*map(host, (self.s, self.lower, self.upper, self.equal, self.mu)))


@dataclass(frozen=True, eq=False)
class Moved:
    """What a line search did with each member, (batch,): the length of its step; whether one was
    accepted, or none was found at all (lost); whether it was a step for the constraints alone, with
    which multipliers stay (still); and the weight ``sigma`` of the matrix that it is of."""

    length: Numbers
    accepted: Mask
    lost: Mask
    still: Mask
    sigma: Numbers


def joined(parts: Sequence[Slacks | None]) -> Slacks | None:
    """Of single members, those of a batch."""
    own = [part for part in parts if part is not None]
    if not own:
        return None
    return Slacks(*(np.concatenate([getattr(p, f.name) for p in own]) for f in fields(Slacks)))


class Bounds:
    """None at all. Masks and what is (batch,) are NumPy's."""

    @property
    def ended(self) -> Mask | bool:
        """(batch,) whether the problem that is solved now is the last one."""
        return True

    def within(self, at: Evaluation) -> Mask | bool:
        """(batch,) whether the rows of an iterate are between their bounds."""
        del at
        return True

    def weigh(self, problem: BlockNLP, at: Evaluation) -> None:
        """Set the weights, shifts and multipliers of the rows, before a linearisation at ``at``."""

    def objective(self, at: Evaluation) -> Numbers:
        """(batch,) E alone, of an iterate as seen."""
        return at.energy

    def seen(self, at: Evaluation) -> Evaluation:
        """An iterate with E and ‖C‖ as an acceptance is to see them."""
        return at

    def tried(self, at: Evaluation, trial: Evaluation, length: Numbers | float) -> Evaluation:
        """The same of a trial, a step of ``length`` (batch,) from ``at``."""
        del at, length
        return self.seen(trial)

    def aimed(
        self,
        problem: BlockNLP,
        at: Evaluation,
        lam: Array,
        model: Model,
        blocks: Callable[[Model], KKTBlocks],
    ) -> tuple[Evaluation, Model, Numbers | None]:
        """The iterate and its model as the next step is to see them, and (batch,) their dual
        infeasibility where it is not ‖b + Aᵀlam‖∞; ``blocks``: of Eq. 12, with products."""
        del problem, lam, blocks
        return at, model, None

    @property
    def lowered(self) -> NDArray[np.intp]:
        """The members that ``aimed`` gave another problem."""
        return np.empty(0, dtype=np.intp)

    def pull(self, problem: BlockNLP, at: Evaluation, model: Model) -> Array:
        """(batch, K, nc) of the gradient b, what draws rows to their slacks."""
        del problem, at
        return array_module(model.b).zeros_like(model.b)

    def shortened(
        self, problem: BlockNLP, at: Evaluation, model: Model, delta: Array, slope: Numbers
    ) -> tuple[Numbers | float, Numbers]:
        """(batch,) the longest length of a step ``delta`` (batch, K, nc), and its slope; ``slope``
        is bᵀΔ."""
        del problem, at, model, delta
        return 1.0, slope

    def moved(self, at: Evaluation, after: Evaluation, by: Moved) -> Evaluation:
        """Learn how members came from ``at`` to ``after``, which is returned as seen."""
        del at, by
        return self.seen(after)

    @property
    def outside(self) -> Mask:
        """(batch,) where rows are so far outside that an elastic phase is to begin with."""
        return np.zeros(0, dtype=bool)

    @property
    def jammed(self) -> Mask | bool:
        """(batch,) where bounds shorten step after step, so that an elastic phase is to help."""
        return False

    def eased(self, members: Mask) -> Mask:
        """(batch,) of ``members`` those that an elastic phase is to lead near their bounds, which
        is counted: not where that was done often enough."""
        return np.zeros_like(members)

    def elastic(self, problem: BlockNLP) -> Bounds:
        """The price of the bounds of ``problem`` in such a phase."""
        del problem
        return self

    def kept(self, rows: Array) -> Mask:
        """(batch,) where the rows of a phase's end (batch, N, rows), on the host, are between their
        bounds, but for the width of their price."""
        return np.ones(len(rows), dtype=bool)

    def anew(self, at: Evaluation, members: Mask) -> Evaluation:
        """Begin anew with some members (batch,) bool of ``at``: the iterate as seen."""
        del members
        return at

    def blamed(self, refused: Mask, mended: Mask) -> Mask:
        """(batch,) where single units are to blame for a first trial that was ``refused``, whether
        it was ``mended`` by a correction or not."""
        del mended
        return refused

    def state(self, member: int) -> Slacks | None:
        """What a warm start needs of one member, on the host."""
        del member
        return None

    def take(self, members: NDArray[np.intp]) -> None:
        """Keep some members only."""
