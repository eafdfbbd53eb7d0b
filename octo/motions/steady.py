"""``octo.walk``, ``octo.stride`` and ``octo.turn``: what they are called with, checked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Unpack

from octo.checks import Array, asked, instance, number, numbers, positive, takes, time_step, whole
from octo.dynamics.laws import ContactLaw
from octo.goals import Goal
from octo.model.character import Character
from octo.model.terrain import Plane, Terrain
from octo.motions.budget import Budget
from octo.motions.journey import Journey
from octo.motions.search import from_rest_to_rest
from octo.progress import check_progress
from octo.result.solution import Solution
from octo.solve import LARGEST_SEED, MOST_STARTS, How, Usual, settings_of


class Steady(How, total=False):
    """What a motion from rest to rest is described by beside its speed, and how it is solved."""

    dt: float
    period: float | Sequence[float] | None
    starts: int
    seed: int
    terrain: Plane | Terrain | None
    law: ContactLaw | None
    pose: Array | None


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
    return goal.said(_steady(robot, (goal.speed, 0.0), 0.0, seconds, **how))


@asked
@takes(Journey, Usual)
def stride(
    robot: Character, speed: float = 0.5, seconds: float = 10.0, **how: Unpack[Steady]
) -> Solution:
    """Walk sideways, to the left where ``speed`` (m/s) is positive, from rest to rest.

    Parameters
    ----------
    seconds, dt, period, starts: and the others, as those of :func:`walk`.
    """
    goal = Goal("stride", number("speed", speed))
    return goal.said(_steady(robot, (0.0, goal.speed), 0.0, seconds, **how))


@asked
@takes(Journey, Usual)
def turn(
    robot: Character, rate: float = 0.5, seconds: float = 10.0, **how: Unpack[Steady]
) -> Solution:
    """Turn on the spot by ``rate`` rad/s, to the left where positive, from rest to rest.

    Parameters
    ----------
    seconds, dt, period, starts: and the others, as those of :func:`walk`.
    """
    goal = Goal("turn", number("rate", rate))
    return goal.said(_steady(robot, (0.0, 0.0), goal.speed, seconds, **how))


def _steady(
    robot: Character, velocity: tuple[float, float], rate: float, seconds: float, **given: Any
) -> Solution:
    """The motion of a call; what is None of its options ``given`` is left to octo.solve."""
    instance("robot", robot, Character, "a Character: what octo.load and octo.gallery give")
    time_step(given["dt"])
    whole("starts", given["starts"], most=MOST_STARTS)
    whole("seed", given["seed"], 0, LARGEST_SEED)
    if given["period"] is not None:
        numbers("period", given["period"])
    check_progress(given["progress"], given["callback"])
    settings_of(given["options"], given["max_iterations"], given["time_limit"], given["tolerance"])
    options = {k: given.pop(k) for k in How.__annotations__}
    journey = Journey(robot, velocity, rate, positive("seconds", seconds, "s"), **given)
    return from_rest_to_rest(journey, Budget({k: v for k, v in options.items() if v is not None}))
