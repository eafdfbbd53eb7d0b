"""One start on its way through the passes, and the Solution that is made of it at the end."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from octo.checks import Array
from octo.problem.phased import Compiled
from octo.result.phased import motion_of
from octo.result.solution import Solution
from octo.result.trajectory import Trajectory
from octo.solver import sqp
from octo.solver.status import HISTORY, Status

# of a motion, that reports keep of each pass
FIGURES = (
    "energy violation pointwise_residual penetration penetration_max slip friction_use "
    "friction_use_95 torque_excess"
)
CONTACT = ("contact.w_perp", "contact.w_par", "contact.onset")


@dataclass(eq=False)
class Member:
    """What is known of one member of the batch after some passes."""

    seed: int
    device: str
    # fields of a Solution, of the last pass that converged, or of the first
    motion: dict[str, Any] = field(default_factory=dict)
    status: Status = Status.STALLED
    passes: list[dict[str, object]] = field(default_factory=list)  # a record of each
    history: list[dict[str, Array]] = field(default_factory=list)  # of each, the columns of HISTORY
    stages: dict[str, float] = field(default_factory=dict)  # s by stage; these are of all passes
    iterations: int = 0
    factorizations: int = 0
    seconds: float = 0.0
    processor_seconds: float = 0.0

    def add(
        self,
        compiled: Compiled,
        result: sqp.Result,
        place: int,
        setup_seconds: float,
        instead: bool = False,
    ) -> bool:
        """One more pass, of which this is the member at ``place``: whether it converged.

        Where it did not, the motion of the last converged pass stays, near its optimum; but not
        where this one is ``instead`` of it.
        """
        number, status = len(self.passes) + 1, result.status[place]
        found = motion_of(compiled, result.at, place)
        iterations = int(result.iterations[place])
        factorizations, seconds = int(result.factorizations[place]), float(result.seconds)
        figures = (Trajectory(**found), status, iterations, factorizations, seconds)
        self.passes.append(record(number, *figures))
        columns = result.history[place]
        self.history.append(columns | {"pass": np.full(len(columns["pass"]), float(number))})
        for name, spent in result.stages.items():
            self.stages[name] = self.stages.get(name, 0.0) + spent
        self.iterations += iterations
        self.factorizations += factorizations
        self.seconds += seconds
        self.processor_seconds += float(result.processor_seconds)
        if status.converged or number == 1 or instead:
            own = {"multipliers": result.lam[place].copy(), "setup_seconds": setup_seconds}
            if result.slacks is not None:
                own["slacks"] = result.slacks.plain(place)
            self.motion, self.status = found | own, status
        else:
            self.status = status if status is Status.INTERRUPTED else Status.ACCEPTABLE
        return status.converged

    def solution(self) -> Solution:
        """The motion, with the iterations and the time of all passes."""
        names = ("status", "seed", "device", "stages", "iterations", "factorizations", "seconds")
        own = {name: getattr(self, name) for name in (*names, "processor_seconds")}
        history = {name: np.concatenate([part[name] for part in self.history]) for name in HISTORY}
        whole = self.motion | {"phases": self._phases(own)}
        return Solution(**whole, **own, passes=tuple(self.passes), history=history)

    def _phases(self, own: dict[str, Any]) -> tuple[Solution, ...]:
        """Those of the motion, which were all found together; the history is the whole's."""
        multipliers, setup = self.motion["multipliers"], self.motion["setup_seconds"]
        none = {name: np.zeros(0) for name in HISTORY}
        made, first = [], 0
        for phase in self.motion.get("phases", ()):
            rows = multipliers[first : first + phase.steps]
            found = {"multipliers": rows, "setup_seconds": setup, "history": none}
            made.append(Solution(**vars(phase), **own, **found))
            first += phase.steps
        return tuple(made)


def record(
    number: int,
    motion: Trajectory,
    status: Status,
    iterations: int = 0,
    factorizations: int = 0,
    seconds: float = 0.0,
) -> dict[str, object]:
    """What reports keep of a pass, counted from 1."""
    weights = {name: motion.parameters.get(name) for name in CONTACT}
    return {
        "pass": number,
        "status": status.label,
        "converged": status.converged,
        "iterations": iterations,
        "factorizations": factorizations,
        **{name: getattr(motion, name) for name in FIGURES.split()},
        "seconds": seconds,
        **{name: value for name, value in weights.items() if value is not None},
    }
