"""A jump from rest to rest: crouch, push, flight, landing, standing.

It is solved like any other motion (both ends are fixed, and the centre of mass is to be at the top
half way); what it needs beside that is a first guess that leaves the ground.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Unpack

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from octo.checks import asked, instance, number, positive, steps_in, takes, whole
from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.laws import ContactLaw
from octo.dynamics.static_pose import static_pose
from octo.errors import ProblemError, ValueRangeError
from octo.goals import Goal
from octo.model.character import Character
from octo.model.feet import touching, toward
from octo.model.kinematics import sphere_centers
from octo.model.terrain import Ground
from octo.problem import presets
from octo.problem.body_costs import CenterOfMassDisplacement
from octo.problem.contact_costs import FootLift, LoadSharing
from octo.problem.costs import Cost
from octo.problem.hard import Held, beside, held
from octo.problem.joint_costs import Effort
from octo.problem.problem import Array, Problem
from octo.ranking import best_of
from octo.result.solution import Solution
from octo.solve import LARGEST_SEED, MOST_STARTS, How, Usual, solve
from octo.starts import smooth_noise

TOP = 30.0  # weight of the place at the top: it is missed by millimetres
AIR = 30.0  # weight of (f_n/mg)² in flight …
FLOWN = 0.85  # … which is this part of the ballistic one: feet leave later and land earlier
PLANTED = 30.0  # weight of (h/ℓ)² of feet on the ground, counted from a height of …
LIFT = 0.03  # … ℓ: without it a robot that lands badly hops once more
LANDED = 1.2  # of the ballistic flight: before and after it feet are on the ground
FORCE_RATE = 0.5  # weights of a jump in place of a walk's: forces grow softly …
LOAD_SHARING = 0.1  # … and may be large for a moment
DEPTHS = (0.4, 0.3, 0.5)  # ℓ, of the crouch, one start after the other
SLOW = 2.5  # √(ℓ/g), from standing to the bottom of the crouch, and back after the landing
LEAST = 1.0  # √(ℓ/g), the shortest of these
REST = 1.0  # √(ℓ/g), at rest before and after
TUCK = 0.15  # ℓ, by which the feet of the first guess are drawn up at the top
REACH = 0.02  # rad and m, kept from the joints' limits in the first guess


@asked
@takes(Usual)
def jump(
    robot: Character,
    height: float = 0.2,
    distance: float = 0.5,
    *,
    seconds: float | None = None,
    dt: float = 0.02,
    terrain: Ground | None = None,
    law: ContactLaw | None = None,
    pose: Array | None = None,
    constraints: Held = (),
    seeds: int = 5,
    seed: int = 0,
    start: Solution | Array | None = None,
    **how: Unpack[How],
) -> Solution:
    """Find a jump that starts at rest, lands and stands.

    Parameters
    ----------
    height: m, gained by the centre of mass from its start to the top.
    distance: m along x, from where it stands to where it stands afterwards; negative for backwards.
    seconds: of the whole motion, the top in the middle; by default what a slow crouch and landing
        need.
    dt: s. terrain, law, pose: as those of a :class:`~octo.problem.problem.Problem`.
    constraints: what must hold: those of a Problem, or "hard", the limits of the robot as
        :func:`octo.limits` lists them. A limit that is held is not priced beside it.
    seeds: starts that differ in the depth of the crouch and in noise, solved as one batch;
        ``seed`` is the number of the first.
    start, passes, options, max_iterations, time_limit, tolerance, device, threads, progress,
        callback: as those of :func:`octo.solve`.

    Returns
    -------
    The best converged of the starts; ``starts`` has a record of each.

    Raises
    ------
    OctoError: what cannot be a jump of this robot is refused; nothing was computed.
    """
    where: Any = {"terrain": terrain, "law": law, "pose": pose, "constraints": constraints}
    problem = jump_problem(robot, height, distance, seconds=seconds, dt=dt, **where)
    solution = solve_jump(problem, seeds=seeds, seed=seed, start=start, **how)
    return Goal("jump", distance=distance, height=height).said(solution)


def jump_problem(
    robot: Character,
    height: float = 0.2,
    distance: float = 0.5,
    *,
    seconds: float | None = None,
    dt: float = 0.02,
    terrain: Ground | None = None,
    law: ContactLaw | None = None,
    pose: Array | None = None,
    constraints: Held = (),
) -> Problem:
    """Describe a jump; the parameters are those of :func:`jump`.

    Raises
    ------
    ProblemError: the robot cannot jump. ValueRangeError: height, distance, seconds or dt.
    """
    instance("robot", robot, Character, "a Character: what octo.load gives")
    height = positive("height", height, "m")
    distance = number("distance", distance)
    cannot = f"robot {robot.name!r} cannot jump:"
    if robot.base != "floating" or robot.nu == 0:
        raise ProblemError(f"{cannot} its base must be floating, and a joint actuated")
    plain = Problem(robot, steps=3, dt=dt, costs=[Effort()], terrain=terrain, law=law, pose=pose)
    assert isinstance(plain.dynamics, RobotDynamics)
    feet = touching(robot, plain.dynamics.terrain, plain.setting.x0)
    if not feet:
        raise ProblemError(f"{cannot} none of its contacts is on the ground")
    moved = plain.start.copy()
    moved[slide(robot, 0)] += distance
    landed = static_pose(plain.dynamics, plain.p, moved)
    rise = float(np.sqrt(2.0 * height / plain.gravity))  # s
    steps = _steps(plain, height, rise, seconds)
    when = dt * np.abs(np.arange(1, steps + 1) - steps // 2)  # (N,) s, to or from the top
    top = np.where(when < 0.5 * dt, TOP * steps, 0.0)
    air = np.where(when < FLOWN * rise, AIR, 0.0)
    planted = np.where(when > LANDED * rise, PLANTED / plain.length**2, 0.0)
    above = (0.5 * distance, 0.0, height)
    costs: list[Cost] = [
        CenterOfMassDisplacement(displacement=above, weight=top, name="Top"),
        LoadSharing(weight=air, name="Flight"),
        FootLift(weight=planted, height=LIFT * plain.length, name="Planted"),
        *presets.natural(length=plain.length),
    ]
    weights = {"ForceRate": FORCE_RATE, "LoadSharing": LOAD_SHARING}
    costs = [replace(term, weight=weights.get(term.label, term.weight)) for term in costs]
    must = held(robot, constraints)
    ends = {"displacement": landed - plain.start, "constraints": must}
    return plain.replace(steps=steps, costs=beside(must, costs), **ends)


def solve_jump(
    problem: Problem,
    *,
    seeds: int = 5,
    seed: int = 0,
    start: Solution | Array | None = None,
    **options: Any,
) -> Solution:
    """Solve a :func:`jump_problem`: :func:`octo.solve` from first guesses that leave the ground."""
    whole("seeds", seeds, most=MOST_STARTS)
    whole("seed", seed, 0, LARGEST_SEED)
    guesses = list(first_guesses(problem, seeds, seed)) if start is None else start
    members = solve([problem] * seeds, start=guesses, **options)
    return best_of([replace(member, seed=seed + k) for k, member in enumerate(members)])


def _steps(problem: Problem, height: float, rise: float, seconds: float | None) -> int:
    """N: what was asked for, or what the slowest of the first guesses takes."""
    rate = float(np.sqrt(problem.length / problem.gravity))  # s
    push = max(DEPTHS) * problem.length * rise / height
    if seconds is None:
        half = rise + push + (SLOW + REST) * rate
        return 2 * (steps_in(half, problem.dt) + (round(half / problem.dt) < half / problem.dt))
    least = 2.0 * (rise + push + LEAST * rate)
    if not positive("seconds", seconds, "s") >= least:
        raise ValueRangeError(
            f"seconds is {seconds:g}, a jump of {height:g} m takes at least {least:.2f} s"
        )
    return steps_in(seconds, problem.dt)


# -- the first guess ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Course:
    """A jump that is the same before and after its top: how high (m), and how long (s) each part
    is."""

    height: float  # m, of the top
    depth: float  # m, of the crouch
    rise: float  # s, from take-off to the top
    push: float  # s, from the bottom of the crouch to take-off
    slow: float  # s, from standing to the bottom

    def base(self, times: Array) -> Array:
        """(...) m, height of the base over where it stands, at times from the top."""
        knots = np.cumsum([0.0, self.rise, self.push, self.slow])
        speed = 2.0 * self.height / self.rise
        heights, slopes = [self.height, 0.0, -self.depth, 0.0], [0.0, -speed, 0.0, 0.0]
        course = CubicHermiteSpline(knots, heights, slopes)
        return np.asarray(course(np.minimum(np.abs(times), knots[-1])))

    def travelled(self, times: Array) -> Array:
        """(...) part of the distance that the base has gone, from the crouch to the landing's."""
        part = np.clip(0.5 + 0.5 * times / (self.rise + self.push), 0.0, 1.0)
        return part**2 * (3.0 - 2.0 * part)

    def flown(self, times: Array) -> Array:
        """(...) part of the flight, which is when the feet travel."""
        return np.clip(0.5 + 0.5 * times / self.rise, 0.0, 1.0)


def first_guesses(problem: Problem, count: int, seed: int = 0) -> Array:
    """(count, N+1, nx) nodes x_0 … x_N of a :func:`jump_problem`.

    The base flies, the legs reach for their footholds.
    """
    courses = _courses(problem)
    made = []
    for k in range(count):
        nodes = _guess(problem, courses[k % len(courses)])
        nodes[1:, problem.dynamics.actuated] += smooth_noise(problem, seed + k)
        made.append(nodes)
    return np.stack(made)


def _courses(problem: Problem) -> list[Course]:
    """One for each depth of the crouch, no slower than the motion is long."""
    height = float(_top(problem)[2])
    rise, rate = np.sqrt(2.0 * height / problem.gravity), np.sqrt(problem.length / problem.gravity)
    made = []
    for depth in problem.length * np.array(DEPTHS):
        push = float(depth * rise / height)
        room = 0.5 * problem.steps * problem.dt - rise - push
        made.append(Course(height, float(depth), float(rise), push, float(min(SLOW * rate, room))))
    return made


def _top(problem: Problem) -> Array:
    """(3,) m, where the centre of mass is to be at the top, from its start."""
    for term in problem.costs:
        if isinstance(term, CenterOfMassDisplacement) and term.label == "Top":
            return np.asarray(term.displacement, dtype=float)
    raise ProblemError("the problem has no term 'Top': jump_problem makes one that has")


def _guess(problem: Problem, course: Course) -> Array:
    """(N+1, nx) nodes, without noise."""
    robot, dynamics = problem.character, problem.dynamics
    assert robot is not None and isinstance(dynamics, RobotDynamics)
    assert problem.displacement is not None
    feet = touching(robot, dynamics.terrain, problem.setting.x0)
    end = problem.start + problem.displacement
    times = problem.dt * (np.arange(problem.steps + 1.0) - problem.steps // 2)
    up, flown = course.base(times), course.flown(times)
    nodes = problem.start + course.travelled(times)[:, None] * problem.displacement
    nodes[:, slide(robot, 2)] += up
    first, last = (sphere_centers(robot, x)[feet] for x in (problem.start, end))
    footholds = first + flown[:, None, None] * (last - first)  # (N+1, feet, 3) m
    tucked = TUCK * problem.length * np.sin(np.pi * flown) ** 2
    footholds[..., 2] += (np.maximum(up, 0.0) + tucked)[:, None]
    joints = robot.actuated
    for i in range(1, len(nodes)):
        nodes[i, joints] = nodes[i - 1, joints]
        nodes[i] = _reaching(robot, nodes[i], feet, footholds[i])
    return nodes


def slide(robot: Character, axis: int) -> int:
    """Index of the base's coordinate along x, y or z (0, 1, 2)."""
    first = robot.base_coordinate
    joints = robot.bodies[robot.base_body].joints
    along = [abs(joint.axis[axis]) if joint.kind == "slide" else 0.0 for joint in joints]
    return first + int(np.argmax(along))


def _reaching(robot: Character, x: Array, feet: list[int], targets: Array) -> Array:
    """x (nx,) whose feet are near ``targets`` (feet, 3) m: damped least squares of the joints."""
    joints = robot.actuated
    lower = np.minimum(robot.lower[joints] + REACH, x[joints])
    upper = np.maximum(robot.upper[joints] - REACH, x[joints])
    for _ in range(5):
        change, x = np.clip(toward(robot, x, feet, targets), -0.3, 0.3), x.copy()
        x[joints] = np.clip(x[joints] + change, lower, upper)
    return x
