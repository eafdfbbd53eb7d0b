"""C text to a loaded shared library, cached by what it was made from; says once when there is no compiler.

``CC`` names the compiler (gcc, cc and clang are tried otherwise), ``OCTO_CACHE`` the cache folder, and
``OCTO_NO_COMPILER=1`` makes octo behave as on a machine without one.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from octo.errors import DeviceError

# No -ffast-math: it lets the compiler assume that NaN never happens, and the solver's checks live on NaN. What is
# here keeps NaN and infinity exact: no errno from sqrt, no floating-point traps.
# The lanes' text looks at vectors as numbers, as masks and as arrays: -fno-strict-aliasing, which costs nothing measurable.
# -fno-semantic-interposition lets it inline functions of a shared library: 15 % of FD, 5 % of its Jacobian.
FLAGS = (
    "-std=gnu11", "-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-fno-strict-aliasing",
    "-fno-semantic-interposition", "-fPIC", "-shared", "-w",
)  # fmt: skip
LIBRARIES = ("-lm", "-lpthread")


@functools.cache
def compiler() -> tuple[str, ...] | None:
    """Command words of the C compiler, or None when there is none (said once on stderr)."""
    if os.environ.get("OCTO_NO_COMPILER", "0") not in ("", "0"):
        print("octo: OCTO_NO_COMPILER is set: CasADi's virtual machine evaluates the dynamics, slowly", file=sys.stderr)
        return None
    wanted = shlex.split(os.environ.get("CC", ""))
    for words in ([wanted] if wanted else []) + [["gcc"], ["cc"], ["clang"]]:
        path = shutil.which(words[0])
        if path:
            return (path, *words[1:])
    print(
        "octo: no C compiler (gcc, cc, clang or $CC): CasADi's virtual machine evaluates, 20 times slower",
        file=sys.stderr,
    )
    return None


@functools.cache
def machine() -> str:
    """What ``-march=native`` and the compiler depend on."""
    words = compiler() or ()
    version = subprocess.run([*words, "--version"], capture_output=True, text=True, check=False).stdout if words else ""
    processor = platform.machine() + platform.processor()
    try:
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
        kept = {line for line in lines if line.startswith(("model name", "flags", "Features", "CPU part"))}
        processor += "".join(sorted(kept))
    except OSError:
        pass
    return "\n".join((*words, version, processor))


def cache_folder() -> Path:
    """Where compiled libraries are kept: ``$OCTO_CACHE``, else the user's cache folder."""
    named = os.environ.get("OCTO_CACHE")
    base = os.environ.get("XDG_CACHE_HOME")
    return Path(named) if named else (Path(base) if base else Path.home() / ".cache") / "octo"


def usable_cache() -> Path:
    """The cache folder, made where it is missing; a temporary one where nothing can be written there."""
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            return folder
    except OSError:
        pass
    return Path(tempfile.mkdtemp(prefix="octo-"))  # read-only home: compiled once per process


def build(text: str, flags: tuple[str, ...] = ()) -> Path | None:
    """Path of the shared library made from the C ``text``, compiled when it is not in the cache; None: no compiler."""
    words = compiler()
    if words is None:
        return None
    options = (*FLAGS, *flags)
    key = hashlib.sha256("\0".join((text, *options, machine())).encode()).hexdigest()[:24]
    library = cache_folder() / f"{key}.so"
    if library.exists():
        return library
    folder = usable_cache()
    with tempfile.TemporaryDirectory(dir=folder) as scratch:
        source, made = Path(scratch) / "octo.c", Path(scratch) / "octo.so"
        source.write_text(text)
        command = [*words, *options, "-o", str(made), str(source), *LIBRARIES]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise DeviceError(f"{words[0]} could not compile octo's C text: {done.stderr.strip()[:2000]}")
        library = folder / library.name
        os.replace(made, library)  # atomic: another process sees the whole library or none
    return library


@functools.cache
def _open(path: Path) -> ctypes.CDLL:
    return ctypes.CDLL(str(path))


def load(text: str, flags: tuple[str, ...] = ()) -> ctypes.CDLL | None:
    """The C ``text`` as a loaded library, or None when there is no compiler."""
    path = build(text, flags)
    return None if path is None else _open(path)
