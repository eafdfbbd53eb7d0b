"""What the command line asks for: walk, stride, turn, jump, stand; as terms of E, and as one number that says how well."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from octo.errors import ProblemError, UnknownNameError, ValueRangeError
from octo.model.character import Character
from octo.problem import presets
from octo.problem.costs import BaseAngularVelocity, CenterOfMassPosition, CenterOfMassVelocity, Cost, Effort
from octo.problem.problem import Array
from octo.solver.solution import Solution

Kind = Literal["walk", "stride", "turn", "jump", "stand"]
Preset = Literal["paper", "robot"]
FLOOR = 0.1  # m/s, rad/s or m: no denominator of a goal's error is smaller


@dataclass(frozen=True)
class Goal:
    """A goal: ``speed`` in m/s (rad/s for turn, its sign the side), ``distance`` and ``height`` in m for jump."""

    kind: Kind = "walk"
    speed: float = 0.5
    distance: float = 0.5
    height: float = 0.2
    preset: Preset = field(default="paper")

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind):
            raise UnknownNameError("goal", self.kind, get_args(Kind))
        if self.preset not in get_args(Preset):
            raise UnknownNameError("costs", self.preset, get_args(Preset))
        for name in ("speed", "distance", "height"):
            if not np.isfinite(getattr(self, name)):
                raise ValueRangeError(f"{name} is {getattr(self, name)}, must be finite")

    @property
    def velocity(self) -> tuple[float, float, float]:
        """m/s, wanted of the centre of mass."""
        along = {"walk": (self.speed, 0.0, 0.0), "stride": (0.0, self.speed, 0.0)}
        return along.get(self.kind, (0.0, 0.0, 0.0))

    def check(self, robot: Character) -> None:
        """Refuse what the robot cannot do.

        Raises
        ------
        ProblemError: no actuator, or no floating base to move.
        """
        if robot.nu == 0:
            raise ProblemError(f"robot {robot.name!r} has no actuator: at least one joint must be actuated")
        if robot.base != "floating":
            raise ProblemError(f"goal {self.kind!r} needs a floating base, robot {robot.name!r} is fixed: try base='floating'")

    def costs(self, com: Array, length: float = 0.3, times: Array | None = None) -> list[Cost]:
        """The terms of E.

        ``com`` (3,) m is the centre of mass at the start; ``length`` (m) and ``times`` (N,) s are those of
        :func:`octo.costs.robot`.
        """
        yaw_rate = self.speed if self.kind == "turn" else 0.0
        terms = presets.paper(self.velocity)
        if self.preset == "robot":
            terms = presets.robot(self.velocity, yaw_rate, length=length, times=times)
        if self.kind == "turn" and self.preset == "paper":
            turn = BaseAngularVelocity(velocity=(0.0, 0.0, self.speed), axes=(0.0, 0.0, 1.0))
            terms = [turn, CenterOfMassVelocity(weight=0.01), Effort()]
        if self.kind == "jump":
            terms = [t for t in terms if not isinstance(t, CenterOfMassVelocity)]
            terms.insert(0, CenterOfMassPosition(target=tuple(com + self._displacement)))
        return terms

    @property
    def _displacement(self) -> Array:
        return np.array([self.distance, 0.0, self.height])

    def error(self, solution: Solution) -> float:
        """How far the motion is from the goal, in parts of it (0.1 is one tenth)."""
        duration = solution.steps * solution.dt
        com = solution.com
        if self.kind == "turn":
            rate = (solution.yaw[-1] - solution.yaw[0]) / duration
            return float(abs(rate - self.speed) / max(abs(self.speed), FLOOR))
        if self.kind == "jump":
            miss = float(np.linalg.norm(com[-1] - com[0] - self._displacement))
            return miss / max(float(np.linalg.norm(self._displacement)), FLOOR)
        wanted = np.array(self.velocity)
        miss = float(np.linalg.norm((com[-1] - com[0]) / duration - wanted))
        return miss / max(float(np.linalg.norm(wanted)), FLOOR)
