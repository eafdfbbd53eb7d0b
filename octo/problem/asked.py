"""What a motion was asked for, what came of it, and whether that is near enough."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np

from octo.checks import Array
from octo.model.character import Character
from octo.model.kinematics import body_poses, center_of_mass

MET = 0.1  # of what was asked: a goal is met when the motion is that near to it
EACH = 0.2  # of one of several numbers
FLOOR = 0.1  # m/s, rad/s, m or rad: no denominator of a goal's error is smaller


@dataclass(frozen=True)
class Asked:
    """One thing that was asked of a motion.

    Attributes
    ----------
    name: of the goal or the term. what: what moves, as words before the numbers.
    found, wanted: what came out and what was asked, in ``unit``.
    size: what the error is in parts of; by default the length of ``wanted``.
    each: every number of ``wanted`` that is not zero must be met on its own too, to a fifth: the
        height of a long jump.
    """

    name: str
    what: str
    found: tuple[float, ...]
    wanted: tuple[float, ...]
    unit: str
    size: float
    each: bool = False

    @classmethod
    def of(
        cls,
        name: str,
        what: str,
        found: Any,
        wanted: Any,
        unit: str,
        size: float | None = None,
        each: bool = False,
    ) -> Asked:
        """From arrays."""
        found, wanted = (
            tuple(float(v) for v in np.atleast_1d(values)) for values in (found, wanted)
        )
        length = float(np.linalg.norm(wanted)) if size is None else float(size)
        return cls(name, what, found, wanted, unit, max(length, FLOOR), each)

    @property
    def off(self) -> float:
        """How far the motion is from it, in ``unit``."""
        return float(np.linalg.norm(np.subtract(self.found, self.wanted)))

    @property
    def error(self) -> float:
        """The same in parts of what was asked (0.1 is one tenth)."""
        return self.off / self.size

    @property
    def met(self) -> bool:
        """Whether it is missed by a tenth at most."""
        return self.error <= MET and not self._short()

    def _short(self) -> list[int]:
        """Places of the numbers that are missed on their own."""
        pairs = enumerate(zip(self.found, self.wanted, strict=True))
        live = [
            (k, abs(found - wanted), abs(wanted))
            for k, (found, wanted) in pairs
            if wanted != 0.0 and self.each
        ]
        return [k for k, off, size in live if not off <= EACH * max(size, FLOOR)]

    def __str__(self) -> str:
        many, short = len(self.found) > MANY, self._short() if self.error <= MET else []
        more = "".join(
            f", and {EACH * max(abs(self.wanted[k]), FLOOR):.2g} of {self.wanted[k]:.2f}"
            for k in short
        )
        numbers = (
            ""
            if many
            else f" {in_numbers(self.found)} {self.unit}, asked for was {in_numbers(self.wanted)}"
        )
        return (
            f"{self.name} {'met' if self.met else 'missed'}: {self.what}{numbers}; off by "
            f"{self.off:.2g} {self.unit}, {MET * self.size:.2g} is allowed{more}"
        )

    def plain(self) -> dict[str, Any]:
        """For files."""
        return asdict(self)

    def report(self) -> dict[str, Any]:
        """For report.json."""
        return {**asdict(self), "error": self.error, "met": self.met}


MANY = 3  # numbers that a line may hold


def in_numbers(values: Any) -> str:
    """One number, or several in brackets, without the sign of a zero."""
    words = [f"{value:.2f}".replace("-0.00", "0.00") for value in np.atleast_1d(values)]
    return words[0] if len(words) == 1 else f"({', '.join(words)})"


@dataclass(frozen=True, eq=False)
class Motion:
    """What a term looks at to say what it was asked and what came of it.

    Attributes
    ----------
    x: (N+1, nx) rad and m, x_0 … x_N. dt: s. character: None for user-written dynamics.
    weights: (N,) the term's own, of x_1 … x_N.
    """

    x: Array
    dt: float
    character: Character | None
    weights: Array

    @property
    def last(self) -> int:
        """The last node at which the term weighs, counted from x_0."""
        live = np.flatnonzero(self.weights > 0.0)
        return int(live[-1]) + 1 if live.size else len(self.x) - 1

    @cached_property
    def com(self) -> Array:
        """(N+1, 3) m, centre of mass."""
        return center_of_mass(self._robot, self.x)

    def pose(self, body: str | None) -> tuple[Array, Array]:
        """Rotation (N+1, 3, 3) and position (N+1, 3) m of a body, by default the base."""
        rotation, position = self._poses
        k = self._robot.base_body if body is None else self._robot.body_index(body)
        return rotation[:, k], position[:, k]

    @cached_property
    def _poses(self) -> tuple[Array, Array]:
        return body_poses(self._robot, self.x)

    @property
    def _robot(self) -> Character:
        assert self.character is not None  # a term over bodies was refused before
        return self.character

    @staticmethod
    def called(body: str | None) -> str:
        """A body in a sentence."""
        return "the base" if body is None else f"body {body!r}"

    def mean(self, values: Array) -> Array:
        """(k,) of rows (N, k) at x_1 … x_N, weighed; or of one row for all."""
        rows = np.broadcast_to(values, (len(self.weights), np.shape(values)[-1]))
        return np.asarray(np.average(rows, axis=0, weights=self.weights))

    def row(self, values: Any) -> Array:
        """The row (k,) of rows for each step, or of one for all, at the last node."""
        array = np.asarray(values, dtype=float)
        return np.asarray(array[self.last - 1] if array.ndim == 2 else array)
