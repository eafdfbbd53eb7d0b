"""The measurements that a controller was given so far: what the next one is checked against."""

from __future__ import annotations

import numpy as np

from octo.model.convention import Convention
from octo.model.quantities import Array
from octo.mpc.command import CommandStatus
from octo.mpc.measurement import plausible

# rad or m, by which a reading that stays the same should have moved; encoders count in a tenth of
# it or less
FROZEN = 0.02
FINE = 3  # readings of which no velocity repeats: these sensors do not count in steps
# s, that a measurement may be older than the last one, or newer than the plan's end, by the same
# clock
SLACK = 1.0


class Readings:
    """The last measurement, the clock it came by, and how its sensors count.

    Attributes
    ----------
    time: s, of the last measurement that was taken; -inf before the first.
    tick: s, between the last two, at most ``dt``.
    """

    def __init__(self, convention: Convention, dt: float):
        self._convention, self._dt = convention, dt
        self.forget()

    def forget(self) -> None:
        self.time, self.tick = -np.inf, self._dt
        self._jump = np.nan  # s, the last time that was refused as another clock's
        self._since = np.inf  # s, from when on all readings have been the same
        self._count, self._in_steps = 0, False
        self._q, self._v = np.zeros(self._convention.nq), np.zeros(self._convention.nv)

    def refuse(self, t: float, q: Array, v: Array, end: float) -> CommandStatus | None:
        """What is wrong with a measurement, if anything; ``end`` (s) is the plan's."""
        if not (np.isfinite(t) and plausible(q, v, self._convention)):
            return CommandStatus.INVALID
        if self._frozen(t, q, v):
            return CommandStatus.STALE
        ahead = t > max(end, self.time) + SLACK
        behind = t < self.time - SLACK
        if np.isfinite(self.time) and (ahead or behind):
            follows = self._jump < t <= self._jump + SLACK
            self._jump = t
            if not follows:
                return CommandStatus.INVALID if ahead else CommandStatus.STALE
            self.time = -np.inf  # two in a row by another clock: that is the clock now
        self._jump = np.nan
        return CommandStatus.STALE if t <= self.time else None

    def _frozen(self, t: float, q: Array, v: Array) -> bool:
        """Whether a sensor has stopped: all readings are the last ones, though by their own
        velocity they should have changed.

        Equal readings alone are no fault where sensors count in steps: a robot that hardly moves
        then reads the same twice. What such sensors are known by is that single velocities repeat,
        and they are given the time to move by FROZEN.
        """
        if not ((q == self._q).all() and (v == self._v).all() and v.any()):
            return False
        moved = float(np.abs(v).max()) * (t - self._since)  # rad or m
        return (self._count >= FINE and not self._in_steps) or moved > FROZEN

    def take(self, t: float, q: Array, v: Array) -> None:
        """Make a measurement that was not refused the last one."""
        self.tick = min(max(t - self.time, 1e-6), self._dt)
        self.time = t
        repeated = v == self._v
        self._in_steps = self._in_steps or bool(repeated[v != 0.0].any())
        self._count += 1
        if not (repeated.all() and (q == self._q).all() and t >= self._since):
            self._since = t
        self._q[:], self._v[:] = q, v
