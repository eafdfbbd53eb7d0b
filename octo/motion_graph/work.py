"""What is solved for a graph: pairs of moments that are alike, and what came of each pair."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from octo.checks import Array
from octo.errors import OctoError
from octo.executors import Failed, stopped
from octo.motion_graph.crossing import Crossing, Placement
from octo.motion_graph.neighbours import Neighbours, in_a_row
from octo.motion_graph.similarity import Alignment
from octo.result.solution import Solution
from octo.solver.sqp import Iterate

# N, ‖C‖∞ of a transition, of robots up to 5 kg; of heavier ones in proportion
LAW, LIGHT = 1e-5, 49.0


@dataclass(frozen=True)
class Pair:
    """From a step of one motion to a step of another, or of the same one."""

    one: str
    at: int
    other: str
    to: int


@dataclass(frozen=True, eq=False)
class Batch:
    """Pairs of the same two motions, alike enough that one leads to the other.

    Attributes
    ----------
    how: options of octo.solve.
    """

    crossing: Crossing
    pairs: tuple[Pair, ...]
    how: dict[str, Any]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came of a pair.

    Attributes
    ----------
    found: whether Newton's law and all bounds hold. reason: why not; empty where they do.
    violation: N, ‖C‖∞. effort: ∫‖u‖²dt, N² m² s. torque: largest |u|/limit, 0 without limits.
    distance: m, rms, how unlike both motions are there. yaw, shift: rad, (2,) m, where the second
        motion stands.
    x: (N+1, nx) x_0 … x_N. u: (N, nu). force: (N, c, 3) N.
    """

    pair: Pair
    found: bool
    reason: str
    violation: float
    effort: float
    torque: float
    iterations: int
    seconds: float
    distance: float
    yaw: float
    shift: Array
    x: Array
    u: Array
    force: Array


def work(batch: Batch) -> list[Outcome] | Failed | None:
    """Solve a batch; None where it was told to stop."""
    try:
        return _outcomes(batch)
    except Exception as error:  # a user's term may raise anything
        words = str(error) if isinstance(error, OctoError) else f"{type(error).__name__}: {error}"
        first, last = batch.pairs[0], batch.pairs[-1]
        return Failed(
            f"from {first.one} to {first.other}, steps {first.at} to {first.to} … {last.at} to "
            f"{last.to}: {words}"
        )


def _outcomes(batch: Batch) -> list[Outcome] | None:
    crossing = batch.crossing
    spots = [
        _Spot(pair, *crossing.placed(pair.at, pair.to), crossing.begins(pair.at))
        for pair in batch.pairs
    ]
    made = [crossing.problem(own.pair.at, own.pair.to, own.place, own.begins) for own in spots]
    alike = Neighbours(made, {**batch.how, "callback": _stopped}, _good, stopped)
    motions = alike.solved()
    if motions is None:
        return None
    base = crossing.robot.base_coordinate
    told = zip(spots, motions, alike.iterations, alike.seconds, strict=True)
    return [_outcome(own, motion, base, *spent) for own, motion, *spent in told]


@dataclass(frozen=True, eq=False)
class _Spot:
    """A pair, how alike its motions are, where the second one stands, and where the first one does:
    a problem is seen from there, so that those that differ in place and heading are the same."""

    pair: Pair
    found: Alignment
    place: Placement
    begins: Placement


def _stopped(at: Iterate) -> bool:
    del at
    return stopped()


def _good(motion: Solution) -> bool:
    return not broken(motion)


def _outcome(spot: _Spot, motion: Solution, base: int, iterations: int, seconds: float) -> Outcome:
    why = broken(motion)
    return Outcome(
        spot.pair,
        not why,
        why,
        motion.violation,
        effort_of(motion.u, motion.dt),
        motion.torque_excess,
        int(iterations),
        float(seconds),
        float(spot.found.distance[0, 0]),
        spot.place.yaw,
        np.asarray(spot.place.shift),
        spot.begins.moved(motion.x[1:], base),
        motion.u,
        spot.begins.turned(motion.contact_force),
    )


def effort_of(u: Array, dt: float) -> float:
    """∫‖u‖²dt of torques (N, nu)."""
    return float((u**2).sum()) * dt


def broken(motion: Solution) -> str:
    """Which law of physics or bound does not hold of a motion, by name; empty where all do."""
    if not np.isfinite(motion.x).all():
        return "not finite"
    names = [bound.name for bound in motion.bounds if not bound.held]
    if motion.violation > LAW * max(1.0, motion.weight / LIGHT):
        names.append("Newton's law")
    return ", ".join(names)


def batches_of(
    crossing: Crossing, pairs: Sequence[Pair], size: int, how: dict[str, Any]
) -> list[Batch]:
    """Pairs of two motions, ``size`` at most together, whose moments are alike."""
    if not pairs:
        return []
    rows = math.isqrt(size)
    left = _tiled(crossing, [pair.at for pair in pairs], False, rows)
    reached = _tiled(crossing, [pair.to for pair in pairs], True, size // rows)
    row = sorted(pairs, key=lambda pair: (left[pair.at], reached[pair.to]))
    return [Batch(crossing, tuple(row[k : k + size]), how) for k in range(0, len(row), size)]


def _tiled(crossing: Crossing, moments: Sequence[int], leads: bool, side: int) -> dict[int, int]:
    """The tile of each moment, ``side`` of them in one."""
    own = np.unique(moments)
    row = own[in_a_row(crossing.apart(own, leads))]
    return {int(step): k // side for k, step in enumerate(row)}
