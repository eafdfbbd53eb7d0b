"""From a journey to its motion: strides are looked for, the best one is entered and left."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from octo.checks import Array
from octo.dynamics.static_pose import inside_limits, over_the_feet
from octo.errors import ProblemError, StaticPoseError
from octo.model.feet import feet_of, touching
from octo.model.terrain import Plane
from octo.motions.budget import Budget, Interrupted, going_on
from octo.motions.journey import Journey
from octo.motions.path import Path, blend, ground_law
from octo.motions.transitions import JOINT, SUMS, TRIED, Pieces, joined
from octo.problem.closure import plane_normal
from octo.problem.compiled import CompiledProblem
from octo.problem.cycle import Cycle
from octo.problem.problem import Problem
from octo.ranking import best_of
from octo.result.gait import flaws
from octo.result.solution import Solution
from octo.solve import evaluated, solve, solve_all
from octo.solver.status import Status
from octo.starts import smooth_noise

LOG = logging.getLogger("octo")

# ℓ: trunks of strides that are higher by more, or lower: a spider's by 0.7 to 1, of eight others by
# 0.3 at most
RISES = 0.4
# of the least E of the strides of that period or a shorter one: strides that cost more are not
# looked at
ODD = 1.25


def from_rest_to_rest(journey: Journey, budget: Budget, scouts: bool = True) -> Solution:
    """The motion of a journey; its ``starts`` has a record of each stride that was tried.

    Where something must hold, strides are looked for with its price first, if ``scouts``, and the
    best of them led to where it holds.

    Raises
    ------
    ProblemError: what must hold does not where the robot stands at the end.
    """
    _check_end(journey)
    if not any((*journey.velocity, journey.rate)):
        return as_one_problem(journey, "it goes nowhere", budget)
    counts, scout = journey.counts(), journey.priced if scouts else journey
    if not counts:
        short = f"{journey.seconds:g} s are too short for a stride between rest and rest"
        return as_one_problem(journey, short, budget)
    try:
        cycles = [scout.cycle(count) for count in counts]
    except ProblemError as error:
        if journey.robot.base != "floating":
            raise
        return as_one_problem(journey, str(error), budget)
    found: list[Solution] = []
    for problem in cycles:
        period = problem.steps * problem.dt * (2 if journey.mirrored else 1)
        options = budget.left(f"a stride of {period:.3g} s")
        found += solve_all(problem, seeds=journey.starts, seed=journey.seed, **options)
        records = tuple(made.report() for made in found)
        if any(made.status is Status.INTERRUPTED for made in found):
            best = min(found, key=lambda made: (not made.converged, made.energy))
            return replace(best, status=Status.INTERRUPTED, starts=records)
        other = standing_as(journey, _good(found))
        if other is not None:
            motion = from_rest_to_rest(other, budget, scouts)
            return replace(motion, starts=records + motion.starts)
    good = sorted(_good(found), key=_quality)
    if not good:
        return as_one_problem(journey, "no stride converged", budget)
    around = _around(journey, good, budget, scout is not journey)
    if around is None:
        motion = from_rest_to_rest(journey, budget, scouts=False)
        return replace(motion, starts=records + motion.starts)
    return replace(around, starts=records)


def _around(
    journey: Journey, strides: Sequence[Solution], budget: Budget, scouted: bool
) -> Solution | None:
    """The motion around the first of these strides, or where that is interrupted strides alone;
    of strides that were ``scouted`` around the first that keeps what must hold, if any."""
    stride: Solution | None = strides[0]
    try:
        if scouted:
            stride = _held(journey, strides, budget)
            if stride is None:
                return None
        assert stride is not None
        stride = _whole_stride(journey, stride, budget)
        return joined(_pieces(journey, stride, budget), budget)
    except Interrupted:
        tiled = (stride or strides[0]).tile(max(1, journey.steps // (2 * strides[0].steps)))
        return replace(tiled, status=Status.INTERRUPTED)


def _held(journey: Journey, strides: Sequence[Solution], budget: Budget) -> Solution | None:
    """The first of these strides that converges where it is to hold what must, from where it is."""
    for scouted in strides[:TRIED]:
        stride = _whole_stride(journey.priced, scouted, budget.scouting)
        assert stride.cycle is not None
        count = round(stride.cycle.period / journey.dt)
        problem = journey.cycle(count).replace(parameters=ground_law(stride))
        if problem.steps != stride.steps:
            problem = _unmirrored(journey, stride)
        made = going_on(solve(problem, start=stride, **budget.near("a stride within limits")))
        if made.converged and made.energy <= ODD * stride.energy:
            parts = {name: getattr(stride, name) + getattr(made, name) for name in SUMS}
            return replace(made, seed=stride.seed, passes=(*stride.passes, *made.passes), **parts)
    return None


def _whole_stride(journey: Journey, stride: Solution, budget: Budget) -> Solution:
    """The stride itself, or solved anew where the mirror image is a little different."""
    assert stride.cycle is not None
    if not stride.cycle.mirrored:
        return stride
    problem = _unmirrored(journey, stride)
    if stride.cycle.asymmetry <= JOINT * stride.weight and _holds(problem, stride.tile(1)):
        return stride
    both = going_on(solve(problem, start=stride.tile(1), **budget.near("the whole stride")))
    if not both.converged or both.energy > ODD * stride.energy:
        return stride
    return replace(both, seed=stride.seed, passes=(*stride.passes, *both.passes))


def _unmirrored(journey: Journey, stride: Solution) -> Problem:
    """The whole of a stride straight ahead, of which a mirrored one is half."""
    assert stride.cycle is not None
    steady = Cycle(speed=stride.cycle.speed, period=stride.cycle.period, mirror=False)
    given = {"costs": journey.terms, "parameters": ground_law(stride)}
    return journey.whole.replace(steps=0, cycle=steady, **given)


def _holds(problem: Problem, motion: Solution) -> bool:
    """Whether a motion keeps the constraints of a problem."""
    if not problem.constraints:
        return True
    return all(own.held for own in evaluated(problem, motion.x[1:], Status.JOINED).bounds)


def _pieces(journey: Journey, stride: Solution, budget: Budget) -> Pieces:
    """From the pose at rest, or where that stumbles from the stride's own mean pose."""
    pieces = Pieces.of(Path(journey, stride), budget)
    if pieces.clean or journey.pose is not None:
        return pieces
    try:
        other = Pieces.of(Path(journey, stride, _mean_pose(journey, stride)), budget)
    except (StaticPoseError, ProblemError):  # it stands nowhere, or not within its limits
        return pieces
    return min(pieces, other, key=lambda one: one.rank)


def standing_as(journey: Journey, strides: Sequence[Solution]) -> Journey | None:
    """The journey of a robot that stands as the best of these strides does, with its length,
    periods and terms; as the best of those in whose mean pose it stands on its feet.

    None where the robot at rest stands about as high, where a pose was given, and where that
    journey has no stride.
    """
    if journey.pose is not None or not strides:
        return None
    good = sorted(strides, key=_quality)
    normal = plane_normal(journey.whole.terrain, journey.whole.values)
    first = journey.robot.base_coordinate
    away = good[0].x[1:, first : first + 3] - journey.whole.start[first : first + 3]
    highest = RISES * journey.whole.length * float(np.linalg.norm(normal))
    if abs(float((away @ normal).mean())) <= highest:
        return None
    for stride in good:
        other = replace(journey, pose=_mean_pose(journey, stride))
        with contextlib.suppress(StaticPoseError):
            if _on_its_feet(other, journey):
                return other if other.counts() else None
    return None


def _on_its_feet(other: Journey, journey: Journey) -> bool:
    """Whether the robot stands on the feet of that journey, and on nothing else of them."""
    robot, terrain = journey.robot, journey.terrain or Plane()
    own, before = (touching(robot, terrain, one.whole.start) for one in (other, journey))
    return set(own) <= set(before) and set(feet_of(robot, own)) == set(feet_of(robot, before))


def _mean_pose(journey: Journey, stride: Solution) -> Array:
    """(nx,) the joints of the stride in the mean, over the feet."""
    joints, pose = journey.robot.actuated, journey.whole.start.copy()
    pose[joints] = stride.tile(1).x[1:-1, joints].mean(axis=0)
    return over_the_feet(journey.robot, inside_limits(journey.robot, pose))


def as_one_problem(journey: Journey, reason: str, budget: Budget) -> Solution:
    """One problem from rest to rest with the natural terms alone, and a line that says so."""
    LOG.warning("%s: solved as one problem, without a stride", reason)
    motion = _one(journey)
    assert motion.end is not None
    ends = (motion.start, motion.end)
    first, last = (np.tile(pose, (journey.steps + 1, 1)) for pose in ends)
    guesses = [blend(first, last) for _ in range(journey.starts)]
    for k, guess in enumerate(guesses):
        guess[1:, motion.dynamics.actuated] += smooth_noise(motion, journey.seed + k)
    members = solve([motion] * journey.starts, start=guesses, **budget.left("one problem"))
    return best_of([replace(made, seed=journey.seed + k) for k, made in enumerate(members)])


def _one(journey: Journey) -> Problem:
    """From rest to rest, and how far."""
    return journey.whole.replace(costs=journey.terms, displacement=journey.way())


def _check_end(journey: Journey) -> None:
    """Refuse what does not hold where the robot stands at the end: before a stride is looked for.

    Raises
    ------
    ProblemError: names the constraint, and what is where.
    """
    if journey.constraints:
        CompiledProblem([_one(journey)])


def _good(strides: Sequence[Solution]) -> list[Solution]:
    """Those that converged and cost no more than ODD of the least E of their period or a shorter
    one, for E falls with the period: others limp, or throw a leg."""
    through = [made for made in strides if made.converged and made.passes[-1]["converged"]]
    kept = []
    for made in through:
        least = min(other.energy for other in through if len(other.u) <= len(made.u))
        kept += [made] if made.energy <= ODD * least else []
    return kept


def _quality(stride: Solution) -> tuple[int, float]:
    """The smaller, the better: flaws of the gait, then the work of the joints on the way."""
    return flaws(stride.gait, stride.length), stride.power
