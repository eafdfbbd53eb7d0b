"""The motions of a graph: yours, or found by their names, each in a process of its own; all under
one contact law."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from octo import executors
from octo.errors import OctoError, ProblemError
from octo.executors import Failed
from octo.model.character import Character
from octo.motion_graph.crossing import check_alike
from octo.motion_graph.file import File
from octo.motion_graph.named import NAMED, POSED
from octo.motion_graph.one_law import under_one_law
from octo.problem.hard import Held
from octo.progress import Progress
from octo.result.solution import Solution, solution_of

if TYPE_CHECKING:
    import os

FAR = 0.2  # of ℓ: a robot that stands higher or lower by more goes into another pose as it moves
Motions = Sequence[str] | Mapping[str, "Solution | str | os.PathLike[str]"]


@dataclass(frozen=True, eq=False)
class Wanted:
    """Which motions, and how those are found of which only the name is known."""

    robot: Character
    motions: Motions
    seconds: float
    dt: float
    constraints: Held


@dataclass(frozen=True, eq=False)
class Search:
    """One motion that is to be found."""

    robot: Character
    name: str
    seconds: float
    how: Mapping[str, Any]


def find(search: Search) -> Solution | Failed:
    """Of a worker: the motion of that name."""
    robot, name = search.robot, search.name
    try:
        motion = NAMED[name](robot, search.seconds, **search.how)
    except OctoError as error:
        return Failed(f"motion {name!r} of {robot.name}: {error}")
    if not motion.converged:
        return Failed(f"motion {name!r} of {robot.name}: {motion.sentence}")
    return motion


def gathered(
    file: File,
    wanted: Wanted,
    how: Mapping[str, Any],
    executor: Executor | None,
    progress: Progress | None,
) -> dict[str, Solution]:
    """The motions by name, in their order; those that the file has not yet are found, or taken,
    and kept there.

    Raises
    ------
    ProblemError: one is not found, or is not of the same robot, ground, dt and law as the first.
    """
    names, known = list(wanted.motions), file.names
    given = {**how, "dt": wanted.dt, "constraints": wanted.constraints}
    searches = {name: Search(wanted.robot, name, wanted.seconds, given) for name in names}
    made = {name: file.motion(name) for name in known}
    kept = _Kept(file, wanted, searches, made, progress)
    if isinstance(wanted.motions, Mapping):
        for name in names[len(known) :]:
            kept.add(name, solution_of(wanted.motions[name]))
        return kept.made
    left = [search for name, search in searches.items() if name not in known]

    def take(search: Search, motion: Solution) -> None:
        kept.add(search.name, motion)

    executors.run("octo.motion_graph.build", left, find, take, executor)
    return kept.made


class _Kept:
    """Motions as they come, kept in the order of their names: the first one has the law."""

    def __init__(
        self,
        file: File,
        wanted: Wanted,
        searches: Mapping[str, Search],
        made: dict[str, Solution],
        progress: Progress | None,
    ):
        self.file, self.wanted, self.searches, self.made = file, wanted, searches, made
        self.names, self.progress = list(searches), progress
        self._waiting: dict[str, Solution] = {}

    def add(self, name: str, motion: Solution) -> None:
        self._waiting[name] = motion
        while len(self.made) < len(self.names):
            name = self.names[len(self.made)]
            if name not in self._waiting:
                return
            own = self._waiting.pop(name)
            self._check_robot(name, own)
            like = next(iter(self.made.values()), own)
            check_alike(like, own)
            own = self._as_it_stands(name, own, like)
            self.made[name] = under_one_law(own, like, self.wanted.constraints, name)
            self.file.keep_motion(name, self.made[name])
            if self.progress is not None:
                self.progress(f"motion {name!r} is there")

    def _as_it_stands(self, name: str, own: Solution, like: Solution) -> Solution:
        """A motion found by its name that stands much higher or lower than ``like``, found again as
        that one stands, if it can begin in any pose."""
        named = not isinstance(self.wanted.motions, Mapping)
        if not named or name not in POSED or abs(own.length - like.length) <= FAR * like.length:
            return own
        search = self.searches[name]
        found = find(replace(search, how={**search.how, "pose": like.x[1]}))
        if isinstance(found, Failed):
            raise ProblemError(found.words)
        return found

    def _check_robot(self, name: str, motion: Solution) -> None:
        robot, its = self.wanted.robot, motion.character
        if its is None or (its.name, its.nx) != (robot.name, robot.nx):
            told = f"{its.name} with {its.nx} coordinates" if its else motion.name
            raise ProblemError(
                f"motion {name!r} is of {told}, must be of {robot.name} with {robot.nx}"
            )
