"""E_RNN (Eq. 14) as a term of a problem."""

from __future__ import annotations

from dataclasses import dataclass

from octo.arrays import Array
from octo.checks import instance
from octo.learn.transition import Transition
from octo.problem.array_costs import ArrayCost
from octo.problem.problem import Problem
from octo.problem.symbols import Setting


@dataclass(frozen=True, eq=False)
class Markovian(ArrayCost):
    """Mean of |c_{i+1} − RNN(c_i)|² over neighbouring controls, lengths in ℓ and angles in rad:
    what makes a motion one that a network can say (§7).

    ``weight`` is λ. The network's weights are data: another network of any size compiles nothing.

    Parameters
    ----------
    transition: the network, with weights.
    """

    anywhere = True
    transition: Transition | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        kind = "an octo.learn.Transition"
        instance(f"{self.label}.transition", self.transition, Transition, kind)
        self._own.known  # noqa: B018  (refuses one without weights)
        self._own.check_told()

    @property
    def _own(self) -> Transition:
        assert self.transition is not None
        return self.transition

    def check(self, problem: Problem) -> None:
        self._own.check(problem)

    def value(self, c: Array, c_next: Array, setting: Setting) -> Array:
        del setting
        return self._own.residual(c, c_next)

    def slopes(self, c: Array, c_next: Array, setting: Setting) -> tuple[Array, Array]:
        del setting
        return self._own.residual_slopes(c, c_next)
