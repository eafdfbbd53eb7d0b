"""The page of libraries quotes what was measured."""

from __future__ import annotations

import json
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
RECORD = json.loads((ROOT / "benchmarks/results/library.json").read_text())
PAGE = (ROOT / "docs/library.md").read_text()


def test_the_library() -> None:
    own = RECORD["library"]
    statuses = own["statuses"]
    assert own["motions"] == 200 and own["converged_share"] == 1.0
    assert f"| {statuses['converged']} of 200, the other {statuses['acceptable']} ended as" in PAGE
    assert f"| iterations of a walk, median | {own['iterations_median']:g} |" in PAGE
    assert f"| solver's time of all | {own['solver_seconds']:.0f} s |" in PAGE
    assert f"| {RECORD['training']['processor_seconds']:.0f} s |" in PAGE
    assert f"unrolled {RECORD['training']['unrolled_rms']:.1f} from the walks" in PAGE


def test_the_starts() -> None:
    rows = {
        "the static pose, the default": "static",
        "the nearest motion of the library": "nearest",
        "its nodes alone, without its multipliers": "nearest_nodes",
        "the network": "network",
    }
    unseen = RECORD["unseen"]
    for words, name in rows.items():
        own = unseen[name]
        counts, seconds = own["iterations"], own["processor_seconds"]
        time = f"{seconds:.0f} s" if seconds >= 10 else f"{seconds:.1f} s"
        row = (
            f"| {words} | {own['iterations_median']:g} | {min(counts)}, {max(counts)} | "
            f"{own['energy_median']:.3f} | {time} |"
        )
        assert row in PAGE
    saved = 1.0 - unseen["network"]["iterations_median"] / unseen["static"]["iterations_median"]
    assert f"{100 * saved:.0f} % of the iterations" in PAGE.replace("\n", " ")
    assert [own["converged"] for name, own in unseen.items() if name != "commands"] == [20] * 4

    def differ(name: str) -> tuple[int, int]:
        """How many cost more, and less, than from the nearest motion, by a hundredth."""
        parts = [
            one / other
            for one, other in zip(unseen[name]["energy"], unseen["nearest"]["energy"], strict=True)
        ]
        return sum(p > 1.01 for p in parts), sum(p < 0.99 for p in parts)

    for name, subject in (("network", "its E differs"), ("static", "that of the static pose")):
        more, less = differ(name)
        words = rf"{subject}[^;:.]* in {more + less}(?: of 20)? \({more} more, {less} less\)"
        assert re.search(words, PAGE.replace("\n", " "))
