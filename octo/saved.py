"""What octo wrote, by its path: a solution or a log, the file or the folder of a command."""

from __future__ import annotations

import os
from pathlib import Path

from octo.mpc.log import Log
from octo.result.solution import Solution, solution_of

Motion = Solution | Log | str | os.PathLike[str]


def opened(path: str | os.PathLike[str]) -> Solution | Log:
    """The solution or the log that a file or a folder holds; of a folder with both the solution."""
    given = Path(path)
    log = given / Log.FILE if os.path.isdir(given) else given
    if log.name == Log.FILE and os.path.isfile(log) and not os.path.isfile(given / Solution.FILE):
        return Log.load(log)
    return Solution.load(given)


def motion_of(given: Motion) -> Solution:
    """A Solution as it is, a Log's motion, or either by its path."""
    found = opened(given) if isinstance(given, (str, os.PathLike)) else given
    return found.solution() if isinstance(found, Log) else solution_of(found)
