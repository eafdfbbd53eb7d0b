"""Section 8.6 and Fig. 12: motion graphs of a spider and a mammal, by benchmarks.motion_graph.

What benchmarks/results/motion_graph.json holds is measured anew with ``--again`` only.
"""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path
from typing import Any

import octo
from benchmarks import motion_graph
from benchmarks.paper.page import Row, number, seconds

TITLE = "motion graphs (Fig. 12)"
PANELS = 0
BENCHMARK = motion_graph
PAPER = "“within 60min of computation for each characters”"


def measure(short: bool) -> dict[str, Any]:
    """A summary of each graph; a short run has one of two motions of two seconds."""
    if not short:
        return {k: summary(own) for k, own in json.loads(motion_graph.RESULTS.read_text()).items()}
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        graph = octo.motion_graph.build(
            octo.gallery.mammal(),
            ("walk", "left"),
            path=Path(folder) / "short.graph",
            seconds=2.0,
            every=4,
            device="cpu",
        )
        found = {"build_seconds": time.perf_counter() - began, **graph.report()}
    return {"mammal, short": summary(found)}


def summary(found: dict[str, Any]) -> dict[str, Any]:
    """What the page shows of a graph."""
    names = ("pairs", "transitions", "build_seconds", "seconds", "iterations")
    way = {k: found["way"][k] for k in ("pointwise_residual", "wait_mean") if "way" in found}
    return {**{name: found[name] for name in names if name in found}, **way}


def rows(records: dict[str, Any]) -> list[Row]:
    """A graph in each."""
    made = []
    for name, own in records.items():
        share = own["transitions"] / own["pairs"]
        took = f" in {seconds(own['build_seconds'])}" if "build_seconds" in own else ""
        told = (
            f"{own['transitions']:,} transitions of {own['pairs']:,} pairs ({100.0 * share:.1f} %)"
            f"{took}, {number(own['seconds'] / own['pairs'])} s of processor time each"
        )
        remark = f"{number(own['iterations'])} iterations each (median)"
        if "wait_mean" in own:
            remark += (
                f"; along ten commands ‖FD‖∞ is {number(own['pointwise_residual'])} N at most, and "
                f"a command begins {number(own['wait_mean'])} s after it is given (mean)"
            )
        made.append(Row(f"{name} (Fig. 12)", PAPER, told, remark))
    return made
