"""Cycles: the last state is the first one carried on, x_N = G (x_0 − x_s) + x_s + shift and v_N = G
v_0.

x_0 and v_0 are unknown. G turns the motion by the heading's change of a stride, or mirrors it (half
a stride, left and right exchanged); x_s is the pose that the problem starts its search from: the
mirror's plane goes through it, and the turn is about it, before the shift, which itself lies along
the arc. Every residual FD_0 … FD_{N−1} is there once, and what follows from the last state is what
followed from the first.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from octo.checks import number, owned, positive
from octo.errors import MirrorError, ProblemError, ValueRangeError, said
from octo.model.character import Character
from octo.model.element import tied_to_the_world
from octo.model.mirror import Mirror, mirror_of

if TYPE_CHECKING:
    from octo.problem.problem import Problem

Array = NDArray[np.float64]
TIME_STEP = 0.025  # s, near which a cycle's own step is chosen
GRAVITY = 9.81  # m/s², only of scales
SLOWEST = 5.0  # √(ℓ/g), of a stride that goes nowhere
# strides of least work were within this factor of ``usual_period``: .5 and .58 s, .6 and .57, 1.0
# and 1.2
AROUND = 1.4
PERIODS = 5  # that a range is tried at, in equal ratios
WHOLE = 1e-6  # of a step: how far a period may be from a whole number of them
LEVEL = 1e-9  # of the normal's length: what counts as a plane without slope


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
                    "(shortest, "
                    "longest)"
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
                "or an "
                "octo.Mirror"
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
    def duration(self) -> float:
        """s, of what is solved for: the period, half of it where mirrored; of a range its geometric
        middle."""
        period = (
            np.sqrt(self.period[0] * self.period[1])
            if isinstance(self.period, tuple)
            else self.period
        )
        return float(period) / (2.0 if self.mirrored else 1.0)

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
            return self.shift / (self.duration * (2.0 if self.mirrored else 1.0))
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
                "has a "
                "dt of its own"
            )
        if dt <= 0.0:
            longest = max(self.periods) / (2.0 if self.mirrored else 1.0)
            steps = steps or max(8, round(longest / TIME_STEP))
            return steps, self.duration / steps
        exact = self.duration / dt
        wanted = steps or max(1, round(exact))
        if abs(exact - wanted) > WHOLE * max(exact, 1.0):
            near = wanted * dt * (2.0 if self.mirrored else 1.0)
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


@dataclass(frozen=True, eq=False)
class Closure:
    """How a cycle closes: x_N = forward x_0 + forward_constant, and back x_0 = matrix x_N +
    constant; (n, n) and (n,)."""

    forward: Array
    forward_constant: Array
    matrix: Array
    constant: Array
    held: Array  # (n,) 1 for the coordinates of x_N that say where the motion takes place
    mirror: Mirror | None  # of the robot, where it has one
    mirrored: bool

    @classmethod
    def of(
        cls,
        forward: Array,
        forward_constant: Array,
        held: Array,
        mirror: Mirror | None,
        mirrored: bool,
    ) -> Closure:
        matrix: Array = np.linalg.inv(forward).astype(float)
        return cls(
            forward, forward_constant, matrix, -matrix @ forward_constant, held, mirror, mirrored
        )

    def along(self, start: Array, steps: int) -> Array:
        """x_{-1} … x_N (N+2, n) on the straight way from ``start`` to where the cycle carries
        it."""
        part = np.arange(-1, steps + 1)[:, None] / steps
        return np.asarray(start + part * (self.forward @ start + self.forward_constant - start))


def closure_of(problem: Problem, cycle: Cycle) -> Closure:
    """The closure of a problem's cycle. What can be refused is refused before a start is looked
    for.

    Raises
    ------
    ProblemError: no floating base, no actuator, a ground or a gravity that is not the same after
        the stride.
    MirrorError: no mirror.
    """
    robot = problem.character
    if robot is None:
        raise ProblemError(
            "cycle needs a robot: user-written dynamics have no base that a stride could carry on"
        )
    if robot.base != "floating":
        raise ProblemError(
            f"cycle needs a floating base, robot {robot.name!r} is fixed: try base='floating'"
        )
    if robot.nu == 0:
        raise ProblemError(f"cycle needs an actuator, robot {robot.name!r} has none")
    moving = {body.name for body, path in zip(robot.bodies, robot.path, strict=True) if path}
    tied = tied_to_the_world(robot.elements, moving)
    if tied:
        raise ProblemError(
            f"a cycle goes on and on: element {tied[0]} must not hold robot {robot.name!r} to the "
            "world"
        )
    values = dict(zip(problem.dynamics.layout.names, problem.p.tolist(), strict=True))
    first = robot.base_coordinate
    normal = plane_normal(problem)
    across = abs(normal[1]) > LEVEL or abs(values.get("gravity_y", 0.0)) > LEVEL
    sloped = across or abs(normal[0]) > LEVEL or abs(values.get("gravity_x", 0.0)) > LEVEL
    if cycle.mirrored and across:
        raise ProblemError(
            "a mirrored cycle needs a ground that rises along the stride only: give mirror=False"
        )
    if cycle.turn != 0.0 and sloped:
        raise ProblemError(
            "a turning cycle needs level ground: on a slope the stride after it is another one"
        )
    forward, mirror = np.eye(robot.nx), _mirror(robot, cycle)
    start, constant = problem.start, np.zeros(robot.nx)
    heading = 0.0 if cycle.mirrored else float(start[first + 3])
    step = along_arc(
        np.array([cycle.velocity, cycle.sideways]), cycle.turn, cycle.duration, heading
    )
    if mirror is not None and cycle.mirrored:
        forward, constant = mirror.matrix.copy(), mirror.offset.copy()
        place = np.zeros(robot.nx)
        # the mirror's plane goes through x_s
        place[first + 1], place[first + 3] = start[first + 1], start[first + 3]
        if abs(place[first + 3]) > LEVEL:
            raise ProblemError(
                f"the start has a heading of {place[first + 3]:g} rad: a mirrored cycle goes along "
                "x, must be 0"
            )
        constant = constant + place - forward @ place
    elif cycle.turn != 0.0:
        c, s = np.cos(cycle.turn), np.sin(cycle.turn)
        forward[first : first + 2, first : first + 2] = [[c, -s], [s, c]]
        middle = start[first : first + 2]
        constant[first : first + 2] = (
            middle - forward[first : first + 2, first : first + 2] @ middle
        )
        constant[first + 3] = cycle.turn
    constant[first : first + 2] += step
    constant[first + 2] -= (normal[0] * step[0] + normal[1] * step[1]) / normal[2]
    held = np.zeros(robot.nx)
    held[first] = 1.0  # on an arc x and y together say how far its middle is
    # the mirror's plane holds y and yaw; without it a sideways walk would turn and walk forward
    if not cycle.mirrored:
        held[first + 1] = held[first + 3] = 1.0
    return Closure.of(forward, constant, held, mirror, cycle.mirrored)


def _mirror(robot: Character, cycle: Cycle) -> Mirror | None:
    """The mirror of a robot; one that has none may do without where the cycle is not mirrored.

    Raises
    ------
    MirrorError: a mirrored cycle of a robot that has no mirror. ProblemError: the mirror of another
        robot.
    """
    if isinstance(cycle.mirror, Mirror):
        if cycle.mirror.matrix.shape != (robot.nx, robot.nx):
            count = len(cycle.mirror.offset)
            raise ProblemError(
                f"cycle.mirror is of a robot with {count} coordinates, {robot.name!r} has "
                f"{robot.nx}"
            )
        return cycle.mirror
    if isinstance(cycle.mirror, Mapping):
        return mirror_of(robot, cycle.mirror)
    try:
        return _own_mirror(robot)
    except MirrorError:
        if cycle.mirrored:
            raise
        return None


@lru_cache(maxsize=64)
def _own_mirror(robot: Character) -> Mirror:
    return mirror_of(robot)


def along_arc(velocity: Array, turn: float, duration: float, heading: float = 0.0) -> Array:
    """(2,) m, where a steady velocity (2,) m/s in the body's axes leads while the heading changes
    by ``turn`` rad.

    heading: rad, where it begins.
    """
    along = np.asarray(velocity, dtype=float) * duration
    if abs(turn) < 1e-9:
        a, b = 1.0, 0.0
    else:
        a, b = np.sin(turn) / turn, (1.0 - np.cos(turn)) / turn
    c, s = np.cos(heading), np.sin(heading)
    return np.asarray(np.array([[c, -s], [s, c]]) @ np.array([[a, -b], [b, a]]) @ along)


def plane_normal(problem: Problem) -> Array:
    """(3,) of the plane that a cycle walks on.

    Raises
    ------
    ProblemError: the ground is no plane.
    """
    from octo.model.terrain import Plane

    if not isinstance(problem.terrain or Plane(), Plane):
        raise ProblemError(
            "a cycle needs ground that is the same everywhere: terrain must be an octo.Plane"
        )
    values = dict(zip(problem.dynamics.layout.names, problem.p.tolist(), strict=True))
    found = np.array([values.get(f"terrain.normal_{axis}", 0.0) for axis in "xyz"])
    return found if found.any() else np.array([0.0, 0.0, 1.0])
