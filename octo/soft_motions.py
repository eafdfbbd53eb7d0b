"""A soft body jumps, rolls or crawls (§3.3, Fig. 2), from rest to rest; no contact is named.

The terms are few: where it ends (and, of a jump, where its top is), that it comes to rest, and
effort; what the motors of the modes may do is a limit that holds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Unpack

import casadi as ca
import numpy as np

from octo.checks import Array, asked, instance, number, one_of, positive, steps_in, takes, whole
from octo.costs import At, Cost, CustomCost, Effort
from octo.dynamics.laws import ContactLaw
from octo.dynamics.simulate import Motion, simulate
from octo.errors import ProblemError, ValueRangeError
from octo.model.terrain import ADDRESS, Ground
from octo.problem.asked import Asked
from octo.problem.limits import TorqueLimits
from octo.problem.problem import Problem
from octo.ranking import best_of
from octo.result.even import even
from octo.result.solution import Solution
from octo.soft.body import Body
from octo.soft.dynamics import SoftDynamics
from octo.solve import LARGEST_SEED, MOST_STARTS, How, Usual, solve

LIMIT = 15.0  # g√m, of each motor
EFFORT = 1e-3  # weight
AT_REST = 0.075  # of the whole time, at its end: it stays where it came to
ENDING, STILL, LOW, AHEAD = 5.0, 0.3, 2.5, 0.5  # weights, of what is in parts of the body's size
RISE = 0.42  # of the body's size, of a jump
FARTHEST = 100.0  # sizes of the body, that it gets to
SWING = 0.02  # size·√m, of the modes of a first guess but the first
WHOLE = 1e-6  # seconds/dt may be that far from a whole number
LEAST = 8  # steps
SPRING, DAMPER = 3000.0, 30.0  # rad²/s² and 1/s, of a replay


# how far along x each goes by default, m
TASKS: dict[str, Callable[[Body], float]] = {
    "jump": lambda body: -float(body.size[0]),
    "roll": lambda body: 2.5 * float(body.size.max()),
    "crawl": lambda body: 5.0 / 6.0 * float(body.size[0]),
}


@asked
@takes(Usual)
def soft_motion(
    body: Body,
    task: str = "jump",
    distance: float | None = None,
    *,
    height: float | None = None,
    seconds: float = 3.0,
    dt: float = 0.025,
    limit: float | None = None,
    terrain: Ground | None = None,
    law: ContactLaw | None = None,
    seeds: int = 1,
    seed: int = 0,
    start: Solution | Array | None = None,
    **how: Unpack[How],
) -> Solution:
    """Find a motion of a soft body from rest to rest.

    Parameters
    ----------
    body: an :class:`octo.soft.Body`.
    task: "jump", "roll" or "crawl": it leaves the ground, it turns as a ball does, or it stays low
        and turns little.
    distance: m along x, negative to the left; by default a jump goes its own length to the left, a
        roll 2.5 of its sizes and a crawl five sixths of its length to the right.
    height: m, that a jump rises by half way; by default 0.42 of the body's size.
    seconds: of the whole motion. dt: s.
    limit: N kg^-½, the most that the motor of any mode does; by default 15 g√m.
    terrain, law: as those of :class:`octo.soft.SoftDynamics`.
    seeds: starts, solved as one batch; ``seed`` is the number of the first.
    start, passes, options, max_iterations, time_limit, tolerance, device, threads, progress,
        callback: as those of :func:`octo.solve`.

    Returns
    -------
    The best converged of the starts; ``starts`` has a record of each. ``solution.soft.surface``
    gives the points of the surface.

    Raises
    ------
    OctoError: what is not possible is refused; nothing was computed.
    """
    where: Any = {"height": height, "limit": limit, "terrain": terrain, "law": law}
    course = soft_course(body, task, distance, seconds=seconds, dt=dt, **where)
    return solve_soft(course, seeds=seeds, seed=seed, start=start, **how)


@dataclass(frozen=True)
class Course:
    """A problem, and what is asked of its motion.

    Attributes
    ----------
    task: its name. way: m along x. rise: m, that a jump is higher half way than at its start; 0 of
        others. end: m, z of the frame where it ends.
    """

    problem: Problem
    task: str
    way: float
    rise: float
    end: float

    def said(self, solution: Solution) -> Solution:
        """The solution with what is asked in place of what its terms ask for."""
        moved = solution.com - solution.com[0]
        found, wanted, what = [moved[-1, 0]], [self.way], "the body ends ahead of its start by"
        if self.rise:
            what = "the body ends ahead of its start and is higher half way by"
            half = moved[self.problem.steps // 2, 2]
            found, wanted = [*found, half], [self.way, self.rise]
        own = Asked.of(f"goal {self.task}", what, found, wanted, "m", each=True)
        return replace(solution, asked=(own,))

    def guess(self, seed: int) -> Array | None:
        """x_0 … x_N (N+1, n) of a rigid ball that rolls; for each seed but 0 its modes swing once,
        each time by another amount. None of other tasks, which begin as octo.solve does."""
        if self.task != "roll":
            return None
        steps, at = self.problem.steps, self.problem.start
        s = np.linspace(0.0, 1.0, steps + 1)
        guess = np.tile(at, (steps + 1, 1))
        guess[:, 0] += self.way * (3.0 * s**2 - 2.0 * s**3)
        guess[:, 2] += (self.end - at[2]) * (guess[:, 0] - at[0]) / (self.way or 1.0)
        guess[:, 5] += (guess[:, 0] - at[0]) / self.problem.length
        assert isinstance(self.problem.dynamics, SoftDynamics)
        body = self.problem.dynamics.body
        largest = SWING * float(body.size.max()) * np.sqrt(body.mass)
        swing = largest * np.random.default_rng(seed).standard_normal(len(at) - 6)
        guess[:, 6:] += (seed != 0) * np.outer(np.sin(np.pi * s), swing)
        return guess


def soft_course(
    body: Body,
    task: str = "jump",
    distance: float | None = None,
    *,
    height: float | None = None,
    seconds: float = 3.0,
    dt: float = 0.025,
    limit: float | None = None,
    terrain: Ground | None = None,
    law: ContactLaw | None = None,
) -> Course:
    """Describe a motion; the parameters are those of :func:`soft_motion`.

    Raises
    ------
    OctoError: names the argument and what is allowed.
    """
    instance("body", body, Body, "an octo.soft.Body, such as octo.soft.ball()")
    one_of("task", task, TASKS)
    size = float(body.size.max())
    way = TASKS[task](body) if distance is None else number("distance", distance)
    if not abs(way) <= FARTHEST * size:
        raise ValueRangeError(f"distance is {way:g} m, must be at most {FARTHEST * size:g} in size")
    if height is not None and task != "jump":
        raise ProblemError(f"height is {height!r}, must be left out of a {task}: it is of a jump")
    rise = RISE * size if height is None else positive("height", height, "m")
    steps = steps_in(positive("seconds", seconds, "s"), positive("dt", dt, "s"))
    if abs(seconds / dt - steps) > WHOLE:
        raise ValueRangeError(f"seconds/dt is {seconds / dt:.9g}, must be whole")
    if steps < LEAST:
        raise ValueRangeError(f"seconds is {seconds:g}, must be at least {LEAST} steps of {dt:g} s")
    # the innermost angle of the chart is the one that it may turn by without end
    dynamics = SoftDynamics(body, law, terrain, chart="zxy" if task == "roll" else "zyx")
    p = dynamics.layout.pack(dt=dt)
    at = dynamics.rest(p)
    there = at + np.eye(dynamics.nx)[0] * way
    fall = [dynamics.on_ground(p, one)[2] - one[2] for one in (at, there)]
    end = there[:3] + [0.0, 0.0, fall[1] - fall[0]]  # as deep in the ground as at the start
    times = np.asarray(dt * np.arange(1, steps + 1), dtype=float)
    costs = _costs(task, dynamics, at, end, rise, times)
    most = LIMIT * dynamics.effort(1.0) if limit is None else positive("limit", limit, "N kg^-½")
    given: dict[str, Any] = {"costs": costs, "constraints": [TorqueLimits(most)], "x0": at}
    problem = Problem(dynamics, steps=steps, dt=dt, **given)
    half = rise + 0.5 * (end[2] - at[2]) if task == "jump" else 0.0
    return Course(problem, task, way, float(half), float(end[2]))


def _costs(
    task: str, dynamics: SoftDynamics, at: Array, end: Array, rise: float, times: Array
) -> list[Cost]:
    """The terms of a motion from rest at ``at`` (n,) to rest at ``end`` (3,) m, at times (N,) s."""
    size = float(dynamics.body.size.max())
    ends = At(times[-1 - int(AT_REST * len(times)) :])
    scale = np.array([1.0 / size])
    costs: list[Cost] = [CustomCost(_place, {"target": end, "scale": scale}, name="End", at=ends)]
    if task == "jump":
        top = {"target": 0.5 * (at[:3] + end) + [0.0, 0.0, rise], "scale": scale}
        costs.append(CustomCost(_place, top, name="Top", at=At(times[len(times) // 2 - 1])))
    else:
        way = float(end[0] - at[0])
        slope = np.array([(end[2] - at[2]) / way if way else 0.0])
        low = {"start": at[:3], "slope": slope, "scale": scale}
        costs.append(CustomCost(_low, low, name="Low"))
    if task == "roll":
        rolled = {"radius": np.array([dynamics.length(at)]), "start": at[:1]}
        costs.append(CustomCost(_rolled, rolled, name="Rolled"))
    if task == "crawl":
        costs.append(CustomCost(_ahead, name="Ahead"))
    rates = np.concatenate([np.full(3, 1 / size), np.ones(3), np.full(dynamics.nx - 6, 1 / size)])
    rates[6:] /= np.sqrt(dynamics.body.mass)
    return [
        *costs,
        CustomCost(_still, {"scale": rates}, name="Still", at="last"),
        Effort(weight=EFFORT),
    ]


def solve_soft(
    course: Course,
    *,
    seeds: int = 1,
    seed: int = 0,
    start: Solution | Array | None = None,
    **options: Any,
) -> Solution:
    """Solve what :func:`soft_course` describes: :func:`octo.solve`, a roll from first guesses that
    turn."""
    whole("seeds", seeds, most=MOST_STARTS)
    whole("seed", seed, 0, LARGEST_SEED)
    guesses: Any = [course.guess(own) for own in range(seed, seed + seeds)]
    if start is not None or guesses[0] is None:
        found = solve(course.problem, start=start, seeds=seeds, seed=seed, **options)
        return course.said(found)
    members = solve([course.problem] * seeds, start=guesses, **options)
    return course.said(best_of([replace(m, seed=seed + k) for k, m in enumerate(members)]))


def soft_replay(
    plan: Solution,
    dynamics: SoftDynamics | None = None,
    times: int = 10,
    *,
    stiffness: float = SPRING,
    damping: float = DAMPER,
) -> Motion:
    """Play a plan back in octo's simulator, in steps that are shorter: what its motors do, and
    springs and dampers that hold the modes to those of the plan.

    Parameters
    ----------
    plan: of :func:`soft_motion`.
    dynamics: what it was planned with; by default the body on level ground, or the plan's world,
        with octo's own law.
    times: how many steps a step of the plan becomes.
    stiffness, damping: rad²/s² and 1/s, of each mode that has a motor; 0 leaves the motors alone
        with the plan.

    Returns
    -------
    Its x[1::times] are at the moments of plan.x[1:].

    Raises
    ------
    ProblemError: not the motion of a soft body, or of another one, or on a ground that dynamics
        must be given for. ValueRangeError: fewer than one step, or negative gains.
    """
    instance("plan", plan, Solution, "a Solution, such as octo.soft_motion gives")
    plan = even(plan)
    dynamics = _planned_with(plan, dynamics)
    own = {
        name: value
        for name, value in plan.parameters.items()
        if name not in ("dt", ADDRESS) and not name.startswith("terrain.")
    }
    count, modes = whole("times", times), dynamics.actuated
    gains = number("stiffness", stiffness), number("damping", damping)
    if min(gains) < 0.0:
        raise ValueRangeError(f"stiffness and damping are {gains}, must be at least 0")

    def controls(t: float, q: Array, v: Array) -> Array:
        place = t / plan.dt
        i = min(int(place + WHOLE), plan.steps - 1)
        at = plan.x[i + 1] + (place - i) * (plan.x[i + 2] - plan.x[i + 1])
        springs = gains[0] * (at - q) + gains[1] * (plan.v[i + 1] - v)
        return np.asarray(plan.u[i] + springs[modes])

    return simulate(
        dynamics,
        plan.x[1],
        plan.v[0],
        controls,
        steps=count * plan.steps,
        dt=plan.dt / count,
        parameters=own,
    )


def _planned_with(plan: Solution, dynamics: SoftDynamics | None) -> SoftDynamics:
    """The dynamics that a plan is played back with.

    Raises
    ------
    ProblemError: not those of the plan.
    """
    soft = plan.soft
    if soft is None:
        raise ProblemError(f"plan is of {plan.name!r}, must be the motion of a soft body")
    if dynamics is None:
        given: dict[str, Any] = {"actuated": soft.actuated, "chart": soft.chart}
        dynamics = SoftDynamics(soft.body, terrain=plan.world, **given)
    instance("dynamics", dynamics, SoftDynamics, "an octo.soft.SoftDynamics")
    if not dynamics.coordinates.same_as(soft):
        raise ProblemError(
            "dynamics have another body, chart or other motors than the plan, must have the same"
        )
    if set(plan.parameters) != set(dynamics.layout.names):
        raise ProblemError(
            "the plan is of another law or ground than dynamics, which must be what it was "
            "planned with: give dynamics"
        )
    return dynamics


def _place(step: Any, p: Any) -> ca.SX:
    return ENDING * p["scale"] * (step.x_next[:3] - p["target"])


def _still(step: Any, p: Any) -> ca.SX:
    return STILL * p["scale"] * (step.x_next - step.x) / step.dt


def _low(step: Any, p: Any) -> ca.SX:
    above = step.x_next[2] - p["start"][2] - p["slope"] * (step.x_next[0] - p["start"][0])
    return LOW * p["scale"] * above


def _ahead(step: Any, _: Any) -> ca.SX:
    return AHEAD * step.x_next[3:6]


def _rolled(step: Any, p: Any) -> ca.SX:
    return step.x_next[5] - (step.x_next[0] - p["start"]) / p["radius"]
