"""Compiled code on the disk: only files that this user's octo made whole are ever loaded.

Beside each file is its digest: a file that was cut, changed or put there by something else is made
anew. The folder is ``$OCTO_CACHE``, else the user's cache folder. Where it cannot serve (a disk
that is full, read-only or forbids code, no home, a folder that others own or may write to) one
temporary folder does, for as long as the process runs.
"""

from __future__ import annotations

import atexit
import functools
import hashlib
import logging
import os
import shutil
import stat
import threading
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

from octo.errors import DeviceError
from octo.files import alone, locked, place, reason, scratch

LOG = logging.getLogger("octo")
TEMPORARY = "octo-code-"  # how the names of temporary folders begin
OTHERS = stat.S_IWGRP | stat.S_IWOTH
NOEXEC: int = getattr(os, "ST_NOEXEC", 0)
PATIENCE = 300.0  # s, for another process that makes the same file; the longest compile takes 40

Maker = Callable[[Path], object]  # writes the file at the path that it is given

# by file: two threads compile it once
_locks: defaultdict[str, threading.Lock] = defaultdict(threading.Lock)
_given_up: set[Path] = set()  # folders that could not be written in this process


class Unsafe(Exception):
    """Code that others may have written; says why."""


def path_of(name: str, make: Maker) -> Path:
    """The file ``name`` of the cache, made by ``make(path)`` where it is not there or not as it was
    made. DeviceError: no folder to make it in; and what ``make`` raises in the temporary one too.
    """
    with _locks[name]:
        folder = lasting()
        if folder is None:
            return path_in_temporary(name, make)
        path = folder / name
        if whole(path):
            return path
        if folder in _given_up:
            return path_in_temporary(name, make)
        try:
            with alone(path, PATIENCE):
                if not whole(path):  # nor has another process made it meanwhile
                    _make(path, make)
            return path
        except (OSError, DeviceError) as error:  # a compiler on a full disk fails in its own words
            made = path_in_temporary(name, make)  # raises where the folder was not to blame
            give_up(folder, reason(error))
            return made


def path_in_temporary(name: str, make: Maker) -> Path:
    """The file ``name`` in the temporary folder."""
    path = temporary() / name
    try:
        if not whole(path):
            _make(path, make)
    except OSError as error:
        why = f"no compiled code can be written to {path.parent}: {reason(error)}"
        raise DeviceError(why) from error
    return path


def lasting() -> Path | None:
    """The folder where compiled code is kept, absolute, made with mode 0700 where it is missing;
    None: there is none."""
    folder = wanted()
    if folder is None:
        _say(
            "octo: there is no home folder for compiled code: it is compiled again in every process"
        )
        return None
    try:
        _check(folder)
    except Unsafe as error:
        give_up(folder, str(error))
        return None
    return folder


def wanted() -> Path | None:
    """The folder that the environment names, absolute; None without a home."""
    named, base = os.environ.get("OCTO_CACHE"), os.environ.get("XDG_CACHE_HOME", "")
    if named:
        return Path(os.path.abspath(os.path.expanduser(named)))
    if os.path.isabs(base):  # a relative one means nothing, says the standard
        return Path(base) / "octo"
    home = os.path.expanduser("~") if os.environ.get("HOME") != "" else ""
    return Path(home) / ".cache" / "octo" if os.path.isabs(home) else None


def give_up(folder: Path, why: str) -> None:
    """Write to the temporary folder in place of this one from now on, and warn once."""
    _given_up.add(folder)
    _say(
        f"{folder} cannot keep compiled code ({' '.join(why.split())}): it is compiled "
        "again in every process"
    )


@functools.cache
def _say(sentence: str) -> None:
    LOG.warning("%s", sentence)


def discard(path: Path) -> None:
    """Forget a file that turned out to be useless."""
    for name in (path, beside(path)):
        if name.is_dir() and not name.is_symlink():
            shutil.rmtree(name, ignore_errors=True)
        else:
            name.unlink(missing_ok=True)


def beside(path: Path) -> Path:
    """Where the digest of a file is."""
    return path.with_name(f"{path.name}.sha256")


def whole(path: Path) -> bool:
    """Whether a file is this user's alone and has the digest that was kept when it was made."""
    try:
        kept = _own(beside(path)).decode("ascii", "replace").split()
        return kept == [hashlib.sha256(_own(path)).hexdigest()]
    except (OSError, Unsafe):
        return False


def _own(path: Path) -> bytes:
    """The bytes of a plain file that belongs to this user and that nobody else may write."""
    handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    with os.fdopen(handle, "rb") as file:
        found = os.fstat(handle)
        ours = stat.S_ISREG(found.st_mode) and found.st_uid == os.geteuid()
        if not ours or found.st_mode & OTHERS:
            raise Unsafe(f"{path} is not a file of this user alone")
        return file.read()


def _make(path: Path, make: Maker) -> None:
    """Make a file beside, then rename it and its digest into place."""
    with scratch(path.parent) as folder:
        if path.is_dir():
            discard(path)
        made, digest = folder / path.name, folder / beside(path).name
        make(made)
        os.chmod(made, stat.S_IRWXU)
        digest.write_text(hashlib.sha256(made.read_bytes()).hexdigest() + "\n", encoding="ascii")
        os.chmod(digest, stat.S_IRUSR | stat.S_IWUSR)
        place(digest, beside(path))
        place(made, path)


def _check(folder: Path) -> None:
    """Make the folder where it is missing; refuse one that cannot keep code safely."""
    # made for nothing else: its permissions are octo's to correct
    ours = not os.environ.get("OCTO_CACHE")
    try:
        missing = [parent for parent in (folder, *folder.parents) if not parent.exists()]
        for parent in reversed(missing):
            parent.mkdir(mode=stat.S_IRWXU, exist_ok=True)
        found = folder.stat()
        if found.st_uid != os.geteuid():
            raise Unsafe("it belongs to another user")
        if found.st_mode & OTHERS and ours:
            folder.chmod(stat.S_IRWXU)
        elif found.st_mode & OTHERS:
            raise Unsafe("other users may write there")
        if os.statvfs(folder).f_flag & NOEXEC:
            raise Unsafe("its disk forbids running code")
    except (OSError, ValueError) as error:
        raise Unsafe(reason(error)) from error


def temporary() -> Path:
    """The temporary folder of this process, removed at its end; DeviceError without a place."""
    with _locks[TEMPORARY]:
        return _temporary_of(os.getpid())


def _anywhere() -> tuple[Path, int]:
    """A new folder that code can be run from, and its lock."""
    why = "no place for temporary files runs code"
    named = (os.environ.get("TMPDIR", ""), os.environ.get("XDG_RUNTIME_DIR", ""))
    for base in (named[0], "/tmp", "/var/tmp", named[1], "/dev/shm"):
        try:
            if os.path.isabs(base) and not os.statvfs(base).f_flag & NOEXEC:
                return locked(Path(base), TEMPORARY)
        except OSError as error:
            why = reason(error)
    raise DeviceError(f"octo found no folder for compiled code: {why}; name one with OCTO_CACHE")


@functools.cache
def _temporary_of(process: int) -> Path:
    path, lock = _anywhere()

    def remove() -> None:
        if os.getpid() == process:  # not at the end of a process that was forked off
            shutil.rmtree(path, ignore_errors=True)
            os.close(lock)

    atexit.register(remove)
    return path
