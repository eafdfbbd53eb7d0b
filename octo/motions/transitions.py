"""The ways into a stride and out of it, each from several phases or lengths, the best kept; and the
pieces in a row, polished as one problem that begins and ends at rest."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from octo.checks import Array
from octo.model.feet import runs, stances
from octo.motions.budget import Budget, going_on
from octo.motions.path import Path
from octo.result.gait import SHORT
from octo.result.solution import Solution
from octo.solve import evaluated, solve, solve_all
from octo.solver.status import Status

Rank = tuple[int, int, int, float]  # failed, stumbles, near ones, E: the smaller, the better
PHASES = 6  # of the stride, at which it may be entered and left
CHEAP = 1.1  # of the stride's E: a clean way to leave it that costs less is not looked for further
DEAR = 3.0  # of the stride's E: a piece that costs more is none
# of the ways that were found with limits priced, so many are tried with limits that must hold
TRIED = 3
# steps, by which the leaving is tried longer: at other phases of the stride
LONGER = range(-4, 20, 2)
# ℓ and rad: where polishing moves the base by more, strides have given way to standing and a dash
KEEPS = 0.2
JOINT = 2e-7  # mg, what pieces may miss of Newton's law: the solver's own tolerance
# of a solution: what adds up over pieces
SUMS = ("iterations", "factorizations", "setup_seconds", "seconds", "processor_seconds")


@dataclass(frozen=True, eq=False)
class Transition:
    """One way into the stride or out of it."""

    at: int  # the phase at which it is entered, or in how many steps it is left
    motion: Solution
    rank: Rank

    @property
    def clean(self) -> bool:
        """Whether it converged, and without a stumble."""
        return self.rank[:2] == (0, 0)

    @property
    def start(self) -> Solution | None:
        """What to start from where more must hold; None where it led nowhere."""
        return self.motion if self.motion.converged else None


@dataclass(frozen=True, eq=False)
class Pieces:
    """What a journey around one stride is joined of."""

    path: Path
    into: Transition
    out: Transition

    @classmethod
    def of(cls, path: Path, budget: Budget) -> Pieces:
        """The best way in, and the best way out behind it."""
        into = entered(path, budget)
        return cls(path, into, left(path, into.at, budget))

    @property
    def rank(self) -> Rank:
        """Of both together."""
        (a, b, c, energy), (d, e, f, more) = self.into.rank, self.out.rank
        return a + d, b + e, c + f, energy + more

    @property
    def clean(self) -> bool:
        """Whether it is entered and left without a stumble."""
        return self.into.clean and self.out.clean


def entered(path: Path, budget: Budget) -> Transition:
    """The best way from rest into the stride."""
    few = sorted({k * path.phases // PHASES for k in range(PHASES)})
    scouted = _ways_in(path.scout, few, budget.scouting)
    others = sorted(set(range(path.phases)).difference(few))
    if others and not _best(scouted).clean:  # it stumbles at all of these: the phases between them
        scouted += _ways_in(path.scout, others, budget.scouting)
    return _within(path, scouted, lambda one: _ways_in(path, [one.at], budget, one.start))


def left(path: Path, phase: int, budget: Budget) -> Transition:
    """The best way from the stride, entered at ``phase``, to rest."""
    scouted: list[Transition] = []
    lengths = [path.ends + more for more in LONGER]
    for length in [one for one in lengths if one <= path.journey.steps - path.ends]:
        scouted.append(_way_out(path.scout, phase, length, budget.scouting))
        best = _best(scouted)
        if best.clean and best.motion.energy < CHEAP * path.stride.energy:
            break
    return _within(path, scouted, lambda one: [_way_out(path, phase, one.at, budget, one.start)])


def _within(
    path: Path, scouted: list[Transition], held: Callable[[Transition], list[Transition]]
) -> Transition:
    """The best of those that were scouted; where something must hold, of a few of them ``held``."""
    if path.scout is path:
        return _best(scouted)
    found: list[Transition] = []
    for one in sorted(scouted, key=lambda one: one.rank)[:TRIED]:
        found += held(one)
        if _best(found).clean:
            break
    return _best(found)


def _best(found: Sequence[Transition]) -> Transition:
    return min(found, key=lambda one: one.rank)


def _ways_in(
    path: Path, phases: Sequence[int], budget: Budget, start: Solution | None = None
) -> list[Transition]:
    """From rest into the stride at some phases, from a first guess or a start."""
    problems, guesses = zip(*(path.enter(phase) for phase in phases), strict=True)
    starts = guesses if start is None else [start]
    members = solve_all(problems, start=starts, **budget.near("entering it"))
    found = []
    for phase, made in zip(phases, map(going_on, members), strict=True):
        after = path.tiled.normal_force[path.entry(phase) :][: path.count]
        found.append(Transition(phase, made, _rank(made, path.stride, after=after)))
    return found


def _way_out(
    path: Path, phase: int, length: int, budget: Budget, start: Solution | None = None
) -> Transition:
    """From the stride to rest in ``length`` steps, from a first guess or a start."""
    problem, guess = path.leave(phase, length)
    given = guess if start is None else start
    made = going_on(solve(problem, start=given, **budget.near("leaving it")))
    node = path.exit(phase, length)
    before = path.tiled.normal_force[node - path.count : node]
    return Transition(length, made, _rank(made, path.stride, before=before))


def _rank(
    piece: Solution, stride: Solution, before: Array | None = None, after: Array | None = None
) -> Rank:
    """``before``, ``after``: loads (k, c) N of the stride that the piece comes from or leads to."""
    parts = (before, piece.normal_force, after)
    loads = np.concatenate([part for part in parts if part is not None])
    bad = not piece.converged or piece.energy > DEAR * stride.energy
    near = stumbles(loads, piece, SHORT + piece.dt)  # polishing may take a step off
    return (int(bad), stumbles(loads, piece), near, piece.energy)


def stumbles(loads: Array, motion: Solution, least: float = SHORT) -> int:
    """How many stances and swings in ``loads`` (N, c) N are shorter than ``least`` s."""
    states = [state for foot in stances(loads, motion.weight).T for state in (foot, ~foot)]
    lengths = [b - a for state in states for a, b in runs(state, 0, len(loads))]
    return sum(length * motion.dt < least - 1e-9 for length in lengths)


def joined(pieces: Pieces, budget: Budget) -> Solution:
    """The motion, with the iterations and the time of its pieces."""
    path, into, out = pieces.path, pieces.into, pieces.out
    middle = path.between(into.at, out.at)
    nodes = np.concatenate([into.motion.x[1:], middle, out.motion.x[2:]])
    whole = path.rest.replace(x_end=nodes[-1], v_end=np.zeros(path.journey.robot.nx))
    raw = evaluated(whole, nodes, Status.JOINED)
    polished = solve(whole, start=nodes, **budget.near("the whole motion"))
    lawful = raw.violation <= JOINT * raw.weight and all(bound.held for bound in raw.bounds)
    keeps = lawful and polished.status is not Status.INTERRUPTED
    best = raw if keeps and _worse(polished, raw, path.journey.robot.base_coordinate) else polished
    return _counted(best, pieces)


def _worse(polished: Solution, raw: Solution, base: int) -> bool:
    """Whether polishing failed, added stumbles or moved the base (from ``base`` on) too far."""
    away = np.abs(polished.x - raw.x)[:, [base, base + 1, base + 3]].max(axis=0)
    more = stumbles(polished.normal_force, polished) > stumbles(raw.normal_force, raw)
    far = (away > KEEPS * np.array([raw.length, raw.length, 1.0])).any()
    return bool(more or not polished.converged or far)


def _counted(motion: Solution, pieces: Pieces) -> Solution:
    """With the iterations and the time of the pieces."""
    stride = pieces.path.stride
    parts = (stride, pieces.into.motion, pieces.out.motion, motion)
    spent: dict[str, Any] = {name: sum(getattr(part, name) for part in parts) for name in SUMS}
    return replace(motion, seed=stride.seed, passes=(*stride.passes, *motion.passes), **spent)
