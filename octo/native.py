"""C text to a loaded shared library, cached by what it was made from; warns once when there is no
compiler.

``CC`` names the compiler (gcc, cc and clang are tried otherwise), ``OCTO_CACHE`` the cache folder
(octo.cache), and ``OCTO_NO_COMPILER=1`` makes octo behave as on a machine without one.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import logging
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
from functools import partial
from importlib import resources
from pathlib import Path

from octo import cache
from octo.errors import DeviceError
from octo.files import reason

# No -ffast-math: it lets the compiler assume that NaN never happens, and the solver's checks live
# on NaN. What is here keeps NaN and infinity exact: no errno from sqrt, no floating-point traps.
# The lanes' text looks at vectors as numbers, as masks and as arrays: -fno-strict-aliasing, which
# costs nothing measurable. -fno-semantic-interposition lets it inline functions of a shared
# library: 15 % of FD, 5 % of its Jacobian.
FLAGS = (
    *("-std=gnu11", "-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math"),
    *("-fno-strict-aliasing", "-fno-semantic-interposition", "-fPIC", "-shared", "-w"),
)
LOG = logging.getLogger("octo")
LIBRARIES = ("-lm", "-lpthread")
ASKED = 60.0  # s, in which a compiler must say its version

_opened: dict[str, ctypes.CDLL] = {}  # by key: a library is read and checked once a process


@functools.cache
def compiler() -> tuple[str, ...] | None:
    """Command words of the C compiler, or None when there is none (which is logged once)."""
    if os.environ.get("OCTO_NO_COMPILER", "0") not in ("", "0"):
        what = "CasADi's virtual machine evaluates the dynamics, slowly"
        LOG.warning("OCTO_NO_COMPILER is set: %s", what)
        return None
    named = os.environ.get("CC", "")
    try:
        wanted = shlex.split(named)
    except ValueError as error:
        allowed = "a compiler and its options"
        raise DeviceError(f"CC is {named!r}, must be {allowed}: {error}") from error
    for words in ([wanted] if wanted else []) + [["gcc"], ["cc"], ["clang"]]:
        path = shutil.which(words[0])
        if path and wanted and words is not wanted:
            LOG.warning("CC is %r, which is no program: %s compiles in its place", named, words[0])
        if path:
            return (path, *words[1:])
    LOG.warning(
        "no C compiler (gcc, cc, clang or $CC): CasADi's virtual machine evaluates, 20 times slower"
    )
    return None


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def threads() -> str:
    """C text of the pool of threads, which stands before the text that shares work out."""
    return (resources.files("octo") / "threads.c").read_text(encoding="utf-8")


def run_compiler(command: list[str], scratch: Path, seconds: float | None = None) -> str:
    """Run a compiler, its own temporary files in ``scratch`` too; what it said. DeviceError: it
    cannot be run, or fails."""
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            check=False,
            stdin=subprocess.DEVNULL,
            timeout=seconds,
            env={**os.environ, "TMPDIR": str(scratch)},
        )
    except (OSError, ValueError, subprocess.TimeoutExpired) as error:
        late = isinstance(error, subprocess.TimeoutExpired)
        said = f"no answer in {seconds:g} s" if late else reason(error)
        raise DeviceError(
            f"the compiler {command[0]} cannot be run: {said}; name another one with CC"
        ) from error
    if done.returncode != 0:
        code = done.returncode
        end = f"ended by signal {-code}" if code < 0 else f"exit code {code}"
        said = " ".join((done.stderr or done.stdout).split())[:2000]
        raise DeviceError(
            f"the compiler {command[0]} could not compile octo's text ({end}): "
            f"{said or 'it says nothing'}"
        )
    return done.stdout


@functools.cache
def machine() -> str:
    """What ``-march=native`` and the compiler depend on."""
    words, folder = compiler() or (), Path(tempfile.gettempdir())
    version = run_compiler([*words, "--version"], folder, ASKED) if words else ""
    processor = platform.machine() + platform.processor()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        kept = ("model name", "flags", "Features", "CPU part")
        processor += "".join(sorted({line for line in lines if line.startswith(kept)}))
    except OSError:
        pass
    return "\n".join((*words, version, processor))


def load(text: str, flags: tuple[str, ...] = ()) -> ctypes.CDLL | None:
    """The C ``text`` as a loaded library, compiled when it is not in the cache; None when there is
    no compiler. DeviceError: it fails, or what it makes cannot be loaded."""
    words = compiler()
    if words is None:
        return None
    options = (*FLAGS, *flags)
    key = hashlib.sha256("\0".join((text, *options, machine())).encode()).hexdigest()[:24]
    found = _opened.get(key)
    if found is None:
        made = _load(key, partial(_compile, (*words, *options), text, key))
        found = _opened.setdefault(key, made)
    return found


def _load(key: str, make: cache.Maker) -> ctypes.CDLL:
    """Open a library; one that the system does not take is made anew, then in another folder."""
    name = f"{key}.so"
    path = cache.path_of(name, make)
    try:
        return _open(path, key)
    except DeviceError:
        cache.discard(path)
    try:
        return _open(cache.path_of(name, make), key)
    except DeviceError as error:
        cache.discard(path)
        library = _open(cache.path_in_temporary(name, make), key)
        cache.give_up(path.parent, str(error))
        return library


def _compile(words: tuple[str, ...], text: str, key: str, path: Path) -> None:
    source = path.with_name("octo.c")
    source.write_text(f"{text}\nconst char octo_text_{key} = 1;\n", encoding="utf-8")
    run_compiler([*words, "-o", str(path), str(source), *LIBRARIES], path.parent)
    if not path.is_file():
        raise DeviceError(f"the compiler {words[0]} made no library: name another one with CC")


def _open(path: Path, key: str) -> ctypes.CDLL:
    try:
        library = ctypes.CDLL(str(path))
    except OSError as error:
        raise DeviceError(f"a compiled library cannot be loaded: {reason(error)}") from error
    if not hasattr(library, f"octo_text_{key}"):
        raise DeviceError(f"{path} is not the library of octo's text: what does the compiler do?")
    return library
