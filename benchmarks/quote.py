"""Writes measured numbers into the pages that quote them.

    python -m benchmarks.quote

A row of the README or of docs/benchmarks.md that ends in ``| NUMBER UNIT | `record` |`` gets the
value of that record in benchmarks/results/bench.json, with as many decimals as it has. What the
README says of the GPU is that of benchmarks/gpu.json, and that it has not run on one while there is
no such file. Tests hold both.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
PAGES = ("README.md", "docs/benchmarks.md")
ROW = re.compile(r"^(\|.*\| )([0-9.]+)((?: [^|`]+)? \| `)([\w./]+)(` \|)$", re.MULTILINE)
GPU = re.compile(
    r"(?<=\| the GPU, see \[its page\]\(docs/gpu\.md\): )[^|\n]+(?= \|$)", re.MULTILINE
)
UNSEEN = "written and tested without one, not yet run on one"


def gpu_words(path: Path = ROOT / "benchmarks" / "gpu.json") -> str:
    """What is measured of a GPU, in the words of the README."""
    if not path.exists():
        return UNSEEN
    found: dict[str, Any] = json.loads(path.read_text())
    values = found["iteration_ms"]
    times = [
        f"{values[basis]:.2f} ms in {basis}" for basis in ("hermite", "nodes") if basis in values
    ]
    judged = [one["met"] for one in found["must_show"]]
    met = f"{judged.count(True)} of {len(judged)} aims met, see benchmarks/gpu.json"
    iteration = (
        f"one iteration of a mammal's walk of 400 steps takes {' and '.join(times)}; "
        if times
        else ""
    )
    return f"on one {found['hardware']['device']}, {found['date']}: {iteration}{met}"


def main() -> int:
    records = json.loads((ROOT / "benchmarks" / "results" / "bench.json").read_text())["records"]
    values = {record["name"]: record["value"] for record in records}

    def quoted(row: re.Match[str]) -> str:
        before, number, between, name, after = row.groups()
        decimals = len(number.partition(".")[2])
        return f"{before}{values[name]:.{decimals}f}{between}{name}{after}"

    for page in PAGES:
        path = ROOT / page
        path.write_text(GPU.sub(lambda _: gpu_words(), ROW.sub(quoted, path.read_text())))
    return 0


if __name__ == "__main__":
    sys.exit(main())
