"""The passes of a continuation (Fig. 7): how stiff contacts are in each, and what it is asked for.

Penetration is sqrt(load/w_perp) and slip (|f_t|/f_n)·(w_perp/w_par), so a pass is said by how deep
four feet sink that carry the weight, and by the ratio w_par/w_perp.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar, cast

import numpy as np

from octo.checks import whole
from octo.dynamics.laws import Smooth, Viscous
from octo.errors import ProblemError
from octo.problem.basis import Hermite
from octo.problem.contact_costs import SlipPower
from octo.problem.phases import Described
from octo.problem.problem import Array, Problem
from octo.solver.options import SqpOptions

DEPTHS = (0.08, 0.04, 0.02, 0.008)  # ℓ; each further pass halves the last
RATIOS = (10.0, 20.0, 60.0, 150.0)  # s/m, w_par/w_perp; the last one stays
# s/m, where a term prices slip: a ratio that grows would tie the price to the friction cone
PRICED = 10.0
ONSETS = (0.04, 0.04, 0.02, 0.008)  # ℓ, smoothing of the contact's onset; the last one stays


@dataclass(frozen=True)
class Pass:
    """One pass: four feet that carry the weight sink by ``depth`` m, w_par/w_perp is ``ratio`` s/m
    (None: not viscous)."""

    depth: float
    ratio: float | None
    onset: float

    def parameters(self, weight: float) -> dict[str, float]:
        """The contact law's parameters for a robot of ``weight`` N: w_perp = mg/(4 depth²)."""
        w_perp = weight / (4.0 * self.depth**2)
        friction = {} if self.ratio is None else {"contact.w_par": self.ratio * w_perp}
        return {"contact.w_perp": w_perp, **friction, "contact.onset": self.onset}


@dataclass(frozen=True)
class Together:
    """One pass of phases: that of each, None where its contact law stays as it is."""

    passes: tuple[Pass | None, ...]


D = TypeVar("D", bound=Described)
Step = Pass | Together
Schedule = list[Step | None]


EARLY = {"dual_tolerance": 1e-3, "step_tolerance": 1e-2, "plateau_change": 5e-3}
EARLY_PLATEAU = 10


def early(options: SqpOptions) -> SqpOptions:
    """What is asked of a pass from which another one goes on: near is enough, its optimum is not
    the next one's."""
    if options.step != "line_search":
        return options
    wider = {name: max(value, getattr(options, name)) for name, value in EARLY.items()}
    return replace(options, plateau=min(EARLY_PLATEAU, options.plateau), **wider)


# a pass reaches its stiffness in so many equal factors (with two, 14 of 15 strides of anymal_b
# converge) …
FACTORS = 3
# … with this many iterations at each before the last: a start of 43 N of ‖C‖∞ becomes one of 8 N
INTERMEDIATE_ITERATIONS = 3


def on_the_way(first: Step, last: Step) -> list[Step]:
    """The passes from one to the next, without the two."""
    if isinstance(first, Together) and isinstance(last, Together):
        still: list[Pass | None] = [None] * (FACTORS - 1)
        each = [
            still if a is None or b is None else intermediate(a, b)
            for a, b in zip(first.passes, last.passes, strict=True)
        ]
        return [Together(passes) for passes in zip(*each, strict=True)]
    assert isinstance(first, Pass) and isinstance(last, Pass)
    return [*intermediate(first, last)]


def intermediate(first: Pass, last: Pass) -> list[Pass]:
    """The stiffnesses on the way from one pass to the next, without the two."""

    def between(name: str, part: float) -> Any:
        a, b = getattr(first, name), getattr(last, name)
        return None if a is None or b is None else a * (b / a) ** part

    parts = [k / FACTORS for k in range(1, FACTORS)]
    return [Pass(*(between(f.name, part) for f in fields(Pass))) for part in parts]


def growable(problem: Problem) -> bool:
    """True where the contact law is Eq. 6, with any friction, and its stiffness was not set by the
    caller."""
    names = ("contact.w_perp", "contact.w_par", "contact.onset")
    law, default = problem.law, Smooth()
    own = (default.w_perp, default.onset)
    plain = law is None or (isinstance(law, Smooth) and (law.w_perp, law.onset) == own)
    given = any(name in problem.parameters for name in names)
    return problem.character is not None and plain and not given


def ratios(problem: Problem) -> tuple[float | None, ...]:
    """w_par/w_perp of each pass: growing by default, the caller's where the law says one, None
    without viscous friction."""
    law = problem.law
    if not isinstance(law, Smooth):
        priced = any(isinstance(term, SlipPower) for term in problem.costs)
        return (PRICED,) * len(RATIOS) if priced else RATIOS
    friction = law.friction
    return (friction.w_par / law.w_perp if isinstance(friction, Viscous) else None,) * len(RATIOS)


def schedule_of(described: Described, count: int | None) -> Schedule:
    """The passes of a problem, or of phases, whose contact laws grow stiff together; [None] solves
    it with the parameters it has."""
    if isinstance(described, Problem):
        return [*schedule(described, count)]
    growing = [growable(problem) for problem in described.problems]
    if not any(growing):
        return [*schedule(described.problems[0], count)]
    own = [
        schedule(problem, count) if grows else None
        for problem, grows in zip(described.problems, growing, strict=True)
    ]
    number = max(len(passes) for passes in own if passes is not None)
    still: list[Pass | None] = [None] * number
    each = (still if passes is None else passes for passes in own)
    return [Together(passes) for passes in zip(*each, strict=True)]


def schedule(problem: Problem, count: int | None) -> list[Pass | None]:
    """The passes of a problem; [None] solves it with the parameters it has.

    By default four in the nodes basis, one in the Hermite basis: a spline of ten steps a segment
    cannot follow the forces of a stiff contact (its pointwise residual grows to several times the
    weight).
    """
    if count is not None:
        whole("passes", count, most=100)
    if not growable(problem):
        if count is not None and count > 1:
            why = "the stiffness of this contact law is fixed by the caller"
            raise ProblemError(f"passes is {count}: {why}, must be 1")
        return [None]
    last = len(DEPTHS) - 1
    usual = 1 if isinstance(problem.basis_object, Hermite) else len(DEPTHS)
    wanted = usual if count is None else int(count)
    ratio, place, length = ratios(problem), [min(k, last) for k in range(wanted)], problem.length
    return [
        Pass(length * DEPTHS[at] / 2.0 ** (k - at), ratio[at], length * ONSETS[at])
        for k, at in enumerate(place)
    ]


def stiffened(problems: Sequence[D], passes: Sequence[Step | None]) -> list[D]:
    """Problems with the contact laws of their passes, None for their own: what is the same problem
    and pass is one object."""
    made: dict[tuple[int, Step | None], D] = {}
    for problem, wanted in zip(problems, passes, strict=True):
        if (id(problem), wanted) not in made:
            made[id(problem), wanted] = cast(D, _with(problem, wanted))
    return [made[id(problem), wanted] for problem, wanted in zip(problems, passes, strict=True)]


def _with(described: Described, wanted: Step | None) -> Described:
    """A problem, or phases, with the contact law of a pass."""
    if isinstance(described, Problem):
        given = wanted.parameters(described.weight) if isinstance(wanted, Pass) else {}
        return described.replace(parameters=given) if given else described
    if not isinstance(wanted, Together):
        return described
    own = [{} if one is None else one.parameters(described.weight) for one in wanted.passes]
    return described.with_parameters(own)


def shifted(nodes: Array, before: Described, problem: Described) -> Array:
    """Nodes (N+2, nx) of the pass before, shifted so that they begin at the start of this one."""
    moved = nodes + (problem.start - before.start)
    if problem.closure is not None:
        moved[:2] = moved[-2:] @ problem.closure.matrix.T + problem.closure.constant
        return np.ascontiguousarray(moved)
    moved[0] = problem.start - problem.dt * problem.start_velocity
    return np.ascontiguousarray(moved)
