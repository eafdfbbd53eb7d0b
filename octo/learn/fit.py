"""What a transition was made for: robot, basis, time, and what its numbers are in parts of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from octo.checks import Array
from octo.errors import ProblemError, ShapeError, UnknownNameError, ValueRangeError, said
from octo.library import Library
from octo.library.commands import flat, numbers_of
from octo.model.archive import Archive
from octo.model.character import Character
from octo.problem.basis import Hermite
from octo.problem.problem import Problem

SAME = 1e-9  # relative, of the seconds of a transition


def _none() -> Array:
    return np.zeros(0)


@dataclass(frozen=True, eq=False)
class Fit:
    """What a transition was made for.

    Attributes
    ----------
    robot: its name, "custom" of user-written dynamics. basis: "nodes" or "hermite".
    seconds: of one transition. heading: coordinates x, y and yaw of a floating base, if any.
    size: (nx,) m or rad, one of each coordinate for the network. center: (nx,) where it is zero.
    command_size, command_center: (G,) the same of the numbers of the command, in its own units.
    """

    robot: str
    basis: str
    seconds: float
    heading: tuple[int, int, int] | None
    size: Array
    center: Array
    command_size: Array = field(default_factory=_none)
    command_center: Array = field(default_factory=_none)

    def __str__(self) -> str:
        return f"for {self.robot} in {self.basis} of {self.seconds:.4g} s"

    @property
    def n(self) -> int:
        return len(self.size)

    @classmethod
    def of(cls, given: Problem | Library, command: Sequence[str] = ()) -> Fit:
        """Of the controls of a problem, with its start as the center; or of those of a library's
        motions, with commands in parts of how much they differ.

        Raises
        ------
        ProblemError: the state of objects beside the robot, which have places of their own.
        UnknownNameError: there is no such command.
        """
        if isinstance(given, Library):
            return cls._of_library(given, command)
        told, start = command_of(given, command), np.array(given.start)
        of_basis = given.basis_object.name, seconds_of(given)
        plain = cls._of_robot(given.character, *of_basis, given.length, start)
        return replace(plain, command_size=np.ones(len(told)), command_center=told)

    @classmethod
    def _of_library(cls, library: Library, command: Sequence[str]) -> Fit:
        first, told = library[0], commands_in(library, command)
        q = 1
        if first.basis == Hermite.name:
            q = first.steps // (len(first.unknowns) - 1)
        of_basis = first.basis, q * first.dt
        plain = cls._of_robot(first.character, *of_basis, first.length, first.x[1].copy())
        spread = told.std(axis=0)
        size = np.where(spread > 0.0, spread, 1.0)
        return replace(plain, command_size=size, command_center=told.mean(axis=0))

    @classmethod
    def _of_robot(
        cls, robot: Character | None, basis: str, seconds: float, length: float, center: Array
    ) -> Fit:
        """Without a command; ``length``: ℓ, m."""
        size, heading = np.ones(len(center)), None
        if robot is not None:
            size[[joint.kind == "slide" for joint in robot.joints]] = length
            if robot.base == "floating" and not robot.objects:
                first = robot.base_coordinate
                heading = first, first + 1, first + 3
        name = "custom" if robot is None else robot.name
        return cls(name, basis, seconds, heading, size, center)

    @property
    def plainly(self) -> Fit:
        """Without a command."""
        return replace(self, command_size=_none(), command_center=_none())

    def check(self, problem: Problem) -> None:
        """Raises
        ------
        ProblemError, ShapeError: the problem's is another one."""
        other = Fit.of(problem)
        for name, own, its in (
            ("robot", self.robot, other.robot),
            ("basis", self.basis, other.basis),
        ):
            if own != its:
                raise ProblemError(f"the transition's {name} is {own!r}, the problem's is {its!r}")
        if self.n != other.n:
            raise ShapeError("the problem's x", (other.n,), f"the transition's ({self.n},)")
        if abs(self.seconds - other.seconds) > SAME * self.seconds:
            raise ProblemError(
                f"the transition is of {self.seconds:.6g} s, from one control of the problem to "
                f"the next it is {other.seconds:.6g} s"
            )

    def plain(self) -> dict[str, Any]:
        """For files, without the arrays."""
        own = {name: getattr(self, name) for name in ("robot", "basis", "seconds")}
        return {**own, "heading": None if self.heading is None else list(self.heading)}

    @classmethod
    def read(cls, file: Archive) -> Fit:
        """Raises
        ------
        ValueRangeError, ShapeError: what stands there is no such thing."""
        size = file.array("size", (None,))
        heading = file.plain.get("heading")
        legal = isinstance(heading, list) and len(heading) == 3
        if heading is not None and not (legal and all(k in range(len(size)) for k in heading)):
            raise ValueRangeError(f"heading is {said(heading)}, must be three coordinates")
        if not (size > 0.0).all():
            raise ValueRangeError("size has a number that is not positive")
        made = None if heading is None else (int(heading[0]), int(heading[1]), int(heading[2]))
        own = file.word("robot"), file.word("basis"), file.number("seconds", positive=True), made
        sizes = size, file.array("center", size.shape)
        if "command_size" not in file.arrays:  # of an earlier version, or without a command
            return cls(*own, *sizes)
        command = file.array("command_size", (None,))
        if not (command > 0.0).all():
            raise ValueRangeError("command_size has a number that is not positive")
        return cls(*own, *sizes, command, file.array("command_center", command.shape))

    @property
    def arrays(self) -> dict[str, Array]:
        """For files."""
        names = ("size", "center", "command_size", "command_center")
        return {name: getattr(self, name) for name in names}


def seconds_of(problem: Problem) -> float:
    """s, from one control to the next."""
    basis = problem.basis_object
    return float(problem.dt) * (basis.steps_per_segment if isinstance(basis, Hermite) else 1)


def command_of(problem: Problem, names: Sequence[str]) -> Array:
    """(G,) the numbers of a problem of these names, one behind the other.

    Raises
    ------
    UnknownNameError: the problem has none of this name. ShapeError: it differs from step to step.
    """
    if not names:
        return _none()
    told = numbers_of(problem)
    for name in names:
        if name not in told:
            raise UnknownNameError("the problem's command", name, told)
        if told[name].ndim > 1:
            raise ShapeError(f"the command {name}", told[name].shape, "one for all steps")
    return flat([told[name] for name in names])


def commands_in(library: Library, names: Sequence[str]) -> Array:
    """(M, G) the same of the motions of a library.

    Raises
    ------
    UnknownNameError: its problems do not differ in one of this name. ShapeError: as above.
    """
    for name in names:
        if name not in library.commands:
            raise UnknownNameError("the library's command", name, library.commands)
        if library.commands[name].ndim > 2:
            shape = library.commands[name].shape[1:]
            raise ShapeError(f"the command {name}", shape, "one for all steps")
    return np.array(
        [flat([library.commands[name][k] for name in names]) for k in range(len(library))]
    )
