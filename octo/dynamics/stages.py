"""The laws of §4, each once, as small CasADi functions that the tree pass of ``phases.c`` calls.

A stage returns a wrench w (6,) about the world origin (moment, force), whose sum over the subtree
of joint j gives FD_j = ξ_j·w, and the blocks (6, 6) of its derivatives with respect to
left-perturbation twists τ of the poses, T -> (1 + τ̂)T: P = ∂w/∂τ_next, B1 = ∂w/∂τ, B2 =
∂w/∂τ_prev. With a virtual twist V *carried by the body* and ψ = V·w, the curvature blocks are K =
∂²ψ/∂τ_next², T1 and T2 = ∂²ψ/∂τ_next∂τ and …∂τ_prev, L1 and L2 = ∂²ψ/∂τ² and …∂τ_prev² (rows: the
perturbation applied last, whose joint is nearer to the root).
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from octo.dynamics import symbolic
from octo.dynamics.forms import about, axial, g_form, moved, q_form, raised, rows, wrench
from octo.dynamics.laws import ContactLaw
from octo.dynamics.parameters import Layout, section
from octo.model.terrain import Ground, World, looked
from octo.model.terrain import normal as normal_of
from octo.world.jet import SIZES

OPTIONS = {"cse": True}
PREFIX = "octo_"  # of the names in the C text; the order of the derivatives is appended
# inputs that are p or of a table
SHARED = {
    "gap": (1, 2),
    "pair": (1, 2),
    "body": (3, 4),
    "contact": (2, 3),
    "joint": (3, 4),
    "point": (2,),
}

JOINT = ("armature", "damping", "stiffness", "rest", "lower", "upper")  # of its table


def body(order: int, layout: Layout) -> ca.Function:
    """Inertia and gravity of one body.

    Inputs: three poses (12), inertia (10: com, second moment xx xy xz yy yz zz, mass), p and, for
    order 2, V (6). Forms are written about the centre of mass of each node, where T M T'ᵀ = diag(Q,
    mass), then moved to the origin.
    """
    flat = [ca.SX.sym(name, 12) for name in ("next", "now", "previous")]
    inertia, p, V = ca.SX.sym("inertia", 10), ca.SX.sym("p", layout.size), ca.SX.sym("V", 6)
    view = layout.view(p)
    (R0, t0), (R1, t1), (R2, t2) = (symbolic.pose_of(f) for f in flat)
    com, m, k = inertia[:3], inertia[9], inertia[3:9]
    M = ca.blockcat([[k[0], k[1], k[2]], [k[1], k[3], k[4]], [k[2], k[4], k[5]]])
    rate = 1.0 / view["dt"] ** 2
    now, old = -2.0 * rate, rate  # of T and T_prev in the second difference
    gravity = ca.vertcat(view["gravity_x"], view["gravity_y"], view["gravity_z"])
    c0, c1, c2 = R0 @ com + t0, R1 @ com + t1, R2 @ com + t2
    # before the mass matrix, which would amplify the rounding of the difference
    turn = R0 - 2.0 * R1 + R2
    move = turn @ com + (t0 - 2.0 * t1 + t2)
    S = R0 @ M
    # [N | f] = F T̂ᵀ, F the body's generalised force
    f, N = m * (rate * move - gravity), rate * (turn @ S.T)
    out = [wrench(axial(N), f, c0)]
    Q0, Q1, Q2, zero = ca.triu2symm(ca.triu(S @ R0.T)), S @ R1.T, S @ R2.T, ca.SX(3, 1)
    if order >= 1:
        out.append(about(rate * q_form(Q0, zero, zero, m) + raised(g_form(N, f)), c0, c0))
        out.append(about(q_form(now * Q1, zero, zero, now * m), c0, c1))
        out.append(about(q_form(old * Q2, zero, zero, old * m), c0, c2))
    if order == 2:
        omega, v, none = ca.skew(V[:3]), moved(V, c0), ca.SX(1, 1)
        VQ0, VQ1, VQ2, delta = rate * omega @ Q0, now * omega @ Q1, old * omega @ Q2, rate * m * v
        bent = raised(g_form(N @ omega.T + f @ v.T + VQ0, delta))
        K = q_form(VQ0 + VQ0.T, delta, delta, none) + bent
        out.append(about(K, c0, c0))
        out.append(about(q_form(VQ1, -2.0 * delta, zero, none), c0, c1))
        out.append(about(q_form(VQ2, delta, zero, none), c0, c2))
        out.append(about(raised(g_form(VQ1, -2.0 * delta)), c1, c1))
        out.append(about(raised(g_form(VQ2, delta)), c2, c2))
    inputs = [*flat, inertia, p, V]
    return ca.Function(f"{PREFIX}body{order}", inputs, [rows(o) for o in out], OPTIONS)


class _Ground:
    """A ground as a stage sees it: its ``view`` of p and, of a world, the jet that the stage gets
    behind its other inputs, symbols ``own`` of it and of the place that it belongs to."""

    def __init__(self, terrain: Ground, layout: Layout, p: ca.SX):
        self.terrain, self.view = terrain, layout.view(p)
        self.own: list[ca.SX] = []
        if isinstance(terrain, World):
            self.own = [ca.SX.sym("jet", SIZES[-1]), ca.SX.sym("at", 3)]
            self.view = looked(self.view, *self.own)

    @property
    def inputs(self) -> list[ca.SX]:
        return self.own[:1]

    def at(self, center: ca.SX) -> list[ca.SX]:
        """In the place of ``own``, of a sphere at ``center``."""
        return [*self.own[:1], center] if self.own else []


def reach(layout: Layout, law: ContactLaw) -> ca.Function:
    """How far from the ground (m) a contact is still active. Input: p."""
    p = ca.SX.sym("p", layout.size)
    found = ca.densify(ca.SX(law.reach(section(layout.view(p), "contact."))))
    return ca.Function(f"{PREFIX}reach", [p], [found], OPTIONS)


def gap(layout: Layout, law: ContactLaw, terrain: Ground) -> ca.Function:
    """Depth plus reach (m) of one contact: it is active where this is positive. Inputs: centre (3),
    radius, p."""
    center, radius, p = ca.SX.sym("center", 3), ca.SX.sym("radius"), ca.SX.sym("p", layout.size)
    ground = _Ground(terrain, layout, p)
    reach = law.reach(section(ground.view, "contact."))
    depth = -symbolic.contact_height(radius, center, terrain, ground.view)
    own = ca.substitute([ca.SX(depth + reach)], ground.own, ground.at(center))
    return ca.Function(f"{PREFIX}gap", [center, radius, p, *ground.inputs], own, OPTIONS)


class _Touch:
    """One contact seen from its sphere's centre c, and the twists (3, 6) of what its law depends
    on.

    The contact point is c + arm, arm = -radius n(c). The material point there was at U one step
    ago: U = T1 T⁻¹(c + arm), and it moves in the body as the sphere rolls. ``slide`` is its
    velocity relative to the body, ``Q`` = R1Rᵀ carries it to U. The twists of the next node are
    about c, those of the present node about U.
    """

    def __init__(self, flat: list[ca.SX], sphere: ca.SX, ground: _Ground):
        (R, t), (R1, t1) = symbolic.pose_of(flat[0]), symbolic.pose_of(flat[1])
        self.center = R @ sphere[:3] + t
        point, pull = ca.SX.sym("point", 3), ca.SX.sym("pull", 3)
        own = section(ground.view, "terrain.")
        numbers = ca.veccat(*(value for name, value in own.items() if name not in ("jet", "at")))
        place = [point, numbers, *ground.own]
        n = normal_of(ground.terrain, point, own)
        at = self.center, numbers, *ground.at(self.center)
        normal, bend = ca.Function("normal", place, [n, ca.jacobian(n, point)])(*at)
        self.radius, self.arm, self.bend = sphere[3], -sphere[3] * normal, -sphere[3] * bend
        second = ca.hessian(ca.dot(pull, n), point)[0]
        self._curvature = ca.Function("curvature", [*place, pull], [second])
        self._at = at
        self.Q = R1 @ R.T
        self.U = R1 @ sphere[:3] + t1 + self.Q @ self.arm
        self.c_tau = self.U_now = ca.horzcat(ca.SX(3, 3), ca.SX.eye(3))
        self.arm_tau = self.bend @ self.c_tau
        self.slide = self.arm_tau + ca.horzcat(ca.skew(self.arm), ca.SX(3, 3))
        self.U_tau = self.Q @ self.slide

    def arm_curvature(self, along: ca.SX) -> ca.SX:
        """∂²(along·arm)/∂c² (3, 3)."""
        return -self.radius * self._curvature(*self._at, along)


def _force(law: ContactLaw, ground: _Ground, radius: ca.SX, c: ca.SX, U: ca.SX) -> ca.SX:
    """Force (3,) N on the body of a sphere at c whose contact point was at U one step ago."""
    view = ground.view
    n = normal_of(ground.terrain, c, section(view, "terrain."))
    depth = -symbolic.contact_height(radius, c, ground.terrain, view)
    return law.force(depth, n, (c - radius * n - U) / view["dt"], section(view, "contact."))


def structure(layout: Layout, law: ContactLaw, terrain: Ground) -> tuple[Any, ...]:
    """What tells the stages of one law and ground from those of others: the expressions of both,
    and the names of p."""
    center, point, before = (ca.SX.sym(name, 3) for name in ("center", "point", "before"))
    radius, p = ca.SX.sym("radius"), ca.SX.sym("p", layout.size)
    ground = _Ground(terrain, layout, p)
    out = [
        _force(law, ground, radius, center, before),
        normal_of(terrain, point, section(ground.view, "terrain.")),
        symbolic.contact_height(radius, center, terrain, ground.view),
        ca.SX(law.reach(section(ground.view, "contact."))),
    ]
    inputs = [center, point, before, radius, p, *ground.own]
    written = ca.Function("law", inputs, [ca.SX(o) for o in out])
    return layout.names, written.serialize()


def contact(order: int, layout: Layout, law: ContactLaw, terrain: Ground) -> ca.Function:
    """Eq. 6 (or another law) of one contact. Inputs: poses next and now (12 each), sphere (4:
    place, radius), p, V, and of a world its jet (20) at the sphere's centre.

    The law is differentiated with respect to the six numbers (c, U) alone; twists enter by the
    chain rule.
    """
    flat = [ca.SX.sym(name, 12) for name in ("next", "now")]
    sphere, p, V = ca.SX.sym("sphere", 4), ca.SX.sym("p", layout.size), ca.SX.sym("V", 6)
    ground = _Ground(terrain, layout, p)
    touch = _Touch(flat, sphere, ground)
    c, U, held = ca.SX.sym("c", 3), ca.SX.sym("U", 3), ca.SX.sym("delta", 3)
    f = _force(law, ground, sphere[3], c, U)
    at_law = [c, U, sphere[3], p, *ground.own]
    here = [touch.center, touch.U, sphere[3], p, *ground.at(touch.center)]
    force, f_c, f_U = ca.Function("force", at_law, [f, ca.jacobian(f, c), ca.jacobian(f, U)])(*here)
    arm = ca.skew(touch.arm)
    out = [-wrench(arm @ force, force, touch.center)]
    if order >= 1:
        f_tau, f_now = f_c @ touch.c_tau + f_U @ touch.U_tau, f_U @ touch.U_now
        P = -ca.vertcat(arm @ f_tau - ca.skew(force) @ (touch.c_tau + touch.arm_tau), f_tau)
        out.append(about(P, touch.center, touch.center))
        out.append(about(-ca.vertcat(arm @ f_now, f_now), touch.center, touch.U))
    if order == 2:
        delta = ca.cross(V[:3], touch.arm) + moved(V, touch.center)
        h, g = ca.hessian(-ca.dot(held, f), ca.vertcat(c, U))
        g, h = ca.Function("law", [*at_law, held], [g, h])(*here, delta)
        K, T1, L1 = _contact_curvature(touch, V[:3], delta, force, (g, h, f_c, f_U))
        out.append(about(K, touch.center, touch.center))
        out.append(about(T1, touch.center, touch.U))
        out.append(about(L1, touch.U, touch.U))
    inputs = [*flat, sphere, p, V, *ground.inputs]
    return ca.Function(f"{PREFIX}contact{order}", inputs, [rows(ca.SX(o)) for o in out], OPTIONS)


def point(order: int, layout: Layout, law: ContactLaw, terrain: Ground) -> ca.Function:
    """Eq. 6 (or another law) of a material point, which has no radius. Inputs: its place c and
    where it was one step ago, U, (3,) m each; p; δ (3,); and of a world its jet (20) at c.

    Outputs: the force f (3,) N; ∂f/∂c and ∂f/∂U (3, 3); ∂²(-δ·f)/∂(c, U)² (6, 6).
    """
    c, U, delta = (ca.SX.sym(name, 3) for name in ("c", "U", "delta"))
    p = ca.SX.sym("p", layout.size)
    ground = _Ground(terrain, layout, p)
    f = _force(law, ground, ca.SX(0), c, U)
    out = [f]
    if order >= 1:
        out += [ca.jacobian(f, c), ca.jacobian(f, U)]
    if order == 2:
        out.append(ca.triu2symm(ca.triu(ca.hessian(-ca.dot(delta, f), ca.vertcat(c, U))[0])))
    own = ca.substitute([rows(ca.SX(o)) for o in out], ground.own, ground.at(c))
    inputs = [c, U, p, delta, *ground.inputs]
    return ca.Function(f"{PREFIX}point{order}", inputs, [ca.densify(o) for o in own], OPTIONS)


def _contact_curvature(
    touch: _Touch, omega: ca.SX, delta: ca.SX, force: ca.SX, law: tuple[ca.SX, ca.SX, ca.SX, ca.SX]
) -> list[ca.SX]:
    """K, T1, L1 of ψ = -δ·f(c, U), where δ = V_ω × arm + V_c is carried by the body: δ_τ = ω × δ +
    V_ω × slide."""
    (g, h, f_c, f_U), c_tau, U_tau, slide = law, touch.c_tau, touch.U_tau, touch.slide
    g_c, g_U, g_delta = g[:3], g[3:], -force
    delta_tau = ca.horzcat(-ca.skew(delta), ca.SX(3, 3)) + ca.skew(omega) @ slide
    z = ca.vertcat(c_tau, U_tau)
    mixed = -(f_c @ c_tau + f_U @ U_tau)  # ∂²ψ/∂δ∂(c, U)
    # the material point's second order, R∂²(Rᵀarm), moves U and δ alike: its coefficient is
    # ``pull``
    pull = touch.Q.T @ g_U + ca.cross(g_delta, omega)
    bent = touch.bend.T @ pull
    turned = ca.skew(g_delta) @ ca.skew(omega) @ slide - ca.skew(pull) @ touch.arm_tau
    half = delta_tau.T @ mixed - raised(turned)
    K = z.T @ h @ z + half + half.T + c_tau.T @ touch.arm_curvature(pull) @ c_tau
    own = g_form(g_delta @ delta.T + touch.arm @ pull.T, g_c + bent)
    K = ca.triu2symm(ca.triu(ca.densify(K))) + raised(own)
    T1 = (z.T @ h[:, 3:] - delta_tau.T @ f_U) @ touch.U_now - raised(ca.skew(g_U) @ U_tau).T
    L1 = touch.U_now.T @ h[3:, 3:] @ touch.U_now + raised(g_form(ca.SX(3, 3), g_U))
    return [K, T1, L1]


def joint(order: int, layout: Layout) -> ca.Function:
    """Armature, damping, spring, limits of one joint and their derivatives.

    Inputs: x_next, x, x_prev, table (6: JOINT), p.
    Outputs: force; its derivatives to the three; its second derivative to x_next.
    """
    x_next, x, x_prev = (ca.SX.sym(name) for name in ("x_next", "x", "x_prev"))
    table, p = ca.SX.sym("table", 6), ca.SX.sym("p", layout.size)
    named = {name: table[k] for k, name in enumerate(JOINT)}
    force = symbolic.joint_force(named, x_next, x, x_prev, layout.view(p))
    out = [force]
    if order >= 1:
        out += [ca.jacobian(force, node) for node in (x_next, x, x_prev)]
    if order == 2:
        out += [ca.jacobian(ca.jacobian(force, x_next), x_next)]
    inputs = [x_next, x, x_prev, table, p]
    return ca.Function(f"{PREFIX}joint{order}", inputs, [ca.densify(o) for o in out], OPTIONS)


def pair(layout: Layout) -> ca.Function:
    """Φ', Φ'', Φ''' of a pair's potential Φ(ρ), ρ = ½|distance|² in m². Inputs: ρ, sum of radii,
    p."""
    rho, radii, p = ca.SX.sym("rho"), ca.SX.sym("radii"), ca.SX.sym("p", layout.size)
    derivative = symbolic.pair_potential(2.0 * rho, radii, layout.view(p))
    out = []
    for _ in range(3):
        derivative = ca.jacobian(derivative, rho)
        out.append(ca.densify(derivative))
    return ca.Function(f"{PREFIX}pair", [rho, radii, p], out, OPTIONS)
