"""One start on its way through the passes, and the Solution that is made of it at the end."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo.problem.compiled import CompiledProblem
from octo.result.measure import measured
from octo.result.solution import Solution
from octo.result.trajectory import Trajectory
from octo.solver import sqp
from octo.solver.status import HISTORY, Status

Array = NDArray[np.float64]
# of a motion, that reports keep of each pass
FIGURES = (
    "energy violation pointwise_residual penetration penetration_max slip friction_use "
    "friction_use_95 torque_excess"
)
CONTACT = ("contact.w_perp", "contact.w_par", "contact.onset")


@dataclass(eq=False)
class Member:
    """What is known of one member of the batch after some passes.

    Attributes
    ----------
    seed: its number. device: where it is solved.
    motion: fields of a Solution, of the last pass that converged, or of the first.
    passes, history: a record, and the columns of HISTORY, of each pass.
    stages: seconds by stage, iterations, factorizations, seconds, processor_seconds: of all passes.
    """

    seed: int
    device: str
    motion: dict[str, Any] = field(default_factory=dict)
    status: Status = Status.STALLED
    passes: list[dict[str, object]] = field(default_factory=list)
    history: list[dict[str, Array]] = field(default_factory=list)
    stages: dict[str, float] = field(default_factory=dict)
    iterations: int = 0
    factorizations: int = 0
    seconds: float = 0.0
    processor_seconds: float = 0.0

    def add(
        self, compiled: CompiledProblem, result: sqp.Result, place: int, setup_seconds: float
    ) -> bool:
        """One more pass, of which this is the member at ``place``: whether it converged.

        Where it did not, the motion of the last converged pass stays, near its optimum.
        """
        number, status = len(self.passes) + 1, result.status[place]
        found = measured(compiled, result.at, place)
        iterations = int(result.iterations[place])
        factorizations = int(result.factorizations[place])
        self.passes.append(
            record(
                number,
                Trajectory(**found),
                status,
                iterations=iterations,
                factorizations=factorizations,
                seconds=float(result.seconds),
            )
        )
        columns = result.history[place]
        self.history.append(columns | {"pass": np.full(len(columns["pass"]), float(number))})
        for name, seconds in result.stages.items():
            self.stages[name] = self.stages.get(name, 0.0) + seconds
        self.iterations += iterations
        self.factorizations += factorizations
        self.seconds += float(result.seconds)
        self.processor_seconds += float(result.processor_seconds)
        if status.converged or number == 1:
            own = {"multipliers": result.lam[place].copy(), "setup_seconds": setup_seconds}
            self.motion, self.status = found | own, status
        else:
            interrupted = status is Status.INTERRUPTED
            self.status = Status.INTERRUPTED if interrupted else Status.ACCEPTABLE
        return status.converged

    def solution(self) -> Solution:
        """The motion, with the iterations and the time of all passes."""
        names = ("status", "seed", "device", "stages", "iterations", "factorizations", "seconds")
        own = {name: getattr(self, name) for name in (*names, "processor_seconds")}
        history = {name: np.concatenate([part[name] for part in self.history]) for name in HISTORY}
        return Solution(**self.motion, **own, passes=tuple(self.passes), history=history)


def record(
    number: int,
    motion: Trajectory,
    status: Status,
    *,
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
