"""What is solved for a graph: pairs of moments in batches, and what came of each pair."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from octo.checks import Array
from octo.errors import OctoError
from octo.executors import Failed, stopped
from octo.motion_graph.crossing import Crossing
from octo.result.solution import Solution
from octo.solve import solve
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
    """Pairs of the same two motions, solved as one.

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
    placed = [crossing.placed(pair.at, pair.to) for pair in batch.pairs]
    made = [
        crossing.problem(pair.at, pair.to, place)
        for pair, (_, place) in zip(batch.pairs, placed, strict=True)
    ]
    motions = solve(
        [problem for problem, _ in made],
        start=[guess for _, guess in made],
        callback=_stopped,
        **batch.how,
    )
    if stopped():
        return None
    share = 1.0 / len(motions)
    told = zip(batch.pairs, placed, motions, strict=True)
    return [_outcome(pair, *place, motion, share) for pair, place, motion in told]


def _stopped(at: Iterate) -> bool:
    del at
    return stopped()


def _outcome(pair: Pair, found: Any, place: Any, motion: Solution, share: float) -> Outcome:
    why = broken(motion)
    return Outcome(
        pair,
        not why,
        why,
        motion.violation,
        effort_of(motion.u, motion.dt),
        motion.torque_excess,
        motion.iterations,
        motion.processor_seconds * share,
        float(found.distance[0, 0]),
        place.yaw,
        np.asarray(place.shift),
        motion.x[1:],
        motion.u,
        motion.contact_force,
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
    """Pairs of two motions, ``size`` at a time."""
    return [Batch(crossing, tuple(pairs[k : k + size]), how) for k in range(0, len(pairs), size)]
