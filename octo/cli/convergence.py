"""E and ‖C‖∞ against seconds, every solver in its own colour."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from octo.bench.contest import Entry
from octo.bench.figure import SOLVERS


def draw(entries: Sequence[Entry], title: str, path: Path) -> None:
    """One line a run; a dot where it stopped, hollow where it did not converge.

    Raises
    ------
    MissingExtraError: matplotlib is not there.
    """
    from octo.figure import Figure

    figure = Figure(figsize=(9.0, 4.0), layout="constrained")
    panels = figure.subplots(1, 2, sharex=True)
    figure.suptitle(title)
    named = set()
    for entry in entries:
        history, color = entry.solution.history, SOLVERS.get(entry.solver, "#6b7785")
        label = None if entry.solver in named else entry.solver
        named.add(entry.solver)
        seconds = np.maximum(np.append(history["seconds"], entry.solution.seconds), 1e-3)
        ends = (entry.solution.energy, entry.solution.violation)
        for panel, name, end in zip(panels, ("energy", "violation"), ends, strict=True):
            values = np.maximum(np.append(history[name], end), 1e-12)
            panel.plot(seconds, values, color=color, linewidth=1.0, alpha=0.75, label=label)
            face = color if entry.solution.converged else "none"
            panel.plot(
                seconds[-1:], values[-1:], "o", color=color, markersize=4.5, markerfacecolor=face
            )
    for panel, name in zip(panels, ("E", "‖C‖∞, N"), strict=True):
        panel.set(xscale="log", yscale="log", xlabel="seconds from the common start", title=name)
        panel.grid(True, color="#e6e8eb", linewidth=0.7)
    panels[0].legend(frameon=False)
    figure.savefig(path, dpi=150)
