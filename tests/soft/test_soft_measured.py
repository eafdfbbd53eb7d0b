"""The page of soft bodies quotes what was measured."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
RECORD = json.loads((ROOT / "benchmarks/results/soft.json").read_text())
CHECKS = json.loads((ROOT / "benchmarks/results/soft_checks.json").read_text())
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


@pytest.mark.parametrize("name", ROWS)
def test_a_replay(name: str) -> None:
    off = [RECORD[name]["replay"][dt]["end"] for dt in ("0.025", "0.0125")]
    assert f"| {name} | {100 * off[0]:.0f} cm | {100 * off[1]:.0f} cm |" in PAGE


@pytest.mark.parametrize("along", ["modes", "points"])
def test_growth(along: str) -> None:
    for own in CHECKS["growth"][along]:
        row = f"| {own['modes']} | {own['points']:,} | {own['contacts']:.0f} | "
        assert f"{row}{1e3 * own['iteration']:.1f} ms | {own['compile']:.1f} s |" in PAGE
        assert own["compile"] < 12.0


def test_the_drop_comes_near_the_other_simulator_as_steps_shrink() -> None:
    drop = dict(CHECKS["drop"])
    other = drop.pop("MuJoCo")
    rises = [own["high"][0][1] for own in drop.values()]
    off = [abs(rise - other["high"][0][1]) for rise in rises]
    assert all(a > b for a, b in zip(off[:-1], off[1:], strict=True)) and off[-1] < 0.01
    for own in (*drop.values(), other):
        (time, height), (_, low) = own["high"][0], own["low"][0]
        assert f"| {height:.3f} m at {time:.3f} s |" in PAGE and f"| {low:.3f} m at " in PAGE


def test_flight_keeps_angular_momentum_to_the_order_of_the_steps() -> None:
    order = CHECKS["flight"]["order"]
    assert 0.85 < order < 1.2 and f"slope\n{order:.2f} (" in PAGE
