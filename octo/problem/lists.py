"""The lists of terms that a Problem is given, checked: costs, and constraints, a cost among which
means its hard form."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from octo.checks import Array
from octo.errors import ProblemError, said
from octo.problem.at import check_at
from octo.problem.constraints import Constraint
from octo.problem.costs import Cost, SizedCost


def costs_of(given: Any) -> tuple[Cost, ...]:
    """The terms of E.

    Raises
    ------
    ProblemError: it is no list of terms, is empty, or has two of one name.
    """
    terms = _listed("costs", given, (Cost,), "octo.Cost objects")
    if not terms:
        raise ProblemError("costs is empty: give at least one term, for example octo.Effort()")
    for term in terms:
        check_at(f"{term.label}.at", term.at)
    return terms


def sized(costs: Sequence[Cost], length: float, times: Array) -> tuple[Cost, ...]:
    """Terms of E with those of a robot of ``length`` ℓ (m), at ``times`` (N,) s, in the place of
    those that waited for it."""
    return tuple(one.sized(length, times) if isinstance(one, SizedCost) else one for one in costs)


def constraints_of(given: Any) -> tuple[Constraint, ...]:
    """What must hold.

    Raises
    ------
    ProblemError: it is no list of constraints, has two of one name, or a term that has no hard
        form.
    """
    kinds = "octo.Constraint or octo.Cost objects"
    terms = _listed("constraints", given, (Constraint, Cost), kinds)
    return tuple(term.hard() if isinstance(term, Cost) else term for term in terms)


def _listed(name: str, given: Any, kinds: tuple[type, ...], words: str) -> tuple[Any, ...]:
    """A list of terms of some kinds, no two of one name."""
    if not isinstance(given, Sequence) or isinstance(given, str):
        raise ProblemError(f"{name} is {said(given)}, must be a list of {words}")
    for term in given:
        if not isinstance(term, kinds):
            raise ProblemError(f"{name} holds {said(term)}, must hold {words} only")
    labels = [term.label for term in given]
    twice = sorted({label for label in labels if labels.count(label) > 1})
    if twice:
        raise ProblemError(f"{name} has two terms named {twice[0]!r}: give one of them name='…'")
    return tuple(given)
