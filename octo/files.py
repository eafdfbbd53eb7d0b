"""Files that are whole or not there: scratch folders, lasting renames, safe names."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import shutil
import tempfile
import time
import unicodedata
from collections.abc import Iterator
from pathlib import Path

from octo.errors import OutputError

# how the names of scratch folders begin; eight letters of tempfile's follow
SCRATCH = ".octo-scratch-"
# bytes of what a file's word becomes of a folder's name; file systems allow 255 in all
LONGEST_NAME = 80


@contextlib.contextmanager
def scratch(folder: Path) -> Iterator[Path]:
    """A new folder in ``folder``, removed at the end; those that dead processes left there are
    removed first."""
    path, lock = locked(folder, SCRATCH)
    try:
        yield path
    finally:
        shutil.rmtree(path, ignore_errors=True)
        os.close(lock)


def locked(folder: Path, prefix: str) -> tuple[Path, int]:
    """A new folder, and the file descriptor that holds its lock: the system opens it when the
    process ends, however it does."""
    sweep(folder, prefix)
    while True:
        path = Path(tempfile.mkdtemp(prefix=prefix, dir=folder))
        # another process took it for a dead one's before it was locked
        with contextlib.suppress(FileNotFoundError):
            lock = os.open(path, os.O_RDONLY)
            # a file system without locks: nobody sweeps there either
            with contextlib.suppress(OSError):
                fcntl.flock(lock, fcntl.LOCK_EX)
            if path.exists():
                return path, lock
            os.close(lock)


@contextlib.contextmanager
def alone(path: Path, seconds: float) -> Iterator[None]:
    """Wait until no other process is within ``alone`` of that path, for so long at most: for work
    that two may do without harm, and one should. The lock is a file beside it."""
    lock, end = path.with_name(f"{path.name}.lock"), time.monotonic() + seconds
    handle = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    try:
        while time.monotonic() < end:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                time.sleep(0.02)
            except OSError:  # a file system without locks
                break
        yield
    finally:
        lock.unlink(missing_ok=True)
        os.close(handle)


def sweep(folder: Path, prefix: str) -> None:
    """Remove this user's folders of that name whose process has ended."""
    ours = re.compile(re.escape(prefix) + r"[a-z0-9_]{8}")
    try:
        found = [Path(entry.path) for entry in os.scandir(folder) if ours.fullmatch(entry.name)]
    except OSError:
        return
    for path in found:
        with contextlib.suppress(OSError):
            lock = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_DIRECTORY)
            try:
                if os.fstat(lock).st_uid == os.geteuid():
                    fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    shutil.rmtree(path, ignore_errors=True)
            finally:
                os.close(lock)


def settle(path: Path) -> None:
    """Wait until a file's or a folder's contents are on the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def place(made: Path, target: Path) -> None:
    """Rename a finished file of the same disk to ``target``: there is the old one or the whole new
    one, whatever happens."""
    settle(made)
    os.replace(made, target)
    with contextlib.suppress(OSError):  # some file systems cannot
        settle(target.parent)


@contextlib.contextmanager
def replacing(target: str | os.PathLike[str]) -> Iterator[Path]:
    """A path to write ``target``'s new contents to, which takes its place at the end, if all went
    well; else OutputError names the file and the system's reason."""
    path = Path(target)
    try:
        with scratch(path.parent) as folder:
            beside = folder / path.name
            yield beside
            place(beside, path)
    except (OSError, ValueError) as error:  # the latter: a zero byte in the name
        raise OutputError(f"{path} cannot be written: {reason(error)}") from error


def is_file(path: Path) -> bool:
    """Whether there is a file; no for names that no file can have: too long, or with a zero
    byte."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def reason(error: Exception) -> str:
    """What the system says, in one line."""
    return " ".join(str(getattr(error, "strerror", None) or error).split())


def file_name(word: str) -> str:
    """``word``, which a file or a user gave, as a part of a file's name: letters, digits and "-+._"
    alone, and not too long."""
    letters = unicodedata.normalize("NFC", str(word))
    plain = "".join(c if c.isalnum() or c in "-+._" else "_" for c in letters)
    plain = re.sub(r"\.{2,}|_{2,}", "_", plain).strip("._")
    return plain.encode("utf-8", "ignore")[:LONGEST_NAME].decode("utf-8", "ignore") or "unnamed"
