"""All groups of measurements, one after another, into one set of records."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence

from octo import native
from octo.bench import bounds, compilation, dynamics, iteration, solvers
from octo.bench.plan import Plan
from octo.bench.timing import Records, Say
from octo.errors import DeviceError
from octo.solver.blas import one_thread

Measure = Callable[[Records, Plan, Say], None]
MEASURES: dict[str, Measure] = {
    "machine": bounds.measure,
    "dynamics": dynamics.measure,
    "iteration": iteration.against_steps,
    "degrees": iteration.against_degrees,
    "threads": iteration.over_threads,
    "solvers": solvers.measure,
    "compile": compilation.measure,
    "symbolic": dynamics.compare_symbolic,
}


class Progress:
    """A line on stderr: rewritten in place on a terminal, one a group elsewhere."""

    def __init__(self) -> None:
        self.terminal, self.began, self.group = sys.stderr.isatty(), time.perf_counter(), ""

    def __call__(self, group: str, text: str) -> None:
        if self.terminal or group != self.group:
            line = f"octo bench: {time.perf_counter() - self.began:.0f} s, {group}: {text}"
            begin, end = ("\r\033[K", "") if self.terminal else ("", "\n")
            print(f"{begin}{line}", end=end, file=sys.stderr, flush=True)
        self.group = group

    def end(self) -> None:
        if self.terminal:
            print("\r\033[K", end="", file=sys.stderr, flush=True)


def run(plan: Plan, groups: Sequence[str], baseline: Mapping[str, float]) -> Records:
    """Measure ``groups``; their values over those of ``baseline`` are in the records.

    Raises
    ------
    DeviceError: there is no C compiler.
    """
    records = Records(baseline, plan)
    if native.compiler() is None:
        raise DeviceError("octo bench needs a C compiler: gcc, cc, clang or the one that CC names")
    progress = Progress()
    try:
        with one_thread():
            for group in groups:
                MEASURES[group](records, plan, lambda text, group=group: progress(group, text))  # type: ignore[misc]
    finally:
        progress.end()
    return records
