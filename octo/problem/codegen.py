"""The costs as CasADi functions of one step and of one contact, and as the C text that assemble.c
works from.

A step's residuals are a function of (x_next, x, x_prev, u, p, q); those over contacts are in
contact_model.py. q (NQ) starts with one coefficient per term, then come the references.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo import native
from octo.dynamics.codegen import lanes_text, numbers_table
from octo.dynamics.crowd import singles_of
from octo.dynamics.evaluate import Dynamics, RobotDynamics
from octo.dynamics.long import COSTLY, check_length
from octo.emit import function_of_numbers
from octo.errors import ProblemError
from octo.interrupts import postponed
from octo.model.feet import touching
from octo.problem.array_costs import ArrayCost
from octo.problem.calls import Calls
from octo.problem.contact_costs import ContactCost
from octo.problem.contact_model import ContactFunctions, ContactResiduals
from octo.problem.costs import NeighbourCost, StepPairCost
from octo.problem.curvature import CenteredStep, CurvedTerms, StateCurvature, nonzeros
from octo.problem.lane_tables import contact_tables, row_tables, tables_text
from octo.problem.references import References, blamed, sizes
from octo.problem.row_products import RowSlopes
from octo.problem.step_pairs import PairFunctions, PairResiduals, pair_residuals
from octo.problem.symbols import Setting, StepSymbols
from octo.problem.terms import Term


@dataclass(frozen=True, eq=False)
class CostFunctions:
    """The residuals of a list of terms, ready to be evaluated, differentiated and written as C."""

    references: References
    state: ca.Function  # (x_next, x, x_prev, u, p, q, v if there are calls) -> r (NR,)
    state_jac: ca.Function  # -> r, nonzeros of dr/d(x_next, x, x_prev, u)
    state_sparsity: ca.Sparsity
    state_terms: tuple[int, ...]  # term of each row, those of bounded terms last
    contact: ContactFunctions | None
    # each term over neighbours' place in the list, and (c_k, c_{k+1}, q) -> r, dr/d(c_k, c_{k+1}),
    # and of one that is exact Σ r d²r/d(c_k, c_{k+1})²
    between: tuple[tuple[int, ca.Function], ...]
    calls: Calls  # of stages of code
    curvature: StateCurvature | None  # of the exact terms over the state
    pairs: PairFunctions | None  # over two steps in a row

    @property
    def contact_spheres(self) -> tuple[int, ...]:
        """Indices into the character's contacts."""
        return () if self.contact is None else self.contact.spheres

    @cached_property
    def bounded(self) -> tuple[int, ...]:
        """The term of each bounded row, the last ones over the state."""
        terms = self.references.terms
        return tuple(k for k in self.state_terms if terms[k].kind == "bounded")

    @property
    def numbers(self) -> int:
        """Of a step, in q: coefficients, references, and a weight, a shift and a multiplier of
        each bounded row."""
        return max(self.references.size, 1) + 3 * len(self.bounded)

    @property
    def row_weights(self) -> tuple[slice, slice, slice]:
        """Where weights, shifts and multipliers of the bounded rows stand in q."""
        count = len(self.bounded)
        first = self.numbers - 3 * count
        weights, shifts, multipliers = (slice(k, k + count) for k in first + count * np.arange(3))
        return weights, shifts, multipliers

    @property
    def rows(self) -> int:
        own = 0 if self.contact is None else len(self.contact.spheres) * len(self.contact.terms)
        return len(self.state_terms) + own


@dataclass(frozen=True, eq=False)
class Residuals:
    """The residuals of a list of terms as expressions, which nothing is derived from yet.

    Attributes
    ----------
    inputs: x_next, x, x_prev, u, p, q, and v where stages of code are called; calls: these.
    state: (rows,) of each term over a step; terms: their indices. between: by the index of each
        term over neighbouring controls c, c_next; contact: those of one contact. exact: indices of
        the terms whose second derivatives are; curved: those of them over a step. pairs: those over
        two steps in a row.
    """

    references: References
    inputs: list[ca.SX]
    state: list[ca.SX]
    terms: list[int]
    controls: list[ca.SX]
    between: dict[int, ca.SX]
    contact: ContactResiduals | None
    calls: Calls
    exact: tuple[int, ...]
    curved: CurvedTerms
    pairs: PairResiduals | None

    @cached_property
    def function(self) -> ca.Function:
        """inputs -> all residuals over a step."""
        r = ca.densify(ca.vertcat(ca.SX(0, 1), *self.state))
        return ca.Function("octo_state_cost", self.inputs, [r], {"cse": True})

    @property
    def structure(self) -> tuple[Any, ...]:
        """What tells one list of terms from another: their expressions, and the names and sizes of
        their references."""
        references = self.references
        kinds = tuple((type(term), term.label) for term in references.terms)
        places = tuple(tuple((k, v.start, v.stop) for k, v in t.items()) for t in references.places)
        written = [self.function.serialize()]
        if self.between:
            over = [*self.controls, *self.inputs[4:6]]
            written.append(ca.Function("between", over, list(self.between.values())).serialize())
        if self.pairs is not None:
            written.append(self.pairs.value.serialize())
        own = None if self.contact is None else self.contact.structure
        whole = kinds, places, tuple(self.terms), self.exact
        return *whole, *written, own, self.calls.structure


@postponed()
def residuals_of(
    dynamics: Dynamics,
    terms: Sequence[Term],
    setting: Setting,
    between_controls: bool,
    exact: bool = False,
    symbols: tuple[ca.SX, list[ca.SX], StepSymbols] | None = None,
    references: References | None = None,
) -> Residuals:
    """Of all terms; ``between_controls``: those over neighbours are over Hermite controls;
    ``exact``: all have exact second derivatives, whatever their ``curvature``; ``symbols``: of
    :func:`step_symbols`, of one who asks for one term after another; ``references``: of the terms,
    where they are known.

    Raises
    ------
    OctoError: a term's residual or its references cannot be formed.
    """
    references = References.of(terms, setting) if references is None else references
    p, nodes, step = step_symbols(dynamics) if symbols is None else symbols
    step.calls.clear()
    q = ca.SX.sym("q", max(references.size, 1))
    controls = [ca.SX.sym(name, 2 * dynamics.nx) for name in ("c", "c_next")]
    state: list[ca.SX] = []
    own, between = [], {}
    bent = tuple(k for k, term in enumerate(terms) if exact or term.curvature == "exact")
    curved = CurvedTerms(CenteredStep.of(step))
    # bounded rows stand last
    for k, term in sorted(enumerate(terms), key=lambda each: each[1].kind == "bounded"):
        if isinstance(term, (ArrayCost, ContactCost, StepPairCost)):
            continue
        view = references.view(q, k)
        with blamed(term, f"its residual cannot be built from {sizes(references, k)}"):
            if between_controls and isinstance(term, NeighbourCost):
                term.check_square("is over Hermite controls")
                between[k] = term.shaped(term.between(controls[0], controls[1], view), view)
                continue
            first, called = sum(r.numel() for r in state), len(step.calls)
            state.append(term.shaped(term.residual(step, view), view))
            if k in bent:
                curved.add(k, term, view, first, step.calls[called:])
        own.append(k)
    over = [term for term in terms if isinstance(term, ContactCost)]
    if over and not isinstance(dynamics, RobotDynamics):
        raise ProblemError(
            f"{over[0].label} is over contacts, which user-written dynamics do not have"
        )
    contact = None
    if over and isinstance(dynamics, RobotDynamics):
        feet = touching(dynamics.character, dynamics.terrain, setting.x0)
        contact = ContactResiduals(dynamics, references, feet, p, q)
    inputs, pairs = [*nodes, p, q], pair_residuals(references, nodes, step, p, q, bent)
    calls = Calls.of(step.calls, inputs)
    inputs += [ca.vertcat(*[call.given for call in step.calls])] if calls else []
    exact_terms = bent, curved
    return Residuals(
        references, inputs, state, own, controls, between, contact, calls, *exact_terms, pairs
    )


@postponed()
def derived(made: Residuals) -> CostFunctions:
    """The functions of residuals and of their first derivatives, over contacts of their second ones
    too."""
    inputs = made.inputs
    terms = [k for k, r in zip(made.terms, made.state, strict=True) for _ in range(r.numel())]
    bounded = sum(made.references.terms[k].kind == "bounded" for k in terms)
    r = ca.densify(ca.vertcat(ca.SX(0, 1), *made.state))
    jac = made.calls.jacobian(r, inputs, ca.vertcat(*inputs[:4]))
    jacobian = ca.Function("octo_state_cost_jac", inputs, [r, nonzeros(jac)], {"cse": True})
    length = jacobian.n_instructions()
    if length >= COSTLY:
        sizes = [ca.Function("length", inputs, [one]).n_instructions() for one in made.state]
        longest = made.references.terms[made.terms[int(np.argmax(sizes))]].label
        check_length("terms of E", length, f"the longest is {longest}, write it in fewer")
    return CostFunctions(
        made.references,
        made.function,
        jacobian,
        jac.sparsity(),
        tuple(terms),
        None if made.contact is None else made.contact.derived(),
        tuple(_over_neighbours(made)),
        made.calls,
        made.curved.derived(inputs[4:], len(terms) - bounded, bounded),
        None if made.pairs is None else made.pairs.derived(),
    )


def _over_neighbours(made: Residuals) -> Iterator[tuple[int, ca.Function]]:
    both = ca.vertcat(*made.controls)
    for number, (k, r) in enumerate(made.between.items()):
        inputs = [*made.controls, made.inputs[5]]
        out = [r, ca.jacobian(r, both)]
        if k in made.exact:
            held = ca.SX.sym("held", r.numel())
            out.append(ca.substitute(ca.hessian(ca.dot(held, r), both)[0], held, r))
        yield k, ca.Function(f"octo_between_{number}", inputs, out, {"cse": True})


def kept_slopes(
    functions: CostFunctions,
    dynamics: Dynamics,
    places: tuple[NDArray[np.intp], NDArray[np.intp]] | None = None,
) -> RowSlopes | None:
    """What a linearisation keeps of the slopes of the bounded rows, if any; ``places``: rows and
    columns of the derivatives over the state, where they are in an order of their own."""
    if not functions.bounded:
        return None
    if places is None:
        own = functions.state_sparsity
        places = np.array(own.row(), dtype=int), np.array(own.get_col(), dtype=int)
    count, pattern = len(functions.bounded), dynamics.jacobian_pattern[dynamics.actuated]
    return RowSlopes.of(places, len(functions.state_terms) - count, count, pattern)


def step_symbols(dynamics: Dynamics) -> tuple[ca.SX, list[ca.SX], StepSymbols]:
    """The symbols p, and x_next, x, x_prev, u of a time step, and what a term sees of them."""
    n, p = dynamics.nx, ca.SX.sym("p", dynamics.layout.size)
    x_next, x, x_prev, u = (
        ca.SX.sym(s, k) for s, k in (("x_next", n), ("x", n), ("x_prev", n), ("u", dynamics.nu))
    )
    robot = dynamics if isinstance(dynamics, RobotDynamics) else None
    step = StepSymbols(x_next, x, x_prev, u, dynamics.layout.view(p), dynamics.actuated, robot)
    return p, [x_next, x, x_prev, u], step


@functools.lru_cache(maxsize=8)
@postponed()
def cost_text(functions: CostFunctions, dynamics: Dynamics) -> str:
    """C text of the costs with a time step in every lane, then assemble.c; stands after the
    dynamics' text in lanes."""
    calls = functions.calls
    text = [calls.lanes_text] if calls else []
    text += [calls.in_lanes(functions.state, 0), calls.in_lanes(functions.state_jac, 1)]
    own_parts: tuple[str, ...] = ()
    if functions.curvature is not None:
        text.append(calls.in_lanes(functions.curvature.function, 2))
        text.append(functions.curvature.tables())
        own_parts = ("curvature.c",)
    if functions.contact is not None:
        own = functions.contact
        shared = {3, 4, own.model.n_in() - 1}  # sphere, p, use
        text += [lanes_text(function, shared) for function in (own.value, own.model, own.exact)]
    sparsity = functions.state_sparsity
    rows = np.array(sparsity.row(), dtype=int)
    columns = np.array(sparsity.get_col(), dtype=int)
    tables = _tables(functions, dynamics, rows, columns)
    tables += "\n" + row_tables(rows, columns, dynamics.nx)
    if functions.contact is not None and isinstance(dynamics, RobotDynamics):
        tables += "\n" + contact_tables(functions.contact, dynamics.character)
    names = ("rows.c", "scatter.c", "sparse_rows.c", "contacts.c", *own_parts, "assemble.c")
    parts = [(resources.files("octo.problem") / name).read_text(encoding="utf-8") for name in names]
    if functions.pairs is not None:
        parts.insert(-1, functions.pairs.c_text)
    kept = kept_slopes(functions, dynamics)
    if kept is not None:
        parts.insert(-1, kept.c_text())
    return "\n".join([*text, tables, native.threads(), *parts])


def asked_of_world(functions: CostFunctions, dynamics: Dynamics) -> str:
    """C text, before that of the dynamics: which contacts of a world terms ask about where they
    carry nothing."""
    if not isinstance(dynamics, RobotDynamics) or not dynamics.looks:
        return ""
    own = functions.contact
    rests = {} if own is None else dict(zip(own.spheres, own.resting, strict=True))
    asked = [int(not rests.get(k, True)) for k in singles_of(dynamics.character)]
    return f"#define ASKED_OF_WORLD {{{', '.join(map(str, asked))}}}\n" if any(asked) else ""


@postponed()
def residual_text(
    functions: CostFunctions,
    dynamics: Dynamics,
    made: list[ca.Function],
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
) -> str:
    """``made`` of the costs' functions and their tables, in C that is CUDA too; stands after the
    text of the dynamics.

    rows, columns (NZ,): of the derivatives over the state, in the order that ``made`` writes them.
    """
    called = [functions.calls.numbers_text] if functions.calls else []
    written = [*called, *(function_of_numbers(function) for function in made)]
    rows_text = (resources.files("octo.problem") / "rows.c").read_text(encoding="utf-8")
    tables = [
        _tables(functions, dynamics, rows, columns),
        _block_tables(functions, dynamics, columns),
    ]
    return "\n".join([*written, *tables, rows_text])


def _block_tables(functions: CostFunctions, dynamics: Dynamics, columns: NDArray[np.intp]) -> str:
    """For a block of threads: how many derivatives, the last ones, are with respect to u; what
    coordinates move each contact."""
    own = functions.contact
    sizes = {
        "NZU": int((columns >= 3 * dynamics.nx).sum()),
        "NY": 0 if own is None else own.factors.size,
    }
    moves: dict[str, Any] = {}
    if functions.contact_spheres and isinstance(dynamics, RobotDynamics):
        robot = dynamics.character
        paths = [robot.path[robot.contacts[k].body] for k in functions.contact_spheres]
        moves["cost_contact_moves"] = [np.isin(np.arange(robot.nx), path) for path in paths]
    return tables_text(sizes, moves)


def _tables(
    functions: CostFunctions, dynamics: Dynamics, rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> str:
    """Sizes as macros, index tables as constant arrays."""
    own = functions.contact
    sizes = {
        "MU": len(dynamics.unactuated),
        "NU": dynamics.nu,
        "NQ": functions.numbers,
        "NBOUNDED": len(functions.bounded),
        "NTERM": len(functions.references.terms),
        "NR": len(functions.state_terms),
        "NZ": len(rows),
        "CR": len(own.terms) if own else 0,
        "NFC": len(functions.contact_spheres),
    }
    tables: dict[str, Any] = {
        "actuated": dynamics.actuated,
        "unactuated": dynamics.unactuated,
        "state_row_term": functions.state_terms,
        "state_entry_row": rows,
        "state_entry_column": columns,
        "contact_row_term": own.terms if own else (),
    }
    values: dict[str, Any] = {
        "cost_contact_data": (),
        "cost_contact_use": own.use.astype(float).ravel() if own else (),
    }
    if own and isinstance(dynamics, RobotDynamics):
        robot = dynamics.character
        spheres = [robot.contacts[k] for k in own.spheres]
        tables["cost_contact_body"] = [sphere.body for sphere in spheres]
        if dynamics.on_world:
            at = {k: g for g, k in enumerate(singles_of(robot))}
            tables["cost_contact_ground"] = [at.get(k, -1) for k in own.spheres]
        values["cost_contact_data"] = [
            number for sphere in spheres for number in (*sphere.position, sphere.radius)
        ]
    written = tables_text(sizes, tables, anew=True)
    return "\n".join([written, *(numbers_table(name, table) for name, table in values.items())])
