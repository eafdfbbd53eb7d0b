"""What generated code knows of a model and of its terms: one batch shares it, and no update changes it.

Weights, references and parameters are numbers of a run. Everything else that a residual was built from is structure: the
model, the body, the contacts, a function, which contacts are feet at the start. Two terms have one structure where their
residuals are the same expression, instruction by instruction, of references with the same names and sizes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import casadi as ca
import numpy as np

from octo.dynamics.evaluate import Dynamics, RobotDynamics
from octo.errors import ProblemError
from octo.problem.basis import Hermite
from octo.problem.codegen import References, blamed, contact_symbols, sizes, step_symbols, touching
from octo.problem.contact_costs import ContactCost
from octo.problem.costs import Cost, NeighbourCost
from octo.problem.symbols import Setting

if TYPE_CHECKING:
    from octo.problem.problem import Problem

SHORT = 40  # characters of a value that a message may hold


class Structure(NamedTuple):
    """Of one term."""

    kind: tuple[type, str, str]  # class, label, steps
    references: tuple[tuple[str, int], ...]  # names and sizes
    residual: str  # the expression, serialised
    contacts: frozenset[int]  # that it acts on


class Reader:
    """Reads the structure of terms of one model.

    Parameters
    ----------
    dynamics: the model. between_controls: terms over neighbouring controls are over those of the Hermite basis.
    """

    def __init__(self, dynamics: Dynamics, between_controls: bool):
        self.dynamics, self.between = dynamics, between_controls

    @cached_property
    def _p(self) -> ca.SX:
        return ca.SX.sym("p", self.dynamics.layout.size)

    @cached_property
    def _step(self) -> Any:
        return step_symbols(self.dynamics, self._p)

    @cached_property
    def _contact(self) -> Any:
        if not isinstance(self.dynamics, RobotDynamics):
            raise ProblemError("user-written dynamics have no contacts")
        return contact_symbols(self.dynamics, self._p)

    def read(self, term: Cost, setting: Setting) -> Structure:
        """The structure of ``term`` in a problem with this setting.

        Raises
        ------
        OctoError: the term's residual or its references cannot be formed.
        """
        table = References.of([term], setting)
        q = ca.SX.sym("q", max(table.size, 1))
        view = table.view(q, 0)
        with blamed(term, f"its residual cannot be built from {sizes(table, 0)}"):
            if isinstance(term, ContactCost):
                inputs, symbols = self._contact
                value = term.contact_residual(symbols, view)
            elif self.between and isinstance(term, NeighbourCost):
                inputs = [ca.SX.sym(name, 2 * self.dynamics.nx) for name in ("c", "c_next")]
                value = term.between(inputs[0], inputs[1], view)
            else:
                inputs, step = self._step
                value = term.residual(step, view)
            function = ca.Function("residual", [*inputs, self._p, q], [ca.vec(ca.SX(value))])
        named = tuple((name, place.stop - place.start) for name, place in table.places[0].items())
        kind = (type(term), term.label, term.steps)
        return Structure(kind, named, function.serialize(), self.contacts(term, setting))

    def contacts(self, term: Cost, setting: Setting) -> frozenset[int]:
        """The contacts that a term acts on, as indices into the robot's."""
        if not isinstance(term, ContactCost) or not isinstance(self.dynamics, RobotDynamics):
            return frozenset()
        return frozenset(term.chosen(self.dynamics.character, touching(self.dynamics, setting)))

    def fixed_fields(self, term: Cost, values: Mapping[str, Any], setting: Setting) -> list[str]:
        """Which of new ``values`` of a term's fields, each on its own, change its structure."""
        own = self.read(term, setting)
        return [name for name, value in values.items() if self.read(dataclasses.replace(term, **{name: value}), setting) != own]


def check_alike(problems: Sequence[Problem]) -> None:
    """Refuse a batch whose problems differ in more than numbers.

    Raises
    ------
    ProblemError: names what differs, and of which problem.
    """
    first = problems[0]
    readers: dict[int, Reader] = {}
    read: dict[int, Structure] = {}  # of the first problem's terms, by place
    seen = {id(first)}
    for place, other in enumerate(problems[1:], start=1):
        if id(other) in seen:
            continue
        seen.add(id(other))
        _check_frame(first, other, place)
        for k in range(len(first.costs)):
            _check_term(first, other, (k, place), readers, read)


def _check_frame(first: Problem, other: Problem, place: int) -> None:
    """Model, steps, basis and the list of terms."""
    alike = {
        "model": _same_model(first.dynamics, other.dynamics),
        "steps": first.steps == other.steps,
        "basis": first.basis_object == other.basis_object,
        "terms": [(type(t), t.label, t.steps) for t in first.costs] == [(type(t), t.label, t.steps) for t in other.costs],
    }
    for name, same in alike.items():
        if not same:
            raise ProblemError(
                f"{name} differ between problems of one batch (problem {place} from the first): they must share model, terms, "
                "basis and steps"
            )


def _same_model(one: Dynamics, other: Dynamics) -> bool:
    """Whether one generated code and one table of numbers serve both."""
    if one is other:
        return True
    if type(one) is not type(other) or one.layout.names != other.layout.names:
        return False
    if not np.array_equal(one.actuated, other.actuated):
        return False
    if isinstance(one, RobotDynamics) and isinstance(other, RobotDynamics):
        if one.character is other.character and one.law == other.law and one.terrain == other.terrain:
            return True
        a, b = one.character, other.character
        if a.mass != b.mass or a.terrain_contacts != b.terrain_contacts:
            return False
    return one.lanes_text() == other.lanes_text()


def _check_term(
    first: Problem, other: Problem, where: tuple[int, int], readers: dict[int, Reader], read: dict[int, Structure]
) -> None:
    """One term of a problem against that of the first."""
    k, place = where
    a, b = first.costs[k], other.costs[k]
    one, two = (_reader(problem, readers) for problem in (first, other))
    if _same_robot(first.dynamics, other.dynamics) and same(vars(a), vars(b), {"weight"}):
        found, wanted = one.contacts(a, first.setting), two.contacts(b, other.setting)
        if found != wanted:
            raise _different(b, place, _contacts_at_the_start(b))
        return
    if k not in read:
        read[k] = one.read(a, first.setting)
    made = two.read(b, other.setting)
    if made == read[k]:
        return
    differing = {name: value for name, value in vars(b).items() if not same(vars(a).get(name), value)}
    own = {f.name for f in dataclasses.fields(a) if f.init}
    given = {name: value for name, value in differing.items() if name in own}
    try:
        blamed_fields = one.fixed_fields(a, given, first.setting)
    except ProblemError:  # the other's value may mean nothing here
        blamed_fields = []
    names = blamed_fields or ([] if made.contacts != read[k].contacts else sorted(differing))
    raise _different(b, place, " and ".join(f"{name} ({_short(vars(b)[name])})" for name in names) or _contacts_at_the_start(b))


def _reader(problem: Problem, readers: dict[int, Reader]) -> Reader:
    key = id(problem.dynamics)
    if key not in readers:
        readers[key] = Reader(problem.dynamics, isinstance(problem.basis_object, Hermite))
    return readers[key]


def _same_robot(one: Dynamics, other: Dynamics) -> bool:
    """Whether names of bodies and contacts mean the same."""
    if one is other:
        return True
    robots = isinstance(one, RobotDynamics) and isinstance(other, RobotDynamics)
    return robots and one.character is other.character  # type: ignore[attr-defined]


def same(one: Any, other: Any, but: Sequence[str] | set[str] = ()) -> bool:
    """Whether two values are the same for certain; what cannot be compared is not. ``but``: keys that may differ."""
    if one is other:
        return True
    if type(one) is not type(other):
        return False
    if isinstance(one, (str, bytes, bool, int, float)):
        return bool(one == other)
    if isinstance(one, np.ndarray):
        return one.dtype != object and one.shape == other.shape and bool(np.array_equal(one, other))
    if isinstance(one, (tuple, list)):
        return len(one) == len(other) and all(same(a, b) for a, b in zip(one, other, strict=True))
    if isinstance(one, Mapping):
        keys = [key for key in one if key not in but]
        return set(keys) == {key for key in other if key not in but} and all(same(one[key], other[key]) for key in keys)
    return False


def _different(term: Cost, place: int, what: str) -> ProblemError:
    return ProblemError(
        f"terms differ between problems of one batch: {term.label}.{what} of problem {place} is not that of the first; only "
        "weights, references and parameters may differ, solve them one by one"
    )


def _contacts_at_the_start(term: Cost) -> str:
    return "contacts (those on the ground at the start)" if isinstance(term, ContactCost) else "residual"


def _short(value: Any) -> str:
    """A value as a message may hold it."""
    if callable(value):
        return str(getattr(value, "__name__", type(value).__name__))
    said = repr(value)
    return said if len(said) <= SHORT else f"{said[:SHORT]}…"
