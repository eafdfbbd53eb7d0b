"""E over the contacts of a step and its derivatives to the twists of their bodies, as CasADi
functions.

A residual depends on where the sphere is and where its contact point was, in this step and in the
one before: twelve numbers y. E is differentiated twice with respect to y, y with respect to left
perturbations exp(outer^) exp(inner^) T of the body's three poses, and chained:

    gradient = y'ᵀ ∂E/∂y,    blocks = y'ᵀ ∂²E/∂y² y' + Σ_k ∂E/∂y_k y_k''

A joint's twist and that of one of its ancestors, which comes first, make a number of E's second
derivative out of a block (contacts.c); blocks of bodies that a joint carries may be summed before.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.laws import ContactLaw
from octo.dynamics.symbolic import Pose, contact_places, perturbed, pose_of
from octo.model.character import Character
from octo.model.quantities import GRAVITY
from octo.model.terrain import World, looked
from octo.problem.contact_costs import ContactCost
from octo.problem.references import References, blamed, sizes
from octo.problem.symbols import ContactSymbols
from octo.world.jet import SIZES

# pairs of nodes (next, now, previous), as HESS in phases.c
BLOCKS = ((0, 0), (0, 1), (0, 2), (1, 1), (2, 2), (1, 2))
# numbers of the gradient, to three twists, and of the blocks, row by row
TOUCHED = 18 + 36 * len(BLOCKS)


@dataclass(frozen=True, eq=False)
class ContactFunctions:
    """The terms over contacts: inputs T_next, T, T_prev (12 numbers each, R row by row), sphere
    (4), p, q, of a world its jets (20 each) at the sphere's centre at x_next and at x, use (CR,).

    value: the residuals r (CR,), without the input use. model, exact: gradient and blocks
    (TOUCHED,) of Σ use·q·r², by Gauss and Newton and with all of their curvature; factors: what
    these are made of. terms: of each residual. use (contacts, CR), spheres: of the contacts that
    have a term, as indices into the character's. resting (contacts,): those whose terms are zero
    where they carry nothing in this step and in the one before.
    """

    value: ca.Function
    model: ca.Function
    exact: ca.Function
    factors: Factors
    terms: tuple[int, ...]
    use: NDArray[np.bool_]
    spheres: tuple[int, ...]
    resting: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Factors:
    """Of the inputs of :class:`ContactFunctions`: y' (size, 18); ∂E/∂y and the upper triangle of
    ∂²E/∂y², column by column, by Gauss and Newton and exact; and Σ_k ∂E/∂y_k y_k'', as the
    blocks."""

    inputs: list[ca.SX]
    slopes: ca.SX
    model: ca.SX
    exact: ca.SX
    bend: ca.SX

    @property
    def size(self) -> int:
        """Of y."""
        return int(self.slopes.shape[0])


class _Weightless:
    """A contact law without a force: what is left of a term where its contact carries nothing."""

    def __init__(self, law: ContactLaw):
        self.parameters, self.reach = law.parameters, law.reach

    def force(self, depth: ca.SX, normal: ca.SX, velocity: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
        return ca.SX.zeros(3)


def contact_symbols(
    dynamics: RobotDynamics, p: ca.SX
) -> tuple[list[ca.SX], ContactSymbols, list[ca.SX]]:
    """The symbols T_next, T, T_prev of a body's poses, its sphere and y; what a term sees of them;
    of a world its jets at x_next and x, then the places that they belong to."""
    columns = [ca.SX.sym(f"T{k}", 12) for k in range(3)]
    sphere = ca.SX.sym("sphere", 4)
    place = ca.SX.sym("place", 12)
    next_, now, previous = (pose_of(column) for column in columns)
    view, ground = dynamics.layout.view(p), []
    seen = (view, view)
    if isinstance(dynamics.terrain, World):
        jets, at = ([ca.SX.sym(f"{name}{k}", size) for k in range(2)] for name, size in LOOKED_UP)
        ground = [*jets, *at]
        seen = (looked(view, jets[0], at[0]), looked(view, jets[1], at[1]))
    symbols = ContactSymbols(
        (next_, now, previous),
        ((place[:3], place[3:6]), (place[6:9], place[9:])),
        sphere[3],
        dynamics.law,
        dynamics.terrain,
        view,
        dynamics.character.mass * GRAVITY,
        seen,
    )
    return [*columns, sphere, place], symbols, ground


LOOKED_UP = (("jet", SIZES[-1]), ("at", 3))


def contact_inputs(robot: Character, contact: int, poses: Sequence[Sequence[Pose]]) -> list[ca.SX]:
    """T_next, T, T_prev of a contact's body, and its sphere.

    contact: its index.

    poses: of all bodies at x_next, x, x_prev.
    """
    sphere = robot.contacts[contact]
    own = [bodies[sphere.body] for bodies in poses]
    columns = [ca.vertcat(ca.vec(rotation.T), position) for rotation, position in own]
    return [*columns, ca.vertcat(ca.DM(sphere.position), sphere.radius)]


def _whole(factors: Factors, name: str) -> ca.Function:
    """Gradient and blocks from their factors."""
    size, numbers = factors.size, getattr(factors, name)
    gradient, upper = numbers[:size], ca.SX(ca.Sparsity.upper(size), numbers[size:])
    curvature = ca.triu2symm(upper)
    nodes = [factors.slopes[:, 6 * k : 6 * k + 6] for k in range(3)]
    out = []
    for k, (a, b) in enumerate(BLOCKS):
        block = ca.vec((nodes[a].T @ curvature @ nodes[b]).T)
        out.append(block + factors.bend[36 * k : 36 * k + 36] if name == "exact" else block)
    whole = ca.densify(ca.vertcat(factors.slopes.T @ gradient, *out))
    return ca.Function(f"octo_contact_{name}", factors.inputs, [whole], {"cse": True})


class ContactResiduals:
    """The residuals r of one contact as functions of y, and y as a function of the poses.

    terms: the term of each residual. resting: whether it is zero where the contact carries nothing.
    use (contacts, CR): whether a contact has it, of those in the character's ``spheres`` that have
    one.

    Parameters
    ----------
    feet: the contacts that touch the ground at the start. p, q: symbols of the numbers.
    """

    def __init__(
        self, dynamics: RobotDynamics, references: References, feet: list[int], p: ca.SX, q: ca.SX
    ):
        self.p, self.q = p, q
        (*self.columns, self.sphere, self.place), symbols, ground = contact_symbols(dynamics, p)
        sphere = self.sphere[:3], self.sphere[3]
        steps = [
            contact_places(*sphere, one, before, dynamics.terrain, view)
            for (one, before), view in zip(pairwise(symbols.poses), symbols.seen, strict=True)
        ]
        # of a world: inputs, and the places of their look-ups, which no derivative moves
        self.jets, self.at = ground[:2], ground[2:]
        self.centers = [center for center, _ in steps[: len(self.at)]]
        self.places = ca.vertcat(*steps[0], *steps[1])
        unloaded = replace(symbols, law=_Weightless(dynamics.law))
        residuals: list[ca.SX] = []
        self.terms: list[int] = []
        self.resting: list[bool] = []
        acts_on: list[Collection[int]] = []
        for k, term in enumerate(references.terms):
            if isinstance(term, ContactCost):
                term.check_square("is over contacts")
                with blamed(term, f"its residual cannot be built from {sizes(references, k)}"):
                    own = references.view(q, k)
                    value = term.shaped(term.contact_residual(symbols, own), own)
                    left = ca.SX(term.contact_residual(unloaded, own))
                residuals.append(value)
                self.terms += [k] * value.numel()
                self.resting += [bool(left.is_zero())] * value.numel()
                acts_on += [term.chosen(dynamics.character, feet)] * value.numel()
        self.r = ca.vertcat(*residuals)
        possible = dynamics.character.terrain_contacts
        use = np.array([[c in chosen for chosen in acts_on] for c in possible], dtype=bool)
        use = use.reshape(len(possible), len(acts_on))
        live = np.flatnonzero(use.any(axis=1))
        self.use, self.spheres = use[live], tuple(int(possible[c]) for c in live)

    @property
    def structure(self) -> tuple[Any, ...]:
        """What tells one list of terms from another."""
        inputs = [*self.columns, self.sphere, self.place, self.p, self.q, *self.jets, *self.at]
        written = ca.Function("contact", inputs, [self.r]).serialize()
        return tuple(self.terms), written, self.use.tobytes(), self.spheres

    def derived(self) -> ContactFunctions:
        """The functions of the residuals and of E's derivatives."""
        factors = self.factors()
        value = ca.Function(
            "octo_contact_cost", factors.inputs[:-1], [self.at_poses(self.r)], {"cse": True}
        )
        model, exact = (_whole(factors, name) for name in ("model", "exact"))
        resting = (~self.use | np.array(self.resting)).all(axis=1)
        return ContactFunctions(
            value, model, exact, factors, tuple(self.terms), self.use, self.spheres, resting
        )

    def at_poses(self, expression: ca.SX) -> ca.SX:
        """An expression of y as one of the poses."""
        if self.at:
            own = [self.place[:3], self.place[6:9]]
            expression = ca.substitute([expression], self.at, own)[0]
        return self._here(ca.densify(ca.substitute(expression, self.place, self.places)))

    def _here(self, expression: ca.SX) -> ca.SX:
        """With the look-ups where the sphere is."""
        if not self.at:
            return expression
        # equal places become one, and their differences nothing when all is written anew
        made = ca.cse(ca.substitute([expression], self.at, self.centers)[0])
        free = ca.symvar(made)
        return ca.Function("anew", free, [made])(*free) if free else made

    def factors(self) -> Factors:
        """E of the contact, differentiated."""
        poses, use = ca.vertcat(*self.columns), ca.SX.sym("use", len(self.terms))
        whole = ca.depends_on(self.r, poses)  # a user's own term may look at the poses themselves
        y, value = (
            (ca.vertcat(self.place, poses), ca.vertcat(self.places, poses))
            if whole
            else (self.place, self.places)
        )
        coefficient = ca.vertcat(*[self.q[k] for k in self.terms]) * use
        energy, rows = ca.dot(coefficient, self.r**2), ca.jacobian(self.r, y)
        curvature, gradient = ca.hessian(energy, y)
        upper = ca.Sparsity.upper(y.numel())
        model, exact = (
            self.at_poses(ca.vertcat(gradient, *ca.project(ca.densify(square), upper).nonzeros()))
            for square in (2.0 * rows.T @ ca.diag(coefficient) @ rows, curvature)
        )
        slopes, bend = self._moved(value, self.at_poses(gradient))
        inputs = [*self.columns, self.sphere, self.p, self.q, *self.jets, use]
        return Factors(inputs, slopes, model, exact, bend)

    def _moved(self, y: ca.SX, gradient: ca.SX) -> tuple[ca.SX, ca.SX]:
        """y' (size, 18), and the blocks of ``gradient`` times y''."""
        outer = ca.SX.sym("outer", 18)
        inner = ca.SX.sym("inner", 18)
        nodes = [slice(6 * k, 6 * k + 6) for k in range(3)]
        moved = [
            perturbed(perturbed(T, inner[at]), outer[at])
            for T, at in zip(self.columns, nodes, strict=True)
        ]
        y = ca.substitute(y, ca.vertcat(*self.columns), ca.vertcat(*moved))
        still, pull = [ca.vertcat(outer, inner), ca.SX.zeros(36)], ca.SX.sym("pull", y.numel())
        pulled, blocks = ca.gradient(ca.dot(pull, y), inner), []
        for a, b in BLOCKS:
            # rows of b, columns of a
            block = ca.jacobian(pulled[nodes[b]], outer if a == b else inner)[:, nodes[a]]
            blocks.append(ca.vec(ca.densify(block)))
        bend = ca.substitute(ca.substitute(ca.vertcat(*blocks), *still), pull, gradient)
        return self._here(ca.substitute(ca.jacobian(y, inner), *still)), self._here(bend)
