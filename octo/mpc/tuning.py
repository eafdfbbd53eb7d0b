"""What may change in a compiled problem between two plans: references, weights, parameters."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping
from typing import Any

from octo.checks import number, one_of
from octo.errors import ProblemError, UnknownNameError, ValueRangeError
from octo.model.quantities import Array
from octo.problem.compiled import CompiledProblem
from octo.problem.costs import Cost
from octo.problem.problem import Problem
from octo.problem.references import References, coefficients
from octo.problem.structure import Reader, same

Widths = list[tuple[str, int]]


class Tuning:
    """The numbers of a compiled problem of one member, by the names of its terms and fields. The
    scales of its terms stay those of ``problem``, from which it was compiled."""

    def __init__(self, compiled: CompiledProblem, problem: Problem):
        self._compiled, self._layout = compiled, problem.dynamics.layout
        self._labels = [term.label for term in problem.costs]
        self._setting, self._reader = problem.setting, Reader(problem)
        self._scales = [term.scale(self._setting) for term in problem.costs]
        self._views: dict[tuple[str, str], Array] = {}
        # by place: a term, its fields that its residual was built from, sizes of its references
        self._read: dict[int, tuple[Cost, frozenset[str], Widths]] = {}

    def reference(self, label: str, name: str) -> Array:
        """(N, size) of a term's references, to be written in place."""
        view = self._views.get((label, name))
        if view is None:
            places = self._place(label)[1]
            if name not in places:
                raise UnknownNameError(f"reference of {label}", name, places)
            view = self._views[label, name] = self._compiled.q[0][:, places[name]]
        return view

    def _place(self, label: str) -> tuple[int, dict[str, slice]]:
        table = self._compiled.functions.references
        if label not in self._labels:
            raise UnknownNameError("term", label, self._labels)
        k = self._labels.index(label)
        return k, table.places[k]

    def update(self, problem: Problem, label: str, values: Mapping[str, Any]) -> Problem:
        """Change fields of a term; the problem with the numbers that it has now.

        Raises
        ------
        UnknownNameError: no such term or field. ProblemError: a field that is compiled, or one that
            only scales E. ShapeError, ValueRangeError: what the term refuses.
        """
        k, places = self._place(label)
        term, setting, q = problem.costs[k], self._setting, self._compiled.q[0]
        fields = [f.name for f in dataclasses.fields(term) if f.init]
        for name in values:
            if name not in fields:
                raise UnknownNameError(f"field of {label}", name, fields)
        changed = self._changed(k, term, values)
        table = self._compiled.functions.references
        scratch = dataclasses.replace(table, terms=(changed,), places=(places,))
        packed = scratch.pack([changed], setting)
        for place in places.values():
            q[:, place] = packed[:, place]
        if not {"weight", "at", "steps"}.isdisjoint(values):
            q[:, k] = coefficients(changed, setting, self._scales[k])
        return _with(problem, k, changed)

    def _changed(self, k: int, term: Cost, values: Mapping[str, Any]) -> Cost:
        """Term ``k`` with other numbers; what is more than a number is refused."""
        setting = self._setting
        changed = dataclasses.replace(term, **values)
        if not self._only_numbers(k, term, changed, values):
            self._check_structure(term, changed, values)
        for name, value in values.items():
            alone = dataclasses.replace(term, **{name: value}) if len(values) > 1 else changed
            scales = alone.scale(setting) != term.scale(setting)
            if scales and same(alone.references(setting), term.references(setting)):
                raise ProblemError(
                    f"{term.label}.{name} cannot be updated: it only scales E, change weight"
                )
        return changed

    def _only_numbers(self, k: int, term: Cost, changed: Cost, values: Mapping[str, Any]) -> bool:
        """Whether a term's residual is known to stay the same, without forming it again: none of
        the fields that it was built from has another value, its references have their sizes."""
        known = self._read.pop(k, None)
        if known is None or known[0] is not term:
            known = term, self._reader.fields_read(term), self._widths(term)
        _, read, widths = known
        for name in read.intersection(values):
            if not same(getattr(changed, name), getattr(term, name)):
                return False
        if self._widths(changed) != widths:
            return False
        self._read[k] = changed, read, widths
        return True

    def _widths(self, term: Cost) -> Widths:
        """Names and sizes of a term's references, in order."""
        places = References.of([term], self._setting).places[0]
        return [(name, place.stop - place.start) for name, place in places.items()]

    def _check_structure(self, term: Cost, changed: Cost, values: Mapping[str, Any]) -> None:
        """Refuse a term whose residual is another expression."""
        fixed = self._reader.fixed_fields(term, values)
        if not fixed and self._reader.read(changed) != self._reader.read(term):
            fixed = sorted(values)
        if fixed:
            raise ProblemError(
                f"{term.label}.{' and '.join(fixed)} cannot be updated: it is compiled into the "
                "controller, make a new Controller"
            )

    def set_parameters(self, values: Mapping[str, float]) -> None:
        """Change run-time parameters of the dynamics by name; not dt."""
        if "dt" in values:
            raise ValueRangeError("parameter dt cannot change: the horizon was compiled for it")
        for name, value in values.items():
            one_of("parameter", name, self._layout.given)
            self._compiled.p[0, self._layout.index(name)] = number(f"parameter {name}", value)


def _with(problem: Problem, k: int, term: Cost) -> Problem:
    """A problem with another term in place of ``k``, whose numbers alone are new: nothing that a
    Problem checks has changed."""
    changed = copy.copy(problem)
    object.__setattr__(changed, "costs", (*problem.costs[:k], term, *problem.costs[k + 1 :]))
    vars(changed)["dynamics"] = problem.dynamics
    return changed
