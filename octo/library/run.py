"""The front door of libraries: many problems of one structure, solved as batches in many
processes."""

from __future__ import annotations

import os
import pickle
from collections.abc import Sequence
from concurrent.futures import Executor
from typing import Any

from octo import executors
from octo.checks import asked, flag, takes, whole
from octo.devices import check_device_name
from octo.errors import ProblemError
from octo.gains import check_gains
from octo.library.collection import Library, joined
from octo.library.commands import check_plain, commands_of
from octo.library.folder import Folder, batch_of, record_of
from octo.library.work import Done, Task, work
from octo.problem.phased import check_all_alike
from octo.problem.problem import Problem
from octo.progress import Progress, check_progress
from octo.solve import Guess, Start, Usual
from octo.starts import starts_of

BATCH = 8  # problems: enough for the vectors of a step, few enough for Ctrl-C and for two processes


@asked
@takes(Usual)
def library(
    problems: Sequence[Problem],
    *,
    folder: str | os.PathLike[str] | None = None,
    executor: Executor | None = None,
    batch: int = BATCH,
    start: Start = None,
    seeds: int = 1,
    seed: int = 0,
    gains: bool = False,
    **how: Any,
) -> Library:
    """Solve many problems of one structure, and keep them with what was asked of each.

    Each batch is one call of :func:`octo.solve`, in a process of its own or wherever ``executor``
    sends it.

    Parameters
    ----------
    problems: of one robot, with the same terms, basis and steps, as of one batch of ``octo.solve``.
    folder: where finished batches are written, and read the next time: what was stopped goes on. A
        folder of other problems is refused.
    executor: of ``concurrent.futures``, or with its ``submit``, such as a Dask client's
        ``get_executor()``; it is left open. By default as many processes as there are cores, that
        begin with nothing of this one, so that a script needs ``if __name__ == "__main__":``.
    batch: problems that are solved as one.
    start: as of ``octo.solve``: one for all, or a list of one for each problem.
    seeds: starts of each problem; ``seed`` is the first one's number.
    gains: also :func:`octo.gains` of each motion.
    callback: cannot be given: it stays in its process.

    Returns
    -------
    A Library, in the order of the problems; the seconds of a motion are its share of its batch's.
    Ctrl-C returns the batches that were finished.

    Raises
    ------
    OctoError: problems, an option or the folder are refused, or a worker failed; the message names
        the problem. Finished batches stay in the folder.
    """
    given = check_plain(problems)
    progress = _check(given, executor, batch, gains, how)
    options = {**how, "seeds": seeds, "seed": seed, "progress": False}
    del options["callback"]
    tasks = _tasks(given, starts_of(start, given, 1), batch, options, gains)
    commands = commands_of(given)
    kept = None if folder is None else Folder(folder, record_of(given, tasks, batch))
    parts = _Parts(kept, Progress(progress) if progress is not None else None, len(given))
    left = [task for task in tasks if not parts.known(task)]
    try:
        if left:
            if executor is None:
                _check_sent(left[0])
            executors.run("octo.library", left, work, parts.take, executor)
    except KeyboardInterrupt:
        if not parts.parts:
            raise
    return joined(parts.parts, commands, len(given))


def _tasks(
    problems: Sequence[Problem],
    starts: Sequence[Guess],
    batch: int,
    how: dict[str, Any],
    gains: bool,
) -> list[Task]:
    """The batches."""
    made = []
    for number, k in enumerate(range(0, len(problems), batch)):
        own = tuple(problems[k : k + batch]), tuple(starts[k : k + batch])
        made.append(Task(number, k, *own, how, gains))
    return made


def _check(
    problems: Sequence[Problem],
    executor: Executor | None,
    batch: int,
    gains: bool,
    how: dict[str, Any],
) -> str | None:
    """Refuse what can be refused before anything is sent; what progress is said behind, if any."""
    whole("batch", batch)
    flag("gains", gains)
    check_progress(how["progress"], how["callback"])
    check_device_name(how["device"])
    if how["callback"] is not None:
        raise ProblemError("callback is given, must be left out: octo.library has progress=True")
    executors.check_executor(executor)
    check_all_alike(list(problems))
    if gains:
        for problem in problems:
            check_gains(problem)
    if not how["progress"]:
        return None
    return how["progress"] if isinstance(how["progress"], str) else ""


class _Parts:
    """The batches that are finished."""

    def __init__(self, folder: Folder | None, progress: Progress | None, count: int):
        self.folder, self.progress, self.count = folder, progress, count
        self.parts: list[Library] = []

    def known(self, task: Task) -> bool:
        """Whether the folder has it."""
        found = None if self.folder is None else self.folder.found(task)
        if found is not None:
            self._add(found)
        return found is not None

    def take(self, task: Task, done: Done) -> None:
        """A new one, which is kept."""
        found = batch_of(task, done)
        if self.folder is not None:
            self.folder.keep(task, found)
        self._add(found)

    def _add(self, found: Library) -> None:
        self.parts.append(found)
        if self.progress is not None:
            done = [bool(one) for part in self.parts for one in part.converged]
            self.progress(f"{len(done)} of {self.count} problems, {sum(done)} converged")


def _check_sent(task: Task) -> None:
    """Refuse problems that no other process can be sent, by their number."""
    for k, problem in enumerate(task.problems):
        try:
            pickle.dumps(problem)
        except Exception as error:
            raise ProblemError(
                f"problem {task.first + k} cannot be sent to another process: {error}; "
                f"{executors.UNSENT}"
            ) from error
