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
from octo.dynamics.laws import ContactLaw
from octo.dynamics.parameters import Layout
from octo.model.terrain import Plane, Terrain

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


def _twisted(pose: symbolic.Pose, twist: ca.SX) -> symbolic.Pose:
    """(1 + τ̂)T: exact for the first derivative in τ."""
    R, t = pose
    return R + ca.skew(twist[:3]) @ R, t + ca.cross(twist[:3], t) + twist[3:]


def _carried(V: ca.SX, twist: ca.SX) -> ca.SX:
    """(1 + ad_τ)V: a twist fixed in a body that moves by τ."""
    omega = ca.cross(twist[:3], V[:3])
    return V + ca.vertcat(omega, ca.cross(twist[3:], V[:3]) + ca.cross(twist[:3], V[3:]))


def gap(layout: Layout, law: ContactLaw, terrain: Plane | Terrain) -> ca.Function:
    """Depth plus reach (m) of one contact: it is active where this is positive. Inputs: centre (3), radius, p."""
    center, radius, p = ca.SX.sym("center", 3), ca.SX.sym("radius"), ca.SX.sym("p", layout.size)
    view = layout.view(p)
    reach = law.reach(symbolic.section(view, "contact."))
    depth = -symbolic.contact_height(radius, center, terrain, view)
    return ca.Function(f"{PREFIX}gap", [center, radius, p], [ca.SX(depth + reach)], OPTIONS)


def contact(order: int, layout: Layout, law: ContactLaw, terrain: Plane | Terrain) -> ca.Function:
    """Eq. 6 (or another law) of one contact. Inputs: poses next and now (12 each), sphere (4: place, radius), p, V."""
    flat = [ca.SX.sym(name, 12) for name in ("next", "now")]
    sphere, p, V = ca.SX.sym("sphere", 4), ca.SX.sym("p", layout.size), ca.SX.sym("V", 6)
    view = layout.view(p)

    def wrench(next_pose: symbolic.Pose, now: symbolic.Pose) -> ca.SX:
        state = symbolic.contact_state(sphere[:3], sphere[3], next_pose, now, law, terrain, view)
        return -ca.vertcat(ca.cross(state.point, state.force), state.force)

    pose, now = _pose(flat[0]), _pose(flat[1])
    last, first, last1, first1 = (ca.SX.sym(name, 6) for name in ("last", "first", "last1", "first1"))
    twists = ca.vertcat(last, first, last1, first1)
    out = [wrench(pose, now)]
    if order >= 1:
        w = wrench(_twisted(pose, last), _twisted(now, last1))
        out += [ca.jacobian(w, last), ca.jacobian(w, last1)]
    if order == 2:
        moved, moved1 = (_twisted(_twisted(q, a), b) for q, a, b in ((pose, first, last), (now, first1, last1)))
        psi = ca.dot(_carried(_carried(V, first), last), wrench(moved, moved1))
        force = ca.gradient(psi, last)
        out += [ca.jacobian(force, first), ca.jacobian(force, last1), ca.jacobian(ca.gradient(psi, last1), first1)]
    inputs = [*flat, sphere, p, V]
    raw = ca.Function("contact_raw", [*inputs, twists], [_rows(ca.SX(o)) for o in out])
    at_rest = raw.call([*inputs, ca.SX(ca.DM.zeros(24))], True, False)
    return ca.Function(f"{PREFIX}contact{order}", inputs, [ca.densify(ca.simplify(o)) for o in at_rest], OPTIONS)


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
