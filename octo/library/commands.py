"""What problems are told, as numbers by name, and in which of them several problems differ."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from octo.checks import Array, numbers
from octo.errors import OctoError, ProblemError, ShapeError
from octo.problem.phases import Phases
from octo.problem.problem import Problem
from octo.problem.terms import Term


def numbers_of(problem: Problem) -> dict[str, Array]:
    """All that a problem is told in numbers: fields of its terms as "label.field", parameters of
    the dynamics by their names ("dt" too), and the states "x0", "v0" and "x_end"."""
    found = {"x0": problem.start, "v0": problem.start_velocity}
    if problem.end is not None:
        found["x_end"] = problem.end
        found["v_end"] = np.zeros_like(problem.end) if problem.v_end is None else problem.v_end
    found |= {name: np.asarray(value, dtype=float) for name, value in problem.values.items()}
    for term in (*problem.costs, *problem.constraints):
        found |= {f"{term.label}.{name}": value for name, value in _of_term(term)}
    return found


def _of_term(term: Term) -> Iterator[tuple[str, Array]]:
    for each in fields(term):
        value = getattr(term, each.name)
        for name, own in value.items() if isinstance(value, Mapping) else ((each.name, value),):
            found = _plain(own)
            if found is not None:
                yield name, found


def _plain(value: Any) -> Array | None:
    """A number or numbers as an array; None of anything else."""
    if value is None or isinstance(value, (bool, str)) or callable(value):
        return None
    try:
        return numbers("value", value)
    except OctoError:
        return None


def commands_of(problems: Sequence[Problem]) -> dict[str, Array]:
    """The numbers in which problems differ, by name: (problems, …) each.

    Raises
    ------
    ShapeError: of two problems one has more numbers of a name than the other.
    """
    told = [numbers_of(problem) for problem in problems]
    found = {}
    for name, first in told[0].items():
        rows = [own.get(name) for own in told]
        known = [row for row in rows if row is not None]
        if len(known) < len(rows):
            continue
        for k, row in enumerate(known):
            if row.shape != first.shape:
                raise ShapeError(
                    f"{name} of problem {k}", row.shape, f"{first.shape}, of problem 0"
                )
        table = np.stack(known)
        if (table != table[0]).any():
            found[name] = table
    return found


def flat(values: Sequence[Array]) -> Array:
    """(size,) of arrays of any shape, one behind the other."""
    return np.concatenate([np.ravel(value) for value in values]) if values else np.zeros(0)


def check_plain(problems: Sequence[Any]) -> list[Problem]:
    """Problems that a library can hold.

    Raises
    ------
    ProblemError: something else is among them.
    """
    if isinstance(problems, (Problem, Phases)) or not isinstance(problems, (list, tuple)):
        raise ProblemError("octo.library was not given a list of octo.Problem: give [problem, …]")
    for k, problem in enumerate(problems):
        if not isinstance(problem, Problem):
            raise ProblemError(f"problem {k} is {_kind(problem)}, must be an octo.Problem")
        if problem.cycle is not None and isinstance(problem.cycle.period, tuple):
            raise ProblemError(
                f"problem {k} is a cycle with a range of periods, must have one period"
            )
    if not problems:
        raise ProblemError("the list of problems is empty, must hold one at least")
    return list(problems)


def _kind(value: object) -> str:
    name = type(value).__name__
    return f"{'an' if name[0].lower() in 'aeiou' else 'a'} {name}"
