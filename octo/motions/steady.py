"""``octo.walk``, ``stride``, ``turn`` and ``go_to``: what they are called with, checked."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, Unpack

from octo.checks import Array, asked, instance, number, numbers, positive, takes, time_step, whole
from octo.dynamics.laws import ContactLaw
from octo.goals import Goal
from octo.model.character import Character
from octo.model.terrain import Ground, World
from octo.motions.budget import Budget
from octo.motions.journey import Journey
from octo.motions.over import over
from octo.motions.search import from_rest_to_rest
from octo.problem.hard import Held, at_every_step, held
from octo.progress import check_progress
from octo.result.solution import Solution
from octo.solve import LARGEST_SEED, MOST_STARTS, How, Usual, settings_of


class Steady(How, total=False):
    """What a motion from rest to rest is described by beside its speed, and how it is solved."""

    dt: float
    period: float | Sequence[float] | None
    starts: int
    seed: int
    terrain: Ground | None
    law: ContactLaw | None
    pose: Array | None
    constraints: Held


@asked
@takes(Journey, Usual)
def walk(
    robot: Character, speed: float = 0.5, seconds: float = 10.0, **how: Unpack[Steady]
) -> Solution:
    """Walk along x, from rest to rest.

    Parameters
    ----------
    speed: m/s, of the whole motion: the strides in the middle are a little faster. Negative is
        backward.
    seconds: s, of the whole motion.
    dt: s, of one step.
    period: s of a stride, or several to try; by default those of the robot's own length.
    starts: of the stride, for each period; ``seed`` is the first one's number.
    terrain, law, pose: as those of a :class:`~octo.problem.problem.Problem`.
    constraints: what must hold at every step, in strides, on the way into them and out of them:
        those of a Problem, or "hard", the limits of the robot as :func:`octo.limits` lists them. A
        limit that is held is not priced beside it.
    passes, options, max_iterations, time_limit, tolerance, device, threads, progress, callback: as
        those of :func:`octo.solve`; ``time_limit`` is of the whole motion, ``passes`` are those of
        the stride.

    Returns
    -------
    The motion, at rest in its first and last state; its ``starts`` has a record of each stride that
    was tried.

    Raises
    ------
    OctoError: in one line that names the field; nothing was computed.
    """
    goal = Goal("walk", number("speed", speed))
    return goal.said(_steady(robot, goal, seconds, **how))


@asked
@takes(Journey, Usual)
def stride(
    robot: Character, speed: float = 0.5, seconds: float = 10.0, **how: Unpack[Steady]
) -> Solution:
    """Walk sideways, to the left where ``speed`` (m/s) is positive, from rest to rest.

    Parameters
    ----------
    seconds, dt, period, starts, constraints: and the others, as those of :func:`walk`.
    """
    goal = Goal("stride", number("speed", speed))
    return goal.said(_steady(robot, goal, seconds, **how))


@asked
@takes(Journey, Usual)
def turn(
    robot: Character, rate: float = 0.5, seconds: float = 10.0, **how: Unpack[Steady]
) -> Solution:
    """Turn on the spot by ``rate`` rad/s, to the left where positive, from rest to rest.

    Parameters
    ----------
    seconds, dt, period, starts, constraints: and the others, as those of :func:`walk`.
    """
    goal = Goal("turn", number("rate", rate))
    return goal.said(_steady(robot, goal, seconds, **how))


@asked
@takes(Journey, Usual)
def go_to(
    robot: Character,
    place: Sequence[float] = (1.0, 0.0, 0.0),
    seconds: float | None = None,
    *,
    speed: float = 0.5,
    **how: Unpack[Steady],
) -> Solution:
    """Go to a place and stand there: from rest to rest, along one arc.

    Parameters
    ----------
    place: (x, y, yaw), seen from where the robot stands: m ahead, m to the left, rad to the left.
        Of yaw the shorter way round is taken: it is a heading, half a turn at most.
    seconds: s, of the whole motion; by default what ``speed`` needs.
    speed: m/s (of a turn rad/s), of the strides, where ``seconds`` are not given.
    dt, period, starts, constraints: and the others, as those of :func:`walk`.

    Returns
    -------
    The motion; its last state is fixed there.
    """
    goal = Goal("to", positive("speed", speed, "m/s"), place=place)
    return goal.said(_steady(robot, goal, seconds, **how))


def _steady(robot: Character, goal: Goal, seconds: float | None, **given: Any) -> Solution:
    """The motion of a call; what is None of its options ``given`` is left to octo.solve."""
    instance("robot", robot, Character, "a Character: what octo.load and octo.gallery give")
    time_step(given["dt"])
    whole("starts", given["starts"], most=MOST_STARTS)
    whole("seed", given["seed"], 0, LARGEST_SEED)
    if given["period"] is not None:
        numbers("period", given["period"])
    check_progress(given["progress"], given["callback"])
    settings_of(given["options"], given["max_iterations"], given["time_limit"], given["tolerance"])
    given["constraints"] = held(robot, given["constraints"])
    at_every_step(given["constraints"], "a motion from rest to rest")
    options = {k: given.pop(k) for k in How.__annotations__}
    if goal.kind == "to":
        time = None if seconds is None else positive("seconds", seconds, "s")
        journey = Journey.to(robot, goal.place, time, goal.speed, **given)
    else:
        rate = goal.speed if goal.kind == "turn" else 0.0
        time = positive("seconds", seconds, "s")
        journey = Journey(robot, goal.velocity[:2], rate, time, **given)
    wanted = {k: v for k, v in options.items() if v is not None}
    budget = Budget(wanted, held=bool(journey.constraints))
    if isinstance(journey.terrain, World):
        level = partial(from_rest_to_rest, budget=budget.scouting)
        return over(journey, journey.terrain, budget, level)
    return from_rest_to_rest(journey, budget)
