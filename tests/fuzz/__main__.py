"""Bad input of every kind, made at random: ``python -m tests.fuzz --cases 2000 --seed 1``.

Robot files, command lines, saved files, Python arguments, damaged caches and output folders. A case
ends well with an answer or with one line that refuses it; tracebacks, crashes, hangs, wrong answers
and what is left behind are counted, each with a line that runs it again. Exit code 0: there were
none.
"""

from __future__ import annotations

import argparse
import json
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from octo import cache
from octo.interrupts import like_ctrl_c
from tests.fuzz.worker import KINDS, kind_of

ROOT = Path(__file__).parents[2]
LONGEST = 180.0  # s of a case by the clock; of its process the time is counted
START = 600.0  # s in which a worker begins


@dataclass
class Report:
    seed: int
    cases: Counter[str] = field(default_factory=Counter)
    seconds: Counter[str] = field(default_factory=Counter)
    faults: list[tuple[int, str]] = field(default_factory=list)

    def add(self, number: int, fault: str | None, seconds: float) -> None:
        kind = kind_of(self.seed, number)
        self.cases[kind] += 1
        self.seconds[kind] += seconds
        if fault is not None:
            self.faults.append((number, fault))
            line = (
                "".join(c if c.isprintable() else " " for c in fault)
                .encode("ascii", "backslashreplace")
                .decode()
            )
            print(
                f"FAULT {line}\n  python -m tests.fuzz --seed {self.seed} --case {number}   # "
                f"{kind}",
                flush=True,
            )

    def __str__(self) -> str:
        words = Counter(fault.partition(",")[0].partition(":")[0][:40] for _, fault in self.faults)
        rows = [
            f"  {kind:8s}{self.cases[kind]:6d} cases {self.seconds[kind]:8.1f} s" for kind in KINDS
        ]
        found = (
            ", ".join(f"{count} {word}" for word, count in words.items())
            or "no traceback, no crash, nothing wrong, nothing left behind"
        )
        return "\n".join(
            [
                f"seed {self.seed}: {self.cases.total()} cases, {len(self.faults)} faults: {found}",
                *rows,
            ]
        )


class Worker:
    """A process that runs cases from ``begin`` on, in folders of its own."""

    def __init__(self, seed: int, begin: int, end: int, kind: str | None, base: Path):
        for name in ("tmp", "home"):
            (base / name).mkdir(exist_ok=True)
        shared = cache.lasting() or cache.temporary()
        environment = {
            **os.environ,
            "PYTHONPATH": str(ROOT),
            "TMPDIR": str(base / "tmp"),
            "HOME": str(base / "home"),
            "OMP_NUM_THREADS": "1",
            "OCTO_CACHE": str(shared),
            "FUZZ_CACHE": str(shared),
            "MPLBACKEND": "agg",
            "MPLCONFIGDIR": str(base / "home"),
        }
        self.reading, writing = os.pipe()
        words = [
            "--seed",
            seed,
            "--begin",
            begin,
            "--end",
            end,
            "--descriptor",
            writing,
            "--base",
            base,
        ]
        words += [] if kind is None else ["--kind", kind]
        self.log = (base / "log").open("wb")
        self.process = subprocess.Popen(
            [sys.executable, "-X", "faulthandler", "-m", "tests.fuzz.worker", *map(str, words)],
            cwd=ROOT,
            env=environment,
            pass_fds=(writing,),
            stdin=subprocess.DEVNULL,
            stdout=self.log,
            stderr=self.log,
            start_new_session=True,
        )
        os.close(writing)
        self.text = b""

    def line(self, seconds: float) -> dict[str, object] | None:
        """The next line; an empty one at its end; None where none came in so many seconds."""
        while b"\n" not in self.text:
            if not select.select([self.reading], [], [], max(0.0, seconds))[0]:
                return None
            read = os.read(self.reading, 1 << 16)
            if not read:
                return {}
            self.text += read
        line, _, self.text = self.text.partition(b"\n")
        return dict(json.loads(line))

    def end(self, kill: bool = False) -> int:
        if kill:
            os.killpg(self.process.pid, signal.SIGKILL)
        try:
            code = self.process.wait(20.0)
        except subprocess.TimeoutExpired:
            os.killpg(self.process.pid, signal.SIGKILL)
            code = self.process.wait()
        os.close(self.reading)
        self.log.close()
        return code


def fuzz(seed: int, begin: int, end: int, seconds: float, kind: str | None = None) -> Report:
    """Run the cases; a worker that dies is a fault of its case, and another one goes on behind
    it."""
    report, deadline, base = Report(seed), float("inf"), Path(tempfile.mkdtemp(prefix="octo-fuzz-"))
    try:
        while begin < end and time.monotonic() < deadline:
            worker, running, since = Worker(seed, begin, end, kind, base), None, time.monotonic()
            while True:
                found = worker.line(LONGEST if running is not None else START)
                if found and "ready" in found and deadline == float("inf"):
                    deadline = time.monotonic() + seconds
                elif found and "begun" in found:
                    begin = running = int(str(found["begun"]))
                    since = time.monotonic()
                elif found and "done" in found:
                    fault = found["fault"]
                    report.add(
                        begin, None if fault is None else str(fault), float(str(found["seconds"]))
                    )
                    begin, running = begin + 1, None
                    if time.monotonic() > deadline:
                        worker.end(kill=True)
                        break
                elif not found:  # it died, or hangs
                    code = worker.end(kill=found is None)
                    said = (base / "log").read_text("utf-8", "replace")[-600:]
                    if running is not None:
                        why = "hangs" if found is None else f"crash, exit code {code}, {said!r}"
                        report.add(begin, why, time.monotonic() - since)
                        begin += 1
                    elif code:
                        raise SystemExit(
                            f"the worker does not begin, or end: exit code {code}, {said}"
                        )
                    else:
                        begin = end
                    break
            for path in (base / "tmp").iterdir():
                shutil.rmtree(path, ignore_errors=True)
    finally:
        shutil.rmtree(base, ignore_errors=True)
    return report


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--case", type=int, help="this one alone")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="stop after so many")
    parser.add_argument("--kind", choices=KINDS, help="of this kind alone")
    given = parser.parse_args()
    like_ctrl_c()  # its folder goes, however it is stopped
    begin, end = (0, given.cases) if given.case is None else (given.case, given.case + 1)
    began = time.monotonic()
    report = fuzz(given.seed, begin, end, given.seconds, given.kind)
    print(f"{report}\n  in {time.monotonic() - began:.0f} s")
    return 1 if report.faults else 0


if __name__ == "__main__":
    sys.exit(main())
