"""The contacts of a step as one expression, and of many steps as numbers, one contact after the
other: where a body has so many that the expression would take long to write (crowd.py)."""

from __future__ import annotations

import casadi as ca
import numpy as np

from octo.checks import Array
from octo.dynamics import symbolic
from octo.dynamics.crowd import crowds_of
from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.laws import ContactLaw
from octo.dynamics.parameters import Layout
from octo.interrupts import postponed
from octo.model.kinematics import body_poses
from octo.model.terrain import Ground, World, looked
from octo.world.jet import SIZES

NAMES = ("force", "point", "velocity", "normal")  # of ContactState, (3,) each; its depth follows
AT_ONCE = 50_000  # contacts that are evaluated together: some 20 MB


def many(dynamics: RobotDynamics) -> bool:
    """Whether a body has so many."""
    return bool(crowds_of(dynamics.character))


@postponed()
def one_contact(layout: Layout, law: ContactLaw, terrain: Ground) -> ca.Function:
    """State (13,) of one contact, NAMES and its depth, from the poses (12 each) of its body at
    x_next and x, its sphere (4), p and, of a world, the place (3,) and the jet (20,) of its
    look-up."""
    flat = [ca.SX.sym(name, 12) for name in ("next", "now")]
    sphere, p = ca.SX.sym("sphere", 4), ca.SX.sym("p", layout.size)
    own = [ca.SX.sym("at", 3), ca.SX.sym("jet", SIZES[-1])]
    view, inputs = layout.view(p), [*flat, sphere, p]
    if isinstance(terrain, World):
        view, inputs = looked(view, own[1], own[0]), [*inputs, *own]
    poses = symbolic.pose_of(flat[0]), symbolic.pose_of(flat[1])
    places = symbolic.contact_places(sphere[:3], sphere[3], *poses, terrain, view)
    state = symbolic.contact_state(*places, sphere[3], law, terrain, view)
    found = ca.vertcat(*(getattr(state, name) for name in NAMES), state.depth)
    return ca.Function("contact", inputs, [ca.densify(found)], {"cse": True})


@postponed()
def contact_function(dynamics: RobotDynamics) -> ca.Function:
    """Forces, points, velocities and normals (3, c) of all contacts with the terrain, and their
    depths (c,), at (x_next, x, p as Dynamics.seen)."""
    robot, terrain = dynamics.character, dynamics.terrain
    x_next, x = ca.SX.sym("x_next", dynamics.nx), ca.SX.sym("x", dynamics.nx)
    p = ca.SX.sym("p", dynamics.layout.size + symbolic.looked_size(robot, terrain))
    seen = symbolic.views(robot, terrain, dynamics.layout, p)
    states = symbolic.contact_states(robot, x_next, x, dynamics.law, terrain, seen)
    depth = ca.vertcat(ca.SX(0, 1), *(state.depth for state in states))
    vectors = [ca.horzcat(ca.SX(3, 0), *(getattr(state, n) for state in states)) for n in NAMES]
    return ca.Function("contacts", [x_next, x, p], [*vectors, depth])


@postponed()
def touch_function(dynamics: RobotDynamics) -> ca.Function:
    """Forces on the spheres' bodies and where they act (3, m), of the contacts between bodies
    (``character.touches``), at (x_next, x, p)."""
    robot = dynamics.character
    x_next, x = ca.SX.sym("x_next", dynamics.nx), ca.SX.sym("x", dynamics.nx)
    p = ca.SX.sym("p", dynamics.layout.size)
    poses, now = symbolic.body_poses(robot, x_next), symbolic.body_poses(robot, x)
    given = (poses, now, dynamics.law, dynamics.layout.view(p))
    pairs = [symbolic.mutual_force(robot, k, *given) for k in range(len(robot.touches))]
    found = [ca.horzcat(ca.SX(3, 0), *values) for values in zip(*pairs, strict=True)]
    return ca.Function("touches", [x_next, x, p], found, {"cse": True})


def contact_numbers(
    dynamics: RobotDynamics, p: Array, x_next: Array, x: Array
) -> tuple[list[Array], Array]:
    """Forces, points, velocities and normals (k, c, 3) of all contacts with the terrain, and their
    depths (k, c), at configurations x_next and, one step before, x (k, n); p (NP,)."""
    robot = dynamics.character
    spheres = [robot.contacts[k] for k in robot.terrain_contacts]
    bodies = [sphere.body for sphere in spheres]
    places = np.array([[*sphere.position, sphere.radius] for sphere in spheres])
    one = one_contact(dynamics.layout, dynamics.law, dynamics.terrain)
    count = len(spheres)
    steps = max(1, AT_ONCE // count)
    found = np.empty((len(x), count, 3 * len(NAMES) + 1))
    for first in range(0, len(x), steps):
        own = slice(first, first + steps)
        given = [_flat(body_poses(robot, node[own]), bodies) for node in (x_next, x)]
        total = given[0].shape[1]
        given += [np.tile(places.T, total // count), np.repeat(p[:, None], total, axis=1)]
        if isinstance(dynamics.terrain, World):
            jets = dynamics.jets(p, x_next[own]).reshape(total, -1).T
            given += [jets[:3], jets[3:]]
        found[own] = np.asarray(one(*given)).T.reshape(-1, count, found.shape[2])
    vectors = [found[..., 3 * k : 3 * k + 3] for k in range(len(NAMES))]
    return vectors, found[..., -1]


def _flat(poses: tuple[Array, Array], bodies: list[int]) -> Array:
    """(12, k c): poses of the contacts' bodies, R row by row and t, of k configurations."""
    rotation, origin = (pose[:, bodies] for pose in poses)
    made = np.concatenate([rotation.reshape(*origin.shape[:2], 9), origin], axis=2)
    return np.ascontiguousarray(made.reshape(-1, 12).T)
