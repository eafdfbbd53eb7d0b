"""``octo.motion_graph.build``: motions, and a transition wherever there is one (§8.6)."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any, Unpack

import numpy as np

from octo import executors
from octo.checks import asked, instance, number, positive, steps_in, takes, whole
from octo.digest import digest
from octo.errors import ProblemError, ValueRangeError, said
from octo.model import store
from octo.model.character import Character
from octo.motion_graph.crossing import Crossing, check_alike
from octo.motion_graph.file import File
from octo.motion_graph.graph import MotionGraph
from octo.motion_graph.named import NAMED, check_name
from octo.motion_graph.one_law import under_one_law
from octo.motion_graph.work import Batch, Outcome, Pair, batches_of, work
from octo.problem.hard import Held, at_every_step, held
from octo.problem.joint_costs import Effort
from octo.progress import Progress, check_progress
from octo.result.solution import Solution, solution_of
from octo.solve import How, Usual

MOTIONS = ("walk", "left", "right", "jump")
Motions = Sequence[str] | Mapping[str, "Solution | str | os.PathLike[str]"]
BATCH = 16  # transitions: enough for the vectors of a step
LONGEST_NAME = 40


@asked
@takes(Usual)
def build(
    robot: Character,
    motions: Motions = MOTIONS,
    *,
    path: str | os.PathLike[str],
    seconds: float = 10.0,
    dt: float = 0.025,
    transitions: float = 1.0,
    moments: float = 0.25,
    every: int = 1,
    share: float = 1.0,
    loops: int = 3,
    constraints: Held = "hard",
    batch: int = BATCH,
    executor: Executor | None = None,
    **how: Unpack[How],
) -> MotionGraph:
    """Find motions, loops in them and transitions between them, and keep all in one file.

    What is finished is in the file at once: a build that was stopped goes on where it was when it
    is called again with the same words.

    Parameters
    ----------
    robot: with a floating base; the ground is level.
    motions: names, of "walk", "back", "left", "right" (turns on the spot), "stride_left",
        "stride_right" and "jump"; or by name motions of yours, or paths of such, of this robot on
        level ground, all with one dt.
    path: of the file, an SQLite database.
    seconds, dt: s, of motions that are found by their names.
    transitions: s, of a transition.
    moments: s between moments of a motion at which it may be left or reached; ``every`` so many of
        them are looked at.
    share: of all pairs of moments of two motions, those that are most alike (Kovar et al. 2002);
        1 is all of them.
    loops: of each motion, so many ways back into itself, from late moments to early ones that are
        alike.
    constraints: what must hold: those of a Problem, or "hard", the limits of the robot as
        :func:`octo.limits` lists them; of transitions, and of motions that are found by name.
    batch: transitions that are solved as one.
    executor: of ``concurrent.futures``, or with its ``submit``, such as a Dask client's
        ``get_executor()``; it is left open. By default as many processes as there are cores, that
        begin with nothing of this one, so that a script needs ``if __name__ == "__main__":``.
    options, max_iterations, time_limit, tolerance, device, threads, progress: of transitions, as
        those of :func:`octo.solve`; ``passes`` and callback cannot be given.

    Returns
    -------
    The graph that the file holds. Ctrl-C returns what there is, unless there is no transition yet.

    Raises
    ------
    OctoError: an argument or the file is refused, or a motion is not found.
    """
    settings = _Settings(
        seconds, dt, transitions, moments, every, share, loops, constraints, batch, how
    )
    settings.check(robot, motions, executor)
    with File(path, writes=True) as file:
        record = settings.record(robot, motions)
        _check_same(file, record)
        progress = Progress("") if settings.progress else None
        try:
            given = _motions(file, robot, motions, settings, progress)
            _cross(file, given, settings, executor, progress)
        except KeyboardInterrupt:
            if not file.done:
                raise
    return MotionGraph(path)


@dataclass(frozen=True)
class _Settings:
    """What a build is asked for."""

    seconds: float
    dt: float
    transitions: float
    moments: float
    every: int
    share: float
    loops: int
    constraints: Held
    batch: int
    how: Mapping[str, Any]

    def check(self, robot: Character, motions: Motions, executor: Executor | None) -> None:
        """Refuse what can be refused before anything is computed."""
        instance("robot", robot, Character, "a Character: what octo.load gives")
        for name in ("seconds", "dt", "transitions", "moments"):
            positive(name, getattr(self, name), "s")
        for name, least in (("every", 1), ("loops", 0), ("batch", 1)):
            whole(name, getattr(self, name), least)
        if not 0.0 < number("share", self.share) <= 1.0:
            raise ValueRangeError(f"share is {self.share:g}, must be above 0, and at most 1")
        check_progress(self.how.get("progress", False), None)
        executors.check_executor(executor)
        for name in ("passes", "callback"):
            if self.how.get(name) is not None:
                raise ProblemError(f"{name} is given, must be left out of a graph")
        if isinstance(motions, str) or not isinstance(motions, (Sequence, Mapping)) or not motions:
            raise ProblemError(
                f"motions is {said(motions)}, must be names such as {', '.join(MOTIONS)}, or "
                "motions by name"
            )
        if not isinstance(motions, Mapping):
            for name in motions:
                check_name(name)
        for name in motions:
            if not isinstance(name, str) or not 0 < len(name) <= LONGEST_NAME or "," in name:
                raise ProblemError(f"a motion's name is {said(name)}, must be a short word")
        if len({*motions}) < len(motions):
            raise ProblemError(f"motions {', '.join(motions)} has a name twice")
        at_every_step(held(robot, self.constraints), "a graph")

    @property
    def progress(self) -> bool:
        return bool(self.how.get("progress", False))

    @property
    def options(self) -> dict[str, Any]:
        """Of octo.solve, for a batch of transitions."""
        given = {name: value for name, value in self.how.items() if value is not None}
        return {"goal": "feasible", **given, "passes": 1, "progress": False}

    def record(self, robot: Character, motions: Motions) -> dict[str, Any]:
        """What the graph is of, as it is kept in its file."""
        named = not isinstance(motions, Mapping)
        each = dict.fromkeys(motions, "named")
        if isinstance(motions, Mapping):
            each = {name: digest(solution_of(given).x) for name, given in motions.items()}
        own = ("transitions", "moments", "every", "share", "loops", "batch")
        return {
            "robot": robot.name,
            "robot's numbers": digest([store.to_plain(robot)]),
            "motions": each,
            **({"seconds": float(self.seconds), "dt": float(self.dt)} if named else {}),
            **{name: getattr(self, name) for name in own},
            "constraints": [repr(one) for one in held(robot, self.constraints)],
            "options": {k: repr(v) for k, v in self.options.items() if k not in ("threads",)},
        }


def _check_same(file: File, record: Mapping[str, Any]) -> None:
    """A new file is of this graph now; one of another graph is refused."""
    known = file.record
    if "robot" not in known:
        file.keep_record(dict(record))
        return
    for name, new in record.items():
        if (old := known.get(name)) != new:
            told = f"{name} is {said(old)} there and {said(new)} here"
            if name in ("robot's numbers", "constraints"):
                told = f"{name} are others"
            raise ProblemError(f"{file.path} is of another graph: {told}; give another path")


# -- motions ---------------------------------------------------------------------------------------


def _motions(
    file: File, robot: Character, asked: Motions, settings: _Settings, progress: Progress | None
) -> dict[str, Solution]:
    """The motions, those that the file has not yet are found or taken."""
    known: list[str] = file.names
    made: dict[str, Solution] = {}
    for name in asked:
        if name not in known:
            if progress is not None:
                progress(f"motion {name!r}")
            motion = _motion(robot, name, asked, settings)
            like = next(iter(made.values()), motion)
            check_alike(like, motion)
            file.keep_motion(name, under_one_law(motion, like, settings.constraints, name))
        made[name] = file.motion(name)
    return made


def _motion(robot: Character, name: str, asked: Motions, settings: _Settings) -> Solution:
    """One of yours, or the one of that name.

    Raises
    ------
    ProblemError: it is not found.
    """
    if isinstance(asked, Mapping):
        return solution_of(asked[name])
    how = {k: v for k, v in settings.how.items() if k in ("device", "threads") and v is not None}
    given = {"dt": settings.dt, "constraints": settings.constraints, **how}
    motion = NAMED[name](robot, settings.seconds, **given)
    if not motion.converged:
        raise ProblemError(f"motion {name!r} of {robot.name}: {motion.sentence}")
    return motion


# -- transitions -----------------------------------------------------------------------------------


def _cross(
    file: File,
    motions: Mapping[str, Solution],
    settings: _Settings,
    executor: Executor | None,
    progress: Progress | None,
) -> None:
    """Solve all pairs that the file has not yet."""
    batches = [own for pair in _crossings(motions, settings) for own in pair]
    done = file.done
    count = sum(len(batch.pairs) for batch in batches)
    left = [batch for batch in batches if batch.pairs[0] not in done]
    told = _Told(progress, count, count - sum(len(batch.pairs) for batch in left))

    def take(batch: Batch, outcomes: list[Outcome]) -> None:
        file.keep(outcomes)
        told(outcomes)

    executors.run("octo.motion_graph.build", left, work, take, executor)


def _crossings(motions: Mapping[str, Solution], settings: _Settings) -> list[list[Batch]]:
    """The batches of each pair of motions, and of each motion with itself."""
    dt = next(iter(motions.values())).dt
    steps, spacing = steps_in(settings.transitions, dt), steps_in(settings.moments, dt)
    if steps < 4:
        raise ValueRangeError(
            f"transitions is {settings.transitions:g}, must be four steps of {dt:g} s or more"
        )
    apart, made = spacing * settings.every, []
    for a, one in motions.items():
        for b, other in motions.items():
            crossing = Crossing(one, other, steps, [Effort()])
            limits = held(crossing.robot, settings.constraints)
            crossing = replace(crossing, constraints=limits)
            pairs = (
                _loops(crossing, a, apart, settings.loops)
                if a == b
                else _pairs(crossing, a, b, apart, settings.share)
            )
            made.append(batches_of(crossing, pairs, settings.batch, settings.options))
    return made


def _pairs(crossing: Crossing, a: str, b: str, apart: int, share: float) -> list[Pair]:
    """The pairs of moments of two motions, all or those that are most alike."""
    leaving = range(0, crossing.one.steps, apart)
    reaching = range(0, crossing.other.steps, apart)
    pairs = [Pair(a, at, b, to) for at in leaving for to in reaching]
    if share >= 1.0:
        return pairs
    distance = np.array([crossing.placed(p.at, p.to)[0].distance[0, 0] for p in pairs])
    best = np.sort(np.argsort(distance, kind="stable")[: max(1, round(share * len(pairs)))])
    return [pairs[k] for k in best]


def _loops(crossing: Crossing, name: str, apart: int, count: int) -> list[Pair]:
    """Ways of a motion back into itself: the most alike ones, no two that leave and reach almost
    the same moments."""
    if count == 0 or crossing.steps > crossing.one.steps:
        return []
    found, leaving, reaching = crossing.similarity(apart)
    # it leads further back than a transition lasts, or it is hardly a loop
    back = leaving[:, None] - reaching[None] >= crossing.steps
    distance = np.where(back, found.distance, np.inf)
    made: list[Pair] = []
    while len(made) < count and np.isfinite(distance).any():
        k, m = np.unravel_index(int(np.argmin(distance)), distance.shape)
        made.append(Pair(name, int(leaving[k]), name, int(reaching[m])))
        near = np.abs(leaving - leaving[k])[:, None] + np.abs(reaching - reaching[m])
        distance[near < crossing.steps] = np.inf
    return made


class _Told:
    """How far a build is, and when it will end."""

    def __init__(self, progress: Progress | None, count: int, known: int):
        self.progress, self.count, self.known = progress, count, known
        self.done = self.found = 0
        self.began = self.last = time.perf_counter()

    def __call__(self, outcomes: Sequence[Outcome]) -> None:
        self.done += len(outcomes)
        self.found += sum(one.found for one in outcomes)
        now, all_done = time.perf_counter(), self.known + self.done
        if self.progress is None or (now - self.last < 5.0 and all_done < self.count):
            return
        self.last = now
        left = (self.count - all_done) * (now - self.began) / self.done
        self.progress(
            f"{all_done} of {self.count} pairs, {self.found / self.done:.0%} of those now found, "
            f"{left / 60.0:.1f} minutes left"
        )
