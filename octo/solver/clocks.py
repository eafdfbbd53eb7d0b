"""What a free dt changes beside the unknowns: the numbers of a problem, or of one of its phases."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from octo.checks import Array
from octo.problem.compiled import CompiledProblem
from octo.problem.data import Data, lowered
from octo.problem.phases import Described, Phases
from octo.problem.problem import Problem

AT_END = 1e-6  # relative, within which a duration that was found at the end of its range may be
# of a range, in ratios, by which a search that would begin outside begins inside: from the end
# itself it may run into the wall beyond
INSIDE = 0.01


@dataclass(frozen=True, eq=False)
class Clock:
    """How the numbers of a batch depend on its dt = dt_0 exp(τ): all are linear in dt.

    Attributes
    ----------
    dt: (batch,) s, where τ is zero. shortest, longest: (batch,) s, what is beyond is refused.
    constant, q: of :class:`~octo.problem.data.Data`, there.
    constant_slope, q_slope: by how much they grow with dt, 1/s.
    """

    dt: Array
    shortest: Array
    longest: Array
    constant: Array
    constant_slope: Array
    q: Array
    q_slope: Array

    @classmethod
    def of(cls, compiled: CompiledProblem, beyond: float) -> Clock:
        """Of a batch; ``beyond``: times the longest duration, or the shortest over it."""
        short = {id(one): with_dt(one, 0.5 * one.dt) for one in compiled.problems}
        other = lowered([short[id(one)] for one in compiled.problems], compiled.functions)[1]
        dt, data = np.array([one.dt for one in compiled.problems]), compiled.data
        references = compiled.functions.references

        def slope(name: str) -> Array:
            change = getattr(data, name) - getattr(other, name)
            return np.asarray(change / (0.5 * dt[:, None, None]))

        q_slope = slope("q")
        # scales of terms stay, and what a solver gives the rows is not of the problem
        q_slope[:, :, : len(references.terms)] = q_slope[:, :, references.size :] = 0.0
        ends = np.array([_ends(one) for one in compiled.problems])
        constant = data.constant.copy(), slope("constant")
        numbers = data.q.copy(), q_slope
        return cls(dt, ends[:, 0] / beyond, ends[:, 1] * beyond, *constant, *numbers)

    def select(self, members: Any) -> Clock:
        """Those of some members, by index."""
        return Clock(*(getattr(self, field.name)[members] for field in fields(self)))

    def dt_at(self, tau: Array) -> Array:
        """(batch,) s."""
        return np.asarray(self.dt * np.exp(np.clip(tau, -700.0, 700.0)))

    def put(self, data: Data, place: int, dt: Array) -> None:
        """Write the numbers of steps of ``dt`` (batch,) s over those of ``data``; ``place``: of dt
        among the parameters of FD."""
        more = (dt - self.dt)[:, None, None]
        data.p[:, place] = dt
        data.constant[...] = self.constant + more * self.constant_slope
        if self.q_slope.any():
            moved = self.q_slope != 0.0
            data.q[moved] = (self.q + more * self.q_slope)[moved]


def with_dt(problem: Problem, dt: float) -> Problem:
    """The problem with steps of ``dt`` s, of a cycle with the period that they make."""
    if problem.cycle is None:
        changed = problem.replace(dt=dt)
        if "start" in problem.__dict__:  # of a phase it is that of the first one
            changed.__dict__["start"] = problem.start
        return changed
    period = dt * int(problem.steps) * problem.cycle.rounds
    return problem.replace(cycle=replace(problem.cycle, period=period))


def _ends(problem: Problem) -> tuple[float, float]:
    """(shortest, longest) s of a step of a free duration."""
    assert problem.duration is not None
    count = int(problem.steps) * (1 if problem.cycle is None else problem.cycle.rounds)
    return problem.duration[0] / count, problem.duration[1] / count


def with_times(described: Described, dt: Array) -> Described:
    """The problem, or the phases, with steps of ``dt`` (phases,) s, where these are free."""
    if isinstance(described, Problem):
        return with_dt(described, float(dt[0]))
    pairs = zip(described.problems, dt.tolist(), strict=True)
    made = (one if one.duration is None else with_dt(one, own) for one, own in pairs)
    return described.with_numbers([*made])


def as_long_as(described: Described, intervals: Array | None) -> Described:
    """The same; where its duration is free with what is nearest in its range to that of another
    motion, whose ``intervals`` are (steps,) s, or to its own.

    intervals: of phases those of a motion of as many steps; None, or of another motion, for its
        own.
    """
    if described.duration is None:
        return described
    phases = (described,) if isinstance(described, Problem) else described.problems
    own = wanted = np.array([one.dt for one in phases])
    if intervals is not None and isinstance(described, Problem):
        wanted = np.array([intervals.sum() / int(described.steps)])
    elif isinstance(described, Phases) and (
        intervals is not None and len(intervals) == described.steps
    ):
        wanted = intervals[list(described.first_steps[:-1])]
    pairs = zip(phases, own, strict=True)
    ends = [(dt, dt) if one.duration is None else _ends(one) for one, dt in pairs]
    low, high = np.transpose(ends)
    outside = (wanted < low * (1.0 - AT_END)) | (wanted > high * (1.0 + AT_END))
    inside = (high / low) ** INSIDE
    begun = np.where(outside, np.clip(wanted, low * inside, high / inside), wanted)
    return described if np.array_equal(begun, own) else with_times(described, begun)
