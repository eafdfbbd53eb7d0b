"""Algorithm 2: a motion that a network can say, and the network that says it, in turn.

    E(c) + λ (E_RNN(c, w) + decay · mean w²)   subject to C(c) = 0            (Eq. 15)

Each round minimises it over the motion c with the weights w fixed, by a number of iterations of
Algorithm 1, then over w with c fixed. With the one-step loss both halves reduce the same number;
the recurrent loss (Eq. 16) is another one, in the second half alone.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from octo.checks import Array, asked, instance, numbers, takes, whole
from octo.errors import ProblemError, ShapeError, ValueRangeError, said
from octo.learn.rounds import Learned
from octo.learn.run import Run
from octo.learn.training import DECAY, LEAST, check_training
from octo.learn.transition import Transition
from octo.problem.basis import Hermite
from octo.problem.problem import Problem
from octo.solve import Guess, Usual

FIRST = 0.1  # of λ: the second round's, where it grows


@asked
@takes(Usual)
def solve(
    problem: Problem,
    transition: Transition | None = None,
    *,
    rounds: int = 10,
    iterations: int = 200,
    training: int = 1000,
    loss: str = "one_step",
    weight: float | Sequence[float] = 1.0,
    decay: float = DECAY,
    start: Guess = None,
    seed: int = 0,
    resume: Learned | str | os.PathLike[str] | None = None,
    callback: Callable[[Learned], bool | None] | None = None,
    **how: Any,
) -> Learned:
    """Find a motion and a network that says it (Algorithm 2, Markovian regularisation).

    Parameters
    ----------
    transition: the network; by default an ``octo.learn.Transition()``. One without weights begins
        with those of ``seed``.
    rounds: how many, of a motion and a training each.
    iterations: of the motion in a round, at most, of each of its passes.
    training: of L-BFGS in a round, at most.
    loss: what the network is trained on: "one_step", Eq. 14; or "recurrent", Eq. 16, which makes
        what is unrolled stable.
    weight: λ, at least 0: one for each round; or the last one: then the first round has 0, so that
        the network sees a motion first, and over half of the rounds λ grows from a tenth of it.
    decay: of the mean square of the weights, in the loss.
    start: what the first motion starts from, as of :func:`octo.solve`.
    seed: of its noise, and of the weights.
    resume: what such a call returned, or the folder that ``Learned.save`` wrote: to go on from.
    callback: called with a Learned, without what is unrolled, after every round; returning True
        stops.
    passes: of the first motion; the contact law stays that of the last one.
    max_iterations: cannot be given: it is ``iterations``.

    Returns
    -------
    A Learned. Ctrl-C returns what was found so far.

    Raises
    ------
    OctoError: the problem, the transition or an option is refused; nothing was computed.
    """
    weights = weights_of(weight, whole("rounds", rounds))
    check_training(loss, training, decay)
    options = _options(how, iterations)
    begun, known = _begun(problem, transition, start, seed, resume, callback)
    run = Run(problem, begun, loss, int(training), float(decay), seed, options, start)
    if known is not None:
        run.go_on(known)
    return run.all(weights, callback)


def _options(how: Mapping[str, Any], iterations: int) -> dict[str, Any]:
    """Those of octo.solve."""
    if how.get("max_iterations") is not None:
        raise ProblemError("max_iterations is given, must be iterations=…, those of each round")
    return {**how, "max_iterations": whole("iterations", iterations)}


def _begun(
    problem: Problem,
    transition: Transition | None,
    start: Guess,
    seed: int,
    resume: Learned | str | os.PathLike[str] | None,
    callback: object,
) -> tuple[Transition, Learned | None]:
    """The network to begin with, and what is gone on from, if anything."""
    instance("problem", problem, Problem, "an octo.Problem")
    if callback is not None and not callable(callback):
        raise ProblemError(f"callback is {said(callback)}, must be a function of a Learned")
    _check_controls(problem)
    known = _known(resume, problem, transition, start)
    return _started(transition if known is None else known.transition, problem, seed), known


def weights_of(weight: float | Sequence[float], rounds: int) -> Array:
    """(rounds,) λ.

    Raises
    ------
    ShapeError, ValueRangeError: another number of them, or one that is negative.
    """
    given = numbers("weight", weight)
    if given.shape not in ((), (rounds,)):
        raise ShapeError("weight", given.shape, f"() or ({rounds},)")
    if (given < 0.0).any():
        raise ValueRangeError(f"weight is {said(weight)}, must not be negative")
    if given.ndim:
        return given
    growing = (rounds - 1) // 2
    parts = np.minimum(np.arange(rounds - 1) / growing, 1.0) if growing else np.ones(rounds - 1)
    return np.append(0.0, float(given) * FIRST ** (1.0 - parts))


def _known(
    resume: Learned | str | os.PathLike[str] | None,
    problem: Problem,
    transition: Transition | None,
    start: Guess,
) -> Learned | None:
    """What is gone on from, if anything.

    Raises
    ------
    OctoError: it is no such thing, or of another basis; a start or a transition is given too.
    """
    if resume is None:
        return None
    if transition is not None or start is not None:
        raise ProblemError("resume has a motion and a network: leave out transition and start")
    known = resume if isinstance(resume, Learned) else Learned.load(resume)
    own, its = len(known.motion.x) - 2, int(problem.steps)
    if own != its:
        raise ProblemError(f"resume has a motion of {own} steps, the problem has {its}")
    return known


def _started(transition: Transition | None, problem: Problem, seed: int) -> Transition:
    """A transition with weights that fits the problem."""
    own = Transition() if transition is None else transition
    instance("transition", own, Transition, "an octo.learn.Transition")
    if own.command:
        raise ProblemError(
            f"Transition.command is {own.command!r}, must be left out where there is one problem: "
            "octo.learn.train trains such a transition on an octo.Library"
        )
    if own.weights is None:
        return own.started(problem, seed)
    own.check(problem)
    return own


def _check_controls(problem: Problem) -> None:
    """Refuse a problem of too few controls."""
    basis, steps = problem.basis_object, int(problem.steps)
    count = 1 + (steps // basis.steps_per_segment if isinstance(basis, Hermite) else steps)
    if count < LEAST:
        what = f"the problem has {count} controls"
        raise ProblemError(f"{what}, must have at least {LEAST}: give it more steps")
