"""Constraints that are ready to use: limits of motors, joints and steps, of the base, and of what a
foot can hold.

Rows over torques, speeds and steps are in parts of their limits, forces in parts of mg, the others
in rad and m.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo.checks import floats, number, numbers, positive
from octo.errors import ProblemError, ShapeError, ValueRangeError
from octo.model.character import Character
from octo.model.feet import chosen_contacts
from octo.problem.constraints import Constraint
from octo.problem.terms import Row

if TYPE_CHECKING:
    from octo.problem.symbols import Setting, StepSymbols

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
SPEED = ("rad/s", "m/s")
PLACE = ("rad", "m")
TORQUE = ("N m", "N")


@dataclass(frozen=True, eq=False)
class _Symmetric(Constraint):
    """Values of coordinates within ± a limit, in parts of it; those without a limit have no row."""

    units: ClassVar[tuple[str, str]]  # of hinges and slides

    def _limit(self, robot: Character | None, count: int) -> Array:
        """(count,) the limits, infinite where there is none."""
        raise NotImplementedError

    def _value(self, step: StepSymbols) -> ca.SX:
        """(count,) what is limited."""
        raise NotImplementedError

    def _coordinates(self, setting: Setting) -> Indices:
        """(count,) indices into x of what is limited."""
        return setting.actuated

    def limits(self, setting: Setting) -> Array:
        """(count,) of all values, infinite where there is none."""
        return self._limit(setting.character, len(self._coordinates(setting)))

    def _limited(self, robot: Character | None, count: int) -> tuple[Indices, Array, Array]:
        """Which (rows,) of ``count`` have a limit, these, and what the rows are in parts of: the
        limit, or 1 where that is zero."""
        limit = self._limit(robot, count)
        if not np.isfinite(limit).any():
            raise ProblemError(
                f"{self.label} has no limit: all are infinite, give at least one that is finite"
            )
        chosen = np.flatnonzero(np.isfinite(limit))
        return chosen, limit[chosen], np.where(limit > 0.0, limit, 1.0)[chosen]

    def _given(self, name: str, count: int) -> Array:
        """(count,) of a field of limits: a number, or one each."""
        field, found = f"{self.label}.{name}", floats(f"{self.label}.{name}", getattr(self, name))
        if found.shape not in ((), (count,)):
            raise ShapeError(field, found.shape, f"() or ({count},)")
        if not (found >= 0.0).all():
            raise ValueRangeError(f"{field} has {found.min():g}, must be numbers ≥ 0")
        return np.asarray(np.broadcast_to(found, (count,)))

    def references(self, setting: Setting) -> Mapping[str, Any]:
        size = self._limited(setting.character, len(self._coordinates(setting)))[2]
        return {"inverse_size": 1.0 / size}

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        value = self._value(step)
        chosen = self._limited(step.character, value.numel())[0]
        return value[[int(k) for k in chosen]] * p["inverse_size"]

    def bounds(self, setting: Setting) -> tuple[Any, Any]:
        _, limit, size = self._limited(setting.character, len(self._coordinates(setting)))
        return -limit / size, limit / size

    def rows(self, setting: Setting) -> Sequence[Row]:
        own, robot = self._coordinates(setting), setting.character
        chosen, _, size = self._limited(robot, len(own))
        words = [in_words(robot, int(own[k]), self.units, setting.names) for k in chosen]
        if robot is None and setting.names is None and self.units == TORQUE:
            words = [(f"u{k}", "") for k in chosen]
        return [Row(*each, float(one)) for each, one in zip(words, size, strict=True)]


def in_words(
    robot: Character | None,
    coordinate: int,
    units: tuple[str, str],
    names: Sequence[str] | None = None,
) -> tuple[str, str]:
    """Name of a coordinate, and its unit of the two for hinges and for slides; of other dynamics
    one of ``names``, where they have any."""
    if names is not None:
        return names[coordinate], ""
    if robot is None:
        return f"x{coordinate}", ""
    joint = robot.joints[coordinate]
    return f"joint {joint.name!r}", units[0] if joint.kind == "hinge" else units[1]


@dataclass(frozen=True, eq=False)
class _OfTheFile(_Symmetric):
    """Limits that a robot's file says, or ``limit``; within ``margin`` times them."""

    limit: Any = None
    margin: float = 1.0

    def _in_file(self, robot: Character) -> Array:
        """(nu,) infinite where the file says none."""
        raise NotImplementedError

    def _limit(self, robot: Character | None, count: int) -> Array:
        if self.limit is not None:
            found = self._given("limit", count)
        else:
            found = np.full(count, np.inf) if robot is None else self._in_file(robot)
            if not np.isfinite(found).any():
                who = "user-written dynamics have" if robot is None else f"{robot.name!r} has"
                raise ProblemError(
                    f"{self.label} has no limit: {who} none, give limit=…, a number or ({count},)"
                )
        return positive(f"{self.label}.margin", self.margin) * found


@dataclass(frozen=True, eq=False)
class TorqueLimits(_OfTheFile):
    """|u| ≤ ``margin``·limit, of every motor that has a limit.

    Parameters
    ----------
    limit: N m or N, a number or (nu,), infinite where there is none; by default that of the robot's
        file.
    margin: what is allowed, in parts of the limit.
    """

    units: ClassVar[tuple[str, str]] = TORQUE

    def _in_file(self, robot: Character) -> Array:
        return robot.torque_limit

    def _value(self, step: StepSymbols) -> ca.SX:
        return step.u


@dataclass(frozen=True, eq=False)
class JointSpeedLimits(_OfTheFile):
    """|q̇| ≤ ``margin``·limit, of every actuated joint that has a limit.

    Parameters
    ----------
    limit: rad/s or m/s, a number or (nu,), infinite where there is none; by default that of the
        robot's file.
    margin: what is allowed, in parts of the limit.
    otherwise: rad/s or m/s, of joints whose file says no limit.
    """

    otherwise: float = np.inf
    units: ClassVar[tuple[str, str]] = SPEED

    def _in_file(self, robot: Character) -> Array:
        found = robot.velocity_limit[robot.actuated]
        return np.where(np.isfinite(found), found, self.otherwise)

    def _value(self, step: StepSymbols) -> ca.SX:
        return step.joints(step.x_next - step.x) / step.dt


@dataclass(frozen=True, eq=False)
class StepLimit(_Symmetric):
    """|x_next − x| ≤ ``largest``, of every coordinate: none leaps from one node to the next.

    Between two nodes no law of physics is looked at: a pendulum may "swing up" by π in one step
    without a torque.

    Parameters
    ----------
    largest: rad or m, a number or (nx,), infinite where there is none.
    """

    largest: Any = 0.5
    units: ClassVar[tuple[str, str]] = PLACE

    def _limit(self, robot: Character | None, count: int) -> Array:
        return self._given("largest", count)

    def _coordinates(self, setting: Setting) -> Indices:
        return np.arange(setting.nx)

    def _value(self, step: StepSymbols) -> ca.SX:
        return step.x_next - step.x


@dataclass(frozen=True, eq=False)
class JointLimits(Constraint):
    """Actuated joints (rad or m) within the limits of the robot's file.

    Parameters
    ----------
    margin: rad or m, how far inside them; at most a quarter of a joint's range.
    """

    margin: float = 0.0

    def _limits(self, robot: Character | None) -> tuple[Indices, Array, Array]:
        """Which joints (rows,) have a limit, as indices into x, and these."""
        if robot is None:
            raise ProblemError(
                f"{self.label} is asked of user-written dynamics, which have no joint limits"
            )
        lower, upper = robot.lower[robot.actuated], robot.upper[robot.actuated]
        some = np.isfinite(lower) | np.isfinite(upper)
        if not some.any():
            raise ProblemError(f"{self.label} has no limit: no joint of {robot.name!r} has one")
        return robot.actuated[some], lower[some], upper[some]

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return step.x_next[[int(j) for j in self._limits(step.character)[0]]]

    def bounds(self, setting: Setting) -> tuple[Any, Any]:
        _, lower, upper = self._limits(setting.character)
        margin = number(f"{self.label}.margin", self.margin)
        if margin < 0.0:
            raise ValueRangeError(f"{self.label}.margin is {margin:g}, must not be negative")
        inside = np.minimum(margin, 0.25 * (upper - lower))
        return lower + inside, upper - inside

    def rows(self, setting: Setting) -> Sequence[Row]:
        robot = setting.character
        return [Row(*in_words(robot, int(j), PLACE)) for j in self._limits(robot)[0]]


@dataclass(frozen=True, eq=False)
class BaseHeightRange(Constraint):
    """Height (m, world z) of a body's origin between bounds.

    Parameters
    ----------
    lower, upper: m, numbers or (N,); at least one of them is finite.
    body: by default the base.
    """

    lower: Any = -np.inf
    upper: Any = np.inf
    body: str | None = None

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return step.pose(self.body)[1][2]

    def bounds(self, setting: Setting) -> tuple[Any, Any]:
        found = [floats(f"{self.label}.{name}", getattr(self, name)) for name in ("lower", "upper")]
        rows = [value[:, None] if value.ndim == 1 else value for value in found]
        return rows[0], rows[1]

    def rows(self, setting: Setting) -> Sequence[Row]:
        return [Row("the base" if self.body is None else f"body {self.body!r}", "m")]


class _Cosine(Row):
    """A row that is the cosine of an angle, which is shown."""

    @property
    def falling(self) -> bool:
        return True

    def shown(self, value: float) -> float:
        return float(np.arccos(np.clip(value, -1.0, 1.0)))


@dataclass(frozen=True, eq=False)
class TiltLimit(Constraint):
    """The angle between a body's up and the world's stays at most ``largest``, whatever its yaw.

    Parameters
    ----------
    largest: rad, more than 0 and less than π.
    body: by default the base.
    pose: (nx,) in which the body is upright; by default the start.
    """

    largest: float = 0.5
    body: str | None = None
    pose: Any = None

    def references(self, setting: Setting) -> Mapping[str, Any]:
        pose = setting.x0 if self.pose is None else numbers(f"{self.label}.pose", self.pose)
        return {"up": setting.up(self.body, pose)}

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        return step.pose(self.body)[0][2, :] @ p["up"]

    def bounds(self, setting: Setting) -> tuple[Any, Any]:
        largest = number(f"{self.label}.largest", self.largest)
        if not 0.0 < largest < np.pi:
            raise ValueRangeError(
                f"{self.label}.largest is {largest:g} rad, must be more than 0 and less than π"
            )
        return np.cos(largest), np.inf

    def rows(self, setting: Setting) -> Sequence[Row]:
        return [_Cosine("the base" if self.body is None else f"body {self.body!r}", "rad")]


@dataclass(frozen=True, eq=False)
class FrictionCones(Constraint):
    """|f_t| ≤ ``mu``·f_n at every contact: |f_t|²/(√(|f_t|² + ε²) f) ≤ μ with f = (f_n + √(f_n² +
    4ε²))/2, forces in parts of mg.

    A contact that carries nothing is in the middle of its cone, and one that carries much uses
    |f_t|/f_n of it (to ε²/f_n²): the row is about one whatever the load, so that a solver sees how
    a foot must land. ``ROUNDING`` is ε; a foot may push ε√μ or so to the side before it carries
    anything.

    Parameters
    ----------
    mu: the coefficient of friction.
    contacts: names, or "feet", those on the ground at the start; by default all that touch the
        terrain.
    """

    mu: float = 0.6
    contacts: tuple[str, ...] | Literal["feet"] | None = field(default=None, kw_only=True)
    ROUNDING: ClassVar[float] = 1e-2  # of mg

    def placed(self, setting: Setting) -> Constraint:
        if self.contacts != "feet":
            return self
        robot = self._robot(setting.character)
        return replace(self, contacts=tuple(robot.contacts[k].name for k in setting.feet))

    def _robot(self, robot: Character | None) -> Character:
        if robot is None:
            raise ProblemError(
                f"{self.label} is over contacts, which user-written dynamics do not have"
            )
        return robot

    def _names(self, robot: Character | None) -> list[str]:
        """Of the contacts, in the robot's order."""
        own = self._robot(robot)
        chosen = chosen_contacts(own, self.contacts, ())
        if not chosen:
            raise ProblemError(
                f"{self.label} has no contacts: {own.name!r} has none there, must be at least one"
            )
        return [own.contacts[k].name for k in sorted(chosen)]

    def references(self, setting: Setting) -> Mapping[str, Any]:
        self._names(setting.character)
        return {}

    def residual(self, step: StepSymbols, p: Mapping[str, ca.SX]) -> ca.SX:
        made = []
        for name in self._names(step.character):
            contact = step.contact(name)
            across, load = ca.sumsqr(contact.tangential_force), contact.normal_force
            carried = 0.5 * (load + ca.sqrt(load**2 + 4.0 * self.ROUNDING**2))
            made.append(across / (ca.sqrt(across + self.ROUNDING**2) * carried))
        return ca.vertcat(*made)

    def bounds(self, setting: Setting) -> tuple[Any, Any]:
        mu = number(f"{self.label}.mu", self.mu)
        if mu < 0.0:
            raise ValueRangeError(f"{self.label}.mu is {mu:g}, must not be negative")
        return -np.inf, mu

    def rows(self, setting: Setting) -> Sequence[Row]:
        return [Row(f"|f_t|/f_n of contact {name!r}") for name in self._names(setting.character)]
