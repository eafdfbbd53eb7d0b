"""The page of soft bodies quotes what was measured."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
RECORD = json.loads((ROOT / "benchmarks/results/soft.json").read_text())
PAGE = (ROOT / "docs/soft.md").read_text()
ROWS = {
    "ball, jump": "the ball jumps its own diameter to the left",
    "ball, roll": "the ball rolls 1 m",
    "beam, jump": "the beam jumps its own length to the left",
    "beam, crawl": "the beam crawls 0.5 m along itself",
}


@pytest.mark.parametrize("name", ROWS)
def test_a_row(name: str) -> None:
    starts = list(RECORD[name]["starts"].values())
    assert all(one["status"] == "converged" and one["held"] for one in starts)
    count = len(starts)
    iterations = ", ".join(str(one["iterations"]) for one in starts)
    spent = sorted(one["seconds"] for one in starts)
    seconds = f"{spent[0]:.1f}–{spent[-1]:.2g}"
    each = sorted(1e3 * one["seconds"] / one["iterations"] for one in starts)[count // 2]
    row = f"| {ROWS[name]} | {count} of {count} | {iterations} | {seconds} | {each:.0f} ms |"
    assert row in PAGE


def test_the_other_solver() -> None:
    own, other = RECORD["ball, jump"]["starts"].values(), RECORD["ball, jump"]["ipopt"]
    assert f"takes {other['iterations']} iterations and {other['seconds']:.1f} s" in PAGE
    energies = [one["energy"] for one in own]
    words = f"E {other['energy']:.4f}, where octo's three starts end\nat {min(energies):.4f} to "
    assert f"{words}{max(energies):.4f}." in PAGE
