"""Commands in processes of their own: damaged caches, disks that are full, odd consoles, signals at
any moment."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from random import Random

from tests.fuzz.judge import Fault
from tests.fuzz.values import QUICK, flaw_of_message

ROOT = Path(__file__).parents[2]
SOLVE = ("solve", "chain", *QUICK)
LIMIT = 120.0  # s, of a process
CONSOLES = (
    {"PYTHONIOENCODING": "ascii"},
    {"PYTHONIOENCODING": "latin-1"},
    {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    {"PYTHONIOENCODING": "cp1252"},
    {"PYTHONIOENCODING": "utf-16"},
    {"LANG": "bogus"},
)
Change = Callable[[Random, Path, dict[str, str]], tuple[str, ...]]


def _damaged_cache(random: Random, folder: Path, environment: dict[str, str]) -> tuple[str, ...]:
    """Libraries that are cut, zeroed, empty or foreign; a digest that lies; folders in place of
    files."""
    cache = folder / "cache"
    cache.mkdir(mode=0o700)
    for path in Path(os.environ["FUZZ_CACHE"]).glob("*"):
        if not path.is_file() or path.name.startswith("."):
            continue
        data, kind = path.read_bytes(), random.randrange(5)
        changed = (data, data[: len(data) // 2], bytes(len(data)), b"", b"\x7fELF" + data[:40])[
            kind
        ]
        if random.random() < 0.05:
            (cache / path.name).mkdir()
        else:
            (cache / path.name).write_bytes(changed)
    environment["OCTO_CACHE"] = str(cache)
    return SOLVE


def _odd_cache(random: Random, folder: Path, environment: dict[str, str]) -> tuple[str, ...]:
    """A cache that is a file, a loop, too long, in a folder of the system, or none."""
    (folder / "file").write_text("no folder")
    os.symlink("loop", folder / "loop")
    environment["OCTO_CACHE"] = random.choice(
        (
            str(folder / "file"),
            str(folder / "loop"),
            "/proc/self",
            "/dev/null",
            "x" * 300,
            "\t",
            str(folder / "a" / "b"),
        )
    )
    if random.random() < 0.3:
        environment.update({"HOME": "", "XDG_CACHE_HOME": "relative"})
        del environment["OCTO_CACHE"]
    return SOLVE


def _odd_output(random: Random, folder: Path, environment: dict[str, str]) -> tuple[str, ...]:
    """A folder that is none."""
    (folder / "file").write_text("no folder")
    os.symlink("loop", folder / "loop")
    os.symlink("nowhere", folder / "dangling")
    out = random.choice(
        (
            "file",
            "loop",
            "file/in",
            "/proc/octo",
            "/dev/full",
            "/dev/null/x",
            "x" * 300,
            "dangling",
            "a\nb",
            "\x1b[31m",
            "-",
            "\u202ea",
        )
    )
    return (*SOLVE, f"--out={out}")


def _console(random: Random, folder: Path, environment: dict[str, str]) -> tuple[str, ...]:
    """A console that cannot show all letters, and words that have them."""
    environment.update(random.choice(CONSOLES))
    return random.choice(
        (
            SOLVE,
            ("info", "mammal"),
            ("robots",),
            ("info", "日本"),
            ("--help",),
            ("solve", "--help"),
            ("info", "chain", "--json"),
            ("help", "mpc"),
            ("compare", "chain", "--tolerance", "é"),
        )
    )


def _compiler(random: Random, folder: Path, environment: dict[str, str]) -> tuple[str, ...]:
    environment["OCTO_CACHE"] = str(folder / "cache")
    script = folder / "cc"
    script.write_text(
        random.choice(
            (
                "#!/bin/sh\nexit 1\n",
                "#!/bin/sh\nkill -9 $$\n",
                "#!/bin/sh\nexit 0\n",
                "#!/bin/sh\necho é >&2; exit 3\n",
                "garbage",
            )
        )
    )
    script.chmod(random.choice((0o700, 0o600)))
    environment["CC"] = random.choice((str(script), "", "nothing", "/", "gcc --bogus", str(script)))
    return SOLVE


CHANGES: tuple[Change, ...] = (
    _damaged_cache,
    _odd_cache,
    _odd_output,
    _console,
    _console,
    _compiler,
)
STREAMS = (
    " 1>&-",
    " 2>&-",
    " >/dev/full",
    " 2>/dev/full",
    " >&- 2>&-",
    " <&-",
    " | true",
    " | head -c 10",
)


def case(random: Random, folder: Path) -> None:
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "OMP_NUM_THREADS": "1",
        "OCTO_CACHE": os.environ["FUZZ_CACHE"],
    }
    environment["TMPDIR"] = str(folder / "tmp")
    (folder / "tmp").mkdir()
    words = list(random.choice(CHANGES)(random, folder, environment))
    if (
        words[0] == "solve"
        and not any(word.startswith("--out") for word in words)
        and "--help" not in words
    ):
        words.append("--out=out")
    stopped = random.random() < 0.35
    stream = random.choice(STREAMS) if not stopped and random.random() < 0.3 else ""
    line = [sys.executable, "-m", "octo", *words]
    if stream:
        line = [
            "bash",
            "-c",
            f'set -o pipefail; "$@"{stream}; exit ${{PIPESTATUS[0]}}',
            "bash",
            *line,
        ]
    process = subprocess.Popen(
        line,
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    number = random.choice((signal.SIGINT, signal.SIGTERM, signal.SIGHUP))
    try:
        if stopped:
            time.sleep(random.uniform(0.05, 4.0))
            process.send_signal(number)
        out, err = process.communicate(timeout=LIMIT)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        raise Fault(f"hangs: octo {' '.join(words)}{stream}") from None
    _look(
        folder,
        words,
        stream,
        number.name if stopped else "",
        process.returncode,
        err.replace(b"\0", b"").decode("utf-8", "replace"),
        environment,
    )


def _look(
    folder: Path,
    words: list[str],
    stream: str,
    number: str,
    code: int,
    said: str,
    environment: dict[str, str],
) -> None:
    changed = {
        key: value[:60]
        for key, value in environment.items()
        if os.environ.get(key) != value and key not in ("PYTHONPATH", "TMPDIR")
    }
    what = (
        f"{changed} octo "
        f"{' '.join(words)}{stream}{f', stopped by {number}' if number else ''}, exit {code}"
    )
    early = number and code in (-2, -15, -1)  # before Python ran a line of octo
    if "Traceback" in said and not (number and "octo" not in said):
        raise Fault(f"traceback: {said[-400:]!r} of {what}")
    if code not in (0, 1, 2, 130, 141) and not early:
        raise Fault(f"exit code: {said[-300:]!r} of {what}")
    if code == 2 and "2>" not in stream:
        last = said.rstrip("\n").rpartition("\n")[2].lstrip("\x00")
        flaw = flaw_of_message(last)
        if flaw or (
            "octo: error: " not in last and environment.get("PYTHONIOENCODING") != "utf-16"
        ):
            raise Fault(f"{flaw or 'no line'}: {said[-300:]!r} of {what}")
    left = [str(path) for path in folder.rglob(".octo-scratch-*")] + [
        path.name for path in (folder / "tmp").iterdir()
    ]
    if left:
        raise Fault(f"left behind: {left} of {what}")
