"""Fig. 2: a deformable ball and a deformable beam of 16 coordinates jump to the left, by
benchmarks.soft, which makes their pictures too."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks import soft
from benchmarks.paper.page import Row, ending, number, seconds

TITLE = "soft bodies that jump (Fig. 2)"
PANELS = 0
PAPER = "“the number of DOFs, |x|, is 16 for both characters”"


def measure(short: bool) -> dict[str, Any]:
    """The jumps from three starts each; a short run has a few iterations of one."""
    if short:
        return soft.measured(["ball, jump"], [0], other=False, most=20)
    return soft.measured(["ball, jump", "beam, jump"], [0, 1, 2])


def rows(records: dict[str, Any]) -> list[Row]:
    """A body in each."""
    return [_row(name, own) for name, own in records.items()]


def _row(name: str, own: dict[str, Any]) -> Row:
    starts = list(own["starts"].values())
    good = sum(one["status"] == "converged" and one["held"] for one in starts)
    median = {k: float(np.median([one[k] for one in starts])) for k in ("iterations", "seconds")}
    each = float(np.median([one["seconds"] / one["iterations"] for one in starts]))
    told = (
        f"{good} of {len(starts)} starts converge, within the motors' limits; "
        f"{number(median['iterations'], 3)} iterations, {seconds(median['seconds'])} (medians), "
        f"{seconds(each)} an iteration"
    )
    first = starts[0]
    remark = (
        f"{number(-first['way'][0])} m to the left, {number(first['in_the_air'])} s in the air, "
        f"bent by {number(first['bends'])} m at most"
    )
    if "ipopt" in own:
        other = own["ipopt"]
        remark += f"; IPOPT: {ending(other)}, {seconds(other['seconds'])}"
    return Row(f"{name} (Fig. 2)", PAPER, told, remark)
