"""Motions from rest to rest: walk, stride sideways, turn. A cycle is found first, then how to get
into it and out of it.

A walk of ten seconds is found in pieces, each of which is small: a stride that repeats (several
starts and periods, the best kept), from rest into it and out of it to rest, with both ends fixed
(several phases, the best kept), strides between. Joined they satisfy Newton's law; the whole is
then polished as one problem, which begins and ends at rest.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo.checks import asked, number, numbers, positive, steps_in, time_step, whole
from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.laws import ContactLaw
from octo.dynamics.static_pose import inside_limits, over_the_feet, static_pose
from octo.errors import MirrorError, ProblemError, StaticPoseError, said
from octo.goals import Goal
from octo.model.character import Character
from octo.model.mirror import mirror_of
from octo.model.terrain import Plane, Terrain
from octo.problem import presets
from octo.problem.codegen import touching_names
from octo.problem.costs import Cost
from octo.problem.cycle import TIME_STEP, Cycle, along_arc, plane_normal, usual_period
from octo.problem.problem import Problem
from octo.progress import check_progress
from octo.ranking import best_of
from octo.result.gait import SHORT, flaws
from octo.result.solution import Solution
from octo.result.stances import runs, stances
from octo.solve import LARGEST_SEED, MOST_STARTS, evaluated, settings_of, solve, solve_all
from octo.solver.options import SqpOptions
from octo.solver.sqp import Iterate
from octo.solver.status import Status
from octo.starts import smooth_noise

Array = NDArray[np.float64]
Rank = tuple[int, int, int, float]  # failed, stumbles, near ones, E: the smaller, the better
PERIODS = (1.0, 1.25, 1.5)  # of the usual period of an animal of that size: what is tried
STARTS = 3  # of the cycle, for each period
PHASES = 6  # of the stride, at which it may be entered and left
BEGUN = 0.5  # of the stride's speed, the mean speed while it is entered or left
ENDS = 5.0  # √(ℓ/g), how long it is entered and left, and a stride at least: shorter ones stumble
# ℓ: trunks of strides that are higher by more, or lower: a spider's by 0.7 to 1, of eight others by
# 0.3 at most
RISES = 0.4
# ℓ and rad: where polishing moves the base by more, strides have given way to standing and a dash
KEEPS = 0.2
JOINT = 2e-7  # mg, what pieces may miss of Newton's law: the solver's own tolerance
CHEAP = 1.1  # of the stride's E: a clean way to leave it that costs less is not looked for further
# of the least E of the strides of that period or a shorter one: strides that cost more are not
# looked at
ODD = 1.25
DEAR = 3.0  # of the stride's E: a piece that costs more is none
# steps, by which the leaving is tried longer: at other phases of the stride
LONGER = range(-4, 20, 2)


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
    those of
        :func:`octo.solve`; ``time_limit`` is of the whole motion.

    Returns
    ------- The motion, at rest in its first and last state; its ``starts`` has a record of each
    stride that was tried.

    Raises
    ------
    OctoError: in one line that names the field; nothing was computed.
    """
    given = locals()
    goal = Goal("walk", number("speed", speed))
    return goal.said(_journey(given, (goal.speed, 0.0), 0.0).solve())


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
    """Walk sideways, to the left where ``speed`` (m/s) is positive, from rest to rest; otherwise as
    :func:`walk`."""
    given = locals()
    goal = Goal("stride", number("speed", speed))
    return goal.said(_journey(given, (0.0, goal.speed), 0.0).solve())


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
    """Turn on the spot by ``rate`` rad/s, to the left where positive, from rest to rest; otherwise
    as :func:`walk`."""
    given = locals()
    goal = Goal("turn", number("rate", rate))
    return goal.said(_journey(given, (0.0, 0.0), goal.speed).solve())


# fields of a Journey; other arguments are octo.solve's
OWN = ("dt", "period", "starts", "seed", "terrain", "law", "pose")


def _journey(given: Mapping[str, Any], velocity: tuple[float, float], rate: float) -> Journey:
    """The motion that a call described by its arguments ``given``; those that are None are left to
    octo.solve."""
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
    return Journey(robot, velocity, rate, positive("seconds", seconds, "s"), **own, options=options)


@dataclass(frozen=True, eq=False)
class Journey:
    """A steady motion of ``velocity`` (2,) m/s in the body's axes and ``rate`` rad/s, begun from
    rest and ended at rest.

    dt: s. seed, starts: number of the first start of each period's cycle, and their count. period:
    s of a stride, or several to try; by default those of the robot's own length. terrain, law,
    pose: as of a Problem. options: of :func:`octo.solve`.
    """

    robot: Character
    velocity: tuple[float, float]
    rate: float
    seconds: float
    dt: float = TIME_STEP
    seed: int = 0
    starts: int = STARTS
    period: float | Sequence[float] | None = None
    terrain: Any = None
    law: Any = None
    pose: Any = None
    options: dict[str, Any] = field(default_factory=dict)

    @property
    def steps(self) -> int:
        return max(1, steps_in(self.seconds, self.dt))

    @cached_property
    def whole(self) -> Problem:
        """The motion as one problem that begins at rest, without a cycle: natural terms and the
        speed."""
        common = {"terrain": self.terrain, "law": self.law, "costs": presets.natural(length=1.0)}
        pose: Any = "balanced" if self.pose is None else self.pose
        problem = Problem(self.robot, steps=self.steps, dt=self.dt, pose=pose, **common)
        speed, rate = (*self.velocity, 0.0), self.rate or None
        return problem.replace(costs=presets.natural(speed, rate, **self._body(problem)))

    @cached_property
    def terms(self) -> list[Cost]:
        """Of problems whose ends say how far: natural terms alone."""
        return presets.natural(**self._body(self.whole))

    @staticmethod
    def _body(problem: Problem) -> dict[str, Any]:
        """What the natural terms ask of the body that stands at rest, for problems that begin
        elsewhere."""
        return {"length": problem.length, "feet": touching_names(problem), "pose": problem.start}

    @cached_property
    def mirrored(self) -> bool:
        """Whether half a stride and its mirror image do: straight ahead, of a robot that has a
        mirror."""
        if self.rate != 0.0 or self.velocity[1] != 0.0:
            return False
        try:
            mirror_of(self.robot)
        except MirrorError:
            return False
        return True

    def periods(self) -> list[int]:
        """Steps of the strides that are tried."""
        own = self.period
        if own is None:
            length = self.whole.length
            usual = usual_period(length, float(np.hypot(*self.velocity)) + abs(self.rate) * length)
            own = [usual * part for part in PERIODS]
        wanted = [own] if isinstance(own, (int, float)) else list(own)
        grain = 2 if self.mirrored else 1
        return sorted(
            {
                max(8, grain * round(positive("period", value, "s") / self.dt / grain))
                for value in wanted
            }
        )

    def counts(self) -> list[int]:
        """Those of them that fit between rest and rest."""
        return [count for count in self.periods() if count + 2 * self.ends(count) <= self.steps]

    def ends(self, count: int) -> int:
        """Steps in which a stride of ``count`` steps is entered."""
        return max(count, round(ENDS * np.sqrt(self.whole.length / self.whole.gravity) / self.dt))

    def faster(self, count: int) -> float:
        """Speed of a stride of ``count`` steps over that of the whole motion, in which it is
        entered and left."""
        return self.steps / (self.steps - 2.0 * (1.0 - BEGUN) * self.ends(count))

    def cycle(self, count: int) -> Problem:
        """A stride of ``count`` steps."""
        factor, period = self.faster(count), count * self.dt
        steady = Cycle(
            speed=factor * self.velocity[0],
            sideways=factor * self.velocity[1],
            turn=factor * self.rate * period,
            period=period,
            mirror=self.mirrored,
        )
        return self.whole.replace(steps=0, cycle=steady, costs=self.terms)

    def solve(self) -> Solution:
        """The motion."""
        return self._solved(time.perf_counter())

    def _solved(self, began: float) -> Solution:
        counts = self.counts()
        if not counts:
            return self._without(
                f"{self.seconds:g} s are too short for a stride between rest and rest", began
            )
        try:
            cycles = [self.cycle(count) for count in counts]
        except ProblemError as error:
            if self.robot.base != "floating":
                raise
            return self._without(str(error), began)
        found: list[Solution] = []
        for problem in cycles:
            doing = f"a stride of {problem.steps * problem.dt * (2 if self.mirrored else 1):.3g} s"
            found += solve_all(
                problem, seeds=self.starts, seed=self.seed, **self.left(began, doing)
            )
            stopped = any(made.status is Status.INTERRUPTED for made in found)
            other = None if stopped else self._standing_as(_good(found))
            if stopped or other is not None:
                break
        records = tuple(made.report() for made in found)
        if stopped:
            best = min(found, key=lambda made: (not made.converged, made.energy))
            return replace(best, status=Status.INTERRUPTED, starts=records)
        if other is not None:
            motion = other._solved(began)
            return replace(motion, starts=records + motion.starts)
        good = _good(found)
        if not good:
            return self._without("no stride converged", began)
        best = min(good, key=_quality)
        try:
            best = self._whole_stride(best, began)
            motion = self._pieces(best, began).joined()
        except _Interrupted:
            motion = replace(
                best.tile(max(1, self.steps // (2 * best.steps))), status=Status.INTERRUPTED
            )
        return replace(motion, starts=records)

    def _whole_stride(self, stride: Solution, began: float) -> Solution:
        """The stride itself, or of a robot whose mirror image is a little different both halves,
        solved for anew."""
        assert stride.cycle is not None
        if not stride.cycle.mirrored or stride.cycle.asymmetry <= JOINT * stride.weight:
            return stride
        steady = Cycle(speed=stride.cycle.speed, period=stride.cycle.period, mirror=False)
        problem = self.whole.replace(
            steps=0, cycle=steady, costs=self.terms, parameters=_ground_laws(stride)
        )
        both = _going_on(
            solve(problem, start=stride.tile(1), **self.near(began, "the whole stride"))
        )
        if not both.converged or both.energy > ODD * stride.energy:
            return stride
        return replace(both, seed=stride.seed, passes=(*stride.passes, *both.passes))

    def _pieces(self, stride: Solution, began: float) -> _Pieces:
        """From the pose at rest, or where that stumbles from one that stands as the stride does in
        the mean."""
        pieces = _Pieces(self, stride, began)
        if pieces.clean or self.pose is not None:
            return pieces
        try:
            other = _Pieces(self, stride, began, self._mean_pose(stride))
        except StaticPoseError:
            return pieces
        return min(pieces, other, key=lambda one: one.rank)

    def _standing_as(self, strides: Sequence[Solution]) -> Journey | None:
        """This motion of a robot that stands as the best of these strides does, with its length,
        periods and terms.

        None where the robot at rest stands about as high, where a pose was given, and where that
        motion has no stride.
        """
        if self.pose is not None or not strides:
            return None
        best, normal = min(strides, key=_quality), plane_normal(self.whole)
        first = self.robot.base_coordinate
        away = best.x[1:, first : first + 3] - self.whole.start[first : first + 3]
        if abs(float((away @ normal).mean())) <= RISES * self.whole.length * float(
            np.linalg.norm(normal)
        ):
            return None
        other = replace(self, pose=self._mean_pose(best))
        try:
            return other if other.counts() else None
        except StaticPoseError:
            return None

    def _mean_pose(self, stride: Solution) -> Array:
        """(nx,) the joints of the stride in the mean, over the feet."""
        joints, pose = self.robot.actuated, self.whole.start.copy()
        pose[joints] = stride.tile(1).x[1:-1, joints].mean(axis=0)
        return over_the_feet(self.robot, inside_limits(self.robot, pose))

    def left(self, began: float, doing: str) -> dict[str, Any]:
        """The options of solve, with what is left of the time, and with what the progress line
        says."""
        options = dict(self.options)
        if options.get("progress"):
            options["progress"] = doing
        if "time_limit" in options:
            options["time_limit"] = max(options["time_limit"] - (time.perf_counter() - began), 1e-3)
        return options

    def near(self, began: float, doing: str) -> dict[str, Any]:
        """:meth:`left` for what starts from a stride and is to stay near it: without the contacts'
        curvature, with which it ends in worse optima (docs/notes/cycles.md)."""
        given = self.left(began, doing)
        own = given.get("options") or SqpOptions()
        return {
            **given,
            "options": replace(own, hessian="dynamics") if own.hessian == "exact" else own,
        }

    def _without(self, reason: str, began: float) -> Solution:
        """One problem from rest to rest with the natural terms alone, and a line that says so."""
        print(f"octo: {reason}: solved as one problem, without a stride", file=sys.stderr)
        way = self._way()
        motion = self.whole.replace(costs=self.terms, displacement=way)
        first, last = (
            np.tile(pose, (self.steps + 1, 1)) for pose in (motion.start, motion.start + way)
        )
        guesses = [_blend(first, last) for _ in range(self.starts)]
        for k, guess in enumerate(guesses):
            guess[1:, motion.dynamics.actuated] += smooth_noise(motion, self.seed + k)
        members = solve([motion] * self.starts, start=guesses, **self.left(began, "one problem"))
        return best_of([replace(made, seed=self.seed + k) for k, made in enumerate(members)])

    def _way(self) -> Array:
        """(nx,) from where the robot stands to where it stands after the motion."""
        robot, problem, duration = self.robot, self.whole, self.steps * self.dt
        assert isinstance(problem.dynamics, RobotDynamics)
        first, angle, moved = robot.base_coordinate, self.rate * duration, problem.start.copy()
        moved[first : first + 2] += along_arc(
            np.array(self.velocity), angle, duration, float(moved[first + 3])
        )
        moved[first + 3] += angle
        return static_pose(problem.dynamics, problem.p, moved) - problem.start


def _good(strides: Sequence[Solution]) -> list[Solution]:
    """Those that converged and cost no more than ODD of the least E of their period or a shorter
    one, for E falls with the period: others limp, or throw a leg."""
    through = [made for made in strides if made.converged and made.passes[-1]["converged"]]
    return [
        made
        for made in through
        if made.energy
        <= ODD * min(other.energy for other in through if len(other.u) <= len(made.u))
    ]


def _quality(stride: Solution) -> tuple[int, float]:
    """The smaller, the better: flaws of the gait, then the work of the joints on the way."""
    return flaws(stride.gait, stride.length), stride.power


class _Interrupted(Exception):
    """Ctrl-C, or a callback that said stop, while pieces were solved."""


def _going_on(made: Solution) -> Solution:
    if made.status is Status.INTERRUPTED:
        raise _Interrupted
    return made


class _Pieces:
    """What a journey around one stride is joined of.

    Place s of the path is where the steady motion is after s steps. The stride, tiled, is entered
    at its node laps·count + phase, which stands at place BEGUN·ends, and left ``length`` steps
    before the end.
    """

    def __init__(self, journey: Journey, stride: Solution, began: float, pose: Array | None = None):
        assert stride.cycle is not None
        self.journey, self.stride, self.began = journey, stride, began
        self.count = round(stride.cycle.period / journey.dt)
        standing = {} if pose is None else {"pose": pose}
        self.rest = journey.whole.replace(
            costs=journey.terms, parameters=_ground_laws(stride), **standing
        )
        self.normal = plane_normal(self.rest)
        self.ends = journey.ends(self.count)
        self.laps = 1 + -(-self.ends // self.count)
        self.tiled = stride.tile(2 * self.laps + 2 + journey.steps // self.count)
        self.phase, self.into, entered = self._entered()
        self.length, self.out, left = self._left_at()
        self.rank = tuple(a + b for a, b in zip(entered, left, strict=True))

    @property
    def clean(self) -> bool:
        """Whether it is entered and left without a stumble."""
        return self.rank[:2] == (0, 0)

    def _entered(self) -> tuple[int, Solution, Rank]:
        """The phase at which the stride is entered best, how, and how good that is."""
        assert self.stride.cycle is not None
        mirrored = self.stride.cycle.mirrored  # half a stride later it is entered as in a mirror
        half = self.count // 2 if mirrored else self.count
        few = sorted({k * half // PHASES for k in range(PHASES)})
        best = self._best_phase(few)
        others = sorted(set(range(half)).difference(few))
        if best[2][:2] != (0, 0) and others:  # it stumbles at all of these: the phases between them
            best = min(best, self._best_phase(others), key=lambda one: one[2])
        return best

    def _best_phase(self, phases: Sequence[int]) -> tuple[int, Solution, Rank]:
        problems, starts = zip(*(self._enter(phase) for phase in phases), strict=True)
        found = [
            _going_on(made)
            for made in solve_all(problems, start=starts, **self._options("entering it"))
        ]
        loads = self.tiled.normal_force
        following = [loads[self._entry(phase) :][: self.count] for phase in phases]
        ranks = [
            self._rank(made, after=after) for made, after in zip(found, following, strict=True)
        ]
        best = min(range(len(phases)), key=lambda k: ranks[k])
        return phases[best], found[best], ranks[best]

    def _left_at(self) -> tuple[int, Solution, Rank]:
        """In how many steps the stride is left best, how, and how good that is."""
        best: tuple[int, Solution, Rank] | None = None
        lengths = [self.ends + more for more in LONGER]
        for length in [length for length in lengths if length <= self.journey.steps - self.ends]:
            problem, start = self._leave(self.phase, length)
            made = _going_on(solve(problem, start=start, **self._options("leaving it")))
            node = self._entry(self.phase) + self.journey.steps - self.ends - length
            rank = self._rank(made, before=self.tiled.normal_force[node - self.count : node])
            if best is None or rank < best[2]:
                best = (length, made, rank)
            if best[2][:2] == (0, 0) and best[2][3] < CHEAP * self.stride.energy:
                break
        assert best is not None
        return best

    def _rank(
        self, piece: Solution, before: Array | None = None, after: Array | None = None
    ) -> Rank:
        """The smaller, the better: converged and not far dearer than the stride, without stumbles,
        then by E.

        before, after: loads (k, c) N of the stride that the piece comes from or leads to.
        """
        loads = np.concatenate(
            [part for part in (before, piece.normal_force, after) if part is not None]
        )
        bad = not piece.converged or piece.energy > DEAR * self.stride.energy
        near = _short(loads, piece, SHORT + piece.dt)  # polishing may take a step off
        return (int(bad), _short(loads, piece), near, piece.energy)

    def joined(self) -> Solution:
        """The best pieces in a row, polished as one problem."""
        journey, first = self.journey, self._entry(self.phase)
        between = journey.steps - self.ends - self.length
        middle = self._placed(self.tiled.x[first + 2 : first + 2 + between], self.phase)
        nodes = np.concatenate([self.into.x[1:], middle, self.out.x[2:]])
        motion = self.rest.replace(x_end=nodes[-1], v_end=np.zeros(journey.robot.nx))
        raw = evaluated(motion, nodes, Status.JOINED)
        polished = solve(motion, start=nodes, **self._options("the whole motion"))
        away = np.abs(polished.x - raw.x)[:, self._base()].max(axis=0) > KEEPS * np.array(
            [raw.length, raw.length, 1.0]
        )
        worse = (
            _short(polished.normal_force, polished) > _short(raw.normal_force, raw)
            or not polished.converged
            or away.any()
        )
        if (
            worse
            and raw.violation <= JOINT * raw.weight
            and polished.status is not Status.INTERRUPTED
        ):
            polished = raw
        return self._counted(polished)

    def _counted(self, motion: Solution) -> Solution:
        """With the iterations and the time of the pieces."""
        parts = (self.stride, self.into, self.out, motion)
        return replace(
            motion,
            iterations=sum(part.iterations for part in parts),
            factorizations=sum(part.factorizations for part in parts),
            setup_seconds=sum(part.setup_seconds for part in parts),
            seconds=sum(part.seconds for part in parts),
            processor_seconds=sum(part.processor_seconds for part in parts),
            seed=self.stride.seed,
            passes=(*self.stride.passes, *motion.passes),
        )

    def _base(self) -> list[int]:
        """Where x, y and the yaw of the base are in a configuration."""
        first = self.journey.robot.base_coordinate
        return [first, first + 1, first + 3]

    def _options(self, doing: str) -> dict[str, Any]:
        return self.journey.near(self.began, doing)

    def _entry(self, phase: int) -> int:
        """The node of the tiled stride at which it is entered."""
        return self.laps * self.count + phase

    def _placed(self, x: Array, phase: int) -> Array:
        """Nodes (…, n) of the tiled stride where they stand on the path."""
        return self._moved(x, BEGUN * self.ends - self._entry(phase))

    def _moved(self, x: Array, places: float) -> Array:
        """Configurations (…, n) carried along the path by so many places."""
        journey, x = self.journey, x.copy()
        first = journey.robot.base_coordinate
        duration, factor = places * journey.dt, journey.faster(self.count)
        angle = factor * journey.rate * duration
        shift = along_arc(factor * np.array(journey.velocity), angle, duration)
        c, s = np.cos(angle), np.sin(angle)
        middle = self.rest.start[first : first + 2]
        before = x[..., first : first + 2].copy()
        x[..., first : first + 2] = middle + (before - middle) @ np.array([[c, s], [-s, c]]) + shift
        x[..., first + 2] -= (x[..., first : first + 2] - before) @ self.normal[:2] / self.normal[2]
        x[..., first + 3] += angle
        return x

    def _enter(self, phase: int) -> tuple[Problem, Array]:
        """From rest into the stride, and a first guess: standing blended into the stride."""
        node = self._entry(phase)
        stride = self._placed(self.tiled.x[node - self.ends + 1 : node + 2], phase)
        velocity = (stride[-1] - stride[-2]) / self.journey.dt
        problem = self.rest.replace(steps=self.ends, x_end=stride[-1], v_end=velocity)
        return problem, _blend(np.broadcast_to(problem.start, stride.shape), stride)

    def _leave(self, phase: int, length: int) -> tuple[Problem, Array]:
        """From the stride to rest."""
        node = self._entry(phase) + self.journey.steps - self.ends - length
        stride = self._placed(self.tiled.x[node : node + length + 2], phase)
        velocity = (stride[1] - stride[0]) / self.journey.dt
        end = self._moved(self.rest.start, self.journey.steps / self.journey.faster(self.count))
        problem = self.rest.replace(
            steps=length, x0=stride[1], pose=None, v0=velocity, x_end=end, v_end=0.0 * end
        )
        return problem, _blend(stride[1:], np.broadcast_to(end, stride[1:].shape))


def _blend(one: Array, other: Array) -> Array:
    """(N+1, n) from one motion into the other, with weights 3w² − 2w³ (docs/notes/cycles.md)."""
    w = np.linspace(0.0, 1.0, len(one))[:, None]
    part = 3.0 * w**2 - 2.0 * w**3
    return (1.0 - part) * one + part * other


def _ground_laws(stride: Solution) -> dict[str, float]:
    """The parameters of the contact law that a stride was solved with, in its last pass."""
    return {name: value for name, value in stride.parameters.items() if name.startswith("contact.")}


def _short(loads: Array, motion: Solution, least: float = SHORT) -> int:
    """How many stances and swings in ``loads`` (N, c) N are shorter than ``least`` s."""
    standing = stances(loads, motion.weight)
    lengths = [
        b - a
        for foot in standing.T
        for state in (foot, ~foot)
        for a, b in runs(state, 0, len(loads))
    ]
    return sum(length * motion.dt < least - 1e-9 for length in lengths)
