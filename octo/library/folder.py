"""The folder of a library: finished batches, and what they are of."""

from __future__ import annotations

import json
import os
import pickle
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from octo.digest import digest
from octo.errors import OutputError, ProblemError, RobotFileError
from octo.files import reason, replacing
from octo.library.collection import Library
from octo.library.commands import numbers_of
from octo.library.work import Done, Task
from octo.model import store
from octo.problem.problem import Problem
from octo.result.solution import Solution
from octo.soft import store as soft_store
from octo.soft.dynamics import SoftDynamics
from octo.world.world import World

RECORD = "library.json"
FORMAT = 1


def record_of(problems: Sequence[Problem], tasks: Sequence[Task], batch: int) -> dict[str, Any]:
    """What a library is of, by name: words and numbers, and digests of what is longer."""
    first = problems[0]
    told = [numbers_of(problem) for problem in problems]
    names = dict.fromkeys(name for own in told for name in own)
    how = {name: _plain(value) for name, value in tasks[0].how.items() if name != "threads"}
    robots = {id(p.character): p.character for p in problems if p.character is not None}
    soft = {id(p.dynamics): p.dynamics for p in problems if isinstance(p.dynamics, SoftDynamics)}
    bodies = [soft_store.to_plain(own.coordinates) for own in soft.values()]
    terrain = getattr(first.dynamics, "terrain", None)
    return {
        "format": FORMAT,
        "count of problems": len(problems),
        "robot": first.dynamics.name if first.character is None else first.character.name,
        "robot's numbers": digest([store.to_plain(robot) for robot in robots.values()] or bodies),
        "world": digest(pickle.dumps(terrain)) if isinstance(terrain, World) else None,
        "steps": int(first.steps),
        "basis": repr(first.basis_object),
        "terms": [term.label for term in first.terms],
        "batch": batch,
        "gains": tasks[0].gains,
        "start": digest([_start(start) for task in tasks for start in task.starts]),
        **how,
        **{name: digest([own.get(name) for own in told]) for name in names},
    }


def _start(start: Any) -> Any:
    return start.x if isinstance(start, Solution) else start


def _plain(value: Any) -> Any:
    """An option of octo.solve as JSON has it."""
    if hasattr(value, "__dataclass_fields__"):
        return json.loads(json.dumps(asdict(value), default=repr))
    return value


class Folder:
    """Where finished batches lie.

    Parameters
    ----------
    path: it is made if it is not there. record: of the library that is asked for.

    Raises
    ------
    ProblemError: it holds a library of other problems. OutputError: it cannot be written.
    """

    def __init__(self, path: str | os.PathLike[str], record: dict[str, Any]):
        self.path = Path(path)
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{self.path} cannot be written: {reason(error)}") from error
        there = self.path / RECORD
        if there.exists():
            self._check(there, record)
            return
        with replacing(there) as beside:
            beside.write_text(json.dumps(record, indent=1), encoding="utf-8")

    def _check(self, there: Path, record: dict[str, Any]) -> None:
        """Refuse a folder of other problems."""
        try:
            known = json.loads(there.read_text(encoding="utf-8"))
            names = list(dict.fromkeys([*known, *record]))
        except Exception as error:
            raise RobotFileError(f"{there} is not a record of a library: {error}") from error
        for name in names:
            old, new = known.get(name), record.get(name)
            if old == new:
                continue
            told = f"{name} is {old!r} there and {new!r} here"
            if isinstance(new, str) and len(new) == 16:
                told = f"{name} is not the same"
            raise ProblemError(
                f"folder {str(self.path)!r} holds a library of other problems: {told}; give "
                "another folder"
            )

    def _file(self, number: int) -> Path:
        return self.path / f"batch-{number:04d}.npz"

    def found(self, task: Task) -> Library | None:
        """A finished batch, if it is there."""
        file = self._file(task.number)
        return Library.load(file) if file.exists() else None

    def keep(self, task: Task, library: Library) -> None:
        """Write a finished batch."""
        library.save(self._file(task.number))


def batch_of(task: Task, done: Done) -> Library:
    """A finished batch, without its commands."""
    return Library(done.motions, {}, task.indices, done.gains)
