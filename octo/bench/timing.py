"""Times of interleaved runs, and the records that benchmarks write."""

from __future__ import annotations

import json
import platform
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

import octo
from octo.bench.plan import FULL, Plan
from octo.errors import UsageError


@dataclass(frozen=True)
class Timing:
    """Seconds of repeated runs: the fastest, and the median."""

    least: float
    median: float

    def per(self, count: float) -> Timing:
        return Timing(self.least / count, self.median / count)


def interleaved(
    candidates: Mapping[str, Callable[[], object]],
    rounds: int,
    clock: Callable[[], float] = time.thread_time,
) -> dict[str, Timing]:
    """Every candidate once a round, so that what else the machine does hits all of them alike.

    The default clock is this thread's processor time: the wall's on a quiet machine, and the same
    on a busy one.
    """
    seconds: dict[str, list[float]] = {name: [] for name in candidates}
    for run in candidates.values():
        run()
    for _ in range(rounds):
        for name, run in candidates.items():
            began = clock()
            run()
            seconds[name].append(clock() - began)
    return {name: Timing(min(values), float(np.median(values))) for name, values in seconds.items()}


@dataclass(frozen=True)
class Record:
    """One number; ``baseline_ratio`` is value over the baseline's, None where that has none of the
    same sizes."""

    name: str
    value: float
    unit: str
    baseline_ratio: float | None = None


Say = Callable[[str], None]  # what is being measured now, for the progress line


def read(path: Path, plan: Plan) -> dict[str, float]:
    """The values of a file that :meth:`Records.write` wrote, by name: those of the same sizes as in
    ``plan``.

    Raises
    ------
    UsageError: the file is missing or holds something else.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        values = {str(record["name"]): float(record["value"]) for record in content["records"]}
        return {k: value for k, value in values.items() if plan.compares(k, content["plan"])}
    except FileNotFoundError:
        raise UsageError(f"baseline is {str(path)!r}, which does not exist") from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UsageError(
            f"baseline is {str(path)!r}, which octo bench did not write: {type(error).__name__}: "
            f"{error}"
        ) from error


class Records:
    """The numbers of one run of a plan, in order, beside those of a baseline."""

    def __init__(self, baseline: Mapping[str, float] | None = None, plan: Plan = FULL):
        self.made: list[Record] = []
        self.plan = plan
        self.before = dict(baseline or {})

    def add(self, name: str, value: float, unit: str) -> None:
        value, before = float(value), self.before.get(name)
        self.made.append(Record(name, value, unit, value / before if before else None))

    def add_timing(self, name: str, timing: Timing, scale: float, unit: str) -> None:
        """``scale`` units in a second."""
        self.add(name, timing.least * scale, unit)
        self.add(f"{name}.median", timing.median * scale, unit)

    def ratio(self, name: str, value: str, of: str) -> None:
        """One number over another."""
        self.add(name, self[value] / self[of], "")

    def __contains__(self, name: str) -> bool:
        return any(record.name == name for record in self.made)

    def __getitem__(self, name: str) -> float:
        return next(record.value for record in self.made if record.name == name)

    def table(self) -> str:
        """One line a number; medians stand behind their minimum."""
        medians = {record.name: record.value for record in self.made}
        lines = []
        for record in self.made:
            if record.name.endswith(".median"):
                continue
            median, ratio = medians.get(f"{record.name}.median"), record.baseline_ratio
            beside = "" if ratio is None else f"{ratio:8.2f} x baseline"
            more = "" if median is None else f"(median {median:.4g})"
            line = f"{record.name:44s} {record.value:10.4g} {record.unit:8s} {more:20s}{beside}"
            lines.append(line.rstrip())
        return "\n".join(lines)

    def write(self, path: Path) -> None:
        where = {"date": time.strftime("%Y-%m-%d"), "processor": processor()}
        found = {"plan": self.plan.record(), "records": [asdict(record) for record in self.made]}
        content = {**where, "octo": octo.__version__, **found}
        path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def processor() -> str:
    """The processor's name as the system says it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
        fields = dict(line.split(":", 1) for line in lines if ":" in line)
        table = {name.strip(): value.strip() for name, value in fields.items()}
        return f"{table['model name']} (family {table['cpu family']}, model {table['model']})"
    except (OSError, KeyError):
        return platform.processor() or platform.machine()
