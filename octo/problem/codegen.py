"""The costs as CasADi functions of one step and of one contact, and as the C text that assemble.c works from.

A step's residuals are a function of (x_next, x, x_prev, u, p, q); those over contacts a function of the three poses of
the contact's body, differentiated with respect to left perturbations exp(ξ)·T of them, so that they chain with the
twists that the dynamics' tree pass already has. q (NQ) starts with one coefficient per term, then come the references.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo.checks import numbers
from octo.dynamics import symbolic
from octo.dynamics.balance import GRAVITY
from octo.dynamics.codegen import integers, lanes_text
from octo.dynamics.emit import function_of_numbers
from octo.dynamics.evaluate import Dynamics, RobotDynamics
from octo.dynamics.long import COSTLY, check_length
from octo.errors import OctoError, ProblemError, ShapeError, ValueRangeError
from octo.model.kinematics import sphere_centers
from octo.model.terrain import signed_distance
from octo.problem.contact_costs import ContactCost
from octo.problem.costs import Cost, NeighbourCost
from octo.problem.symbols import ContactSymbols, Setting, StepSymbols

if TYPE_CHECKING:
    from octo.problem.problem import Problem

Array = NDArray[np.float64]
TOUCHING = 0.01  # m above the ground up to which a contact is a foot at the start


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
        """q (N, NQ): coefficient weight/(scale·N) of each term (weight/scale at the last step alone), references."""
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
                raise ProblemError(f"{term.label} has the references {list(found)}, must have {list(self.places[k])}")
            for name, rows in found.items():
                place = self.places[k][name]
                allowed = ((), (place.stop - place.start,), (steps, place.stop - place.start))
                if rows.shape not in allowed:
                    raise ShapeError(f"{term.label}.{name}", rows.shape, f"{allowed[1]} or {allowed[2]}")
                q[:, place] = rows
        return q


def _references(term: Cost, setting: Setting) -> dict[str, Array]:
    """A term's references as finite arrays."""
    with blamed(term, "its references cannot be formed"):
        values = dict(term.references(setting))
    return {name: numbers(f"{term.label}.{name}", value) for name, value in values.items()}


def sizes(references: References, term: int) -> str:
    """The references of a term and how many numbers each has, for a message."""
    places = references.places[term]
    return ", ".join(f"{name} ({place.stop - place.start},)" for name, place in places.items()) or "no references"


@contextlib.contextmanager
def blamed(term: Cost, sentence: str) -> Iterator[None]:
    """Whatever goes wrong inside (a user's code may raise anything) is one sentence that names the term."""
    try:
        yield
    except OctoError:
        raise
    except Exception as error:
        said = re.sub(r"^\S*\.hpp:\d+: ", "", str(error).strip().split("\n")[0])  # CasADi names its own source file
        raise ProblemError(f"{term.label}: {sentence}: {type(error).__name__}: {said}") from error


@dataclass(frozen=True, eq=False)
class CostFunctions:
    """The residuals of a list of terms, ready to be evaluated, differentiated and written as C."""

    references: References
    state: ca.Function  # (x_next, x, x_prev, u, p, q) -> r (NR,)
    state_jac: ca.Function  # -> r, nonzeros of dr/d(x_next, x, x_prev, u)
    state_sparsity: ca.Sparsity
    state_terms: tuple[int, ...]  # term of each row
    contact: ca.Function | None  # (T_next, T, T_prev, sphere, p, q) -> r (CR,)
    contact_jac: ca.Function | None  # -> r, dr/d(twists) (CR·18,)
    contact_terms: tuple[int, ...]
    contact_use: NDArray[np.bool_]  # (contacts, CR)
    contact_spheres: tuple[int, ...]  # indices into the character's contacts

    @property
    def rows(self) -> int:
        return len(self.state_terms) + len(self.contact_spheres) * len(self.contact_terms)


def cost_functions(dynamics: Dynamics, terms: Sequence[Cost], setting: Setting, between_controls: bool) -> CostFunctions:
    """Residuals and first derivatives of all terms; ``between_controls`` leaves those over neighbouring controls out."""
    references = References.of(terms, setting)
    p, q = ca.SX.sym("p", dynamics.layout.size), ca.SX.sym("q", max(references.size, 1))
    state = _state_functions(dynamics, references, p, q, between_controls)
    contact = _contact_functions(dynamics, references, setting, p, q)
    return CostFunctions(references, *state, *contact)


def step_symbols(dynamics: Dynamics, p: ca.SX) -> tuple[list[ca.SX], StepSymbols]:
    """The symbols x_next, x, x_prev, u of a time step, and what a term sees of them."""
    n = dynamics.nx
    x_next, x, x_prev, u = (ca.SX.sym(s, k) for s, k in (("x_next", n), ("x", n), ("x_prev", n), ("u", dynamics.nu)))
    robot = dynamics.character if isinstance(dynamics, RobotDynamics) else None
    return [x_next, x, x_prev, u], StepSymbols(x_next, x, x_prev, u, dynamics.layout.view(p), dynamics.actuated, robot)


def contact_symbols(dynamics: RobotDynamics, p: ca.SX, twists: Sequence[ca.SX] = ()) -> tuple[list[ca.SX], ContactSymbols]:
    """The symbols T_next, T, T_prev of a body's poses and its sphere, and what a term over contacts sees of them.

    twists: left perturbations of the three poses, if any.
    """
    columns, sphere = [ca.SX.sym(f"T{k}", 12) for k in range(3)], ca.SX.sym("sphere", 4)
    poses = [_pose(column) for column in columns]
    if twists:
        poses = [_perturbed(pose, twist) for pose, twist in zip(poses, twists, strict=True)]
    weight = dynamics.character.mass * GRAVITY
    symbols = ContactSymbols(
        (poses[0], poses[1], poses[2]), sphere[:3], sphere[3], dynamics.law, dynamics.terrain, dynamics.layout.view(p), weight
    )
    return [*columns, sphere], symbols


def _state_functions(dynamics: Dynamics, references: References, p: ca.SX, q: ca.SX, between_controls: bool) -> Any:
    (x_next, x, x_prev, u), step = step_symbols(dynamics, p)
    residuals, rows = [ca.SX(0, 1)], []
    for k, term in enumerate(references.terms):
        if isinstance(term, ContactCost) or (between_controls and isinstance(term, NeighbourCost)):
            continue
        with blamed(term, f"its residual cannot be built from {sizes(references, k)}"):
            value = ca.vec(ca.SX(term.residual(step, references.view(q, k))))
        residuals.append(value)
        rows += [k] * value.numel()
    r = ca.densify(ca.vertcat(*residuals))
    jac = ca.jacobian(r, ca.vertcat(x_next, x, x_prev, u))
    inputs = [x_next, x, x_prev, u, p, q]
    nonzeros = ca.vertcat(*jac.nonzeros()) if jac.nnz() else ca.SX(0, 1)
    length = ca.Function("length", inputs, [r, nonzeros]).n_instructions()
    if length >= COSTLY:
        check_length("terms of E", length, f"the longest is {_longest(residuals[1:], references, inputs)}, write it in fewer")
    function = ca.Function("octo_state_cost", inputs, [r], {"cse": True})
    jacobian = ca.Function("octo_state_cost_jac", inputs, [r, nonzeros], {"cse": True})
    return function, jacobian, jac.sparsity(), tuple(rows)


def _longest(residuals: Sequence[ca.SX], references: References, inputs: Sequence[ca.SX]) -> str:
    """The label of the longest term over a step."""
    sizes = [ca.Function("length", list(inputs), [residual]).n_instructions() for residual in residuals]
    alone = [term for term in references.terms if not isinstance(term, ContactCost)]
    return alone[int(np.argmax(sizes))].label if sizes else "none"


def touching(dynamics: RobotDynamics, setting: Setting) -> list[int]:
    """The contacts that touch the ground at the start, as indices into the robot's."""
    robot, possible = dynamics.character, list(dynamics.character.terrain_contacts)
    radius = np.array([robot.contacts[k].radius for k in possible])
    centers = sphere_centers(robot, setting.x0)[possible]
    gap = signed_distance(dynamics.terrain, centers, dynamics.terrain.parameters) - radius
    return [k for k, distance in zip(possible, gap, strict=True) if distance < TOUCHING]


def touching_names(problem: Problem) -> tuple[str, ...]:
    """Names of the contacts that touch the ground at the start: what ``contacts="feet"`` means."""
    dynamics = problem.dynamics
    if not isinstance(dynamics, RobotDynamics):
        raise ProblemError("user-written dynamics have no contacts")
    return tuple(dynamics.character.contacts[k].name for k in touching(dynamics, problem.setting))


def _contact_functions(dynamics: Dynamics, references: References, setting: Setting, p: ca.SX, q: ca.SX) -> Any:
    chosen = [(k, term) for k, term in enumerate(references.terms) if isinstance(term, ContactCost)]
    if not chosen:
        return None, None, (), np.zeros((0, 0), dtype=bool), ()
    if not isinstance(dynamics, RobotDynamics):
        raise ProblemError(f"{chosen[0][1].label} is over contacts, which user-written dynamics do not have")
    robot, feet = dynamics.character, touching(dynamics, setting)
    twists = [ca.SX.sym(f"twist{k}", 6) for k in range(3)]
    places, symbols = contact_symbols(dynamics, p, twists)
    residuals, rows, use = [], [], []
    for k, term in chosen:
        with blamed(term, f"its residual cannot be built from {sizes(references, k)}"):
            value = ca.vec(ca.SX(term.contact_residual(symbols, references.view(q, k))))
        acts_on = term.chosen(robot, feet)
        residuals.append(value)
        rows += [k] * value.numel()
        use += [[c in acts_on for c in robot.terrain_contacts]] * value.numel()
    r = ca.densify(ca.vertcat(*residuals))
    moved = ca.vertcat(*twists)
    still = ca.SX.zeros(18)
    jac = ca.densify(ca.substitute(ca.jacobian(r, moved), moved, still))
    r = ca.substitute(r, moved, still)
    inputs = [*places, p, q]
    function = ca.Function("octo_contact_cost", inputs, [r], {"cse": True})
    jacobian = ca.Function("octo_contact_cost_jac", inputs, [r, ca.vec(jac.T)], {"cse": True})
    table = np.array(use, dtype=bool).T
    live = np.flatnonzero(table.any(axis=1))
    spheres = tuple(int(robot.terrain_contacts[c]) for c in live)
    return function, jacobian, tuple(rows), table[live], spheres


def _pose(column: ca.SX) -> symbolic.Pose:
    """R and t of 12 numbers, R row by row."""
    return ca.reshape(column[:9], 3, 3).T, column[9:]


def _perturbed(pose: symbolic.Pose, twist: ca.SX) -> symbolic.Pose:
    """exp(twist)·T to first order; twist is (ω, v of the point at the world's origin)."""
    turn = ca.SX.eye(3) + ca.skew(twist[:3])
    return turn @ pose[0], turn @ pose[1] + twist[3:]


def cost_text(functions: CostFunctions, dynamics: Dynamics) -> str:
    """C text of the costs with a time step in every lane, then assemble.c; stands after the dynamics' text in lanes."""
    text = [lanes_text(function, {4}) for function in (functions.state, functions.state_jac)]  # shared: p
    if functions.contact is not None:  # sphere and p
        text += [lanes_text(function, {3, 4}) for function in (functions.contact, functions.contact_jac)]
    sparsity = functions.state_sparsity
    tables = _tables(functions, dynamics, np.array(sparsity.row(), dtype=int), np.array(sparsity.get_col(), dtype=int))
    parts = ((resources.files("octo.problem") / name).read_text() for name in ("threads.c", "rows.c", "scatter.c", "assemble.c"))
    return "\n".join([*text, tables, *parts])


def residual_text(
    functions: CostFunctions, dynamics: Dynamics, made: list[ca.Function], rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> str:
    """``made`` of the costs' functions and their tables, in C that is CUDA too; stands after the text of the dynamics.

    rows, columns (NZ,): of the derivatives over the state, in the order that ``made`` writes them.
    """
    written = [function_of_numbers(function) for function in made]
    rows_text = (resources.files("octo.problem") / "rows.c").read_text()
    tables = [_tables(functions, dynamics, rows, columns), _block_tables(functions, dynamics, columns)]
    return "\n".join([*written, *tables, rows_text])


def _block_tables(functions: CostFunctions, dynamics: Dynamics, columns: NDArray[np.intp]) -> str:
    """For a block of threads: how many derivatives, the last ones, are with respect to u; what coordinates move each contact."""
    lines = [f"#define NZU {int((columns >= 3 * dynamics.nx).sum())}"]
    if functions.contact_spheres and isinstance(dynamics, RobotDynamics):
        robot = dynamics.character
        moves = np.zeros((len(functions.contact_spheres), robot.nx), dtype=int)
        for k, sphere in enumerate(functions.contact_spheres):
            moves[k, list(robot.path[robot.contacts[sphere].body])] = 1
        lines.append(integers("cost_contact_moves", moves))
    return "\n".join(lines)


def _tables(functions: CostFunctions, dynamics: Dynamics, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> str:
    """Sizes as macros, index tables as constant arrays."""
    sizes = {
        "MU": len(dynamics.unactuated), "NU": dynamics.nu, "NQ": max(functions.references.size, 1),
        "NTERM": len(functions.references.terms), "NR": len(functions.state_terms), "NZ": len(rows),
        "CR": len(functions.contact_terms), "NFC": len(functions.contact_spheres),
    }  # fmt: skip
    lines = [f"#undef {name}\n#define {name} {value}" for name, value in sizes.items()]
    tables: dict[str, Any] = {
        "actuated": dynamics.actuated, "unactuated": dynamics.unactuated, "state_row_term": functions.state_terms,
        "state_entry_row": rows, "state_entry_column": columns, "contact_row_term": functions.contact_terms,
        "cost_contact_use": functions.contact_use.astype(int).ravel(),
    }  # fmt: skip
    data: list[float] = []
    if functions.contact_spheres and isinstance(dynamics, RobotDynamics):
        robot = dynamics.character
        spheres = [robot.contacts[k] for k in functions.contact_spheres]
        tables["cost_contact_body"] = [sphere.body for sphere in spheres]
        tables["cost_path_start"] = np.concatenate([[0], np.cumsum([len(path) for path in robot.path])])
        tables["cost_path"] = [j for path in robot.path for j in path]
        for sphere in spheres:
            data += [*sphere.position, sphere.radius]
    lines += [integers(name, values) for name, values in tables.items()]
    numbers = ", ".join(float(v).hex() for v in data) or "0.0"
    lines.append(f"static const double octo_cost_contact_data[] = {{{numbers}}};")
    return "\n".join(lines)
