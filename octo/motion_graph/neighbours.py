"""Transitions that are alike: a quarter from a blend of two motions, the others from the nearest
that was found, which takes a third of the iterations and finds what no blend leads to."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from octo.checks import Array
from octo.problem.problem import Problem
from octo.result.solution import Solution
from octo.solve import solve

Steps = NDArray[np.intp]
SAME = 1e-9  # rms, of first guesses: the same problem
TRIES = 3  # a try has a third of the iterations: from a neighbour anew is better than on
SHARE = 4  # of which one is solved from its first guess
Made = Sequence[tuple[Problem, Array]]


class Neighbours:
    """Problems of one structure, with first guesses (steps + 1, nx) in one frame.

    Parameters
    ----------
    made: problems and first guesses. how: options of :func:`octo.solve`.
    good: whether a motion is one to start from. stopped: asked between batches.

    Attributes
    ----------
    iterations, seconds: (n,) of each, and of processor time; of one that is solved already nothing.
    """

    def __init__(
        self,
        made: Made,
        how: dict[str, Any],
        good: Callable[[Solution], bool],
        stopped: Callable[[], bool],
    ):
        self.made, self.how = made, how
        self.good, self.stopped = good, stopped
        self.guesses = np.stack([guess for _, guess in made])
        self.apart = apart(self.guesses)
        self.iterations = np.zeros(len(made), dtype=int)
        self.seconds = np.zeros(len(made))
        self.motions: dict[int, Solution] = {}
        self.found: list[int] = []

    def solved(self) -> list[Solution] | None:
        """All motions; None where it was told to stop."""
        first = np.argmax(self.apart <= SAME, axis=1)  # of those that are the same
        own = np.unique(first)
        begin = own[spread(self.apart[np.ix_(own, own)], math.ceil(len(own) / SHARE))]
        most = self.how.get("max_iterations")
        few = {} if most is None else {"max_iterations": math.ceil(most / TRIES)}
        self._solve(begin, **few)
        self._solve(np.setdiff1d(own, begin), **few)
        lost = np.setdiff1d(own, self.found)
        if self.found:
            self._solve(lost, **few)
        elif few:  # there is nothing to start from but the first guess
            self._solve(lost)
        return None if self.stopped() else [self.motions[int(k)] for k in first]

    def _solve(self, members: Steps, **more: Any) -> None:
        """Some in one batch, each from the nearest that was found, if one was."""
        if not len(members) or self.stopped():
            return
        starts: list[Any] = [self.guesses[k] for k in members]
        if self.found:
            near = self.apart[members][:, self.found].argmin(axis=1)
            pairs = zip(members.tolist(), near.tolist(), strict=True)
            starts = [self._start(k, self.found[m]) for k, m in pairs]
        solved = solve([self.made[k][0] for k in members], start=starts, **{**self.how, **more})
        for k, motion in zip(members.tolist(), solved, strict=True):
            self.motions[k] = motion
            self.iterations[k] += motion.iterations
            self.seconds[k] += motion.processor_seconds / len(members)
            if self.good(motion):
                self.found.append(k)

    def _start(self, member: int, near: int) -> Solution:
        """What was found of its neighbour, by as much elsewhere as the first guesses are."""
        motion = self.motions[near]
        x = self.guesses[member] + motion.x[1:] - self.guesses[near]
        return replace(motion, x=np.concatenate([motion.x[:1], x]))


def apart(guesses: Array) -> Array:
    """(n, n) rms of the differences of guesses (n, …)."""
    flat = guesses.reshape(len(guesses), -1)
    return np.asarray(cdist(flat, flat) / math.sqrt(flat.shape[1]))


def spread(apart: Array, count: int) -> Steps:
    """So many of things that are (n, n) apart, each next one as far from those before as can be;
    the first one is in the middle."""
    chosen = [int(apart.sum(axis=1).argmin())]
    while len(chosen) < min(count, len(apart)):
        chosen.append(int(apart[:, chosen].min(axis=1).argmax()))
    return np.array(chosen)


def in_a_row(apart: Array) -> Steps:
    """Things that are (n, n) apart in an order in which those that are alike come together: behind
    the first one always the nearest of the rest."""
    rest, row = list(range(1, len(apart))), [0]
    while rest:
        row.append(rest.pop(int(apart[row[-1], rest].argmin())))
    return np.array(row)
