"""What is left of the options, and of the time, for each piece of a motion."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from octo.result.solution import Solution
from octo.solver.options import SqpOptions
from octo.solver.status import Status


@dataclass(frozen=True)
class Budget:
    """Options of :func:`octo.solve`, of which ``time_limit`` is of all solves since it began."""

    options: dict[str, Any]
    held: bool = False  # whether there is something that must hold
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

    @cached_property
    def scouting(self) -> Budget:
        """The same for what need not hold yet."""
        return replace(self, held=False)

    def near(self, doing: str) -> dict[str, Any]:
        """:meth:`left` for what starts from a stride and is to stay near it: with its stiffness, so
        in one pass, and without the contacts' curvature, with which it ends in worse optima
        (docs/notes/cycles.md). Where something must hold with it: multipliers of rows want the
        rows' curvature (the ways into a stride of a mammal: 177 to 490 iterations, without 1062 to
        1968, and two of six stall)."""
        given = self.left(doing) | {"passes": None}
        own = given.get("options") or SqpOptions()
        if self.held or own.hessian != "exact":
            return given
        return given | {"options": replace(own, hessian="dynamics")}


class Interrupted(Exception):
    """Ctrl-C, or a callback that said stop, while pieces were solved."""


def going_on(made: Solution) -> Solution:
    """A solution that nobody interrupted; else ``Interrupted``."""
    if made.status is Status.INTERRUPTED:
        raise Interrupted
    return made
