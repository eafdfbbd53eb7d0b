"""``octo.motion_graph.build``: motions, and a transition wherever there is one (§8.6)."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import Any, Unpack

import numpy as np

from octo import executors
from octo.checks import asked, steps_in, takes
from octo.errors import ProblemError, ValueRangeError, said
from octo.model.character import Character
from octo.motion_graph.crossing import Crossing
from octo.motion_graph.file import File
from octo.motion_graph.gather import Motions, Wanted, gathered
from octo.motion_graph.graph import MotionGraph
from octo.motion_graph.settings import MOTIONS, Building, Settings
from octo.motion_graph.similarity import points_of
from octo.motion_graph.work import Batch, Outcome, Pair, batches_of, work
from octo.problem.hard import held
from octo.progress import Progress
from octo.result.solution import Solution
from octo.solve import Usual

# decimals of m to which distances tie, in the order of moments: beyond them is rounding, and the
# same build on another machine must try the same pairs
SAME = 7


@asked
@takes(Settings, Usual)
def build(
    robot: Character,
    motions: Motions = MOTIONS,
    *,
    path: str | os.PathLike[str],
    executor: Executor | None = None,
    **how: Unpack[Building],
) -> MotionGraph:
    """Find motions, loops in them and transitions between them, and keep all in one file.

    What is finished is in the file at once: a build that was stopped goes on where it was when it
    is called again with the same words.

    Parameters
    ----------
    robot: with a floating base; the ground is level.
    motions: names: "walk", "back", "left", "right" (turns on the spot), "stride_left",
        "stride_right", "jump"; or by name motions of yours, or paths of such, of this robot on
        level ground, all with one dt.
    path: of the file, an SQLite database.
    seconds, dt: s, of motions that are found by their names. transitions: s, of a transition.
    moments: s between moments at which a motion may be left or reached; ``every`` so many of them
        are looked at.
    share: of all pairs of moments of two motions, the most alike (Kovar et al. 2002); 1 is all.
    window: s, over which motions are compared, from a moment that is left and to one that is
        reached; by default the transition. cloud: (robot, x (…, nx)) to the points (…, points, 3) m
        that are compared; by default where bodies and contacts are.
    loops: of each motion, so many ways back into itself, from late moments to early alike ones.
    costs: terms of a transition's E; by default effort, as in the paper.
    constraints: what must hold of transitions, and of motions that are found by name: those of a
        Problem, or "hard", the limits of the robot as :func:`octo.limits` lists them.
    batch: so many that are alike are solved together, from the nearest one that was found.
    executor: of ``concurrent.futures``, or a Dask client's ``get_executor()``; it is left open. By
        default as many processes as there are cores, for which a script needs
        ``if __name__ == "__main__":``.
    max_iterations: of a transition, by default 300. options, time_limit, tolerance, device,
        threads, progress: as those of :func:`octo.solve`; passes and callback cannot be given.

    Returns
    -------
    The graph that the file holds. Ctrl-C returns what there is, unless there is no transition yet.

    Raises
    ------
    OctoError: an argument or the file is refused, or a motion is not found.
    """
    settings = Settings.of(how)
    settings.check(robot, motions, executor)
    with File(path, writes=True) as file:
        record = settings.record(robot, motions)
        _check_same(file, record)
        progress = Progress("") if settings.progress else None
        try:
            wanted = Wanted(robot, motions, settings.seconds, settings.dt, settings.constraints)
            given = gathered(file, wanted, settings.of_motions, executor, progress)
            _cross(file, given, settings, executor, progress)
        except KeyboardInterrupt:
            if not file.done:
                raise
    return MotionGraph(path)


def _check_same(file: File, record: Mapping[str, Any]) -> None:
    """A file without a motion is of this graph now; one of another graph is refused."""
    known = file.record
    if not file.names:
        file.keep_record(dict(record))
        return
    for name, new in record.items():
        if (old := known.get(name)) != new:
            told = f"{name} is {said(old)} there and {said(new)} here"
            if name in ("robot's numbers", "costs", "constraints"):
                told = f"{name} are others"
            raise ProblemError(f"{file.path} is of another graph: {told}; give another path")


# -- transitions -----------------------------------------------------------------------------------


def _cross(
    file: File,
    motions: Mapping[str, Solution],
    settings: Settings,
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


def _crossings(motions: Mapping[str, Solution], settings: Settings) -> list[list[Batch]]:
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
            crossing = crossing_of(one, other, steps, settings)
            pairs = (
                _loops(crossing, a, apart, settings.loops)
                if a == b
                else pairs_of(crossing, a, b, apart, settings.share)
            )
            made.append(batches_of(crossing, pairs, settings.batch, settings.options))
    return made


def crossing_of(one: Solution, other: Solution, steps: int, settings: Settings) -> Crossing:
    """What the transitions between two motions share."""
    window = None if settings.window is None else steps_in(settings.window, one.dt)
    cloud = points_of if settings.cloud is None else settings.cloud
    begun = Crossing(one, other, steps, settings.costs, window=window, cloud=cloud)
    made = replace(begun, constraints=held(begun.robot, settings.constraints))
    _ = made.limits  # once, here, and not for every batch
    return made


def pairs_of(crossing: Crossing, a: str, b: str, apart: int, share: float) -> list[Pair]:
    """The pairs of moments of two motions, all or those that are most alike."""
    found, leaving, reaching = crossing.similarity(apart, held=True)
    wanted = max(1, round(share * found.distance.size))
    order = np.argsort(np.round(found.distance, SAME), axis=None, kind="stable")
    best = np.sort(order[:wanted])
    at, to = np.unravel_index(best, found.distance.shape)
    return [Pair(a, int(leaving[k]), b, int(reaching[m])) for k, m in zip(at, to, strict=True)]


def _loops(crossing: Crossing, name: str, apart: int, count: int) -> list[Pair]:
    """Ways of a motion back into itself: the most alike ones, no two that leave and reach almost
    the same moments."""
    if count == 0 or crossing.steps > crossing.one.steps:
        return []
    found, leaving, reaching = crossing.similarity(apart)
    # it leads further back than a transition lasts, or it is hardly a loop
    back = leaving[:, None] - reaching[None] >= crossing.steps
    distance = np.where(back, np.round(found.distance, SAME), np.inf)
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
