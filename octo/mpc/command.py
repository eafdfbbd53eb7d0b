"""What a controller answers: a command, and how it came about."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import cached_property

from octo.model.quantities import Array


class CommandStatus(Enum):
    """Why the command is what it is, in words."""

    SOLVED = "solved: the plan starts at this measurement"
    LATE = "late: the plan had run out before this measurement came; the new one starts at it"
    BUDGET = "the budget ran out before one iteration was done: the plan before continues, shifted"
    INVALID = (
        "the measurement is not finite, out of all bounds, or has another shape: the plan "
        "before continues, shifted"
    )
    STALE = "the measurement is no newer than the one before: the plan before continues, shifted"
    FAILED = "the step could not be computed: the plan before continues, shifted"
    DIVERGED = (
        "the step leads to a motion that is not finite or breaks the laws of physics: the "
        "plan before continues, shifted"
    )

    @property
    def label(self) -> str:
        """The name reports use: "solved", "late", …"""
        return self.name.lower()

    @property
    def fresh(self) -> bool:
        """Whether the plan is a new one."""
        return self in (CommandStatus.SOLVED, CommandStatus.LATE)


@dataclass(frozen=True, eq=False)
class Command:
    """The command at one measurement.

    Attributes
    ----------
    u: (nu,) N m or N, inside the torque limits. x (nq,), v (nv,): where the plan is one tick later,
        convention's form.
    valid_until: s, when the plan ends. seconds: of the call; prepare: s, of what could be done
        before the measurement.
    iterations: done at this call. torque_excess: largest |u|/limit in the plan. energy: E of the
        plan.
    violation: ‖C‖∞ of the plan relative to mg.
    clipped: by how much, in parts of its limit, the plan's first torque was beyond it before it was
        clipped; 0 inside.
    beyond: by how much the plan is beyond a hard bound at most, relative to the constraint's size;
        0 inside, or without one.
    status: what became of this measurement, with its sentence.
    """

    u: Array
    valid_until: float
    status: CommandStatus
    seconds: float
    prepare: float
    iterations: int
    torque_excess: float
    energy: float
    violation: float
    clipped: float
    beyond: float
    _gains: Callable[[], Array]
    _goal: Callable[[], tuple[Array, Array]]

    @cached_property
    def _state(self) -> tuple[Array, Array]:
        return self._goal()

    @property
    def x(self) -> Array:
        return self._state[0]

    @property
    def v(self) -> Array:
        return self._state[1]

    @cached_property
    def K(self) -> Array:
        """(nu, 2nv) du/d(error of place, error of velocity), from the factorisation of the plan's
        last iteration.

        The error of place is the measured minus the planned configuration in the tangent space of
        the convention.
        """
        return self._gains()
