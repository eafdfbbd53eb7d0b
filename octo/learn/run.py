"""Algorithm 2 at work: a motion and a network that are improved in turn."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from octo.checks import Array
from octo.gains import at_stiffness
from octo.learn.controls import controls
from octo.learn.markovian import Markovian
from octo.learn.rounds import Learned, Round
from octo.learn.training import Training, trained
from octo.learn.transition import Transition
from octo.learn.unrolled import losses_of, unrolled, unrolled_error
from octo.problem.problem import Problem
from octo.progress import Progress
from octo.result.solution import Solution
from octo.solve import Guess, solve
from octo.solver.status import Status

NAME = "Markovian"
ALLOWED = 1e-9  # relative: rounding of Eq. 15


@dataclass(frozen=True)
class Half:
    """The motion's half of a round.

    Attributes
    ----------
    weight: λ. made: what the solve found; accepted: whether it was taken.
    before: Eq. 15 without the decay, of the motion before; None in the first round.
    seconds: processor time.
    """

    weight: float
    made: Solution
    accepted: bool
    before: float | None
    seconds: float


@dataclass(eq=False)
class Run:
    """What is known between two rounds.

    Attributes
    ----------
    problem: without E_RNN. transition: with weights. loss, training, decay: of the network.
    seed: of a first motion, which begins at ``start``. how: options of octo.solve.
    """

    problem: Problem
    transition: Transition
    loss: str
    training: int
    decay: float
    seed: int
    how: dict[str, Any]
    start: Guess = None
    motion: Solution | None = None
    rounds: list[Round] = field(default_factory=list)

    def go_on(self, known: Learned) -> None:
        """From where another one ended."""
        self.motion, self.rounds = known.motion, list(known.rounds)
        self.problem, self.how["passes"] = at_stiffness(self.problem, known.motion), None

    def all(self, weights: Array, callback: Callable[[Learned], bool | None] | None) -> Learned:
        """Round after round; what Ctrl-C ends keeps what was found."""
        stopped, say = False, self._progress()
        for weight in weights.tolist():
            try:
                stopped = self._round(weight)
            except KeyboardInterrupt:  # while something was compiled
                if self.motion is None:
                    raise
                stopped = True
            if self.rounds:
                say(str(self.rounds[-1]))
            if not stopped and callback is not None:
                stopped = bool(callback(self._found(False)))
            if stopped:
                break
        found = self._found(stopped)
        return replace(found, unrolled=unrolled(self.problem, self.transition, found.motion))

    def _progress(self) -> Callable[[str], None]:
        doing = self.how.get("progress", False)
        return Progress(doing if isinstance(doing, str) else "") if doing else lambda text: None

    def _found(self, interrupted: bool) -> Learned:
        assert self.motion is not None
        return Learned(self.motion, self.transition, tuple(self.rounds), interrupted=interrupted)

    def _round(self, weight: float) -> bool:
        """One round; whether Ctrl-C ended it."""
        half = self._move(weight)
        if half.made.status is Status.INTERRUPTED:
            return True
        assert self.motion is not None
        began, given, old = time.process_time(), controls(self.motion), self.transition
        found = trained(old, given[None], self.loss, self.training, self.decay)
        self.transition = found.transition
        self.rounds.append(self._record(half, found, given, old, time.process_time() - began))
        return found.interrupted

    def _move(self, weight: float) -> Half:
        """The motion's half: E + λ E_RNN with the network as it is."""
        began = time.process_time()
        term = Markovian(transition=self.transition, weight=weight, name=NAME)
        own = self.problem.replace(costs=[*self.problem.costs, term])
        before = self._before(weight)
        start = self.start if before is None else before
        made = solve(own, start=start, seed=self.seed, **self.how)
        accepted = before is None or better(made, before)
        self.motion = made if accepted else before
        if before is None:  # from now on the contact law is that of the last pass
            self.problem, self.how["passes"] = at_stiffness(self.problem, made), None
        energy = None if before is None else before.energy
        return Half(weight, made, accepted, energy, time.process_time() - began)

    def _before(self, weight: float) -> Solution | None:
        """The motion so far, with the E_RNN of this round."""
        if self.motion is None:
            return None
        error, _ = losses_of(self.transition, controls(self.motion), self.decay)
        return replace(self.motion, terms={**self.motion.terms, NAME: weight * error})

    def _record(
        self, half: Half, found: Training, given: Array, old: Transition, seconds: float
    ) -> Round:
        """What is written down of a round."""
        assert self.motion is not None
        plain, weight = self.motion.energy - self.motion.terms[NAME], half.weight
        error, with_decay = losses_of(old, given, self.decay)
        _, after = losses_of(found.transition, given, self.decay)
        before = None if half.before is None else half.before + weight * (with_decay - error)
        return Round(
            number=len(self.rounds) + 1,
            weight=weight,
            iterations=half.made.iterations,
            status=half.made.status.label,
            accepted=half.accepted,
            energy=plain,
            markovian=error,
            violation=self.motion.violation,
            before=before,
            between=plain + weight * with_decay,
            after=plain + weight * after,
            first_loss=found.first,
            loss=found.loss,
            training=found.iterations,
            unrolled=unrolled_error(found.transition, given),
            motion_seconds=half.seconds,
            network_seconds=seconds,
        )


def better(made: Solution, before: Solution) -> bool:
    """Whether a motion is no worse than the one before: by E and an exact penalty of ‖C‖∞, which is
    ‖lam‖₁ of its multipliers."""
    penalty = float(np.abs(made.multipliers).sum()) / made.weight
    new, old = (one.energy + penalty * one.violation for one in (made, before))
    return new <= old + ALLOWED * abs(old)
