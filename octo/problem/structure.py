"""What generated code knows of a model and of its terms: a batch shares it, no update changes it.

Weights, references and parameters are numbers of a run. Everything else that a residual was built
from is structure: the model, the body, the contacts, a function, which contacts are feet at the
start. Two terms have one structure where their residuals are the same expression, instruction by
instruction, of references with the same names and sizes.
"""

from __future__ import annotations

import contextlib
import dataclasses
import inspect
import threading
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from types import FunctionType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from octo.dynamics.content import recent
from octo.dynamics.evaluate import Dynamics, RobotDynamics
from octo.errors import OctoError, ProblemError
from octo.interrupts import postponed
from octo.model.feet import touching
from octo.problem.basis import Hermite
from octo.problem.codegen import Residuals, derived, residuals_of, step_symbols
from octo.problem.contact_costs import ContactCost
from octo.problem.program import Program
from octo.problem.references import References, blamed, sizes
from octo.problem.terms import Term

if TYPE_CHECKING:
    from octo.problem.problem import Problem

SHORT = 40  # characters of a value that a message may hold
AT_THE_START = "contacts (those on the ground at the start)"


class Structure(NamedTuple):
    """Of one term."""

    residual: tuple[Any, ...]  # class, label, references and expressions (Residuals.structure)
    contacts: frozenset[int]  # that it acts on


class Reader:
    """Reads the structure of the terms of one problem.

    Parameters
    ----------
    problem: whose model, start and basis the terms are read with.
    """

    def __init__(self, problem: Problem):
        self.problem, self.dynamics = problem, problem.dynamics

    @cached_property
    @postponed()
    def _symbols(self) -> Any:
        """Of a step, with its poses as soon as a term has asked for them."""
        return step_symbols(self.dynamics)

    @cached_property
    def _feet(self) -> list[int]:
        assert isinstance(self.dynamics, RobotDynamics)
        return touching(self.dynamics.character, self.dynamics.terrain, self.problem.setting.x0)

    def read(self, term: Term) -> Structure:
        """The structure of a term.

        Raises
        ------
        OctoError: the term's residual or its references cannot be formed.
        """
        made = _residuals(self.problem, [term], symbols=self._symbols)
        with blamed(term, f"its residual cannot be built from {sizes(made.references, 0)}"):
            return Structure(made.structure, self.contacts(term))

    def fields_read(self, term: Term) -> frozenset[str]:
        """The fields of a term that its structure is read from: no other changes it, as long as
        the references keep their names and sizes.

        All of them where the residual looks at something that may be made of any.

        Raises
        ------
        OctoError: the term's residual or its references cannot be formed.
        """
        known = References.of([term], self.problem.setting)
        with _read_of(term) as names:
            made = _residuals(self.problem, [term], symbols=self._symbols, references=known)
            with blamed(term, f"its residual cannot be built from {sizes(known, 0)}"):
                _ = made.structure, self.contacts(term)
        fields = {f.name for f in dataclasses.fields(term) if f.init}
        if not all(_is_plain(term, name) for name in names - fields):
            return frozenset(fields)
        return frozenset(names & fields)

    def contacts(self, term: Term) -> frozenset[int]:
        """The contacts that a term acts on, as indices into the robot's."""
        if not isinstance(term, ContactCost) or not isinstance(self.dynamics, RobotDynamics):
            return frozenset()
        return frozenset(term.chosen(self.dynamics.character, self._feet))

    def fixed_fields(self, term: Term, values: Mapping[str, Any]) -> list[str]:
        """Which of new ``values`` of a term's fields, each on its own, change its structure."""
        own = self.read(term)
        new = {name: dataclasses.replace(term, **{name: value}) for name, value in values.items()}
        return [name for name, changed in new.items() if self.read(changed) != own]


_reading = threading.RLock()


@contextlib.contextmanager
def _read_of(term: Term) -> Iterator[set[str]]:
    """The names of the attributes of a term that are read inside.

    Its class looks on meanwhile: a term of another class, such as a subclass made for this, could
    have another residual.
    """
    kind, names = type(term), set[str]()
    with _reading:
        own, found = vars(kind).get("__getattribute__"), kind.__getattribute__

        def noted(each: Term, name: str) -> Any:
            if each is term:
                names.add(name)
            return found(each, name)

        setattr(kind, "__getattribute__", noted)  # noqa: B010
        try:
            yield names
        finally:
            if own is None:
                delattr(kind, "__getattribute__")
            else:
                setattr(kind, "__getattribute__", own)  # noqa: B010


# what a class has that says nothing of an object but through the object's other attributes
METHODS = (FunctionType, staticmethod, classmethod, property, cached_property)


def _is_plain(term: Term, name: str) -> bool:
    """Whether an attribute of a term is its class's, and holds nothing of the term itself."""
    if name == "__class__":
        return True
    if name.startswith("__") or name in vars(term):
        return False
    found = inspect.getattr_static(type(term), name, None)
    return found is not None and (isinstance(found, METHODS) or not hasattr(found, "__get__"))


def _residuals(problem: Problem, terms: Sequence[Term], **more: Any) -> Residuals:
    """Of terms of a problem, which need not be those that it has; ``more`` as of
    ``residuals_of``."""
    between = isinstance(problem.basis_object, Hermite)
    return residuals_of(problem.dynamics, terms, problem.setting, between, **more)


_programs: OrderedDict[Any, Program] = OrderedDict()


@postponed()
def program_of(problem: Problem, exact: bool = False) -> Program:
    """What is generated for the terms; of the last few problems it is kept, for others of the same
    structure whose dynamics say the same. ``exact``: of all terms with exact second derivatives.

    Raises
    ------
    OctoError: a term's residual or its references cannot be formed.
    """
    made = _residuals(problem, problem.terms, exact=exact)
    key = (problem.dynamics.key, isinstance(problem.basis_object, Hermite), made.structure)
    return recent(_programs, key, lambda: Program(problem.dynamics, derived(made)))


def check_alike(problems: Sequence[Problem]) -> None:
    """Refuse a batch whose problems differ in more than numbers.

    Raises
    ------
    ProblemError: names what differs, and in which problem, counted from 0.
    """
    first = Reader(problems[0])
    read: dict[int, Structure] = {}  # of the first problem's terms, by place
    for place, problem in enumerate(problems):
        if problem is not problems[0]:
            _check_frame(problems[0], problem, place)
            _check_terms(first, Reader(problem), place, read)


def _check_frame(first: Problem, other: Problem, place: int) -> None:
    """Whether the duration is free, model, steps, basis and the list of terms."""
    if (first.duration is None) != (other.duration is None):
        raise ProblemError(
            f"duration is free in one problem of a batch and fixed in another, 0 and {place}: it "
            "must be free in all of them or in none"
        )
    lists = [[(type(t), t.label) for t in p.terms] for p in (first, other)]
    alike = {
        "model": _same_model(first.dynamics, other.dynamics),
        "steps": first.steps == other.steps,
        "terms": lists[0] == lists[1],  # before the basis, which depends on them
        "basis": first.basis_object == other.basis_object,
    }
    for name, same in alike.items():
        if not same:
            raise ProblemError(
                f"{name} differ between problems of one batch, 0 and {place}: they must share "
                "model, terms, basis and steps"
            )


def _same_model(one: Dynamics, other: Dynamics) -> bool:
    """Whether one generated code and one table of numbers serve both."""
    if one.key == other.key:
        return True
    if type(one) is not type(other) or one.layout.names != other.layout.names:
        return False
    if not np.array_equal(one.actuated, other.actuated):
        return False
    if isinstance(one, RobotDynamics) and isinstance(other, RobotDynamics):
        a, b = one.character, other.character
        if a is b and says_equal(one.law, other.law) and says_equal(one.terrain, other.terrain):
            return True
        if a.mass != b.mass or a.terrain_contacts != b.terrain_contacts:
            return False
        if a.objects != b.objects:
            return False
    return one.lanes_text() == other.lanes_text()


def says_equal(one: Any, other: Any) -> bool:
    """Whether two objects say that they are equal; those that cannot say are not."""
    try:
        return one is other or bool(one == other)
    except Exception:  # a user's class may raise anything
        return False


def _check_terms(first: Reader, other: Reader, place: int, read: dict[int, Structure]) -> None:
    """The terms of a problem against those of the first."""
    robots = _same_robot(first.dynamics, other.dynamics)
    stands = robots and np.array_equal(first.problem.start, other.problem.start)
    for k, (a, b) in enumerate(zip(first.problem.terms, other.problem.terms, strict=True)):
        if robots and same(vars(a), vars(b), but="weight"):
            if not stands and first.contacts(a) != other.contacts(b):
                raise _different(b, place, AT_THE_START)
            continue
        if k not in read:
            read[k] = first.read(a)
        made = other.read(b)
        if made != read[k]:
            what = AT_THE_START if made.contacts != read[k].contacts else "residual"
            raise _different(b, place, _fields(first, a, b) or what)


def _fields(first: Reader, a: Term, b: Term) -> str:
    """The fields of ``b`` that are to blame, with their values; empty where it is none."""
    names = [f.name for f in dataclasses.fields(a) if f.init and f.name in vars(b)]
    given = {name: vars(b)[name] for name in names if not same(vars(a).get(name), vars(b)[name])}
    try:
        blame = first.fixed_fields(a, given)
    except OctoError:  # what stands in the other may mean nothing here
        blame = sorted(given)
    return " and ".join(f"{name} ({_short(given[name])})" for name in blame)


def _same_robot(one: Dynamics, other: Dynamics) -> bool:
    """Whether names of bodies and contacts mean the same."""
    if not isinstance(one, RobotDynamics) or not isinstance(other, RobotDynamics):
        return one is other
    return one.character is other.character


def same(one: Any, other: Any, but: str = "") -> bool:
    """Whether two values are the same for certain; what cannot be compared is not.

    but: a key that may differ.
    """
    if one is other:
        return True
    if type(one) is not type(other):
        return False
    if isinstance(one, (str, bytes, bool, int, float)):
        return bool(one == other)
    if isinstance(one, np.ndarray):
        return one.dtype != object and one.shape == other.shape and bool(np.array_equal(one, other))
    if isinstance(one, (tuple, list)):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, Mapping):
        keys = set(one) - {but}
        return keys == set(other) - {but} and all(same(one[key], other[key]) for key in keys)
    return False


def _different(term: Term, place: int, what: str) -> ProblemError:
    return ProblemError(
        f"terms differ between problems of one batch: {term.label}.{what} of problem {place} is "
        "not that of problem 0; only weights, references and parameters may differ, solve them "
        "apart"
    )


def _short(value: Any) -> str:
    """A value as a message may hold it."""
    if callable(value):
        return str(getattr(value, "__name__", type(value).__name__))
    said = repr(value)
    return said if len(said) <= SHORT else f"{said[:SHORT]}…"
