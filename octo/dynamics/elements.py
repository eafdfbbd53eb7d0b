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

    stages: of each kind of force those of point a, of point b and of what is between them, each in
    the order of the derivatives; none of what nothing moves. sizes: macros. links: the link of each
    end that something moves. integers, points: tables of elements.c.
    """

    stages: tuple[tuple[tuple[ca.Function, ...], ...], ...]
    sizes: dict[str, int]
    links: tuple[int, ...]
    integers: dict[str, list[int]]
    points: Sequence[Sequence[float]]

    @property
    def functions(self) -> list[ca.Function]:
        return [function for kind in self.stages for part in kind for function in part]

    def text(self) -> str:
        """C text that calls a part of a stage; the functions stand before it."""
        cases = []
        for k, kind in enumerate(self.stages):
            for part, functions in enumerate(kind):
                calls = " ".join(
                    f"if (order == {2 - back}) STAGE({function.name()}, arg, res);"
                    for back, function in enumerate(reversed(functions))
                )
                cases.append(f"    case {3 * k + part}: {calls} break;")
        head = "static inline void octo_element_stage(int k, int order, const ARGUMENT **arg, "
        return "\n".join([f"{head}real **res) {{", "  switch (k) {", *cases, "  }", "}"])


def elements_of(character: Character, layout: Layout, links: Sequence[int]) -> Elements:
    """``links``: the link of each body, -1 where it is fixed to the world."""
    found: dict[tuple[str, tuple[bool, bool]], int] = {}
    stages: list[tuple[tuple[ca.Function, ...], ...]] = []
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
            stages.append(stages_of(found[key], law, live, layout))
        table["body"] += bodies
        table["link"] += on
        table["kind"].append(found[key])
        for link in on:
            table["end"].append(len(ends) if link >= 0 else 0)
            ends += [link] if link >= 0 else []
        own = [layout.index(f"{named[k]}.{name}") for name in element.parameters]
        table["parameter"].append(own[0] if own else 0)  # they follow each other
        table["dof"] += reaches[k]
        for j in reaches[k]:
            moved = sum((j in character.path[b]) << side for side, b in enumerate(bodies))
            table["moves"].append(moved)
        table["start"].append(len(table["dof"]))
    reach = int(max(np.diff(table["start"]), default=0))
    sizes = {"NELEMENT": len(character.elements), "NEND": len(ends), "NREACH": reach}
    points = [(*element.point_a, *element.point_b) for element in character.elements]
    return Elements(tuple(stages), sizes, tuple(ends), table, points)


def stages_of(
    kind: int, law: ca.Function, live: tuple[bool, bool], layout: Layout
) -> tuple[tuple[ca.Function, ...], ...]:
    """The stages of a force, as contributions to FD: of point a, of point b, of what is between.

    One long function would need more registers than a GPU's thread has. Inputs: points (12) m: a
    and b of the next node, then of the present one; the element's parameters; p; V (12) of a's and
    b's link. Outputs of a point: w; P, B1; K, T1, L1. Between: C (3, 3) of the next and the present
    node, of each point: -∂(force on it)/∂(other point); and of ψ, ∂²ψ/∂a∂b, ∂²ψ/∂a∂b' and
    ∂²ψ/∂b∂a', ∂²ψ/∂a'∂b'.
    """
    points, own = ca.SX.sym("points", 12), ca.SX.sym("own", law.numel_in(4))
    p, V, held = ca.SX.sym("p", layout.size), ca.SX.sym("V", 12), ca.SX.sym("delta", 6)
    f = law(points[:3], points[3:6], points[6:9], points[9:], own, layout.view(p)["dt"])
    psi = ca.dot(held[:3] - held[3:], f)  # -δ_a·(-f) - δ_b·f
    slopes = [ca.jacobian(f, points[3 * k : 3 * k + 3]) for k in range(4)]
    hessian, gradient = ca.hessian(psi, points)
    ends = [_End(k, points, V, SIGN[k] * f, slopes) for k in (0, 1)]
    parts = [[end.wrench(), end.slopes(), end.curvature(gradient, hessian, held)] for end in ends]
    coupled = [-SIGN[end] * slopes[node + 1 - end] for node in (0, 2) for end in (0, 1)]
    bent = [
        hessian[3 * a : 3 * a + 3, 3 * b : 3 * b + 3] for a, b in ((0, 1), (0, 3), (1, 2), (2, 3))
    ]
    parts.append([[], coupled, bent])
    delta = ca.vertcat(*(end.delta for end in ends))
    made = []
    for part, wanted in enumerate((*live, all(live))):
        functions = []
        for order in range(3) if wanted else ():
            out = [rows(block) for some in parts[part][: order + 1] for block in some]
            if out:
                name = f"{PREFIX}element{kind}_{'abc'[part]}{order}"
                out = ca.substitute(out, [held], [delta])
                functions.append(ca.Function(name, [points, own, p, V], out, OPTIONS))
        made.append(tuple(functions))
    return tuple(made)


class _End:
    """One point of an element and what its own body sees of it: a contact of radius 0."""

    def __init__(self, k: int, points: ca.SX, V: ca.SX, force: ca.SX, slopes: Sequence[ca.SX]):
        self.k, self.force = k, force
        self.point, self.before = points[3 * k : 3 * k + 3], points[6 + 3 * k : 9 + 3 * k]
        self.f_next, self.f_now = SIGN[k] * slopes[k], SIGN[k] * slopes[2 + k]
        self.delta = moved(V[6 * k : 6 * k + 6], self.point)

    def wrench(self) -> list[ca.SX]:
        return [-wrench(ca.SX(3, 1), self.force, self.point)]

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
        return [*self._blocks(K, T), about(L, self.before, self.before)]

    def _blocks(self, next_next: ca.SX, next_now: ca.SX) -> list[ca.SX]:
        return [about(next_next, self.point, self.point), about(next_now, self.point, self.before)]
