"""The limits of a robot as constraints, and which terms of a list they take the place of."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

import casadi as ca
import numpy as np

from octo.checks import Array, asked, instance, number, one_of, positive
from octo.errors import ProblemError, ValueRangeError, said
from octo.model.character import Character
from octo.problem.at import always
from octo.problem.constraints import Constraint
from octo.problem.contact_costs import FrictionCone
from octo.problem.costs import Cost
from octo.problem.joint_costs import JointLimit, JointSpeedLimit, TorqueLimit
from octo.problem.limits import FrictionCones, JointLimits, JointSpeedLimits, TorqueLimits
from octo.problem.lists import constraints_of
from octo.problem.presets import FASTEST
from octo.problem.terms import Row

if TYPE_CHECKING:
    from octo.problem.symbols import Setting, StepSymbols

Kind = Literal["soft", "hard"]  # what a robot's limits are
Held = Sequence[Constraint | Cost] | Kind
MU = 0.6  # of friction, where nothing is said: that of the natural terms
# terms of E about a limit, and the constraint that is the same limit
SOFT: dict[type[Cost], type[Constraint]] = {
    FrictionCone: FrictionCones,
    JointLimit: JointLimits,
    JointSpeedLimit: JointSpeedLimits,
    TorqueLimit: TorqueLimits,
}


@asked
def limits(robot: Character, mu: float = MU, speed: float = FASTEST) -> list[Constraint]:
    """List what a robot cannot do, as constraints: torques, joints, speeds, friction of its feet.

    They are those that :func:`octo.costs.natural` prices; a robot whose file has no torque limit,
    or no joint limit, has no such constraint.

    Parameters
    ----------
    robot: whose limits they are.
    mu: coefficient of friction of the ground, more than 0.
    speed: rad/s or m/s, of joints whose file says no limit.

    Returns
    -------
    A list for ``constraints=`` of :func:`octo.walk` and the others, or of a Problem.

    Raises
    ------
    ValueRangeError: mu or speed.
    """
    instance("robot", robot, Character, "a Character: what octo.load and octo.gallery give")
    if not number("mu", mu) > 0.0:
        raise ValueRangeError(f"mu is {mu:g}, must be positive")
    found: list[Constraint] = []
    if np.isfinite(robot.torque_limit).any():
        found.append(TorqueLimits())
    joints = robot.actuated
    if (np.isfinite(robot.lower[joints]) | np.isfinite(robot.upper[joints])).any():
        found.append(JointLimits())
    found.append(JointSpeedLimits(otherwise=positive("speed", speed, "rad/s")))
    if robot.contacts:
        found.append(FrictionCones(mu, contacts="feet"))
    return found


def beside(constraints: Sequence[Constraint | Cost], costs: Sequence[Cost]) -> list[Cost]:
    """The terms of E without those about a limit that the constraints hold."""
    held = tuple(type(one.hard() if isinstance(one, Cost) else one) for one in constraints)
    replaced = {soft for soft, hard in SOFT.items() if issubclass(hard, held)} if held else set()
    return [term for term in costs if type(term) not in replaced]


def held(robot: Character, given: Held) -> tuple[Constraint, ...]:
    """What must hold: a list as of a Problem, "hard" for the limits of the robot, "soft" for none.

    Raises
    ------
    OctoError: names what is wrong with the list, or the word.
    """
    if isinstance(given, str):
        one_of("constraints", given, get_args(Kind))
        return constraints_of(limits(robot) if given == "hard" else ())
    return constraints_of(given)


def at_every_step(constraints: Sequence[Constraint], motion: str) -> None:
    """Refuse constraints of some steps alone.

    Parameters
    ----------
    constraints: of a motion that is found in several pieces. motion: what a message calls it.

    Raises
    ------
    ProblemError: names the first of them.
    """
    for one in constraints:
        if not always(one.at):
            raise ProblemError(
                f"{one.label}.at is {said(one.at)}, must be 'all': {motion} is found in several "
                "pieces; describe it as one octo.Problem for what holds at some steps"
            )


@dataclass(frozen=True, eq=False)
class Standing(Constraint):
    """A constraint that means what it does of a robot that stands, wherever its problem begins.

    Parameters
    ----------
    own: the constraint. x0: (nx,) where the robot stands: its upright, its height.
    """

    own: Constraint
    x0: Array

    def references(self, setting: Setting) -> Mapping[str, Any]:
        return self.own.references(replace(setting, x0=self.x0))

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return self.own.residual(step, p)

    def bounds(self, setting: Setting) -> tuple[Any, Any]:
        return self.own.bounds(replace(setting, x0=self.x0))

    def rows(self, setting: Setting) -> Sequence[Row]:
        return self.own.rows(replace(setting, x0=self.x0))


def standing(own: Constraint, x0: Array) -> Constraint:
    """The constraint of a robot that stands at x0 (nx,)."""
    return Standing(own, x0, name=own.label, at=own.at, curvature=own.curvature)
