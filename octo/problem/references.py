"""Where the references and weights of the terms stand in q, the numbers of a step, and what is said
of a term that fails."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from octo.checks import Array, numbers
from octo.errors import OctoError, ProblemError, ShapeError, ValueRangeError
from octo.problem.costs import LOSS, Cost
from octo.problem.symbols import Setting


@dataclass(frozen=True, eq=False)
class References:
    """Where each term's references stand in q, and how q is packed from the terms."""

    terms: tuple[Cost, ...]
    places: tuple[dict[str, slice], ...]
    size: int

    @classmethod
    def of(cls, terms: Sequence[Cost], setting: Setting) -> References:
        places, at = [], len(terms)
        for term in terms:
            table = {}
            for name, value in _references(term, setting).items():
                width = np.atleast_1d(value).shape[-1]
                table[name] = slice(at, at + width)
                at += width
            places.append(table)
        return cls(tuple(terms), tuple(places), at)

    def view(self, q: ca.SX, term: int) -> dict[str, ca.SX]:
        return {name: q[place] for name, place in self.places[term].items()}

    def pack(self, terms: Sequence[Cost], setting: Setting) -> Array:
        """q (N, NQ): coefficient weight/(scale·N) of each term (weight/scale at the last step
        alone), references."""
        steps = setting.steps
        q = np.zeros((steps, self.size))
        for k, term in enumerate(terms):
            weight = numbers(f"{term.label}.weight", term.weight)
            if weight.shape not in ((), (steps,)):
                raise ShapeError(f"{term.label}.weight", weight.shape, f"() or ({steps},)")
            if not (weight >= 0.0).all():
                raise ValueRangeError(f"{term.label}.weight is {term.weight}, must not be negative")
            on = np.full(steps, 1.0 / steps) if term.steps == "all" else np.eye(steps)[-1]
            q[:, k] = weight * on / term.scale(setting)
            found = _references(term, setting)
            if set(found) != set(self.places[k]):
                raise ProblemError(
                    f"{term.label} has the references {list(found)}, must have "
                    f"{list(self.places[k])}"
                )
            for name, rows in found.items():
                place = self.places[k][name]
                allowed = ((), (place.stop - place.start,), (steps, place.stop - place.start))
                if rows.shape not in allowed:
                    raise ShapeError(
                        f"{term.label}.{name}", rows.shape, f"{allowed[1]} or {allowed[2]}"
                    )
                q[:, place] = rows
        return q


def _references(term: Cost, setting: Setting) -> dict[str, Array]:
    """A term's references as finite arrays."""
    with blamed(term, "its references cannot be formed"):
        values = dict(term.references(setting))
        if term.loss is not None:
            values |= {f"{LOSS}{name}": value for name, value in term.loss.references().items()}
    return {name: numbers(f"{term.label}.{name}", value) for name, value in values.items()}


def sizes(references: References, term: int) -> str:
    """The references of a term and how many numbers each has, for a message."""
    places = references.places[term]
    return (
        ", ".join(f"{name} ({place.stop - place.start},)" for name, place in places.items())
        or "no references"
    )


@contextlib.contextmanager
def blamed(term: Cost, sentence: str) -> Iterator[None]:
    """Whatever goes wrong inside (a user's code may raise anything) is one sentence that names the
    term."""
    try:
        yield
    except OctoError:
        raise
    except Exception as error:
        # CasADi names its own source file
        said = re.sub(r"^\S*\.hpp:\d+: ", "", str(error).strip().split("\n")[0])
        raise ProblemError(f"{term.label}: {sentence}: {type(error).__name__}: {said}") from error
