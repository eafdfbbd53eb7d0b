"""Writes the numbers of benchmarks/results/bench.json into the tables of the README and of docs/benchmarks.md that quote them.

    python -m benchmarks.quote

A row that ends in ``| NUMBER UNIT | `record` |`` gets that record's value, with as many decimals as it has. A test holds them.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = ("README.md", "docs/benchmarks.md")
ROW = re.compile(r"^(\|.*\| )([0-9.]+)((?: [^|`]+)? \| `)([\w./]+)(` \|)$", re.MULTILINE)


def main() -> int:
    records = json.loads((ROOT / "benchmarks" / "results" / "bench.json").read_text())["records"]
    values = {record["name"]: record["value"] for record in records}

    def quoted(row: re.Match[str]) -> str:
        before, number, between, name, after = row.groups()
        decimals = len(number.partition(".")[2])
        return f"{before}{values[name]:.{decimals}f}{between}{name}{after}"

    for page in PAGES:
        path = ROOT / page
        path.write_text(ROW.sub(quoted, path.read_text()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
