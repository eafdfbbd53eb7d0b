"""What Algorithm 1's loop asks of a rule that makes and accepts steps, and what it gets back."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from octo.arrays import Array, Numbers
from octo.problem.block_nlp import BlockNLP
from octo.problem.evaluation import Evaluation, Model

STAGES = ("linearize", "factor", "solve", "evaluate")


@dataclass(eq=False)
class Clock:
    """Seconds by stage. ``finish`` waits for what a stage has begun, where somebody wants to know
    how long that takes."""

    finish: Callable[[], None] = lambda: None
    seconds: dict[str, float] = field(default_factory=lambda: dict.fromkeys(STAGES, 0.0))

    def __call__(self, stage: str) -> _Stage:
        return _Stage(self, stage)


class _Stage:
    """What lasts as long as a block of code."""

    def __init__(self, clock: Clock, name: str):
        self._clock, self._name = clock, name

    def __enter__(self) -> None:
        self._began = time.perf_counter()

    def __exit__(self, error: type[BaseException] | None, *_: object) -> None:
        if error is None:
            self._clock.finish()
        self._clock.seconds[self._name] += time.perf_counter() - self._began


@dataclass(eq=False)
class Move:
    """What a rule did in one iteration; NumPy arrays over the batch, but for the iterate itself."""

    at: Evaluation  # where the members are now
    lam: Array
    accepted: NDArray[np.bool_]
    failed: NDArray[np.bool_]  # no step can be found from here
    dual: Numbers  # ‖∇E + Aᵀlam‖∞ at the iterate before
    step: Numbers  # ‖Δ‖∞ of the full KKT step from the iterate before
    taken: Numbers  # ‖Δ‖∞ of what was taken
    ratio: Numbers  # actual over predicted reduction, or the line search's length
    radius: Numbers | float
    sigma: Numbers
    factorizations: NDArray[np.intp]
    converged: NDArray[np.bool_]  # the tests of the rule held before the step: it was not taken


class Rule(Protocol):
    """How a step is made and accepted."""

    def move(self, at: Evaluation, lam: Array, model: Model, iteration: int) -> Move: ...

    def anew(self, members: NDArray[np.intp]) -> None:
        """Forget what stands in the way of some members, which were moved."""

    def take(self, members: NDArray[np.intp], problem: BlockNLP) -> None: ...
