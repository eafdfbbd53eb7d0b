"""A library: motions with what was asked of each."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array, ending, numbers
from octo.errors import ProblemError, ShapeError, UnknownNameError, said
from octo.library import store
from octo.library.commands import flat, numbers_of
from octo.problem.problem import Problem
from octo.result.solution import Solution
from octo.shown import Shown


@dataclass(frozen=True, eq=False, repr=False)
class Library(Shown):
    """Motions of one structure, M of them, with what was asked of each.

    Attributes
    ----------
    motions: Solutions, in the order of the problems.
    commands: by name the numbers in which the problems differ, (M, …) each: fields of terms as
        "CenterOfMassVelocity.velocity", parameters of the dynamics as "contact.w_perp", "x0", "v0",
        "x_end".
    problems: (M,) which of the problems each is of, counted from 0: all of them in order, unless
        Ctrl-C left some out.
    gains: (M, N, nu, 2 nx) of :func:`octo.gains`, NaN of motions that are not finite; None where
        nobody asked for them.
    interrupted: whether Ctrl-C left problems out.
    """

    motions: tuple[Solution, ...]
    commands: Mapping[str, Array]
    problems: NDArray[np.intp]
    gains: Array | None = None
    interrupted: bool = False

    def __len__(self) -> int:
        return len(self.motions)

    def __iter__(self) -> Iterator[Solution]:
        return iter(self.motions)

    def __getitem__(self, k: int) -> Solution:
        return self.motions[k]

    def __str__(self) -> str:
        first, statuses = self.motions[0], Counter(m.status.label for m in self.motions)
        counts = ", ".join(f"{count} {name}" for name, count in statuses.most_common())
        told = ", ".join(f"{name} {_range(own)}" for name, own in self.commands.items())
        rest = ", interrupted" if self.interrupted else ""
        return "\n".join(
            [
                f"library of {len(self)} motions of {first.name}, {first.sampling} ({first.basis})"
                f"{rest}",
                f"  {self.share:.0%} converged: {counts}",
                f"  differ in {told or 'nothing'}",
                f"  {self.seconds:.1f} s of processor time, {int(self.iterations.sum())} "
                f"iterations{'' if self.gains is None else ', with gains'}",
            ]
        )

    # -- as arrays ---------------------------------------------------------------------------------

    @property
    def x(self) -> Array:
        """(M, N+2, nx) rad and m, x_{-1}, x_0 … x_N."""
        return np.stack([motion.x for motion in self.motions])

    @property
    def v(self) -> Array:
        """(M, N+1, nx) rad/s and m/s, at x_0 … x_N."""
        return np.stack([motion.v for motion in self.motions])

    @property
    def u(self) -> Array:
        """(M, N, nu) N m or N."""
        return np.stack([motion.u for motion in self.motions])

    @property
    def converged(self) -> NDArray[np.bool_]:
        """(M,) whether each solve ended at a result."""
        return np.array([motion.converged for motion in self.motions])

    @property
    def share(self) -> float:
        """Of the motions that converged."""
        return float(self.converged.mean())

    @property
    def iterations(self) -> NDArray[np.intp]:
        """(M,) of each solve, all passes."""
        return np.array([motion.iterations for motion in self.motions])

    @property
    def seconds(self) -> float:
        """s of processor time, of all solves; of a batch each has its share."""
        return float(sum(motion.processor_seconds for motion in self.motions))

    @cached_property
    def _told(self) -> Array:
        """(M, size) the commands, each number in parts of how much it differs."""
        table = np.stack([self._flat(k) for k in range(len(self))])
        return table / self._spread

    @cached_property
    def _spread(self) -> Array:
        table = np.stack([self._flat(k) for k in range(len(self))])
        with np.errstate(over="ignore"):  # of numbers as large as can be
            spread = table.std(axis=0)
        return np.where(spread > 0.0, spread, 1.0)

    def _flat(self, k: int) -> Array:
        return flat([own[k] for own in self.commands.values()])

    # -- found again -------------------------------------------------------------------------------

    def command(self, k: int) -> dict[str, Array]:
        """What was asked of motion k, by name."""
        return {name: own[k] for name, own in self.commands.items()}

    def order(self, command: Problem | Mapping[str, Any]) -> NDArray[np.intp]:
        """(converged,) the converged motions, those first of whom most nearly the same was asked:
        by the distance of the commands, each number in parts of its standard deviation.

        Parameters
        ----------
        command: a problem, or numbers by name; what is left out does not count.

        Raises
        ------
        OctoError: there is no such command, or it has another shape; or no motion converged.
        """
        wanted = self._wanted(command)
        good = np.flatnonzero(self.converged)
        if not len(good):
            raise ProblemError("no motion of the library converged: there is none to be near")
        off = (self._told[good] - wanted / self._spread) ** 2
        return good[np.argsort(np.nansum(off, axis=1), kind="stable")]

    def nearest(self, command: Problem | Mapping[str, Any]) -> Solution:
        """The first of :meth:`order`: a start for a problem that the library does not hold.

        Parameters
        ----------
        command: a problem, or numbers by name; what is left out does not count.

        Raises
        ------
        OctoError: there is no such command, or it has another shape; or no motion converged.
        """
        return self.motions[int(self.order(command)[0])]

    def _wanted(self, command: Problem | Mapping[str, Any]) -> Array:
        """(size,) of a command; NaN where nothing is said."""
        if isinstance(command, Problem):
            told: Mapping[str, Any] = numbers_of(command)
            left = [name for name in self.commands if name not in told]
            if left:
                raise UnknownNameError("command of the problem", left[0], told)
        elif isinstance(command, Mapping):
            told = command
            for name in told:
                if name not in self.commands:
                    raise UnknownNameError("command", name, self.commands)
        else:
            raise ProblemError(
                f"command is {said(command)}, must be an octo.Problem or numbers by name"
            )
        found = []
        for name, own in self.commands.items():
            if name not in told:
                found.append(np.full(own.shape[1:], np.nan))
                continue
            value = numbers(name, told[name])
            if value.shape != own.shape[1:]:
                raise ShapeError(name, value.shape, own.shape[1:])
            found.append(value)
        return flat(found)

    # -- files -------------------------------------------------------------------------------------

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an .npz file, which ``numpy.load`` reads without pickle: ``x`` (M, N+2, nx), ``v``
        (M, N+1, nx), ``u`` (M, N, nu), ``contact_force``, ``contact_point`` (M, N, c, 3), ``terms``
        (M, terms) of the names ``term_names``, ``status``, ``converged``, ``iterations`` and
        ``problems`` (M,), ``command_…`` (M, …), ``gains`` (M, N, nu, 2 nx) where there are any; and
        what makes Solutions of it again.

        Raises
        ------
        OutputError: the path does not end in .npz, or cannot be written.
        """
        store.write(ending("path", path, (".npz",)), vars(self))

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Library:
        """Read a library that :meth:`save` wrote.

        Raises
        ------
        RobotFileError: the file is missing, or something in it is not as octo writes it.
        """
        return Library(**store.read(path))


def joined(parts: list[Library], commands: Mapping[str, Array], count: int) -> Library:
    """One library of several, of ``count`` problems with ``commands`` (count, …)."""
    problems = np.concatenate([part.problems for part in parts])
    order = np.argsort(problems)
    motions = [motion for part in parts for motion in part.motions]
    found = [part.gains for part in parts if part.gains is not None]
    return Library(
        tuple(motions[k] for k in order),
        {name: own[problems[order]] for name, own in commands.items()},
        problems[order],
        np.concatenate(found)[order] if found else None,
        interrupted=len(problems) < count,
    )


def _range(values: Array) -> str:
    """The least and the largest of each number that differs, in words."""
    table = values.reshape(len(values), -1)
    lows, highs = table.min(axis=0), table.max(axis=0)
    differ = np.flatnonzero(lows != highs)
    said = [f"{lows[j]:.3g}…{highs[j]:.3g}" for j in differ[:3]]
    return ", ".join(said) + (", …" if len(differ) > 3 else "")
