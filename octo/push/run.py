"""From a task to its motion: the walk, the stages of the push, the way to where it begins."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Unpack

import numpy as np

from octo.checks import Array, asked, positive, takes, time_step, whole
from octo.continuation.schedule import early
from octo.goals import Goal
from octo.model.scene import Scene
from octo.motions.budget import Budget
from octo.motions.steady import go_to
from octo.motions.transitions import JOINT, SUMS
from octo.problem.cycle import TIME_STEP
from octo.push.kick import Kick
from octo.push.plan import FRICTION, Plan
from octo.push.task import SPEED, Task
from octo.ranking import best_of
from octo.result.solution import Solution
from octo.solve import LARGEST_SEED, MOST_STARTS, How, Usual, evaluated, solve
from octo.solver.options import SqpOptions
from octo.solver.status import Status
from octo.starts import smooth_noise

LOG = logging.getLogger("octo")

# rad and m, of one iteration of the last stage: of five starts of a box all end as converged or
# acceptable, without it or with 0.05 four
CAP = 0.02
NEAR = 0.05  # ℓ and rad, of where the push begins: no walk leads there


@asked
@takes(Usual)
def push(
    scene: Scene,
    body: str,
    place: Sequence[float],
    seconds: float | None = None,
    *,
    mu: float = 0.6,
    dt: float = TIME_STEP,
    seeds: int = 5,
    seed: int = 0,
    **how: Unpack[How],
) -> Solution:
    """Push an object to a place: the robot walks behind it, pushes, and stands. A ball is kicked.

    Parameters
    ----------
    scene: a robot on level ground, and objects. Where its ``contacts`` are not given, all contact
        spheres of the robot may touch ``body``.
    body: name of the object.
    place: (2,) m, x and y in the world, where the middle of the object gets to.
    seconds: of the push; by default those of a slow walk. The way to the object comes before it. Of
        a ball those of the walk in which a foot meets it; it rolls for as long as it takes.
    mu: friction of all contacts, more than 0.
    dt: s, of one step.
    seeds: starts that differ in the noise of the joints, solved as one batch; ``seed`` is the first
        one's number.
    passes, options, max_iterations, time_limit, tolerance, device, threads, progress, callback: as
        those of :func:`octo.solve`; ``time_limit`` is of the whole motion, ``passes`` are those of
        the strides.

    Returns
    -------
    The best converged of the starts, behind the way to the object; ``starts`` has a record of each.
    The object ends there, turned as it was, and its friction brings it to rest. A ball rolls
    through its place at the last step.

    Raises
    ------
    OctoError: what cannot be pushed is refused; nothing was computed, but that no foot meets a ball
        is known once the walk is found.
    """
    task = Task.of(scene, body, place, mu, time_step(dt))
    whole("seeds", seeds, most=MOST_STARTS)
    whole("seed", seed, 0, LARGEST_SEED)
    time = None if seconds is None else positive("seconds", seconds, "s")
    budget = Budget({name: value for name, value in how.items() if value is not None})
    found = pushed(task, time, seeds, seed, budget)
    return Goal("push", place=task.place.tolist(), body=body).said(found)


def pushed(task: Task, seconds: float | None, seeds: int, seed: int, budget: Budget) -> Solution:
    """The motion of a task: the way to the object, and the best of the pushes."""
    kind = Kick if task.rolls else Plan
    walk = _walk(task, np.array([kind.distance(task), 0.0, 0.0]), seconds, budget)
    if walk.status is Status.INTERRUPTED:
        return walk
    plan = kind(task, walk)
    members: list[Any] = _starts(plan, seeds, seed)
    for number in range(len(plan.stages)):
        members = _solved(plan, number, members, budget)
        if any(one.status is Status.INTERRUPTED for one in members):
            break
    best = best_of([replace(one, seed=seed + k) for k, one in enumerate(members)])
    return _behind(plan, best, budget)


def _walk(task: Task, place: Array, seconds: float | None, budget: Budget) -> Solution:
    """A walk of the robot alone, in the pose in which it pushes."""
    options = budget.left("the walk") | {"law": task.law(FRICTION), "pose": task.leaning}
    speed = SPEED * task.speed
    return go_to(task.robot, place.tolist(), seconds, speed=speed, dt=task.dt, **options)


def _starts(plan: Plan, seeds: int, seed: int) -> list[Array]:
    """First guesses: the walk with the noise of each seed in the joints."""
    first = plan.problem(plan.stages[0])
    made = []
    for k in range(seeds):
        nodes = plan.nodes.copy()
        nodes[1:-1, first.dynamics.actuated] += smooth_noise(first, seed + k)[:-1]
        made.append(nodes)
    return made


def _solved(plan: Plan, number: int, members: Sequence[Any], budget: Budget) -> list[Solution]:
    """A stage of all starts, from where each was after the one before; the last is solved to its
    end, the others need not converge, for the next one begins elsewhere."""
    problem, count = plan.problem(plan.stages[number]), len(plan.stages)
    options = budget.left(f"pushing, stage {number + 1} of {count}") | {"passes": None}
    own = options.get("options") or SqpOptions()
    if number + 1 < count:
        options["options"] = early(replace(own, hessian="dynamics"))
        options["max_iterations"] = min(
            plan.iterations, options.get("max_iterations", plan.iterations)
        )
    else:
        options["options"] = replace(own, cap=min(CAP, own.cap))
    starts = [_moved(one, problem.start) for one in members]
    made = solve([problem] * len(starts), start=starts, **options)
    LOG.info("stage %d: %s", number + 1, ", ".join(one.status.label for one in made))
    return [_after(*pair) for pair in zip(members, made, strict=True)]


def _moved(given: Any, start: Array) -> Any:
    """Nodes (N+1, nx), or a solution with its multipliers, moved so that it begins at ``start``."""
    if isinstance(given, Solution):
        return replace(given, x=given.x + (start - given.x[1]))
    return given + (start - given[0])


def _after(before: Any, made: Solution) -> Solution:
    """A start with what it took before too."""
    if not isinstance(before, Solution):
        return made
    sums = {name: getattr(before, name) + getattr(made, name) for name in SUMS}
    return replace(made, passes=(*before.passes, *made.passes), **sums)


def _behind(plan: Plan, best: Solution, budget: Budget) -> Solution:
    """The push behind the way to where it begins, where the robot is not there yet."""
    task, base = plan.task, plan.base
    begin, stands = best.x[1], task.scene.start_pose
    off = begin[base : base + 2] - stands[base : base + 2]
    yaw = float(stands[base + 3])
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = (off @ np.array([[c, -s], [s, c]])).tolist()
    turn = float(begin[base + 3]) - yaw
    if np.hypot(x, y) < NEAR * task.length and abs(turn) < NEAR:
        return best
    if best.status is Status.INTERRUPTED:
        return best
    way = _walk(task, np.array([x, y, turn]), None, budget)
    nodes = np.tile(begin, (way.steps + 1, 1))
    nodes[:, : task.robot.nx] = way.x[1:]
    nodes[:, base : base + 2] += begin[base : base + 2] - way.x[-1, base : base + 2]
    nodes[:, base + 3] += begin[base + 3] - way.x[-1, base + 3]
    options = budget.left("the way to the object") | {"passes": None}
    clear = solve(plan.approach(nodes), start=nodes, **options)
    both = np.concatenate([clear.x[1:], best.x[2:]])
    whole = plan.problem(plan.stages[-1]).replace(steps=len(both) - 1, x0=both[0], pose=None)
    raw = evaluated(whole, both, Status.JOINED)
    lawful = clear.converged and best.converged and raw.violation <= JOINT * raw.weight
    parts = (way, clear, best)
    spent: dict[str, Any] = {name: sum(getattr(one, name) for one in parts) for name in SUMS}
    kept: dict[str, Any] = {name: getattr(best, name) for name in ("seed", "starts", "passes")}
    return replace(raw, status=Status.JOINED if lawful else Status.STALLED, **kept, **spent)
