"""``octo.transition``: from one motion into another, as a motion that obeys the laws of physics."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import Any, Unpack

import numpy as np

from octo.checks import Array, asked, positive, steps_in, takes, whole
from octo.dynamics.laws import ContactLaw
from octo.errors import ProblemError, ValueRangeError
from octo.motion_graph.crossing import Crossing, Placement, laid_end_to_end
from octo.problem.hard import Held, at_every_step, held
from octo.problem.joint_costs import Effort
from octo.result.solution import Solution, solution_of
from octo.shown import Shown
from octo.solve import How, Usual, solve

Given = Solution | str | os.PathLike[str]


@dataclass(frozen=True, eq=False, repr=False)
class Transition(Shown):
    """What :func:`transition` found.

    Attributes
    ----------
    motion: the transition alone, from step ``at`` of the first motion to step ``to`` of the second.
    one, other: the motions, as they were given.
    at, to: steps.
    distance: m, how unlike the two are while it lasts (root mean square over a cloud of points).
    yaw, shift: rad about z, and then (2,) m, by which the second motion is laid where the first
        leads.
    law: of contact, as it was given.
    """

    motion: Solution
    one: Solution
    other: Solution
    at: int
    to: int
    distance: float
    yaw: float
    shift: Array
    law: ContactLaw | None = None

    def __str__(self) -> str:
        dt = self.motion.dt
        return (
            f"from {self.at * dt:.3g} s of one motion to {self.to * dt:.3g} s of another, "
            f"{self.distance:.3g} m apart (rms)\n{self.motion}"
        )

    def joined(self) -> Solution:
        """The first motion until it is left, the transition, and what is left of the second, laid
        where it leads: evaluated as one motion, whose ‖C‖∞ is that of its parts."""
        robot = self.motion.character
        assert robot is not None
        placed = Placement(self.yaw, self.shift)
        after = placed.moved(self.other.x[self.to + 2 :], robot.base_coordinate)
        x = np.concatenate([self.one.x[: self.at + 1], self.motion.x[1:], after])
        return laid_end_to_end(x, self.motion, self.law)


@asked
@takes(Usual)
def transition(
    one: Given,
    other: Given,
    *,
    seconds: float = 1.0,
    at: int | None = None,
    to: int | None = None,
    constraints: Held = "hard",
    goal: str = "feasible",
    law: ContactLaw | None = None,
    **how: Unpack[How],
) -> Transition:
    """Find a way from one motion into another, with both ends fixed in place and velocity (§8.6).

    The second motion is laid where the first one leads: places on the ground and headings do not
    count. The solve starts from a blend of the two.

    Parameters
    ----------
    one, other: Solutions, or the paths of such, of one robot with a floating base on level ground,
        with one dt and one contact law.
    seconds: of the transition, a whole number of their steps.
    at, to: step of the first motion that is left, and of the second that is reached; where None is
        given, those at which the two are most alike while they are crossed (Kovar et al. 2002).
        From a motion into itself it leads back: a loop.
    constraints: what must hold: those of a Problem, or "hard", the limits of the robot as
        :func:`octo.limits` lists them.
    goal: as of :func:`octo.solve`: "feasible" ends once all constraints hold, "optimal" at the way
        of least effort.
    law: of contact, as a Problem's, where the motions have another one than the default.
    passes, options, max_iterations, time_limit, tolerance, device, threads, progress, callback: as
        those of :func:`octo.solve`.

    Raises
    ------
    OctoError: between these motions there is no transition, or an option is refused; nothing was
        computed.
    """
    first, second = solution_of(one), solution_of(other)
    steps = steps_in(positive("seconds", seconds, "s"), first.dt)
    if steps < 4:
        raise ValueRangeError(
            f"seconds is {seconds:g}, must be four steps of {first.dt:g} s or more"
        )
    begun = Crossing(first, second, steps, [Effort()], law=law)
    limits = held(begun.robot, constraints)
    at_every_step(limits, "a transition")
    crossing = replace(begun, constraints=limits)
    left, reached = _moments(crossing, at, to)
    found, placed = crossing.placed(left, reached)
    problem, guess = crossing.problem(left, reached, placed)
    given = {name: value for name, value in how.items() if value is not None}
    options: dict[str, Any] = {"passes": 1, **given}
    motion = solve(problem, start=guess, goal=goal, **options)
    distance = float(found.distance[0, 0])
    return Transition(motion, first, second, left, reached, distance, placed.yaw, placed.shift, law)


def _moments(crossing: Crossing, at: int | None, to: int | None) -> tuple[int, int]:
    """The steps of a transition: those given, or the most alike."""
    for name, step, motion in (("at", at, crossing.one), ("to", to, crossing.other)):
        if step is not None:
            whole(name, step, 0, motion.steps)
    if at is not None and to is not None:
        return int(at), int(to)
    if crossing.steps > min(crossing.one.steps, crossing.other.steps):
        raise ProblemError(f"{_long(crossing)}: give at and to, there they are held still")
    found, leaving, reaching = crossing.similarity()
    rows = np.ones(len(leaving), dtype=bool) if at is None else leaving == at
    columns = np.ones(len(reaching), dtype=bool) if to is None else reaching == to
    if not rows.any() or not columns.any():
        raise ProblemError(f"{_long(crossing)} there: give both at and to")
    asked = rows[:, None] & columns
    if crossing.one is crossing.other and asked.size > 1:  # back: on is the motion itself
        asked &= reaching < leaving[:, None]
        if not asked.any():
            raise ProblemError("no later step of the motion is left for an earlier one: give both")
    distance = np.where(asked, found.distance, np.inf)
    a, b = np.unravel_index(int(np.argmin(distance)), distance.shape)
    return int(leaving[a]), int(reaching[b])


def _long(crossing: Crossing) -> str:
    return (
        f"a transition of {crossing.steps} steps is longer than what is left of the motions, of "
        f"{crossing.one.steps} and {crossing.other.steps} steps"
    )
