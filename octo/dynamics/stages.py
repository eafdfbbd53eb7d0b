"""The laws of §4, each once, as small CasADi functions that the tree pass of ``phases.c`` calls.

A stage returns a wrench w (6,) about the world origin (moment, force), whose sum over the subtree of joint j gives
FD_j = ξ_j·w, and the blocks (6, 6) of its derivatives with respect to left-perturbation twists τ of the poses,
T -> (1 + τ̂)T: P = ∂w/∂τ_next, B1 = ∂w/∂τ, B2 = ∂w/∂τ_prev. With a virtual twist V *carried by the body* and
ψ = V·w, the curvature blocks are K = ∂²ψ/∂τ_next², T1 and T2 = ∂²ψ/∂τ_next∂τ and …∂τ_prev, L1 and L2 = ∂²ψ/∂τ² and
…∂τ_prev² (rows: the perturbation applied last, whose joint is nearer to the root).
"""

from __future__ import annotations

import casadi as ca

from octo.dynamics import symbolic
from octo.dynamics.laws import ContactLaw, View
from octo.dynamics.parameters import Layout
from octo.model.terrain import Plane, Terrain
from octo.model.terrain import normal as normal_of

OPTIONS = {"cse": True}
PREFIX = "octo_"  # of the names in the C text; the order of the derivatives is appended


def _pose(flat: ca.SX) -> symbolic.Pose:
    """(R, t) from kin's twelve numbers: R row by row, then t."""
    return ca.reshape(flat[:9], 3, 3).T, flat[9:12]


def _axial(N: ca.SX) -> ca.SX:
    return ca.vertcat(N[2, 1] - N[1, 2], N[0, 2] - N[2, 0], N[1, 0] - N[0, 1])


def _q_form(Q: ca.SX, q_r: ca.SX, q_t: ca.SX, mass: ca.SX) -> ca.SX:
    """Matrix (6, 6) of the bilinear form tr(τ̂_i Q τ̂_jᵀ) with the homogeneous Q = [[Q, q_r], [q_tᵀ, mass]]."""
    turn = ca.trace(Q) * ca.SX.eye(3) - Q.T
    return ca.blockcat([[turn, ca.skew(q_r)], [-ca.skew(q_t), mass * ca.SX.eye(3)]])


def _g_form(N: ca.SX, f: ca.SX) -> ca.SX:
    """Upper rows (3, 6) of the form ⟨τ̂_i τ̂_j, [N | f]⟩; its lower rows are zero."""
    return ca.horzcat(N.T - ca.trace(N) * ca.SX.eye(3), -ca.skew(f))


def _raise(upper: ca.SX) -> ca.SX:
    return ca.vertcat(upper, ca.SX.zeros(3, 6))


def body(order: int, layout: Layout) -> ca.Function:
    """Inertia and gravity of one body.

    Inputs: three poses (12), inertia (10: com, second moment xx xy xz yy yz zz, mass), p and, for order 2, V (6).
    """
    flat = [ca.SX.sym(name, 12) for name in ("next", "now", "previous")]
    inertia, p, V = ca.SX.sym("inertia", 10), ca.SX.sym("p", layout.size), ca.SX.sym("V", 6)
    view = layout.view(p)
    (R0, t0), (R1, t1), (R2, t2) = (_pose(f) for f in flat)
    com, m, k = inertia[:3], inertia[9], inertia[3:9]
    M = ca.blockcat([[k[0], k[1], k[2]], [k[1], k[3], k[4]], [k[2], k[4], k[5]]])
    rate = 1.0 / view["dt"] ** 2
    gravity = ca.vertcat(view["gravity_x"], view["gravity_y"], view["gravity_z"])
    c0, c1, c2 = R0 @ com + t0, R1 @ com + t1, R2 @ com + t2
    turn = R0 - 2.0 * R1 + R2  # before the mass matrix, which would amplify the rounding of the difference
    move = turn @ com + (t0 - 2.0 * t1 + t2)
    S = R0 @ M
    f = m * (rate * move - gravity)
    N = rate * (turn @ S.T) + f @ c0.T  # [N | f] = F T̂ᵀ, F the body's generalised force
    out = [ca.vertcat(_axial(N), f)]
    Q0, Q1, Q2 = S @ R0.T + m * c0 @ c0.T, S @ R1.T + m * c0 @ c1.T, S @ R2.T + m * c0 @ c2.T
    if order >= 1:
        P = rate * _q_form(Q0, m * c0, m * c0, m) + _raise(_g_form(N, f))
        B1 = -2.0 * rate * _q_form(Q1, m * c0, m * c1, m)
        B2 = rate * _q_form(Q2, m * c0, m * c2, m)
        out += [P, B1, B2]
    if order == 2:
        omega, v = ca.skew(V[:3]), V[3:]
        delta = m * (ca.cross(V[:3], c0) + v)
        VQ0, VQ1, VQ2 = (omega @ Q + m * v @ c.T for Q, c in ((Q0, c0), (Q1, c1), (Q2, c2)))
        both = _q_form(VQ0 + VQ0.T, delta, delta, ca.SX(0))
        K = rate * both + _raise(_g_form(N @ omega.T + f @ v.T + rate * VQ0, rate * delta))
        still = ca.SX.zeros(3)
        T1, T2 = (factor * _q_form(VQ, delta, still, ca.SX(0)) for factor, VQ in ((-2.0 * rate, VQ1), (rate, VQ2)))
        L1, L2 = (_g_form(factor * VQ, factor * delta) for factor, VQ in ((-2.0 * rate, VQ1), (rate, VQ2)))
        out += [K, T1, T2, _raise(L1), _raise(L2)]
    return ca.Function(f"{PREFIX}body{order}", [*flat, inertia, p, V], [_rows(o) for o in out], OPTIONS)


def _rows(matrix: ca.SX) -> ca.SX:
    """A matrix as one dense column, row by row (C's order)."""
    return ca.densify(ca.vec(matrix.T)) if matrix.shape[1] > 1 else ca.densify(matrix)


def gap(layout: Layout, law: ContactLaw, terrain: Plane | Terrain) -> ca.Function:
    """Depth plus reach (m) of one contact: it is active where this is positive. Inputs: centre (3), radius, p."""
    center, radius, p = ca.SX.sym("center", 3), ca.SX.sym("radius"), ca.SX.sym("p", layout.size)
    view = layout.view(p)
    reach = law.reach(symbolic.section(view, "contact."))
    depth = -symbolic.contact_height(radius, center, terrain, view)
    return ca.Function(f"{PREFIX}gap", [center, radius, p], [ca.SX(depth + reach)], OPTIONS)


class _Touch:
    """One contact: centre c, contact point P, the old place U of the material point now at P, and their twists.

    The material point moves in the body as the sphere rolls: m = local - radius Rᵀn(c), U = R1 m + t1. ``slide`` is
    its world velocity R∂m/∂τ (3, 6) relative to the body, ``Q`` = R1Rᵀ carries it to U. Subscript τ: (3, 6) blocks.
    """

    def __init__(self, flat: list[ca.SX], sphere: ca.SX, terrain: Plane | Terrain, view: View):
        (R, t), (R1, t1) = _pose(flat[0]), _pose(flat[1])
        self.center = R @ sphere[:3] + t
        point = ca.SX.sym("point", 3)
        ground = symbolic.section(view, "terrain.")
        normal = normal_of(terrain, point, ground)
        at = ca.Function("normal", [point, ca.veccat(*ground.values())], [normal, ca.jacobian(normal, point)])
        self.normal, self.bend = at(self.center, ca.veccat(*ground.values()))
        self.radius = sphere[3]
        self.P = self.center - self.radius * self.normal
        self.Q = R1 @ R.T
        self.U = R1 @ sphere[:3] + t1 - self.radius * self.Q @ self.normal
        self.c_tau, self.U_now = _carry(self.center), _carry(self.U)
        self.n_tau = self.bend @ self.c_tau
        self.P_tau = self.c_tau - self.radius * self.n_tau
        self.slide = self.radius * (ca.horzcat(-ca.skew(self.normal), ca.SX(3, 3)) - self.n_tau)  # P_tau - ω × P - v
        self.U_tau = self.Q @ self.slide


def _carry(point: ca.SX) -> ca.SX:
    """(3, 6) velocity ω × point + v of a point carried by a twist."""
    return ca.horzcat(-ca.skew(point), ca.SX.eye(3))


def _force(law: ContactLaw, terrain: Plane | Terrain, view: View, radius: ca.SX, c: ca.SX, U: ca.SX) -> ca.SX:
    """Force (3,) N on the body of a sphere at c whose contact point was at U one step ago."""
    n = normal_of(terrain, c, symbolic.section(view, "terrain."))
    depth = -symbolic.contact_height(radius, c, terrain, view)
    return law.force(depth, n, (c - radius * n - U) / view["dt"], symbolic.section(view, "contact."))


def contact(order: int, layout: Layout, law: ContactLaw, terrain: Plane | Terrain) -> ca.Function:
    """Eq. 6 (or another law) of one contact. Inputs: poses next and now (12 each), sphere (4: place, radius), p, V.

    The law is differentiated with respect to the six numbers (c, U) alone; twists enter by the chain rule.
    """
    flat = [ca.SX.sym(name, 12) for name in ("next", "now")]
    sphere, p, V = ca.SX.sym("sphere", 4), ca.SX.sym("p", layout.size), ca.SX.sym("V", 6)
    view = layout.view(p)
    touch = _Touch(flat, sphere, terrain, view)
    c, U = ca.SX.sym("c", 3), ca.SX.sym("U", 3)
    f = _force(law, terrain, view, sphere[3], c, U)
    at_law = [c, U, sphere[3], p]
    here = [touch.center, touch.U, sphere[3], p]
    force, f_c, f_U = ca.Function("force", at_law, [f, ca.jacobian(f, c), ca.jacobian(f, U)])(*here)
    P = ca.skew(touch.P)
    out = [-ca.vertcat(P @ force, force)]
    if order >= 1:
        f_tau, f_now = f_c @ touch.c_tau + f_U @ touch.U_tau, f_U @ touch.U_now
        out += [-ca.vertcat(P @ f_tau - ca.skew(force) @ touch.P_tau, f_tau), -ca.vertcat(P @ f_now, f_now)]
    if order == 2:
        delta = ca.cross(V[:3], touch.P) + V[3:]
        held = ca.SX.sym("delta", 3)
        gradient, h = _curvature_of(-ca.dot(held, f), ca.vertcat(c, U), [*at_law, held], [*here, delta])
        out += _contact_curvature(touch, V[:3], delta, force, (gradient, h, f_c, f_U), terrain, view)
    return ca.Function(f"{PREFIX}contact{order}", [*flat, sphere, p, V], [_rows(ca.SX(o)) for o in out], OPTIONS)


def _curvature_of(value: ca.SX, variables: ca.SX, inputs: list[ca.SX], at: list[ca.SX]) -> tuple[ca.SX, ca.SX]:
    h, g = ca.hessian(value, variables)
    gradient, hessian = ca.Function("law", inputs, [g, h])(*at)
    return gradient, hessian


def _contact_curvature(
    touch: _Touch, omega: ca.SX, delta: ca.SX, force: ca.SX, law: tuple[ca.SX, ...], terrain: Plane | Terrain, view: View
) -> list[ca.SX]:
    """K, T1, L1 of ψ = -δ·f(c, U), where δ = V_ω × P + V_v is carried by the body: δ_τ = ω × δ + V_ω × slide."""
    (gradient, h, f_c, f_U), c_tau, U_tau, slide = law, touch.c_tau, touch.U_tau, touch.slide
    g_c, g_U, g_delta = gradient[:3], gradient[3:], -force
    V = ca.skew(omega)
    delta_tau = ca.horzcat(-ca.skew(delta), ca.SX(3, 3)) + V @ slide
    z = ca.vertcat(c_tau, U_tau)
    mixed = -(f_c @ c_tau + f_U @ U_tau)  # ∂²ψ/∂δ∂(c, U)
    # the material point's second order, R∂²m = -radius ∂²(Rᵀn), moves U and δ alike: its coefficient is ``pull``
    n, pull = -touch.radius * touch.normal, touch.Q.T @ g_U + ca.cross(g_delta, omega)
    bent = -touch.radius * touch.bend.T @ pull
    half = delta_tau.T @ mixed - _raise(ca.skew(g_delta) @ V @ slide + touch.radius * ca.skew(pull) @ touch.n_tau)
    K = z.T @ h @ z + half + half.T - touch.radius * c_tau.T @ _normal_curvature(touch, pull, terrain, view) @ c_tau
    turning = (g_c + bent) @ touch.center.T + g_delta @ delta.T + n @ pull.T
    K = ca.triu2symm(ca.triu(ca.densify(K))) + _raise(_g_form(turning, g_c + bent))
    T1 = z.T @ (h[:, 3:] @ touch.U_now) - delta_tau.T @ (f_U @ touch.U_now) - _raise(ca.skew(g_U) @ U_tau).T
    L1 = touch.U_now.T @ h[3:, 3:] @ touch.U_now + _raise(_g_form(g_U @ touch.U.T, g_U))
    return [K, T1, L1]


def _normal_curvature(touch: _Touch, pull: ca.SX, terrain: Plane | Terrain, view: View) -> ca.SX:
    """∂²(pull·n)/∂c² (3, 3) of the terrain's normal."""
    point, held = ca.SX.sym("point", 3), ca.SX.sym("pull", 3)
    ground = symbolic.section(view, "terrain.")
    values = ca.veccat(*ground.values())
    bend, _ = ca.hessian(ca.dot(held, normal_of(terrain, point, ground)), point)
    return ca.Function("bend", [point, held, values], [bend])(touch.center, pull, values)


def joint(order: int, layout: Layout) -> ca.Function:
    """Armature, damping, spring, limits of one joint and their derivatives.

    Inputs: x_next, x, x_prev, table (6: armature, damping, stiffness, rest, lower, upper), p.
    Outputs: force; its derivatives to the three; its second derivative to x_next.
    """
    x_next, x, x_prev = (ca.SX.sym(name) for name in ("x_next", "x", "x_prev"))
    table, p = ca.SX.sym("table", 6), ca.SX.sym("p", layout.size)
    names = ("armature", "damping", "stiffness", "rest", "lower", "upper")
    named = {name: table[k] for k, name in enumerate(names)}
    force = symbolic.joint_force(named, x_next, x, x_prev, layout.view(p))
    out = [force]
    if order >= 1:
        out += [ca.jacobian(force, node) for node in (x_next, x, x_prev)]
    if order == 2:
        out += [ca.jacobian(ca.jacobian(force, x_next), x_next)]
    return ca.Function(f"{PREFIX}joint{order}", [x_next, x, x_prev, table, p], [ca.densify(o) for o in out], OPTIONS)


def pair(layout: Layout) -> ca.Function:
    """Φ', Φ'', Φ''' of a pair's potential Φ(ρ), ρ = ½|distance|² in m². Inputs: ρ, sum of radii, p."""
    rho, radii, p = ca.SX.sym("rho"), ca.SX.sym("radii"), ca.SX.sym("p", layout.size)
    derivative = symbolic.pair_potential(2.0 * rho, radii, layout.view(p))
    out = []
    for _ in range(3):
        derivative = ca.jacobian(derivative, rho)
        out.append(ca.densify(derivative))
    return ca.Function(f"{PREFIX}pair", [rho, radii, p], out, OPTIONS)
