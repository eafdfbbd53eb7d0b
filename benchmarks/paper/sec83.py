"""Section 8.3, the receding horizon: the chain's 40 s by sub-trajectories of 1 s."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.paper.curves import every
from benchmarks.paper.fig8 import DT, SPEED, chain
from benchmarks.paper.page import Row, number, seconds
from benchmarks.paper.timed import WAYS, solved
from octo.mpc.animation import animate
from octo.solve import solve

TITLE = "A receding horizon of 1 s (section 8.3)"
PANELS = 1
HORIZON = 20  # steps: 1 s
ADVANCE = 2  # steps of each that are kept: 0.1 s


def measure(short: bool) -> dict[str, Any]:
    """The receding horizon, and the full one in the same basis by the same solver."""
    length = 4.0 if short else 40.0  # s
    steps, limit = round(length / DT), 100 if short else 3000
    short_one = chain(HORIZON, basis="nodes")
    moved = animate(short_one, length, advance=ADVANCE)
    whole = solve(
        chain(steps, basis="nodes"),
        passes=1,
        max_iterations=limit,
        options=WAYS["default"],
        device="cpu",
    )
    motions = {"receding": moved, "full": whole}
    return {
        "seconds": length,
        "advance": ADVANCE,
        "plans": len(moved.history["energy"]),
        **{
            name: {
                **solved(one),
                "travel": float(one.com[-1, 0] - one.com[0, 0]),
                "along": every(one.com[:, 0] - one.com[0, 0]),
            }
            for name, one in motions.items()
        },
    }


def draw(records: dict[str, Any], axes: Any) -> None:
    """How far both get."""
    for name, label in (("receding", "receding horizon"), ("full", "full horizon")):
        along = records[name]["along"]
        axes[0].plot(np.linspace(0.0, records["seconds"], len(along)), along, label=label)
    times = np.array([0.0, records["seconds"]])
    axes[0].plot(times, SPEED * times, "k:", label="wanted")
    axes[0].set(xlabel="time (s)", ylabel="centre of mass (m)")


def rows(records: dict[str, Any]) -> list[Row]:
    """What the text says."""
    moved, whole = records["receding"], records["full"]
    kept = records["advance"] * DT
    ratio = moved["seconds"] / whole["seconds"]
    return [
        Row(
            "one sub-trajectory of 1 s",
            "3 – 5 s",
            seconds(moved["seconds"] / records["plans"]),
            f"{records['plans']} of them, of each {number(kept)} s are kept",
        ),
        Row(
            "the whole motion",
            "1200 s for 40 s",
            f"{seconds(moved['seconds'])} for {records['seconds']:.0f} s",
            f"leaves ‖C‖∞ = {number(moved['violation'])} N",
        ),
        Row(
            "over the full horizon",
            "1200 s over 110 s",
            f"{seconds(moved['seconds'])} over {seconds(whole['seconds'])}: "
            f"{number(ratio)} times as long",
            "both in the nodes basis, by octo's default",
        ),
        Row(
            "how far they get",
            "–",
            f"{number(moved['travel'])} m and {number(whole['travel'])} m (full), E "
            f"{number(moved['energy'], 3)} and {number(whole['energy'], 3)}",
            f"{number(SPEED * records['seconds'])} m are wanted",
        ),
    ]
