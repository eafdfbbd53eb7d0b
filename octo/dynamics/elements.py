"""Elements (octo/model/element.py) for the tree pass: stages of their forces, the tables of
elements.c.

What an element does to one of its bodies alone, a wrench and blocks (6, 6), goes down the tree like
a contact's. What couples the two branches of the tree are the derivatives of the force on one point
with respect to the other point: blocks (3, 3), between the velocities of the points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from octo.dynamics import slots, symbolic
from octo.dynamics.forms import about, g_form, moved, raised, rows, wrench
from octo.dynamics.parameters import Layout
from octo.dynamics.stages import OPTIONS, PREFIX
from octo.model.character import Character
from octo.model.element import names_of

SHARED = (1, 2)  # inputs that are the same for all lanes
SIGN = (-1.0, 1.0)  # of the force on points a and b


@dataclass(frozen=True, eq=False)
class Elements:
    """What the text of a robot's elements is made of.

    functions: the stages of each kind of force, in the order of the derivatives. sizes: macros.
    links: the link of each end that something moves. integers, points: tables of elements.c.
    """

    functions: tuple[ca.Function, ...]
    sizes: dict[str, int]
    links: tuple[int, ...]
    integers: dict[str, list[int]]
    points: Sequence[Sequence[float]]

    def text(self) -> str:
        """C text that calls a stage; the functions stand before it."""
        cases = []
        for k in range(len(self.functions) // 3):
            zero, one, two = (
                f"STAGE({function.name()}, arg, res);"
                for function in self.functions[3 * k : 3 * k + 3]
            )
            cases.append(
                f"    case {k}: if (order == 0) {zero} else if (order == 1) {one} else {two} break;"
            )
        return "\n".join(
            [
                "static inline void octo_element_stage(int kind, int order, "
                "const ARGUMENT **arg, real **res) {",
                "  switch (kind) {",
                *cases,
                "  }",
                "}",
            ]
        )


def elements_of(character: Character, layout: Layout, links: Sequence[int]) -> Elements:
    """``links``: the link of each body, -1 where it is fixed to the world."""
    found: dict[tuple[str, tuple[bool, bool]], int] = {}
    functions: list[ca.Function] = []
    names = ("body", "link", "end", "kind", "parameter", "dof", "moves", "start")
    table: dict[str, list[int]] = {name: [] for name in names}
    ends: list[int] = []
    table["start"].append(0)
    named, reaches = names_of(character.elements), slots.reaches(character)
    for k, element in enumerate(character.elements):
        bodies = [
            -1 if body is None else character.body_index(body)
            for body in (element.body_a, element.body_b)
        ]
        on = [links[b] if b >= 0 else -1 for b in bodies]
        law, live = symbolic.element_law(element), (on[0] >= 0, on[1] >= 0)
        key = law.serialize(), live  # elements of one kind share their functions
        if key not in found:
            found[key] = len(found)
            functions += [stage(order, found[key], law, live, layout) for order in (0, 1, 2)]
        table["body"] += bodies
        table["link"] += on
        table["kind"].append(found[key])
        for link in on:
            table["end"].append(len(ends) if link >= 0 else 0)
            ends += [link] if link >= 0 else []
        own = [layout.index(f"{named[k]}.{name}") for name in element.parameters]
        table["parameter"].append(own[0] if own else 0)  # they follow each other
        table["dof"] += reaches[k]
        table["moves"] += [
            sum((j in character.path[b]) << side for side, b in enumerate(bodies))
            for j in reaches[k]
        ]
        table["start"].append(len(table["dof"]))
    sizes = {
        "NELEMENT": len(character.elements),
        "NEND": len(ends),
        "NREACH": int(max(np.diff(table["start"]), default=0)),
    }
    points = [(*element.point_a, *element.point_b) for element in character.elements]
    return Elements(tuple(functions), sizes, tuple(ends), table, points)


def stage(
    order: int, kind: int, law: ca.Function, live: tuple[bool, bool], layout: Layout
) -> ca.Function:
    """The force of an element and its derivatives, as contributions to FD.

    Inputs: points (12) m: a and b of the next node, then of the present one; the element's
    parameters; p; V (12) of a's and b's link. Outputs: w of a and b; P and B1 of each, and C (3, 3)
    of the next and the present node, of each: -∂(force on it)/∂(other point); K, T1, L1 of each,
    and of ψ, ∂²ψ/∂a∂b, ∂²ψ/∂a∂b' and ∂²ψ/∂b∂a', ∂²ψ/∂a'∂b'. Of a point that nothing moves they
    are empty.
    """
    points, own = ca.SX.sym("points", 12), ca.SX.sym("own", law.numel_in(4))
    p, V, held = ca.SX.sym("p", layout.size), ca.SX.sym("V", 12), ca.SX.sym("delta", 6)
    f = law(points[:3], points[3:6], points[6:9], points[9:], own, layout.view(p)["dt"])
    psi = ca.dot(held[:3] - held[3:], f)  # -δ_a·(-f) - δ_b·f
    slopes = [ca.jacobian(f, points[3 * k : 3 * k + 3]) for k in range(4)]
    hessian, gradient = ca.hessian(psi, points)
    ends = [_End(k, points, V, SIGN[k] * f, slopes, live[k]) for k in (0, 1)]
    out = [end.wrench() for end in ends]
    both = all(live)
    if order >= 1:
        out += [block for end in ends for block in end.slopes()]
        for node in (0, 2):
            for end in (0, 1):
                out.append(_if(both, rows(-SIGN[end] * slopes[node + 1 - end])))
    if order == 2:
        out += [block for end in ends for block in end.curvature(gradient, hessian, held)]
        for a, b in ((0, 1), (0, 3), (1, 2), (2, 3)):
            out.append(_if(both, rows(hessian[3 * a : 3 * a + 3, 3 * b : 3 * b + 3])))
        out = ca.substitute(out, [held], [ca.vertcat(*(end.delta for end in ends))])
    return ca.Function(f"{PREFIX}element{kind}_{order}", [points, own, p, V], out, OPTIONS)


def _if(wanted: bool, output: ca.SX) -> ca.SX:
    return output if wanted else ca.SX(0, 1)


class _End:
    """One point of an element, its force and what its own body sees of it: a contact of radius 0
    (stages.contact)."""

    def __init__(
        self, k: int, points: ca.SX, V: ca.SX, force: ca.SX, slopes: Sequence[ca.SX], live: bool
    ):
        self.k, self.live, self.force = k, live, force
        self.point, self.before = points[3 * k : 3 * k + 3], points[6 + 3 * k : 9 + 3 * k]
        self.f_next, self.f_now = SIGN[k] * slopes[k], SIGN[k] * slopes[2 + k]
        self.delta = moved(V[6 * k : 6 * k + 6], self.point)

    def wrench(self) -> ca.SX:
        return _if(self.live, rows(-wrench(ca.SX(3, 1), self.force, self.point)))

    def slopes(self) -> list[ca.SX]:
        P = ca.blockcat([[ca.SX(3, 3), ca.skew(self.force)], [ca.SX(3, 3), -self.f_next]])
        B = ca.blockcat([[ca.SX(3, 6)], [ca.horzcat(ca.SX(3, 3), -self.f_now)]])
        return self._blocks(P, B)

    def curvature(self, gradient: ca.SX, hessian: ca.SX, held: ca.SX) -> list[ca.SX]:
        """K, T1, L1 of ψ = -δ·F + what the other point has; δ is carried by the body."""
        k, delta = self.k, held[3 * self.k : 3 * self.k + 3]
        now, then = slice(3 * k, 3 * k + 3), slice(6 + 3 * k, 9 + 3 * k)
        turned = ca.skew(delta)  # δ_τ = [-δ^ 0]
        # ∂²ψ/∂δ∂P is -f_next
        half = turned.T @ self.f_next
        K = ca.blockcat([[ca.SX(3, 3), half], [half.T, hessian[now, now]]])
        K += raised(g_form(-self.force @ delta.T, gradient[now]))
        T = ca.blockcat([[ca.SX(3, 3), turned.T @ self.f_now], [ca.SX(3, 3), hessian[now, then]]])
        L = ca.blockcat([[ca.SX(3, 3), ca.SX(3, 3)], [ca.SX(3, 3), hessian[then, then]]])
        L += raised(g_form(ca.SX(3, 3), gradient[then]))
        return [*self._blocks(K, T), _if(self.live, rows(about(L, self.before, self.before)))]

    def _blocks(self, next_next: ca.SX, next_now: ca.SX) -> list[ca.SX]:
        pair = about(next_next, self.point, self.point), about(next_now, self.point, self.before)
        return [_if(self.live, rows(block)) for block in pair]
