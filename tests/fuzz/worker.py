"""Runs cases in one process and writes a line of JSON for each to a file descriptor; tests.fuzz
starts it."""

from __future__ import annotations

import argparse
import functools
import json
import os
import resource
import shutil
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from random import Random
from types import FrameType

from tests.fuzz.judge import Fault, Slow, where

KINDS = {"robots": 0.3, "calls": 0.3, "flags": 0.18, "saved": 0.15, "solves": 0.05, "faults": 0.02}
PROCESSOR = 6.0  # s of a case; then it is stopped as by Ctrl-C …
INSISTS = 1.0  # … and so often again, s
MEMORY = 12 << 30  # bytes of address space, so that a case that takes all of it harms nobody else


def kind_of(seed: int, number: int) -> str:
    random = Random(f"kind {seed} {number}")
    return random.choices(list(KINDS), list(KINDS.values()))[0]


def stop(number: int, frame: FrameType | None) -> None:
    raise Slow


@functools.cache
def case_of(kind: str) -> Callable[[Random, Path], None]:
    from importlib import import_module

    return import_module(f"tests.fuzz.{kind}").case  # type: ignore[no-any-return]


def run(seed: int, number: int, base: Path) -> str | None:
    """What was wrong; None: nothing."""
    kind = kind_of(seed, number)
    case = case_of(kind)
    folder = base / f"case {number}"
    folder.mkdir()
    os.chdir(folder)
    # The first case of a kind prepares what all of them share. CasADi may swallow what is raised
    # while symbols are built, where nobody pressed Ctrl-C: the clock insists.
    signal.setitimer(signal.ITIMER_PROF, PROCESSOR, INSISTS)
    try:
        case(Random(f"case {seed} {number}"), folder)
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        return left_behind(folder, base)
    except Fault as fault:
        return str(fault)
    except Slow as error:
        return f"too slow, {where(error)}"
    except Exception as error:
        return f"the fuzzer itself: {where(error)}"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        os.chdir(base)
        shutil.rmtree(folder, ignore_errors=True)


def left_behind(folder: Path, base: Path) -> str | None:
    scratch = [str(path.relative_to(folder)) for path in folder.rglob(".octo-scratch-*")]
    temporary = [
        path.name for path in (base / "tmp").iterdir() if not path.name.startswith("octo-code-")
    ]
    children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    for path in (base / "tmp").iterdir():
        if path.name in temporary:
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    found = [*scratch, *temporary, *(f"process {child}" for child in children)]
    return f"left behind: {', '.join(found)}" if found else None


def prepare(base: Path) -> None:
    """What cases share, before the clock of one of them runs."""
    from tests.fuzz import calls, robots, saved

    import_all = (calls._all, robots.corpus, saved.originals)
    for make in import_all:
        make()
    import matplotlib.pyplot  # noqa: F401


def main() -> None:
    parser = argparse.ArgumentParser()
    for name in ("seed", "begin", "end", "descriptor"):
        parser.add_argument(f"--{name}", type=int, required=True)
    parser.add_argument("--base", type=Path, required=True)
    parser.add_argument("--kind")
    given = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    signal.signal(signal.SIGPROF, stop)
    prepare(given.base)
    with os.fdopen(given.descriptor, "w", buffering=1) as report:
        print(json.dumps({"ready": True}), file=report)
        for number in range(given.begin, given.end):
            if given.kind not in (None, kind_of(given.seed, number)):
                continue
            print(json.dumps({"begun": number}), file=report)
            began = time.perf_counter()
            fault = run(given.seed, number, given.base)
            print(
                json.dumps(
                    {"done": number, "fault": fault, "seconds": time.perf_counter() - began}
                ),
                file=report,
            )
    sys.stdout.flush()
    os._exit(0) if threads() > 1 else sys.exit(0)


def threads() -> int:
    return len(os.listdir("/proc/self/task"))


if __name__ == "__main__":
    main()
