"""octo's native code under AddressSanitizer and UndefinedBehaviorSanitizer: ``python -m
tests.sanitize``.

Every lane width that this processor has, one process each, over robots with contacts and sphere
pairs, user-written dynamics, batches of 1, 3 and 7, 1 and 3 threads (tests/sanitized.py). Exit code
0: nothing was found, and what is planted was.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from octo import cache, native

ROOT = Path(__file__).parents[1]
# UBSan without what AddressSanitizer finds too, which costs minutes of compiling.
FLAGS = (
    "-O1 -g1 -fsanitize=address,undefined "
    "-fno-sanitize=null,object-size,pointer-overflow -fno-sanitize-recover=all"
)
# what it needs, what it leaves
WIDTHS = {8: ("avx512f", ""), 4: ("avx", "-mno-avx512f"), 2: ("sse2", "-mno-avx512f -mno-avx")}
ROBOTS = ("chain", "biped", "mammal", "spider", "humanoid", "user-written")
QUICK = ("biped", "user-written")
FAULTS = {  # what tests/sanitized.py plants, and what is said of it
    "an overrun": "heap-buffer-overflow",
    "a read beyond the end": "heap-buffer-overflow",
    "an overflow": "signed integer overflow",
}


def widths() -> list[int]:
    """Lanes of the vectors that this processor has, widest first."""
    try:
        words = set(Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").split())
    except OSError:
        words = set()
    return [width for width, (needed, _) in WIDTHS.items() if needed in words] or [2]


def library(name: str) -> str:
    """Path of one of the compiler's libraries."""
    return subprocess.run(
        ["gcc", f"-print-file-name={name}"], capture_output=True, text=True, check=True
    ).stdout.strip()


def compiler_of(width: int) -> Path:
    """A script that compiles what octo compiles, for so many lanes and with the sanitizers; it has
    a cache beside it."""
    text = f'#!/bin/sh\nunset LD_PRELOAD\nexec gcc "$@" {FLAGS} {WIDTHS[width][1]}\n'
    base = cache.lasting() or cache.temporary()
    folder = base / f"sanitized-{width}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"
    folder.mkdir(mode=0o700, exist_ok=True)
    script = folder / "gcc"
    if not script.exists():
        script.write_text(text, encoding="utf-8")
        script.chmod(0o700)
    return script


def run(width: int, words: Sequence[str]) -> subprocess.CompletedProcess[str]:
    """tests/sanitized.py with so many lanes."""
    script = compiler_of(width)
    environment = {
        **os.environ,
        "CC": str(script),
        "OCTO_CACHE": str(script.parent),
        "OMP_NUM_THREADS": "1",
        "PYTHONMALLOC": "malloc",
        "LD_PRELOAD": f"{library('libasan.so')} {library('libstdc++.so.6')}",
        "PYTHONPATH": str(ROOT),
        "PYTHONWARNINGS": "ignore",
        "ASAN_OPTIONS": "detect_leaks=0",
        "UBSAN_OPTIONS": "print_stacktrace=1",
    }
    return subprocess.run(
        [sys.executable, "-m", "tests.sanitized", *words],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env=environment,
    )


def found(done: subprocess.CompletedProcess[str]) -> str:
    """The first line of what a sanitizer said, "" for nothing."""
    lines = [
        line
        for line in done.stderr.splitlines()
        if "ERROR: AddressSanitizer" in line or "runtime error:" in line
    ]
    if lines:
        return lines[0]
    clean = done.returncode == 0 and done.stdout.endswith("clean\n")
    return "" if clean else f"exit code {done.returncode}: {done.stderr[-2000:]}"


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--robots",
        nargs="+",
        default=ROBOTS,
        metavar="NAME",
        help=f"some of {', '.join(ROBOTS)} (default all)",
    )
    parser.add_argument(
        "--lanes",
        nargs="+",
        type=int,
        default=widths(),
        metavar="N",
        help="lane widths (default all there are)",
    )
    parser.add_argument(
        "--quick", action="store_true", help=f"{' and '.join(QUICK)} alone: two minutes"
    )
    arguments = parser.parse_args(words)
    if native.compiler() is None:
        print("no C compiler: nothing native to check")
        return 1
    bad = 0
    for width in arguments.lanes:
        for robot in QUICK if arguments.quick else arguments.robots:
            began = time.perf_counter()
            said = found(run(width, [robot]))
            bad += bool(said)
            print(
                f"{width} lanes  {robot:14s}{said or 'clean'}  {time.perf_counter() - began:.0f} s",
                flush=True,
            )
    for fault, words_of in FAULTS.items():
        said = found(run(arguments.lanes[0], [fault, "user-written"]))
        bad += words_of not in said
        print(
            f"planted: {fault:24s}{'found' if words_of in said else f'NOT FOUND: {said}'}",
            flush=True,
        )
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
