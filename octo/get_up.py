"""Getting up: from a pose that lies at rest to one that stands at rest, as one problem."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Unpack, cast, get_args

import numpy as np

from octo.checks import Array, asked, instance, numbers, positive, steps_in, takes, time_step, whole
from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.laws import ContactLaw
from octo.dynamics.lying import Side, drawn, on_its, settled, static_near
from octo.dynamics.static_pose import balanced_pose
from octo.errors import ProblemError, StaticPoseError, UsageError, said
from octo.goals import Goal
from octo.model.character import Character
from octo.model.chart import Chart
from octo.model.charted import base_angles, charted, in_chart
from octo.model.feet import terrain_bottoms
from octo.model.terrain import Ground
from octo.motions.budget import Budget
from octo.motions.transitions import SUMS
from octo.problem import scales
from octo.problem.constraints import Constraint
from octo.problem.hard import Held, beside, held
from octo.problem.joint_costs import Effort
from octo.problem.limits import FrictionCones, StepLimit
from octo.problem.presets import contact_rich
from octo.problem.problem import Problem
from octo.problem.symbols import Setting
from octo.ranking import best_of
from octo.result.solution import Solution
from octo.solve import LARGEST_SEED, MOST_STARTS, How, Usual, solve
from octo.solver.status import Status
from octo.starts import smooth_noise

LYING = "lying:"  # and a seed, the pose of that name
LOW = 0.5  # of its height when it stands: where the base of a robot that lies is at most
LEVEL = 0.01  # rad, that it leans at most when it stands with the joints of its balanced pose
DRAWS = 100  # poses that are drawn until one lies
STEEP = 0.87  # sine of the middle angle of a chart beyond which the base has the other one
LEAP = 0.5  # rad and m, of a step: rotations are linearised in it, and half a turn is none
OVER = 0.6 * np.pi  # rad, of the inner angle, from which a robot may roll over either side
MOVES = ((0.1, 0.7), (0.3, 0.9), (0.2, 0.95))  # parts of the time in which first guesses move


@asked
@takes(Usual)
def get_up(
    robot: Character,
    pose: str | Array = "lying:0",
    seconds: float = 3.0,
    *,
    dt: float = 0.05,
    terrain: Ground | None = None,
    law: ContactLaw | None = None,
    constraints: Held = (),
    seeds: int = 4,
    seed: int = 0,
    start: Solution | Array | None = None,
    **how: Unpack[How],
) -> Solution:
    """Find how a robot that lies gets up: from rest to rest, into its balanced pose.

    Parameters
    ----------
    pose: "lying:SEED", a random pose: any orientation, any joints within their limits; "lying:back"
        or "lying:front", the joints of the balanced pose; or (nx,) rad and m. From there the robot
        is let down on the ground with its joints held: where it lies at rest is where it starts.
    seconds: of the whole motion.
    dt: s. terrain, law: as those of a :class:`~octo.problem.problem.Problem`.
    constraints: what must hold: those of a Problem, or "hard", the limits of the robot as
        :func:`octo.limits` lists them, friction at all its contacts. A limit that is held is not
        priced beside it.
    seeds: starts that differ in the side over which the robot rolls, in when it moves and in noise,
        solved as one batch; ``seed`` is the number of the first.
    start, passes, options, max_iterations, time_limit, tolerance, device, threads, progress,
        callback: as those of :func:`octo.solve`.

    Returns
    -------
    The best converged of the starts; ``starts`` has a record of each. It ends above where it lay,
    with the heading that it had there. Where the robot lies too near to the singularity of its
    base's angles the character of the solution has the other order of them (``chart``).

    Raises
    ------
    OctoError: what cannot get up is refused; nothing was computed.
    """
    where: Any = {"dt": dt, "terrain": terrain, "law": law, "constraints": constraints}
    problems = get_up_problems(robot, pose, seconds, **where)
    solution = solve_get_up(problems, seeds=seeds, seed=seed, start=start, **how)
    return Goal("up").said(solution)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Rise(Problem):
    """A Problem from a pose that lies to one that stands: its length, its feet and what terms
    compare with are those of its end. Both ends are static in each pass."""

    @cached_property
    def start(self) -> Array:
        """(nx,) x_0: where the robot lies, let down from its pose."""
        assert isinstance(self.dynamics, RobotDynamics) and isinstance(self.pose, np.ndarray)
        return static_near(self.dynamics, self.p, self.pose)

    @cached_property
    def end(self) -> Array:
        """(nx,) x_N: where it stands."""
        assert isinstance(self.dynamics, RobotDynamics) and self.displacement is not None
        assert isinstance(self.pose, np.ndarray)
        return static_near(self.dynamics, self.p, self.pose + self.displacement, LEVEL)

    @cached_property
    def length(self) -> float:
        """m, ℓ of the robot that stands."""
        assert self.character is not None
        return scales.length(self.character, self.end)

    @cached_property
    def setting(self) -> Setting:
        return replace(super().setting, x0=self.end)

    @property
    def priced(self) -> Rise:
        """The same without constraints, their limits as terms: what a motion that keeps them is
        found from."""
        kept = [one for one in self.constraints if isinstance(one, StepLimit)]
        costs = contact_rich(length=self.length, gravity=self.gravity)
        made = self.replace(costs=costs, constraints=kept)
        assert isinstance(made, Rise)
        return made


RESTLESS = "does not come to rest on the ground with its joints held, give another one"


def get_up_problems(
    robot: Character,
    pose: str | Array = "lying:0",
    seconds: float = 3.0,
    *,
    dt: float = 0.05,
    terrain: Ground | None = None,
    law: ContactLaw | None = None,
    constraints: Held = (),
) -> list[Rise]:
    """Describe getting up, over each side that is near; the parameters are those of :func:`get_up`.

    Raises
    ------
    ProblemError: the robot cannot get up. StaticPoseError: it does not lie. UsageError,
        ShapeError: pose. ValueRangeError: seconds or dt.
    """
    instance("robot", robot, Character, "a Character: what octo.load gives")
    word = word_of(pose)
    given = numbers("pose", pose, (robot.nx,)) if word is None else np.zeros(robot.nx)
    steps = steps_in(positive("seconds", seconds, "s"), time_step(dt))
    cannot = f"robot {robot.name!r} cannot get up:"
    if robot.base != "floating" or robot.nu == 0:
        raise ProblemError(f"{cannot} its base must be floating, and a joint actuated")
    if not robot.own_contacts:
        raise ProblemError(f"{cannot} it has no contact with the ground")
    plain = Problem(robot, steps=steps, dt=dt, costs=[Effort()], terrain=terrain, law=law)
    standing = plain.replace(pose="balanced")
    if isinstance(word, int):
        standing, lying = _random(standing, word)
    else:
        standing, lying = _laid(standing, given if word is None else on_its(word, robot), word)
    must = _everywhere(held(robot, constraints))
    if not any(isinstance(one, StepLimit) for one in must):
        must = (*must, StepLimit(LEAP))
    costs = beside(must, contact_rich(length=standing.length, gravity=standing.gravity))
    first = robot.base_coordinate
    kept = [first, first + 1, first + 3]  # x, y, and the outer angle
    found = []
    assert standing.character is not None
    upright = balanced_pose(standing.character)
    for side in _sides(standing.character, lying):
        end = upright.copy()
        end[kept] = side[kept]
        values = {name: getattr(standing, name) for name in ("model", "steps", "dt", "terrain")}
        ends: dict[str, Any] = {"pose": side, "displacement": end - side, "law": law}
        found.append(Rise(**values, **ends, costs=costs, constraints=must))
    return found


def solve_get_up(
    problems: list[Rise],
    *,
    seeds: int = 4,
    seed: int = 0,
    start: Solution | Array | None = None,
    **options: Any,
) -> Solution:
    """Solve :func:`get_up_problems`: :func:`octo.solve` from first guesses on the ground.

    Where something must hold, from motions in which limits are priced: many starts that begin with
    all limits held stall in the first pass.
    """
    whole("seeds", seeds, most=MOST_STARTS)
    whole("seed", seed, 0, LARGEST_SEED)
    budget = Budget({name: value for name, value in options.items() if value is not None})
    batch = [problems[k % len(problems)] for k in range(seeds)]
    guesses: Any = list(first_guesses(problems, seeds, seed)) if start is None else start
    scouts: list[Solution] = []
    if start is None and len(problems[0].constraints) > 1:
        priced = {id(one): one.priced for one in problems}
        about = [priced[id(one)] for one in batch]
        guesses = scouts = solve(about, start=guesses, **budget.left("with limits priced"))
    if any(scout.status is Status.INTERRUPTED for scout in scouts):
        members, scouts = scouts, []
    else:
        members = solve(batch, start=guesses, **budget.left("getting up"))
    if scouts:
        members = [_after(*pair) for pair in zip(scouts, members, strict=True)]
    return best_of([replace(member, seed=seed + k) for k, member in enumerate(members)])


def _after(scout: Solution, member: Solution) -> Solution:
    """The member with what the solve that it began with took."""
    both = {name: getattr(scout, name) + getattr(member, name) for name in SUMS}
    return replace(member, **both)


def word_of(pose: str | Array) -> int | Side | None:
    """The seed, or the side, of "lying:…"; None of a pose of numbers.

    Raises
    ------
    UsageError: another word.
    """
    if not isinstance(pose, str):
        return None
    word = pose.removeprefix(LYING)
    if word != pose and word in get_args(Side):
        return cast(Side, word)
    if word == pose or not (word.isascii() and word.isdigit()) or int(word) > LARGEST_SEED:
        raise UsageError(
            f"pose is {said(pose)}, must be 'lying:SEED', as 'lying:3', 'lying:back', "
            "'lying:front', or a configuration (nx,)"
        )
    return int(word)


# -- the start ------------------------------------------------------------------------------------


def _random(standing: Problem, seed: int) -> tuple[Problem, Array]:
    """The robot that stands, in the chart in which it lies, and a random pose (nx,) that lies."""
    robot, rng = standing.character, np.random.default_rng(seed)
    assert robot is not None
    for _ in range(DRAWS):
        with_chart, lying = _in_a_chart(standing, drawn(robot, rng))
        if lying is not None and _low(with_chart, lying):
            return with_chart, lying
    raise StaticPoseError(
        f"{robot.name}: of {DRAWS} poses of seed {seed} none comes to rest with its base under "
        f"{LOW:g} of its height when it stands; give a pose (nx,) that lies"
    )


def _laid(standing: Problem, pose: Array, side: Side | None) -> tuple[Problem, Array]:
    """The same from a pose (nx,), the caller's or that of a side."""
    with_chart, lying = _in_a_chart(standing, pose)
    assert standing.character is not None
    if lying is None:
        raise StaticPoseError(f"{standing.character.name}: pose {RESTLESS}")
    if side is not None and not _low(with_chart, lying):
        raise StaticPoseError(
            f"{standing.character.name}: let down on its {side} it does not lie, its base is "
            f"higher than {LOW:g} of its height when it stands; give a pose (nx,) that lies"
        )
    return with_chart, lying


def _low(standing: Problem, lying: Array) -> bool:
    """Whether the base lies low over the lowest contact."""
    assert standing.character is not None
    return scales.length(standing.character, lying) <= LOW * standing.length


def _in_a_chart(standing: Problem, pose: Array) -> tuple[Problem, Array | None]:
    """Where the robot lies, None where it does not come to rest, in a chart that is regular
    there."""
    lying: Array | None = pose
    first = standing
    for _ in range(3):  # where it begins to fall and where it lies may need another one each
        robot = standing.character
        assert robot is not None and isinstance(standing.dynamics, RobotDynamics)
        assert lying is not None
        if abs(np.sin(lying[base_angles(robot)][1])) > STEEP:
            other: Chart = "zyx" if robot.chart == "zxy" else "zxy"
            lying = in_chart(robot, lying, other)
            standing = standing.replace(model=charted(robot, other))
            robot = standing.character
        assert robot is not None and isinstance(standing.dynamics, RobotDynamics)
        lying = settled(standing.dynamics, standing.p, lying)
        if lying is None or abs(np.sin(lying[base_angles(robot)][1])) <= STEEP:
            return _as_it_was(first, standing, lying)
    return standing, None


def _as_it_was(
    first: Problem, standing: Problem, lying: Array | None
) -> tuple[Problem, Array | None]:
    """The same in the robot's own chart, where that is regular too: the way from its back to its
    feet leads through the other one's singularity."""
    own, robot = first.character, standing.character
    if lying is None or own is None or robot is None or own.chart == robot.chart:
        return standing, lying
    back = in_chart(robot, lying, own.chart)
    return (first, back) if abs(np.sin(back[base_angles(own)][1])) <= STEEP else (standing, lying)


def _sides(robot: Character | None, lying: Array) -> list[Array]:
    """The pose (nx,) with its inner angle within half a turn; of a robot on its back also the one
    that is the other way round."""
    assert robot is not None
    inner, pose = base_angles(robot).stop - 1, lying.copy()
    pose[inner] = np.remainder(pose[inner] + np.pi, 2.0 * np.pi) - np.pi
    if abs(pose[inner]) < OVER:
        return [pose]
    other = pose.copy()
    other[inner] -= 2.0 * np.pi * np.sign(pose[inner])
    return [pose, other]


def _everywhere(constraints: tuple[Constraint, ...]) -> tuple[Constraint, ...]:
    """The constraints, those about the friction of feet about that of all contacts: what gets up
    pushes with its trunk and its knees."""
    return tuple(
        replace(one, contacts=None)
        if isinstance(one, FrictionCones) and one.contacts == "feet"
        else one
        for one in constraints
    )


# -- the first guess ------------------------------------------------------------------------------


def first_guesses(problems: list[Rise], count: int, seed: int = 0) -> Iterator[Array]:
    """x_0 … x_N (N+1, nx) of each of ``count`` starts: the sides in turn, then another time in
    which it moves, each with its own noise."""
    for k in range(count):
        moves = MOVES[k // len(problems) % len(MOVES)]
        yield first_guess(problems[k % len(problems)], moves, seed + k)


def first_guess(problem: Rise, moves: tuple[float, float], seed: int) -> Array:
    """Nodes (N+1, nx) straight from one end to the other, at the height at which the robot touches
    the ground, with smooth noise in the joints."""
    robot = problem.character
    assert robot is not None
    begin, end = moves
    part = np.clip((np.linspace(0.0, 1.0, problem.steps + 1) - begin) / (end - begin), 0.0, 1.0)
    part = part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
    nodes = problem.start + part[:, None] * (problem.end - problem.start)
    nodes[1:, robot.actuated] += smooth_noise(problem, seed)
    lowest = terrain_bottoms(robot, nodes).min(axis=1)  # (N+1,) m
    wanted = lowest[0] + part * (lowest[-1] - lowest[0])
    nodes[:, robot.base_coordinate + 2] += wanted - lowest
    return nodes
