"""The tables of docs/paper.md, written from the records between its markers."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

HEAD = "| | the paper | octo | remark |\n| --- | --- | --- | --- |\n"
NOT_RUN = "not run"
MARKED = re.compile(r"(?P<begin><!-- (?P<name>\w+) -->\n).*?(?P<end><!-- end -->)", re.DOTALL)


@dataclass(frozen=True)
class Row:
    """One thing that the paper says, as it says it, what was measured here, and what to make of
    it."""

    what: str
    paper: str
    octo: str
    remark: str = ""

    def __str__(self) -> str:
        cells = (self.what, self.paper, self.octo, self.remark)
        return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"


def number(value: float, digits: int = 2) -> str:
    """With so many digits that count, thousands apart, and powers of ten where it is small."""
    if value == 0.0:
        return "0"
    if abs(value) < 1e-3:
        return f"{value:.{digits - 1}e}"
    rounded = float(f"{value:.{digits - 1}e}")
    if abs(rounded) >= 10.0 ** (digits - 1):
        return f"{rounded:,.0f}"
    return f"{rounded:#.{digits}g}".rstrip(".")


def seconds(value: float) -> str:
    """With its unit, in ms below a tenth of a second."""
    return f"{number(1e3 * value)} ms" if value < 0.1 else f"{number(value)} s"


def on_gpu(one: dict[str, Any] | None) -> str:
    """A solve on a GPU, or that there was none."""
    if one is None:
        return NOT_RUN
    return f"{ending(one)}, {seconds(one['seconds'])} on {one['device']}"


def measured(figure: dict[str, Any]) -> str:
    """One line under a table: when, where and how long."""
    return (
        f"\n{figure['date']}, {figure['processor']}, {figure['cores']} cores, octo "
        f"{figure['octo']} ({figure['commit']}); {number(figure['processor_seconds'])} s of "
        "processor time.\n"
    )


def table(rows: Iterable[Row], figure: dict[str, Any] | None = None) -> str:
    """The text between the markers of a figure."""
    return HEAD + "".join(map(str, rows)) + ("" if figure is None else measured(figure))


def written(text: str, tables: dict[str, str]) -> str:
    """The page with ``tables`` by the names of their markers; others stay as they are."""

    def filled(found: re.Match[str]) -> str:
        inside = tables.get(found["name"])
        return found[0] if inside is None else f"{found['begin']}\n{inside}\n{found['end']}"

    return MARKED.sub(filled, text)


def ending(one: dict[str, Any]) -> str:
    """How a solve ended, of a record with its status and iterations."""
    return f"{one['status'].replace('_', ' ')}, {one['iterations']:,} iterations"
