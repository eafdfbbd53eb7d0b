"""The file of a motion graph: one SQLite database, so that what is written is whole, a build that
was stopped goes on, and one transition of many thousands is read alone.

=============  =====================================================================================
table          a row
=============  =====================================================================================
record         a name and JSON: what the graph is of
motions        a motion, as the bytes of a Solution's .npz file
transitions    a pair of moments, found or not: numbers that say how good it is, or why it was not
paths          a found transition's arrays: x float64, torques and forces float32
=============  =====================================================================================
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import sqlite3
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from octo.checks import Array
from octo.errors import OctoError, OutputError, ProblemError, RobotFileError
from octo.files import reason
from octo.motion_graph.work import Outcome, Pair
from octo.result.solution import Solution

FORMAT = 1
WAIT = 60.0  # s, for a reader that has the file
APPLICATION = 0x6F63746F  # "octo", in the header of the file
# of an Outcome, each a column
NUMBERS = ["violation", "effort", "torque", "iterations", "seconds", "distance", "yaw"]
NUMBERS += ["shift_x", "shift_y"]
TABLES = f"""
CREATE TABLE record (name TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE motions (name TEXT PRIMARY KEY, file BLOB NOT NULL);
CREATE TABLE transitions (
    number INTEGER PRIMARY KEY, one TEXT, at INTEGER, other TEXT, "to" INTEGER, found INTEGER,
    reason TEXT, {", ".join(f"{name} REAL" for name in NUMBERS)}, UNIQUE (one, at, other, "to"));
CREATE TABLE paths (number INTEGER PRIMARY KEY, x BLOB NOT NULL, u BLOB, force BLOB);
"""


class File:
    """A motion graph's file, open.

    Parameters
    ----------
    path: of the file. writes: as one of which there is one at a time; it is made if it is not
        there.

    Raises
    ------
    RobotFileError: it is no such file. OutputError: it cannot be read or written. ProblemError:
        another build writes it.
    """

    def __init__(self, path: str | os.PathLike[str], writes: bool = False):
        self.path, self.writes = Path(path), writes
        self._new = not self.path.exists()
        self._lock: int | None = None
        if writes:
            self._lock = self._alone()
        elif not self.path.is_file():
            raise RobotFileError(f"{self.path} is not there: octo.motion_graph.build makes it")
        with self._said(), contextlib.ExitStack() as failed:
            failed.callback(self._unlock)
            way = f"{self.path.absolute().as_uri()}?mode={'rwc' if writes else 'ro'}"
            self.database = sqlite3.connect(way, uri=True, timeout=WAIT, check_same_thread=False)
            failed.callback(self.database.close)
            self._begin()
            failed.pop_all()

    def _begin(self) -> None:
        """An empty file gets its tables; any other must be octo's."""
        empty = not self.database.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
        if empty and self.writes:
            self.database.executescript(f"BEGIN; PRAGMA application_id = {APPLICATION}; {TABLES}")
            self._record("format", FORMAT)
            self.database.commit()
        known = self.database.execute("PRAGMA application_id").fetchone()[0]
        if known != APPLICATION:
            raise RobotFileError(f"{self.path} is not a motion graph that octo wrote")
        found = self.record.get("format")
        if found != FORMAT:
            raise RobotFileError(f"{self.path} is of format {found!r}, must be {FORMAT}")

    def close(self) -> None:
        """A new file that has no motion is not left behind."""
        empty = self.writes and self._new and not self.names
        self.database.close()
        if empty:
            self.path.unlink(missing_ok=True)
        self._unlock()  # behind it: a file that this process closes loses all its locks

    def __enter__(self) -> File:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def _alone(self) -> int:
        """Take the lock of the one that writes."""
        try:
            handle = os.open(self.path, os.O_RDWR | os.O_CREAT, 0o666)
        except (OSError, ValueError) as error:
            raise OutputError(f"{self.path} cannot be written: {reason(error)}") from error
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            raise ProblemError(f"{self.path} is being written by another build") from None
        except OSError as error:  # a file system without locks
            if error.errno not in (errno.ENOLCK, errno.ENOTSUP):
                raise
        return handle

    def _unlock(self) -> None:
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    @contextlib.contextmanager
    def _said(self) -> Iterator[None]:
        """What the database says, as one line."""
        try:
            yield
        except sqlite3.OperationalError as error:
            doing = "written" if self.writes else "read"
            raise OutputError(f"{self.path} cannot be {doing}: {error}") from error
        except (sqlite3.Error, json.JSONDecodeError, UnicodeDecodeError) as error:
            raise RobotFileError(f"{self.path} is damaged: {error}") from error

    # -- what it is of -----------------------------------------------------------------------------

    @property
    def record(self) -> dict[str, Any]:
        with self._said():
            rows = self.database.execute("SELECT name, value FROM record").fetchall()
            return {name: json.loads(value) for name, value in rows}

    def _record(self, name: str, value: Any) -> None:
        row = name, json.dumps(value)
        self.database.execute("INSERT OR REPLACE INTO record VALUES (?, ?)", row)

    def keep_record(self, record: dict[str, Any]) -> None:
        with self._said(), self.database:
            for name, value in record.items():
                self._record(name, value)

    @property
    def names(self) -> list[str]:
        """Of the motions, in the order in which they came."""
        with self._said():
            rows = self.database.execute("SELECT name FROM motions ORDER BY rowid").fetchall()
        return [name for (name,) in rows]

    def motion(self, name: str) -> Solution:
        with self._said():
            row = self.database.execute("SELECT file FROM motions WHERE name = ?", (name,))
            (file,) = row.fetchone()
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "motion.npz"
            path.write_bytes(file)
            try:
                return Solution.load(path)
            except OctoError as error:
                raise RobotFileError(f"{self.path}, motion {name!r}: {error}") from error

    def keep_motion(self, name: str, motion: Solution) -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "motion.npz"
            motion.save(path)
            file = path.read_bytes()
        with self._said(), self.database:
            self.database.execute("INSERT INTO motions VALUES (?, ?)", (name, file))

    # -- transitions -------------------------------------------------------------------------------

    def keep(self, outcomes: Sequence[Outcome]) -> None:
        """All of them, or where that fails none."""
        marks = ", ".join("?" * (6 + len(NUMBERS)))
        names = f'one, at, other, "to", found, reason, {", ".join(NUMBERS)}'
        with self._said(), self.database:
            for one in outcomes:
                values = [getattr(one, name) for name in NUMBERS[:-2]] + [*one.shift.tolist()]
                pair = one.pair
                row = (pair.one, pair.at, pair.other, pair.to, one.found, one.reason, *values)
                made = self.database.execute(
                    f"INSERT INTO transitions ({names}) VALUES ({marks})",
                    [v.item() if isinstance(v, np.generic) else v for v in row],
                )
                if one.found:
                    arrays = _blob(one.x, "<f8"), _blob(one.u, "<f4"), _blob(one.force, "<f4")
                    path = (made.lastrowid, *arrays)
                    self.database.execute("INSERT INTO paths VALUES (?, ?, ?, ?)", path)

    @property
    def done(self) -> set[Pair]:
        """The pairs that were solved, found or not."""
        with self._said():
            rows = self.database.execute('SELECT one, at, other, "to" FROM transitions')
            return {Pair(*row) for row in rows}

    def table(self) -> list[dict[str, Any]]:
        """The numbers of all pairs."""
        names = ["number", "one", "at", "other", "to", "found", "reason", *NUMBERS]
        words = ", ".join(f'"{name}"' for name in names)
        with self._said():
            rows = self.database.execute(f"SELECT {words} FROM transitions ORDER BY number")
            return [dict(zip(names, row, strict=True)) for row in rows]

    def arrays(self, number: int, nx: int) -> tuple[Array, Array, Array]:
        """x (N+1, nx), u (N, nu) and forces (N, c, 3) of a transition that was found."""
        with self._said():
            found = self.database.execute(
                "SELECT x, u, force FROM paths WHERE number = ?", (number,)
            )
            row = found.fetchone()
        try:
            x = np.frombuffer(row[0], dtype="<f8").reshape(-1, nx)
            u, force = (np.frombuffer(own, dtype="<f4").astype(float) for own in row[1:])
            return x, u.reshape(len(x) - 1, -1), force.reshape(len(x) - 1, -1, 3)
        except (TypeError, ValueError) as error:
            raise RobotFileError(
                f"{self.path} is damaged: transition {number} has no path"
            ) from error


def _blob(values: Array, kind: str) -> bytes:
    return np.ascontiguousarray(values, dtype=kind).tobytes()
