"""Where a solve starts from: nodes and multipliers, given, or a pose with smooth noise."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from octo.checks import numbers
from octo.dynamics.evaluate import RobotDynamics
from octo.errors import ShapeError
from octo.model.feet import feet_of, touching
from octo.model.kinematics import body_poses, sphere_centers
from octo.model.mass_matrix import joint_twists
from octo.problem.closure import Closure
from octo.problem.phased import Compiled
from octo.problem.phases import Described, Phases, times_of
from octo.problem.problem import Array, Problem
from octo.result.solution import Solution, solution_of
from octo.solver.bounds import Slacks, joined

# rad and m, of the actuated coordinates: a perfectly symmetric start keeps the solution planar
NOISE = 0.02
NOISE_PERIOD = 0.5  # s, between the knots of the noise
SWINGS = 0.02  # m/rad, by which a joint must move its foot forward to be one that swings it
CYCLE_NOISE = 0.1  # rad and m, of a cycle's first harmonic


class Starter(ABC):
    """What makes the start of a problem, as a learned transition does."""

    @abstractmethod
    def start_of(self, problem: Described) -> Array:
        """x_0 … x_N (N+1, nx), rad and m."""


def first_nodes(problem: Described, seed: int, start: Solution | Starter | Array | None) -> Array:
    """x_{-1} … x_N (N+2, nx): the start held still with smooth noise on the actuated coordinates,
    or what the user gave."""
    if isinstance(problem, Problem) and problem.closure is not None:
        return _first_cycle(problem, problem.closure, seed, start)
    if start is None:
        nodes = np.repeat(problem.start[None], problem.steps + 2, axis=0)
        nodes[2:, problem.dynamics.actuated] += smooth_noise(problem, seed)
    else:
        nodes = _given_nodes(problem, start)
        nodes[1] = problem.start
    nodes[0] = problem.start - problem.dt * problem.start_velocity
    return nodes


def _first_cycle(
    problem: Problem, closure: Closure, seed: int, start: Solution | Starter | Array | None
) -> Array:
    """x_{-1} … x_N (N+2, nx) of a cycle: the start carried along, with noise in the joints."""
    if start is None:
        part = np.arange(-1, problem.steps + 1)[:, None] / problem.steps
        nodes = closure.along(problem.start, problem.steps)
        angle = 2.0 * np.pi * part / (2.0 if closure.mirrored else 1.0)
        a, b = CYCLE_NOISE * np.random.default_rng(seed).standard_normal((2, problem.dynamics.nx))
        swing = fore_and_aft(problem)
        a = np.where(swing != 0.0, np.abs(a) * swing, a)
        if closure.mirror is not None:  # left and right do the same, half a period apart
            a, b = (0.5 * (wave - closure.mirror.matrix @ wave) for wave in (a, b))
        joints = problem.dynamics.actuated
        swings = np.cos(angle) * a + np.sin(angle) * b
        nodes[:, joints] = problem.start[joints] + swings[:, joints]
    else:
        nodes = _given_nodes(problem, start)
    nodes[:2] = nodes[-2:] @ closure.matrix.T + closure.constant
    return nodes


def fore_and_aft(problem: Problem) -> Array:
    """(nx,) the sign with which a joint swings its foot forward while the neighbours of that foot
    swing back; 0 of other joints.

    Neighbours are the foot beside it and the one before it: of four legs those across swing
    together, as in a trot. Starts without this rule pace as often as they trot, at the same E, and
    a pace at speed falls over sideways.
    """
    signs = np.zeros(problem.dynamics.nx)
    if not isinstance(problem.dynamics, RobotDynamics):
        return signs
    robot, x = problem.dynamics.character, problem.start
    feet = touching(robot, problem.dynamics.terrain, problem.setting.x0)
    centers, twists = sphere_centers(robot, x), joint_twists(robot, x)
    heading = body_poses(robot, x)[0][robot.base_body]
    place = (centers[feet] - centers[feet].mean(axis=0)) @ heading  # fore, left, up
    for side in (1.0, -1.0):
        beside = [k for k in range(len(feet)) if side * place[k, 1] > 0.0]
        row = sorted(beside, key=lambda k: place[k, 0])
        bodies = feet_of(robot, (feet[k] for k in row))
        for k in row:
            body = robot.contacts[feet[k]].body
            step = side * (-1.0) ** bodies.index(body)
            for j in set(robot.path[body]).intersection(robot.actuated.tolist()):
                moved = twists[j, 3:] + np.cross(twists[j, :3], centers[feet[k]])
                forward = moved @ heading[:, 0]
                signs[j] = step * np.sign(forward) if abs(forward) > SWINGS else signs[j]
    return signs


def _given_nodes(problem: Described, start: Solution | Starter | Array) -> Array:
    """x_0 (twice) … x_N (N+2, nx) that the user gave."""
    if isinstance(start, Starter):
        start = start.start_of(problem)
    given = numbers("start", start.x[1:] if isinstance(start, Solution) else start)
    if given.ndim != 2 or given.shape[1] != problem.dynamics.nx or len(given) < 2:
        rows = f"(N+1, {problem.dynamics.nx}), one row for each of two moments or more"
        raise ShapeError("start", given.shape, rows)
    before = start.times if isinstance(start, Solution) and start.phases else None
    after = problem.times if isinstance(problem, Phases) else None
    given = resampled(given, problem.steps, before, after)
    return np.concatenate([given[:1], given])


def resampled(
    nodes: Array, steps: int, before: Array | None = None, after: Array | None = None
) -> Array:
    """Nodes (M+1, nx) as (steps+1, nx): the same motion from its first to its last, on a natural
    cubic spline.

    before, after: when the nodes are and when they are to be, of any unit and from 0 on; by default
        at even times.
    """
    if len(nodes) == steps + 1:
        return nodes
    given, wanted = (
        np.linspace(0.0, 1.0, count) if times is None else times / times[-1]
        for times, count in ((before, len(nodes)), (after, steps + 1))
    )
    spline = CubicSpline(given, nodes, axis=0, bc_type="natural")
    return np.asarray(spline(wanted))


def smooth_noise(problem: Described, seed: int) -> Array:
    """(N, nu) rad and m: a cubic spline through random knots, zero at the start; the same for the
    same seed."""
    times = times_of(problem)
    duration = float(times[-1])
    knots = max(3, int(np.ceil(duration / NOISE_PERIOD)) + 1)
    values = NOISE * np.random.default_rng(seed).standard_normal((knots, problem.dynamics.nu))
    values[0] = 0.0
    return np.asarray(CubicSpline(np.linspace(0.0, duration, knots), values, axis=0)(times[1:]))


def first_multipliers(
    starts: Sequence[Solution | Starter | Array | None], compiled: Compiled
) -> Array | None:
    """Those of warm starts of the same shape, zero for other members."""
    found = np.zeros((len(starts), compiled.K, compiled.ma))
    warm = False
    for k, start in enumerate(starts):
        if isinstance(start, Solution) and start.multipliers.shape == found.shape[1:]:
            found[k], warm = start.multipliers, True
    return found if warm else None


def first_slacks(
    starts: Sequence[Solution | Starter | Array | None], compiled: Compiled
) -> Slacks | None:
    """Those of warm starts with as many rows, over the steps of the problem; None where a member
    has none."""
    steps, rows = compiled.row_bounds[0].shape[1:]
    found = []
    for start in starts:
        known = start.slacks if isinstance(start, Solution) else {}
        if not known or known["s"].shape[1] != rows:
            return None
        before = len(known["s"])
        scale = before / steps  # E is a mean over the steps
        lower, upper, equal = (
            scale * _over(known[name], steps)[None] for name in ("lower", "upper", "equal")
        )
        s = _over(known["s"], steps)[None]
        found.append(Slacks(s, lower, upper, equal, scale * known["mu"]))
    return joined(found)


def _over(values: Array, steps: int) -> Array:
    """What is known of each step (M, k), at the middles of others (steps, k)."""
    if len(values) == steps:
        return values.copy()
    middles, own = (np.arange(count) + 0.5 for count in (steps, len(values)))
    at, known = middles / steps, own / len(values)
    return np.stack([np.interp(at, known, column) for column in values.T], axis=1)


def starts_of(
    start: Any, problems: Sequence[Described], seeds: int
) -> list[Solution | Starter | Array | None]:
    """The start of each member: a list has one for each problem."""
    if not isinstance(start, (list, tuple)):
        return [_opened(start)] * (len(problems) * seeds)
    if len(start) != len(problems):
        raise ShapeError("start", (len(start),), f"({len(problems)},): one for each problem")
    return [one for one in map(_opened, start) for _ in range(seeds)]


def _opened(start: Any) -> Any:
    """What the user gave, or the solution at a path."""
    return solution_of(start) if isinstance(start, (str, os.PathLike)) else start
