"""Contact between bodies, for the tree pass (bodies.c): a sphere of body A against a solid of B.

Seen from B nothing is new: A's sphere touches a surface that stands still, so that the stage of a
contact with the ground (stages.py) is called with the solid as the ground and with A's pose
*relative to B* one step ago, T_A' = T_B T_B_now⁻¹ T_A_now. It gives the wrench w on A, P = ∂w/∂α,
B = ∂w/∂α' of left perturbations of A and, with v = V_A − V_B carried by A, the curvature K, T, L.

What a perturbation β of B does follows, for all of it may move together and nothing changes. With
W the form w·[τ, σ] of two twists and ψ = v·w:

    ∂w_A/∂β = W − P    ∂w_B/∂α = −P    ∂w_B/∂β = P − W    (of the present node ±B alone)

V_B is carried by B and not by A: with ad the matrix of [V_B, ·], K becomes K − adᵀP − Pᵀad − W ad
and T becomes T − adᵀB. Then, K of A, T of A and A', L of A':

    of B: Kᵀ, T, Lᵀ    of A and B: −Kᵀ    of A and B', of B and A': −T    of A' and B': −Lᵀ
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from octo.checks import Array
from octo.dynamics import slots, stages
from octo.dynamics.forms import rows
from octo.dynamics.laws import ContactLaw
from octo.dynamics.parameters import Layout
from octo.dynamics.stages import OPTIONS, PREFIX
from octo.dynamics.symbolic import pose_of
from octo.model.character import Character
from octo.model.solid import NUMBERS, Solid, surface
from octo.model.terrain import Terrain

# of a solid as ground: its pose in the world, then its numbers
PLACED = tuple(f"solid{k}" for k in range(NUMBERS))
# inputs that are p or of a table, the same for all lanes
SHARED = {"mutual": (4, 5, 6), "reach": (2, 3, 4)}


@dataclass(frozen=True, eq=False)
class Mutuals:
    """What the text of contacts between bodies is made of: stages, sizes (macros) and tables of
    bodies.c. Pairs that nothing moves are left out."""

    stages: tuple[ca.Function, ...]
    kinds: tuple[str, ...]
    sizes: dict[str, int]
    integers: dict[str, list[int]]
    numbers: dict[str, Array]

    def text(self) -> str:
        """C text that calls a stage by the kind of its solid; the functions stand before it."""
        reach, force = [], []
        for k, kind in enumerate(self.kinds):
            reach.append(f"    case {k}: STAGE({PREFIX}reach_{kind}, arg, res); break;")
            calls = " ".join(
                f"if (order == {order}) STAGE({PREFIX}mutual_{kind}{order}, arg, res);"
                for order in (0, 1, 2)
            )
            force.append(f"    case {k}: {calls} break;")
        arguments = "const ARGUMENT **arg, real **res) {\n  switch (k) {"
        return "\n".join(
            [
                f"static inline void octo_mutual_reach(int k, {arguments}",
                *reach,
                "  }\n}",
                f"static inline void octo_mutual_stage(int k, int order, {arguments}",
                *force,
                "  }\n}",
            ]
        )


def mutuals_of(
    character: Character, layout: Layout, law: ContactLaw, links: Sequence[int]
) -> Mutuals:
    """``links``: the link of each body, -1 where it is fixed to the world."""
    names = ("body", "link", "kind", "dof", "moves", "start")
    table: dict[str, list[int]] = {name: [] for name in names}
    spheres: list[Array] = []
    solids: list[Array] = []
    kinds: dict[str, Solid] = {}
    table["start"].append(0)
    ends, reaches = slots.mutual_ends(character), slots.mutual_reaches(character)
    found = zip(character.touches, ends, reaches, strict=True)
    for (c, s), bodies, dofs in found:
        if links[bodies[0]] < 0 and links[bodies[1]] < 0:
            continue
        sphere, solid = character.contacts[c], character.solids[s]
        kinds.setdefault(solid.kind, solid)
        table["body"] += bodies
        table["link"] += [links[b] for b in bodies]
        table["kind"].append(list(kinds).index(solid.kind))
        table["dof"] += dofs
        table["moves"] += [
            sum((j in character.path[b]) << side for side, b in enumerate(bodies)) for j in dofs
        ]
        table["start"].append(len(table["dof"]))
        spheres.append(np.append(sphere.position, sphere.radius))
        solids.append(solid.numbers)
    sizes = {"NMUTUAL": len(spheres), "NMUTUALREACH": int(max(np.diff(table["start"]), default=0))}
    made: list[ca.Function] = []
    for one in kinds.values():
        made.append(reach(layout, law, one))
        made += [mutual(order, layout, law, one) for order in (0, 1, 2)]
    numbers = {"sphere": np.array(spheres), "solid": np.array(solids)}
    return Mutuals(tuple(made), tuple(kinds), sizes, table, numbers)


def _surface(solid: Solid) -> Terrain:
    """A solid as ground, its pose and numbers among the ground's parameters."""

    def phi(point: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
        rotation, position = pose_of(ca.vertcat(*(p[name] for name in PLACED[:12])))
        own = ca.vertcat(*(p[name] for name in PLACED[12:]))
        return surface(solid, point, rotation, position, own)

    return Terrain(phi, dict.fromkeys(PLACED, 0.0))


def _grounded(layout: Layout) -> Layout:
    """p with a solid's numbers in place of those of the ground."""
    kept = {
        name: float(value)
        for name, value in zip(layout.names, layout.defaults, strict=True)
        if not name.startswith("terrain.")
    }
    return Layout.of({**kept, **{f"terrain.{name}": 0.0 for name in PLACED}})


def _parameters(layout: Layout, p: ca.SX, body: ca.SX, solid: ca.SX) -> ca.SX:
    """The numbers of ``_grounded``, of a solid of a body at a pose (12,)."""
    (R, t), (R_own, t_own) = pose_of(body), pose_of(solid[:12])
    own = layout.view(p)
    kept = [own[name] for name in layout.names if not name.startswith("terrain.")]
    return ca.vertcat(*kept, ca.vec((R @ R_own).T), R @ t_own + t, solid[12:])


def reach(layout: Layout, law: ContactLaw, like: Solid) -> ca.Function:
    """Depth plus reach (m) of one contact: it is active where this is positive. Inputs: centre (3)
    of the sphere, next pose of B (12), radius, solid (16), p."""
    center, pose, radius = ca.SX.sym("center", 3), ca.SX.sym("pose", 12), ca.SX.sym("radius")
    solid, p = ca.SX.sym("solid", NUMBERS), ca.SX.sym("p", layout.size)
    gap = stages.gap(_grounded(layout), law, _surface(like))
    depth = gap(center, radius, _parameters(layout, p, pose, solid))
    inputs = [center, pose, radius, solid, p]
    return ca.Function(f"{PREFIX}reach_{like.kind}", inputs, [ca.densify(depth)], OPTIONS)


def mutual(order: int, layout: Layout, law: ContactLaw, like: Solid) -> ca.Function:
    """The contact of a sphere of A with a solid of B.

    Inputs: next and present pose of A, of B (12 each), sphere (4: place, radius), solid (16), p,
    V (12) of A and of B. Outputs: w; P, B; K, T, L, of A, about the world's origin.
    """
    flat = [ca.SX.sym(name, 12) for name in ("A", "A_now", "B", "B_now")]
    sphere, solid = ca.SX.sym("sphere", 4), ca.SX.sym("solid", NUMBERS)
    p, V = ca.SX.sym("p", layout.size), ca.SX.sym("V", 12)
    (R1, t1), (R, t), (R_old, t_old) = (pose_of(f) for f in flat[1:])
    turn = R @ R_old.T  # of T_B T_B_now⁻¹
    shift = t - turn @ t_old
    before = ca.vertcat(ca.vec((turn @ R1).T), turn @ t1 + shift)
    ground = stages.contact(order, _grounded(layout), law, _surface(like))
    V_B = V[6:]
    found = ground(flat[0], before, sphere, _parameters(layout, p, flat[2], solid), V[:6] - V_B)
    out = list(found) if order else [found]
    if order >= 1:
        P, B = (ca.reshape(block, 6, 6).T for block in out[1:3])
        moved = _adjoint(turn, shift)
        out[2] = rows(B @ moved)
    if order == 2:
        K, T, L = (ca.reshape(block, 6, 6).T for block in out[3:])
        ad, W = _ad(V_B), _bracket(out[0])
        bent = ad.T @ P
        out[3] = rows(K - bent - bent.T - W @ ad)
        out[4] = rows((T - ad.T @ B) @ moved)
        out[5] = rows(moved.T @ L @ moved)
    inputs = [*flat, sphere, solid, p, V]
    dense = [ca.densify(block) for block in out]
    return ca.Function(f"{PREFIX}mutual_{like.kind}{order}", inputs, dense, OPTIONS)


def _adjoint(turn: ca.SX, shift: ca.SX) -> ca.SX:
    """(6, 6) of a rigid motion, on twists."""
    return ca.blockcat([[turn, ca.SX(3, 3)], [ca.skew(shift) @ turn, turn]])


def _ad(V: ca.SX) -> ca.SX:
    """(6, 6) of the bracket [V, ·] of twists."""
    omega, v = ca.skew(V[:3]), ca.skew(V[3:])
    return ca.blockcat([[omega, ca.SX(3, 3)], [v, omega]])


def _bracket(w: ca.SX) -> ca.SX:
    """(6, 6) of the form w·[τ, σ] of a wrench."""
    moment, force = ca.skew(w[:3]), ca.skew(w[3:])
    return -ca.blockcat([[moment, force], [force, ca.SX(3, 3)]])
