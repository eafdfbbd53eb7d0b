"""octo on a GPU, measured: ``python benchmarks/gpu.py`` writes benchmarks/gpu.json and
benchmarks/gpu.png.

Needs a CUDA GPU, CuPy and NVRTC (pip install -e '.[cuda13,view]' or cuda12), and for "kkt", octo's
reduction beside cuBLAS and cuSOLVER (gpu_kkt.py), those (pip install 'cupy-cuda13x[ctk]'); nothing
is downloaded. On a machine without one, ``--emulate`` runs the same kernels on the CPU, which says
whether this script works and nothing about speed. ``--once`` solves one small problem for three
iterations and measures nothing: for compute-sanitizer (docs/gpu.md).

The JSON is written anew whenever something has been measured, so that an end at any time keeps what
is there. A section that fails, or takes too long, says so under "why_not", and the next one
follows. ``--only`` adds sections to an existing JSON.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import gpu_figure
import numpy as np
from gpu_bench import Bench, Lost, first_line, walk
from gpu_sections import SECTIONS

import octo
from octo.bench.timing import processor
from octo.gpu import cuda
from octo.solver.options import SqpOptions

FOLDER = Path(__file__).parent
PATIENCE = 3.0  # times what a section is thought to take, and at least a minute


def emulated() -> Any:
    """The CPU in the place of a GPU: a tool of the tests."""
    sys.path.insert(0, str(FOLDER.parent))
    from tests.emulator import EmulatedDevice

    return EmulatedDevice()


class Ended(BaseException):
    """Ctrl-C or the end that a batch system sends: not KeyboardInterrupt, after which a solve gives
    its best so far."""


class TooLong(BaseException):
    """A section's time is over."""


class Paper:
    """The JSON: written whole, at once, whenever something is added."""

    def __init__(self, path: Path, found: dict[str, Any]):
        self.path, self.found = path, found

    def write(self) -> None:
        gpu_figure.conclude(self.found)
        part = self.path.with_name(f"{self.path.name}.part")
        part.write_text(
            json.dumps(self.found, indent=1, default=lambda value: np.asarray(value).tolist())
            + "\n"
        )
        os.replace(part, self.path)


@contextmanager
def signals() -> Iterator[None]:
    """Ctrl-C, SIGTERM and the alarm as exceptions that only this script takes."""

    def raising(kind: type[BaseException]) -> Any:
        def handle(number: int, frame: Any) -> None:
            raise kind

        return handle

    wanted = {signal.SIGINT: Ended, signal.SIGTERM: Ended, signal.SIGALRM: TooLong}
    before = {number: signal.signal(number, raising(kind)) for number, kind in wanted.items()}
    try:
        yield
    finally:
        signal.alarm(0)
        for number, handler in before.items():
            signal.signal(number, handler)


def measure(bench: Bench, paper: Paper, names: Sequence[str], end: float) -> list[str] | None:
    """Sections, while their time fits before ``end``; those that another process must do. None: it
    was ended."""
    name = ""
    try:
        for place, name in enumerate(names):
            _fitting(bench, paper, name, end - time.perf_counter())
            if bench.lost:
                return list(names[place + 1 :])
    except Ended:
        paper.found.setdefault(name, {})["why_not"] = "interrupted"
        return None
    return []


def _fitting(bench: Bench, paper: Paper, name: str, left: float) -> None:
    """One section, if it takes no more than the ``left`` s."""
    section = SECTIONS[name]
    if section.about > left:
        why = (
            f"not begun: it takes about {section.about:.0f} s and {max(0.0, left):.0f} s of the "
            "budget are left"
        )
        paper.found.setdefault(name, {"why_not": why})
        print(f"skipped: {name}, {why}", flush=True)
        return
    print(f"measuring: {name}, {section.words}", flush=True)
    _section(bench, paper, name, min(left, max(60.0, PATIENCE * section.about)))


def _section(bench: Bench, paper: Paper, name: str, limit: float) -> None:
    """One section into ``paper``; whatever goes wrong is said there."""
    rows: dict[str, Any] = {"why_not": "the program ended while this was measured"}
    paper.found[name] = rows
    began = time.perf_counter()
    why = None
    try:
        paper.write()
        signal.setitimer(signal.ITIMER_REAL, limit)
        for key, row in SECTIONS[name].run(bench):
            rows[key] = row
            print(
                f"  {key}: {gpu_figure.in_short(row)} ({time.perf_counter() - began:.0f} s)",
                flush=True,
            )
            paper.write()
        del rows["why_not"]
    except TooLong:
        why = f"stopped after {limit:.0f} s"
    except Exception as error:
        why = first_line(error)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    if why is not None:
        rows["why_not"] = why
        print(f"  not measured: {why}", file=sys.stderr, flush=True)
        with suppress(Lost):
            bench.recover()
    paper.found["seconds"][name] = time.perf_counter() - began
    paper.write()


def once(device: Any) -> None:
    """Three iterations of each rule of a small problem, every kernel: launched, captured and
    replayed."""
    for options in (SqpOptions(max_iterations=3), SqpOptions.paper(max_iterations=3)):
        bench = Bench(device, short=True)
        print(bench.solve(walk(octo.gallery.mammal(), 8, "nodes"), options, range(2)).at.energy)


def begun(path: Path, hardware: dict[str, str], short: bool, add: bool) -> dict[str, Any]:
    """What the JSON begins with: nothing, or with ``add`` what is there already, of the same
    hardware.

    Raises
    ------
    ValueError: the file is of another machine, or no file of this script.
    """
    found: dict[str, Any] = {}
    if add and path.exists():
        try:
            found = json.loads(path.read_text())
            there = found["hardware"], found["short"]
        except (ValueError, KeyError, TypeError):
            raise ValueError(
                f"--only adds to {path}, which this script did not write: give another --out"
            ) from None
        if there != (hardware, short):
            own, other = (
                f"{device['device']}, {device['cpu']}, short {small}"
                for device, small in ((hardware, short), there)
            )
            raise ValueError(
                f"--only adds to {path}, which is of {other}; this is {own}: give another --out"
            )
    fresh = {
        "hardware": hardware,
        "date": datetime.date.today().isoformat(),
        "octo": octo.__version__,
        "short": short,
    }
    return {**found, **fresh, "seconds": found.get("seconds", {})}


def arguments_of(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="benchmarks/gpu.py",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--short", action="store_true", help="small sizes: whether it works, not how fast"
    )
    parser.add_argument(
        "--emulate",
        action="store_true",
        help="run the kernels on the CPU; writes only where --out says",
    )
    parser.add_argument(
        "--once",
        action="store_true",
        help="three iterations of a small problem, and nothing measured",
    )
    parser.add_argument(
        "--only", metavar="NAME,…", help=f"these sections, added to the JSON: {', '.join(SECTIONS)}"
    )
    parser.add_argument("--no-ipopt", action="store_true", help="leave IPOPT out")
    parser.add_argument(
        "--budget",
        type=float,
        default=float("inf"),
        metavar="SECONDS",
        help="leave out what no longer fits",
    )
    parser.add_argument(
        "--out", type=Path, help="the JSON; the figure is beside it (default benchmarks/gpu.json)"
    )
    arguments = parser.parse_args(words)
    arguments.names = list(SECTIONS) if arguments.only is None else arguments.only.split(",")
    for name in arguments.names:
        if name not in SECTIONS:
            parser.error(f"--only has {name!r}, must be among {', '.join(SECTIONS)}")
    if arguments.no_ipopt:
        arguments.names = [name for name in arguments.names if name != "ipopt"]
    if (arguments.emulate or arguments.short) and arguments.out is None and not arguments.once:
        parser.error("--emulate and --short need --out: their figures are no measurement of a GPU")
    if arguments.out is not None and not arguments.out.absolute().parent.is_dir():
        parser.error(f"--out is {arguments.out}: there is no such folder")
    return arguments


def main(words: Sequence[str] | None = None) -> int:
    arguments = arguments_of(words)
    why = None if arguments.emulate else cuda.reason()
    if why is not None:
        print(f"benchmarks/gpu.py: {why}; --emulate runs the kernels on the CPU", file=sys.stderr)
        return 2
    device: Any = emulated() if arguments.emulate else cuda.device()
    if arguments.once:
        once(device)
        return 0
    name = gpu_figure.EMULATED if arguments.emulate else f"{device.name} ({device.architecture})"
    hardware = {"device": name, "cpu": f"{processor()}, {len(os.sched_getaffinity(0))} cores"}
    path: Path = arguments.out or FOLDER / "gpu.json"
    try:
        paper = Paper(path, begun(path, hardware, arguments.short, arguments.only is not None))
    except ValueError as error:
        print(f"benchmarks/gpu.py: {error}", file=sys.stderr)
        return 2
    end = time.perf_counter() + arguments.budget
    with signals():
        rest = measure(Bench(device, arguments.short), paper, arguments.names, end)
    paper.write()
    if rest:
        print(
            f"the GPU is lost to this process: another one goes on with {', '.join(rest)}",
            flush=True,
        )
        flags = [f"--{name}" for name in ("emulate", "short") if getattr(arguments, name)]
        own = [
            "--only",
            ",".join(rest),
            "--budget",
            str(end - time.perf_counter()),
            "--out",
            str(path),
        ]
        os.execv(sys.executable, [sys.executable, __file__, *flags, *own])
    print("\n".join(gpu_figure.table(paper.found)), flush=True)
    try:
        gpu_figure.draw(paper.found, path.with_suffix(".png"))
    # matplotlib is not installed, say: the figures are worth more than their picture
    except Exception as error:
        print(f"no figure: {first_line(error)}", file=sys.stderr)
    if rest is None:
        print(f"benchmarks/gpu.py: interrupted; what was measured is in {path}", file=sys.stderr)
    return 130 if rest is None else 0


if __name__ == "__main__":
    sys.exit(main())
