"""What an interactive session shows of octo's objects: a few lines, in a notebook a table."""

from __future__ import annotations

import importlib

LINE = 100  # columns


class Shown:
    """A base class: ``__repr__`` of a subclass is at most five lines, ``_repr_html_`` is
    :mod:`octo.notebook`'s."""

    def __repr__(self) -> str:
        return str(self)

    def _repr_html_(self) -> str:
        # By name, when a notebook asks: what draws is on a higher floor than what is drawn.
        return str(importlib.import_module("octo.notebook").html(self))


def listed(label: str, names: list[str]) -> str:
    """One indented line: how many there are, and the names as far as they fit."""
    line = f"  {len(names)} {label}: {', '.join(names)}" if names else f"  no {label}"
    return line if len(line) <= LINE else f"{line[:LINE].rpartition(',')[0]}, …"
