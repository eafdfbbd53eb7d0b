"""Training (Algorithm 2, line 5): the weights of a network by L-BFGS, of motions that are fixed."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from octo.checks import Array, asked, instance, number, numbers, one_of, whole
from octo.errors import ProblemError, ShapeError, ValueRangeError
from octo.learn import lbfgs
from octo.learn.controls import controls
from octo.learn.fit import commands_in
from octo.learn.frame import USUAL, Frame
from octo.learn.losses import LOSSES, Loss, recurrent, with_decay
from octo.learn.transition import Transition
from octo.library import Library
from octo.result.solution import Solution

MEMORY = 5  # pairs of L-BFGS: with ten or twenty an iteration takes longer and is worth no more
DECAY = 1e-2  # of the mean square of the weights: 45,000 of them know 40 transitions by heart
LEAST = 3  # controls
# training ends where so many iterations took less than this part off the loss: later rounds go on
# from a network that nearly knows the motion, and end after a few hundred
PLATEAU, PLATEAU_CHANGE = 100, 0.01
# of a recurrent training from a network that does not know the motion: parts of the iterations on
# pieces of it, and of these on single transitions; transitions of a piece, and starts of each, of
# which all but one are so far beside the motion, in parts of what its numbers vary by (rms)
PIECES, SINGLE, LENGTHS, COPIES, BESIDE = 2 / 3, 1 / 2, (1, 2, 4, 8), 8, 0.2
KNOWN = 0.1  # of Eq. 16 of a network that says "stand": below it a network knows the motion
# of the weights: how far L-BFGS goes at first, how much nearer it begins again, how near at most
UNIT, NEARER, NEAREST = 0.1, 0.1, 1e-4


@dataclass(frozen=True, eq=False)
class Training:
    """What came of a training.

    Attributes
    ----------
    transition: the best weights found.
    loss: of them, with the decay; first: before.
    error: of them without the decay: Eq. 14 or Eq. 16 as a mean over the transitions.
    history: the loss after each iteration; of the recurrent one without those on shorter pieces.
    iterations: of all.
    seconds, processor_seconds: of the training. stopped: why it ended, in words.
    """

    transition: Transition
    loss: float
    first: float
    error: float
    history: Array
    iterations: int
    seconds: float
    processor_seconds: float
    stopped: str

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C ended it."""
        return self.stopped == INTERRUPTED


INTERRUPTED = "interrupted"


class _Best:
    """A loss that remembers the best finite value and where it was; not finite ones are as large as
    a number can be, from which a line search goes back."""

    def __init__(self, loss: Loss, w: Array):
        self.loss, self.w = loss, w
        self.value, _ = loss(w)
        if not np.isfinite(self.value):
            raise ProblemError(
                f"the loss is {self.value} where training begins, must be finite: begin with other "
                "weights, or train with loss='one_step'"
            )
        self.first = self.value
        self.history: list[float] = []

    def __call__(self, w: Array) -> tuple[float, Array]:
        with np.errstate(over="ignore", invalid="ignore"):
            value, gradient = self.loss(w)
        if not (np.isfinite(value) and np.isfinite(gradient).all()):
            return 1e3 * (1.0 + abs(self.first)) * (1.0 + self.value), np.zeros_like(w)
        if value < self.value:
            self.value, self.w = value, w.copy()
        return value, gradient


@asked
def train(
    transition: Transition,
    motions: Solution | Array | Sequence[Solution | Array] | Library,
    *,
    loss: str = "one_step",
    iterations: int = 1000,
    decay: float = DECAY,
    seed: int = 0,
) -> Training:
    """Train a transition on motions that stay as they are.

    Parameters
    ----------
    transition: with weights (``transition.started(problem)``), which it goes on from; for a library
        one without weights begins with those of ``seed``. One with a command is trained on a
        library, which has the commands of its motions.
    motions: a Solution or several, or controls (Z + 1, 2 nx) as :func:`octo.learn.controls` gives
        them, of one number of controls; or an octo.Library, of which the motions that converged.
    loss: "one_step", Eq. 14; or "recurrent", Eq. 16: each motion is unrolled from its first
        control.
    iterations: of L-BFGS, at most.
    decay: of the mean square of the weights, in the loss.
    seed: of the weights of a transition that has none.

    Raises
    ------
    OctoError: the motions have fewer than three controls, are of another robot, or not finite; an
        option is refused.
    """
    check_training(loss, iterations, decay)
    instance("transition", transition, Transition, "an octo.learn.Transition")
    commands = None
    if isinstance(motions, Library):
        if transition.weights is None:
            transition = transition.started(motions, seed)
        motions, commands = _of_library(transition, motions)
    elif transition.command:
        raise ProblemError(
            f"the transition asks for the command {', '.join(transition.command)}, which motions "
            "do not tell: train it on an octo.Library"
        )
    transition.known  # noqa: B018  (refuses one without weights)
    several: Sequence[Any] = motions if isinstance(motions, (list, tuple)) else [motions]
    if not several:
        raise ProblemError("motions is an empty list, must hold a motion at least")
    given = [_controls(one, transition) for one in several]
    if len({one.shape for one in given}) != 1:
        raise ShapeError("motions", tuple(len(one) for one in given), "one number of controls")
    how = loss, int(iterations), float(decay)
    return trained(transition, np.stack(given), *how, commands)


def _of_library(transition: Transition, library: Library) -> tuple[list[Solution], Array | None]:
    """The motions that converged, and their commands (motions, G) as the network sees them.

    Raises
    ------
    ProblemError: none converged. UnknownNameError: there is no such command.
    """
    good = np.flatnonzero(library.converged)
    if not len(good):
        raise ProblemError("no motion of the library converged: there is none to train on")
    motions = [library[int(k)] for k in good]
    if not transition.command:
        return motions, None
    fit, told = transition.known, commands_in(library, transition.command)[good]
    if told.shape[1] != len(fit.command_size):
        expected = f"(motions, {len(fit.command_size)}), as the transition has"
        raise ShapeError("the library's command", told.shape, expected)
    return motions, (told - fit.command_center) / fit.command_size


def check_training(loss: str, iterations: int, decay: float) -> None:
    """Raises
    ------
    UnknownNameError, ValueRangeError: an option of a training is refused."""
    one_of("loss", loss, LOSSES)
    whole("training iterations", iterations, 0)
    if number("decay", decay) < 0.0:
        raise ValueRangeError(f"decay is {decay}, must not be negative")


def trained(
    transition: Transition,
    given: Array,
    loss: str,
    iterations: int,
    decay: float,
    commands: Array | None = None,
) -> Training:
    """The same of controls (motions, Z + 1, 2n) and commands (motions, G), with nothing checked."""
    network, frame = transition.network, transition.frame
    began, spent = time.perf_counter(), time.process_time()
    weights = transition.weights
    assert weights is not None

    error = LOSSES[loss](network, frame, given, commands)
    best = _Best(with_decay(error, network, decay), np.array(weights))
    stopped, left = "", iterations
    try:
        if loss == "recurrent" and best.value > KNOWN * error(np.zeros_like(weights))[0]:
            most = int(PIECES * iterations)
            left -= _lengthen(best, transition, given, commands, decay, most)
        stopped = _descend(best, left)
    except KeyboardInterrupt:
        stopped = INTERRUPTED
    own = transition.with_weights(best.w)
    return Training(
        own,
        best.value,
        best.first,
        error(best.w)[0],
        np.array(best.history),
        iterations - left + len(best.history),
        time.perf_counter() - began,
        time.process_time() - spent,
        stopped,
    )


def _lengthen(
    best: _Best,
    transition: Transition,
    given: Array,
    commands: Array | None,
    decay: float,
    most: int,
) -> int:
    """Train on short pieces of the motions that are unrolled by themselves, most of them from
    beside the motion: from weights that know nothing a whole motion leads nowhere, and what single
    steps alone have taught explodes. How many of ``most`` iterations it took; what it found is
    taken where the whole motion says that it is better."""
    network, frame = transition.network, transition.frame
    lengths = [length for length in LENGTHS if length < given.shape[-2] - 1]
    noise = BESIDE * variation(given, frame)
    w, taken = best.w, 0
    for k, length in enumerate(lengths):
        own = beside(pieces(given, length), frame, noise)
        told = None if commands is None else np.repeat(commands, len(own) // len(given), axis=0)
        piece = _Best(with_decay(recurrent(network, frame, own, told), network, decay), w)
        share = SINGLE if k == 0 else 1.0 / (len(lengths) - k)
        _descend(piece, int(share * (most - taken)))
        taken += len(piece.history)
        w = piece.w
    best(w)  # which remembers it, where it is better
    return taken


def pieces(given: Array, length: int) -> Array:
    """(pieces, length + 1, 2n) of motions (motions, Z + 1, 2n), each from the end of the one
    before; the last one ends where the motion does."""
    steps = given.shape[-2] - 1
    first = np.minimum(np.arange(0, steps, length), steps - length)
    places = first[:, None] + np.arange(length + 1)
    return np.ascontiguousarray(given[:, places].reshape(-1, length + 1, given.shape[-1]))


def variation(given: Array, frame: Frame) -> float:
    """What the numbers of motions (motions, Z + 1, 2n) that a network sees vary by, root mean
    square, rad and ℓ."""
    seen = frame.inputs(given).reshape(-1, len(frame.kept))
    return USUAL * float(np.sqrt(seen.var(axis=0).mean()))


def beside(own: Array, frame: Frame, noise: float) -> Array:
    """Pieces (pieces, length + 1, 2n), each ``COPIES`` times, all but one with a start that is
    normally distributed about its own by ``noise``, rad and ℓ: what is unrolled comes back to the
    motion."""
    made = np.repeat(own, COPIES, axis=0)
    moved = np.zeros_like(made[:, 0])
    kept = frame.kept
    random = np.random.default_rng(0).standard_normal((len(made), len(kept)))
    moved[:, kept] = noise * random * frame.sizes[kept]
    moved[::COPIES] = 0.0
    made[:, 0] += moved
    return made


def _descend(best: _Best, iterations: int) -> str:
    """Run L-BFGS; why it ended. Where it finds no better weights so far away as it begins with, it
    begins again nearer."""
    stopped, unit = "no iterations were asked for", UNIT

    def watch() -> bool:
        best.history.append(best.value)
        if len(best.history) <= PLATEAU:
            return False
        before = best.history[-1 - PLATEAU]
        return before - best.value <= PLATEAU_CHANGE * before

    while len(best.history) < iterations and unit >= NEAREST:
        left = iterations - len(best.history)
        stopped = lbfgs.minimise(best, best.w, left, MEMORY, unit, watch)
        if stopped == lbfgs.WATCHED:
            return f"the loss fell by less than {PLATEAU_CHANGE:.0%} in {PLATEAU} iterations"
        if stopped == lbfgs.LIMIT:
            break
        unit *= NEARER
    return stopped


def _controls(motion: Solution | Array, transition: Transition) -> Array:
    """A motion's controls, where the transition is made for such."""
    fit = transition.known
    if isinstance(motion, Solution):
        for name, own, its in (
            ("robot", fit.robot, motion.name),
            ("basis", fit.basis, motion.basis),
        ):
            if own != its:
                raise ProblemError(f"the transition's {name} is {own!r}, the motion's is {its!r}")
        motion = controls(motion)
    found = numbers("motions", motion)
    if found.ndim != 2 or found.shape[1] != 2 * fit.n:
        raise ShapeError("motions", found.shape, f"(controls, {2 * fit.n})")
    if len(found) < LEAST:
        raise ProblemError(
            f"a motion of {len(found)} controls is given, must have at least {LEAST} to train on"
        )
    return found
