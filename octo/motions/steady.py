"""``octo.walk``, ``octo.stride`` and ``octo.turn``: what they are called with, checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from octo.checks import Array, asked, number, numbers, positive, time_step, whole
from octo.dynamics.laws import ContactLaw
from octo.errors import ProblemError, said
from octo.goals import Goal
from octo.model.character import Character
from octo.model.terrain import Plane, Terrain
from octo.motions.budget import Budget
from octo.motions.journey import STARTS, Journey
from octo.motions.search import from_rest_to_rest
from octo.problem.cycle import TIME_STEP
from octo.progress import check_progress
from octo.result.solution import Solution
from octo.solve import LARGEST_SEED, MOST_STARTS, settings_of
from octo.solver.options import SqpOptions
from octo.solver.sqp import Iterate


@asked
def walk(
    robot: Character,
    speed: float = 0.5,
    seconds: float = 10.0,
    *,
    dt: float = TIME_STEP,
    period: float | Sequence[float] | None = None,
    starts: int = STARTS,
    seed: int = 0,
    terrain: Plane | Terrain | None = None,
    law: ContactLaw | None = None,
    pose: Array | None = None,
    passes: int | None = None,
    options: SqpOptions | None = None,
    max_iterations: int | None = None,
    time_limit: float | None = None,
    tolerance: float | None = None,
    device: str = "auto",
    threads: int = 1,
    progress: bool | str = False,
    callback: Callable[[Iterate], bool | None] | None = None,
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
    given = locals()
    goal = Goal("walk", number("speed", speed))
    return goal.said(_steady(given, (goal.speed, 0.0), 0.0))


@asked
def stride(
    robot: Character,
    speed: float = 0.5,
    seconds: float = 10.0,
    *,
    dt: float = TIME_STEP,
    period: float | Sequence[float] | None = None,
    starts: int = STARTS,
    seed: int = 0,
    terrain: Plane | Terrain | None = None,
    law: ContactLaw | None = None,
    pose: Array | None = None,
    passes: int | None = None,
    options: SqpOptions | None = None,
    max_iterations: int | None = None,
    time_limit: float | None = None,
    tolerance: float | None = None,
    device: str = "auto",
    threads: int = 1,
    progress: bool | str = False,
    callback: Callable[[Iterate], bool | None] | None = None,
) -> Solution:
    """Walk sideways, to the left where ``speed`` (m/s) is positive, from rest to rest.

    Parameters
    ----------
    seconds, dt, period, starts: and the others, as those of :func:`walk`.
    """
    given = locals()
    goal = Goal("stride", number("speed", speed))
    return goal.said(_steady(given, (0.0, goal.speed), 0.0))


@asked
def turn(
    robot: Character,
    rate: float = 0.5,
    seconds: float = 10.0,
    *,
    dt: float = TIME_STEP,
    period: float | Sequence[float] | None = None,
    starts: int = STARTS,
    seed: int = 0,
    terrain: Plane | Terrain | None = None,
    law: ContactLaw | None = None,
    pose: Array | None = None,
    passes: int | None = None,
    options: SqpOptions | None = None,
    max_iterations: int | None = None,
    time_limit: float | None = None,
    tolerance: float | None = None,
    device: str = "auto",
    threads: int = 1,
    progress: bool | str = False,
    callback: Callable[[Iterate], bool | None] | None = None,
) -> Solution:
    """Turn on the spot by ``rate`` rad/s, to the left where positive, from rest to rest.

    Parameters
    ----------
    seconds, dt, period, starts: and the others, as those of :func:`walk`.
    """
    given = locals()
    goal = Goal("turn", number("rate", rate))
    return goal.said(_steady(given, (0.0, 0.0), goal.speed))


# fields of a Journey; other arguments are octo.solve's
OWN = ("dt", "period", "starts", "seed", "terrain", "law", "pose")


def _steady(given: Mapping[str, Any], velocity: tuple[float, float], rate: float) -> Solution:
    """The motion of a call with the arguments ``given``; what is None is left to octo.solve."""
    robot, seconds = given["robot"], given["seconds"]
    if not isinstance(robot, Character):
        raise ProblemError(
            f"robot is {said(robot)}, must be a Character: what octo.load and octo.gallery give"
        )
    time_step(given["dt"])
    whole("starts", given["starts"], most=MOST_STARTS)
    whole("seed", given["seed"], 0, LARGEST_SEED)
    if given["period"] is not None:
        numbers("period", given["period"])
    check_progress(given["progress"], given["callback"])
    settings_of(given["options"], given["max_iterations"], given["time_limit"], given["tolerance"])
    own = {name: given[name] for name in OWN}
    others = set(given).difference(OWN, ("robot", "speed", "rate", "seconds"))
    options = {name: given[name] for name in others if given[name] is not None}
    journey = Journey(robot, velocity, rate, positive("seconds", seconds, "s"), **own)
    return from_rest_to_rest(journey, Budget(options))
