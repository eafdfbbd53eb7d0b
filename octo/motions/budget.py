"""What is left of the options, and of the time, for each piece of a motion."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import Any

from octo.result.solution import Solution
from octo.solver.options import SqpOptions
from octo.solver.status import Status


@dataclass(frozen=True)
class Budget:
    """Options of :func:`octo.solve`, of which ``time_limit`` is of all solves since it began."""

    options: dict[str, Any]
    began: float = field(default_factory=time.perf_counter)  # s

    def left(self, doing: str) -> dict[str, Any]:
        """The options of solve, with what is left of the time, and with what the progress line
        says."""
        options = dict(self.options)
        if options.get("progress"):
            options["progress"] = doing
        if "time_limit" in options:
            spent = time.perf_counter() - self.began
            options["time_limit"] = max(options["time_limit"] - spent, 1e-3)
        return options

    def near(self, doing: str) -> dict[str, Any]:
        """:meth:`left` for what starts from a stride and is to stay near it: with its stiffness, so
        in one pass, and without the contacts' curvature, with which it ends in worse optima
        (docs/notes/cycles.md)."""
        given = self.left(doing) | {"passes": None}
        own = given.get("options") or SqpOptions()
        near = replace(own, hessian="dynamics") if own.hessian == "exact" else own
        return given | {"options": near}


class Interrupted(Exception):
    """Ctrl-C, or a callback that said stop, while pieces were solved."""


def going_on(made: Solution) -> Solution:
    """A solution that nobody interrupted; else ``Interrupted``."""
    if made.status is Status.INTERRUPTED:
        raise Interrupted
    return made
