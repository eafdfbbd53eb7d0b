"""What is generated for a list of terms of one model: structure alone, no number of a problem."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca

from octo.dynamics.contact_numbers import contact_function, touch_function
from octo.dynamics.evaluate import Dynamics, RobotDynamics
from octo.errors import ProblemError
from octo.interrupts import postponed
from octo.problem.between import BetweenCode
from octo.problem.codegen import CostFunctions, asked_of_world, cost_text, kept_slopes
from octo.problem.row_products import RowSlopes


@dataclass(frozen=True, eq=False)
class Program:
    """Of problems of one structure (octo.problem.structure): the dynamics and the functions of the
    terms."""

    dynamics: Dynamics
    functions: CostFunctions

    def c_text(self) -> str:
        """A time step in every lane, then assemble.c, and between.c where a term needs it."""
        return self._c_text

    @cached_property
    def _c_text(self) -> str:
        stages = self.functions.calls.stages_text + asked_of_world(self.functions, self.dynamics)
        text = stages + self.dynamics.lanes_text() + cost_text(self.functions, self.dynamics)
        between = self.between
        return text if between is None else f"{text}\n{between.c_text()}"

    @cached_property
    def between(self) -> BetweenCode | None:
        """Of the terms over neighbouring controls, if any."""
        return BetweenCode(self.functions) if self.functions.between else None

    @cached_property
    def kept(self) -> RowSlopes | None:
        """What a linearisation keeps of the slopes of the bounded rows, if any."""
        return kept_slopes(self.functions, self.dynamics)

    def interpreted(self) -> Program:
        """The same for CasADi's virtual machine, dynamics included."""
        return replace(self, dynamics=self.dynamics.interpreted())

    @cached_property
    @postponed()
    def kinematics(self) -> ca.Function:
        """Contact forces, points, velocities, normals and depths of one step, for reports:
        (x_next, x, p)."""
        dynamics = self.dynamics
        if not isinstance(dynamics, RobotDynamics):
            raise ProblemError("user-written dynamics have no contacts")
        return contact_function(dynamics)

    @cached_property
    @postponed()
    def touches(self) -> ca.Function:
        """Forces between bodies of one step and where they act, for reports: (x_next, x, p)."""
        assert isinstance(self.dynamics, RobotDynamics)
        return touch_function(self.dynamics)
