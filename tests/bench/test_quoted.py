"""Every number that the pages quote from octo bench is the one in the committed records, to the
printed digits."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROW = re.compile(r"^\|.*\| ([0-9.]+)(?: [^|`]+)? \| `([\w./]+)` \|$", re.MULTILINE)
LEAST = {"README.md": 6, "docs/benchmarks.md": 12}


def quoted(page: str) -> list[tuple[str, str]]:
    return ROW.findall((ROOT / page).read_text())


@pytest.mark.parametrize("page", LEAST)
def test_quoted_numbers_are_those_of_the_records(page: str) -> None:
    records = json.loads((ROOT / "benchmarks" / "results" / "bench.json").read_text())["records"]
    values = {record["name"]: record["value"] for record in records}
    rows = quoted(page)
    assert len(rows) >= LEAST[page]
    for words, name in rows:
        decimals = len(words.partition(".")[2])
        assert f"{values[name]:.{decimals}f}" == words, name
