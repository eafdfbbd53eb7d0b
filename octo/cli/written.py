"""What a command writes of a motion: its numbers, a plot, a page."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from octo.cli.output import OutputFolder, Writer, say_left_out
from octo.result.solution import Solution

FILES = ("solution.npz", "report.json", "plot.png", "motion.html")


def write(
    folder: OutputFolder,
    solution: Solution,
    report: Callable[[], Mapping[str, Any]],
    plotted: Callable[[Solution], Solution] = lambda solution: solution,
) -> None:
    """The four files; a picture that cannot be drawn, as without the extra 'view', is left out."""
    writers: dict[str, Writer] = {
        "solution.npz": solution.save,
        "report.json": lambda path: write_json(path, report()),
        "plot.png": lambda path: write_plot(plotted(solution), path),
        "motion.html": lambda path: write_page(solution, path),
    }
    say_left_out(folder.write(writers))


def say_written(folder: OutputFolder, solution: Solution) -> None:
    """Where the files are, and who says why it failed."""
    more = "" if solution.converged else f"; why it failed: octo explain {folder.path}"
    print(f"written to {folder.path}{more}")


def write_plot(solution: Solution, path: Path) -> None:
    from octo.plot import plot  # here: what draws is loaded when the numbers are written

    plot(solution, path)


def write_page(solution: Solution | Sequence[Solution], path: Path, **options: Any) -> None:
    from octo.viewer import view

    view(solution, path, **options)


def write_json(path: Path, values: Mapping[str, Any] | Sequence[Any]) -> None:
    text = json.dumps(finite(values), indent=1, ensure_ascii=False, allow_nan=False)
    path.write_text(f"{text}\n", encoding="utf-8")


def finite(value: Any) -> Any:
    """The same with null for what is not a finite number: JSON has no NaN and no infinity."""
    if isinstance(value, Mapping):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(entry) for entry in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value.item() if hasattr(value, "item") else value
