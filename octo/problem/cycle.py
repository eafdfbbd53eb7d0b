"""Cycles: what a user says of a motion that repeats itself; how it closes is in closure.py."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from octo.checks import number, owned, positive
from octo.errors import ProblemError, ValueRangeError, said
from octo.model.mirror import Mirror
from octo.model.quantities import GRAVITY

TIME_STEP = 0.025  # s, near which a cycle's own step is chosen
SLOWEST = 5.0  # √(ℓ/g), of a stride that goes nowhere
# strides of least work were within this factor of ``usual_period``: .5 and .58 s, .6 and .57, 1.0
# and 1.2
AROUND = 1.4
PERIODS = 5  # that a range is tried at, in equal ratios
WHOLE = 1e-6  # of a step: how far a period may be from a whole number of them


@dataclass(frozen=True, kw_only=True)
class Cycle:
    """A motion that repeats: a stride, or with ``mirror`` half of one.

    Attributes
    ----------
    speed: m/s over the ground plan, of the mean over a stride, along the heading at its beginning
        and, where it turns, along the arc that the heading describes; negative is backward.
    period: s, of a whole stride; or (shortest, longest): :func:`octo.solve` solves a few periods
        between the two (``periods``) as one batch and keeps the one whose joints work least on the
        way.
    mirror: half a stride is solved for, the other half is its mirror image. True finds the mirror
        (:func:`octo.mirror_of`), a mapping gives pairs of names by hand, a Mirror is taken as it
        is.
    turn: rad, by which the heading changes in a stride, to the left where positive. A turning
        stride cannot be mirrored.
    sideways: m/s, to the left; a stride sideways cannot be mirrored.
    shift: m, length of a stride, in place of ``speed``.

    Raises
    ------
    ProblemError, ValueRangeError: one line that names the field.
    """

    speed: float | None = None
    period: float | tuple[float, float] = 0.8
    mirror: bool | Mirror | Mapping[str, str] = True
    turn: float = 0.0
    sideways: float = 0.0
    shift: float | None = None

    def __post_init__(self) -> None:
        for name in ("turn", "sideways"):
            number(f"cycle.{name}", getattr(self, name))
        for name in ("speed", "shift"):
            if getattr(self, name) is not None:
                number(f"cycle.{name}", getattr(self, name))
        if isinstance(self.period, (tuple, list)):
            if len(self.period) != 2:
                raise ValueRangeError(
                    f"cycle.period is {said(self.period)}, must be a number of seconds or "
                    "(shortest, longest)"
                )
            low, high = (positive("cycle.period", value, "s") for value in self.period)
            if not low < high:
                raise ValueRangeError(
                    f"cycle.period is {said(self.period)}: the shortest must be less than the "
                    "longest"
                )
            object.__setattr__(self, "period", (low, high))
        else:
            positive("cycle.period", self.period, "s")
        if self.shift is not None and self.speed is not None:
            both = f"speed {self.speed:g} m/s and shift {self.shift:g} m"
            raise ProblemError(f"cycle has {both}: one follows from the other, give one")
        if not isinstance(self.mirror, (bool, Mirror, Mapping)):
            raise ProblemError(
                f"cycle.mirror is {said(self.mirror)}, must be True, False, a mapping of names "
                "or an octo.Mirror"
            )
        object.__setattr__(self, "mirror", owned(self.mirror))
        if self.mirrored and self.turn != 0.0:
            raise ProblemError(
                f"cycle.turn is {self.turn:g} rad: a turning stride cannot be mirrored, give "
                "mirror=False"
            )
        if self.mirrored and self.sideways != 0.0:
            sideways = f"cycle.sideways is {self.sideways:g} m/s"
            raise ProblemError(
                f"{sideways}: a stride sideways cannot be mirrored, give mirror=False"
            )

    @property
    def mirrored(self) -> bool:
        return self.mirror is not False

    @property
    def rounds(self) -> int:
        """How often a stride goes through the steps that are solved for: twice where mirrored."""
        return 2 if self.mirrored else 1

    @property
    def duration(self) -> float:
        """s, of what is solved for: the period, half of it where mirrored; of a range its geometric
        middle."""
        period = (
            np.sqrt(self.period[0] * self.period[1])
            if isinstance(self.period, tuple)
            else self.period
        )
        return float(period) / self.rounds

    @property
    def periods(self) -> tuple[float, ...]:
        """s, that are solved for: the one given, or a few of a range, in equal ratios."""
        if isinstance(self.period, tuple):
            return tuple(float(period) for period in np.geomspace(*self.period, PERIODS))
        return (float(self.period),)

    @property
    def velocity(self) -> float:
        """m/s along the heading."""
        if self.shift is not None:
            return self.shift / (self.duration * self.rounds)
        return 0.0 if self.speed is None else self.speed

    def sampling(self, steps: int, dt: float) -> tuple[int, float]:
        """Steps and dt (s) of the duration, from either, both or none (0).

        Raises
        ------
        ProblemError: the duration is no whole number of steps.
        """
        half = "half of a mirrored stride, " if self.mirrored else ""
        if isinstance(self.period, tuple) and dt > 0.0:
            raise ProblemError(
                f"dt is {dt:g} s and cycle.period a range: give steps alone, each period then "
                "has a dt of its own"
            )
        if dt <= 0.0:
            longest = max(self.periods) / self.rounds
            steps = steps or max(8, round(longest / TIME_STEP))
            return steps, self.duration / steps
        exact = self.duration / dt
        wanted = steps or max(1, round(exact))
        if abs(exact - wanted) > WHOLE * max(exact, 1.0):
            near = wanted * dt * self.rounds
            raise ProblemError(
                f"cycle.period is {self.period:g} s, {half}{exact:.6g} steps of {dt:g} s, must be "
                f"{'the ' + str(steps) if steps else 'a whole number of'} steps: for example a "
                f"period of {near:.6g} s"
            )
        return wanted, dt


def usual_period(length: float, speed: float) -> float:
    """s, of the stride of an animal whose legs are ``length`` m at ``speed`` m/s.

    Its stride is 2.3 ℓ (v²/gℓ)^0.3 long (Alexander, Nature 261, 1976), slow ones take no longer
    than 5 √(ℓ/g).
    """
    slowest = SLOWEST * float(np.sqrt(length / GRAVITY))
    froude = speed**2 / (GRAVITY * length)
    return min(slowest, 2.3 * length * froude**0.3 / abs(speed)) if froude > 1e-6 else slowest


def usual_periods(length: float, speed: float) -> tuple[float, float]:
    """s, shortest and longest to look for a stride in: see ``usual_period``."""
    period = usual_period(length, speed)
    return period / AROUND, period * AROUND
