"""FD of a reduced deformable body as one CasADi expression: for other solvers, and what the loops
of ``octo.soft`` are tested against. Its length grows with the vertices: it is for a few."""

from __future__ import annotations

import casadi as ca

from octo.dynamics.laws import ContactLaw, View
from octo.dynamics.parameters import Layout, section
from octo.dynamics.symbolic import contact_state
from octo.interrupts import postponed
from octo.model.chart import Chart
from octo.model.terrain import Ground
from octo.soft.body import Body
from octo.soft.moments import Moments
from octo.soft.stvk import products


def rotation(angles: ca.SX, chart: Chart) -> ca.SX:
    """(3, 3) of the chart's three angles (rad), outermost first."""
    turns = {"x": _about_x, "y": _about_y, "z": _about_z}
    first, second, third = (turns[axis](angles[k]) for k, axis in enumerate(chart))
    return first @ second @ third


def _about_x(angle: ca.SX) -> ca.SX:
    s, c = ca.sin(angle), ca.cos(angle)
    return ca.blockcat([[1, 0, 0], [0, c, -s], [0, s, c]])


def _about_y(angle: ca.SX) -> ca.SX:
    s, c = ca.sin(angle), ca.cos(angle)
    return ca.blockcat([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def _about_z(angle: ca.SX) -> ca.SX:
    s, c = ca.sin(angle), ca.cos(angle)
    return ca.blockcat([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def embedding(x: ca.SX, chart: Chart) -> ca.SX:
    """T(x) = [R, z_1 R, …, z_r R, t] (3, 3r+4): a point of the body is T·Y of its Y = (X; φ_1; …;
    φ_r; 1)."""
    R = rotation(x[3:6], chart)
    bent = [x[k] * R for k in range(6, x.numel())]
    return ca.horzcat(R, *bent, x[:3])


@postponed()
def forward_dynamics(
    body: Body, law: ContactLaw, terrain: Ground, layout: Layout, chart: Chart
) -> ca.Function:
    """FD(x_next, x, x_prev, p) (6+r,) of a body, all of whose vertices are in it: N, N m and N
    kg^-½ m."""
    count = body.modes.shape[1]
    x_next, x, x_prev = nodes = [ca.SX.sym(name, 6 + count) for name in ("x_next", "x", "x_prev")]
    p = ca.SX.sym("p", layout.size)
    view = layout.view(p)
    T, now, old = (embedding(node, chart) for node in nodes)
    M = ca.DM(body.inertia)
    change = T - 2.0 * now + old
    gravity = ca.vertcat(view["gravity_x"], view["gravity_y"], view["gravity_z"])
    potential = 0.5 * ca.trace(change @ M @ change.T) / view["dt"] ** 2
    potential -= ca.dot(gravity, T @ M[:, -1])
    work, held, values = ca.SX(0), [], []
    for rest, modes in zip(body.points, body.modes, strict=True):
        Y = ca.DM([*rest, *modes.ravel(), 1.0])
        state = contact_state(T @ Y, now @ Y, 0.0, law, terrain, view)
        force = ca.SX.sym("f", 3)
        work += ca.dot(force, T @ Y)  # virtual work at a fixed force
        held.append(force)
        values.append(state.force)
    fd = ca.gradient(potential - work, x_next)
    if held:
        fd = ca.substitute(fd, ca.vertcat(*held), ca.vertcat(*values))
    fd[6:] += elastic_force(body, x_next[6:], x[6:], section(view, "elastic."), view["dt"])
    inputs, names = [*nodes, p], ["x_next", "x", "x_prev", "p"]
    return ca.Function("FD", inputs, [ca.densify(fd)], names, ["fd"], {"cse": True})


def elastic_force(body: Body, z_next: ca.SX, z: ca.SX, own: View, dt: ca.SX) -> ca.SX:
    """Elastic forces and Rayleigh damping (r,), N kg^-½ m: ``own`` has the factor ``stiffness`` of
    Λ, ``alpha`` (1/s) and ``beta`` (s)."""
    stiffness = own["stiffness"] * ca.SX(ca.DM(body.stiffness))
    rate = (z_next - z) / dt
    mass = ca.SX(ca.DM(Moments.of(body).modal))
    damped = own["alpha"] * (mass @ rate) + own["beta"] * (stiffness @ rate)
    if body.stvk is None:
        return stiffness @ z_next + damped
    first, second = (each.tolist() for each in products(z.numel()))
    free = ca.SX.sym("z", z.numel())
    w = ca.vertcat(free, free[first] * free[second])
    energy = 0.5 * own["stiffness"] * ca.dot(w, ca.DM(body.stvk) @ w)
    return ca.substitute(ca.gradient(energy, free), free, z_next) + damped
