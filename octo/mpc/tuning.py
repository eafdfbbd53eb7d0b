"""What may change in a compiled problem between two plans: references, weights, parameters."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from octo.checks import number
from octo.errors import ProblemError, UnknownNameError, ValueRangeError
from octo.model.quantities import Array
from octo.problem.compiled import CompiledProblem
from octo.problem.costs import Cost
from octo.problem.problem import Problem
from octo.problem.references import coefficients
from octo.problem.structure import Reader, same


class Tuning:
    """The numbers of a compiled problem of one member, by the names of its terms and fields. The
    scales of its terms stay those of ``problem``, from which it was compiled."""

    def __init__(self, compiled: CompiledProblem, problem: Problem):
        self._compiled, self._layout = compiled, problem.dynamics.layout
        self._labels = [term.label for term in problem.costs]
        self._setting, self._reader = problem.setting, Reader(problem)
        self._scales = [term.scale(self._setting) for term in problem.costs]
        self._views: dict[tuple[str, str], Array] = {}

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
        changed = self._changed(term, values)
        table = self._compiled.functions.references
        scratch = dataclasses.replace(table, terms=(changed,), places=(places,))
        packed = scratch.pack([changed], setting)
        for place in places.values():
            q[:, place] = packed[:, place]
        if not {"weight", "at", "steps"}.isdisjoint(values):
            q[:, k] = coefficients(changed, setting, self._scales[k])
        return problem.replace(costs=[*problem.costs[:k], changed, *problem.costs[k + 1 :]])

    def _changed(self, term: Cost, values: Mapping[str, Any]) -> Cost:
        """A term with other numbers; what is more than a number is refused."""
        setting = self._setting
        changed = dataclasses.replace(term, **values)
        fixed = self._reader.fixed_fields(term, values)
        if not fixed and self._reader.read(changed) != self._reader.read(term):
            fixed = sorted(values)
        if fixed:
            raise ProblemError(
                f"{term.label}.{' and '.join(fixed)} cannot be updated: it is compiled into the "
                "controller, make a new Controller"
            )
        for name, value in values.items():
            alone = dataclasses.replace(term, **{name: value})
            alike = same(alone.references(setting), term.references(setting))
            if alike and alone.scale(setting) != term.scale(setting):
                raise ProblemError(
                    f"{term.label}.{name} cannot be updated: it only scales E, change weight"
                )
        return changed

    def set_parameters(self, values: Mapping[str, float]) -> None:
        """Change run-time parameters of the dynamics by name; not dt."""
        if "dt" in values:
            raise ValueRangeError("parameter dt cannot change: the horizon was compiled for it")
        for name, value in values.items():
            self._compiled.p[0, self._layout.index(name)] = number(f"parameter {name}", value)
