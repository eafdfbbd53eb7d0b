"""The command: what is not measured yet, figure by figure, then the pictures and the page."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

from benchmarks.paper import (
    fig2,
    fig7,
    fig8,
    fig9a,
    fig9b,
    fig9c,
    fig10,
    fig11,
    page,
    records,
    sec81,
    sec83,
    sec86,
)

FIGURES: Mapping[str, ModuleType] = {
    one.__name__.rpartition(".")[2]: one
    for one in (sec81, fig7, fig8, fig9a, fig9b, fig9c, sec83, fig10, fig11, fig2, sec86)
}
RESULTS = records.ROOT / "benchmarks" / "results"
DOCS = records.ROOT / "docs"
PAGE = DOCS / "paper.md"
SHORT = records.ROOT / "build" / "paper"
WIDE, HIGH, DPI = 4.2, 3.0, 80  # inches of a panel


def measured(figure: ModuleType, short: bool, again: bool = False) -> dict[str, Any]:
    """The records of a figure, with what they depend on and what they cost; those of a benchmark
    that stands for itself are measured by its own command, what its file holds only if ``again``.
    """
    began, processor = time.perf_counter(), time.process_time()
    if not short and (own := getattr(figure, "BENCHMARK", None)) is not None:
        own.main(["--json", str(own.RESULTS), *(["--again"] if again else [])])
    found = figure.measure(short)
    return {
        **records.circumstances(),
        "short": short,
        "seconds": time.perf_counter() - began,
        "processor_seconds": time.process_time() - processor,
        "records": found,
    }


def draw(name: str, found: dict[str, Any], folder: Path) -> None:
    """paper_NAME.png, where the figure has panels.

    Raises
    ------
    MissingExtraError: matplotlib is not there.
    """
    from octo.figure import Figure

    figure = FIGURES[name]
    if not figure.PANELS:
        return
    picture = Figure(figsize=(WIDE * figure.PANELS, HIGH), layout="constrained")
    axes = picture.subplots(1, figure.PANELS, squeeze=False)[0]
    figure.draw(found["records"], axes)
    for one in axes:
        one.grid(True, color="#e6e8eb", linewidth=0.7)
        one.set_axisbelow(True)
        one.spines[["top", "right"]].set_visible(False)
        if one.get_legend_handles_labels()[1]:
            one.legend(frameon=False, fontsize=7.5)
    picture.savefig(folder / f"paper_{name}.png", dpi=DPI)


def tables(done: Mapping[str, dict[str, Any]]) -> dict[str, str]:
    """The table and picture of each figure that was measured; of others that they were not."""
    made: dict[str, str] = {}
    for name, figure in FIGURES.items():
        if name in done:
            drawn = f"\n![{figure.TITLE}](paper_{name}.png)\n" if figure.PANELS else ""
            made[name] = page.table(figure.rows(done[name]["records"]), done[name]) + drawn
        else:
            made[name] = page.table([page.Row(figure.TITLE, "", page.NOT_RUN)])
    return made


def _asked(words: Sequence[str] | None) -> argparse.Namespace:
    """What the command line asks for."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.paper",
        description="Measure every figure of section 8 of the paper, and write the page of them.",
    )
    parser.add_argument(
        "--only", default=",".join(FIGURES), help=f"some of {', '.join(FIGURES)}, with commas"
    )
    parser.add_argument("--short", action="store_true", help="small sizes: whether all of it runs")
    parser.add_argument("--again", action="store_true", help="also what is measured already")
    parser.add_argument("--out", type=Path, help="a folder for the records, pictures and tables")
    asked = parser.parse_args(words)
    asked.only = [name.strip() for name in asked.only.split(",")]
    for name in asked.only:
        if name not in FIGURES:
            parser.error(f"figure {name!r} is not known, must be one of {', '.join(FIGURES)}")
    return asked


def main(words: Sequence[str] | None = None) -> int:
    asked = _asked(words)
    folder = asked.out or (SHORT if asked.short else None)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    kept, drawn = (folder, folder) if folder is not None else (RESULTS, DOCS)
    file = kept / "paper.json"
    done = records.read(file)
    for name in asked.only:
        if not asked.again and name in done and done[name]["short"] == asked.short:
            print(f"{name}: measured on {done[name]['date']}", flush=True)
            continue
        print(f"{name}: {FIGURES[name].TITLE}", flush=True)
        done[name] = measured(FIGURES[name], asked.short, asked.again)
        records.write(file, {one: done[one] for one in FIGURES if one in done})
        draw(name, done[name], drawn)
        spent = [page.number(done[name][unit]) for unit in ("seconds", "processor_seconds")]
        print(f"{name}: {spent[0]} s, {spent[1]} s of processor time", flush=True)
    text = page.written(PAGE.read_text(encoding="utf-8"), tables(done))
    (drawn / PAGE.name).write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
