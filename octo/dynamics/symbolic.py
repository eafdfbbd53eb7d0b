"""The laws of §4 summed into one CasADi expression: the oracle, the reference model and the
fallback.

Everything here is SX, so that any part can be differentiated or put into a cost.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from octo.dynamics.laws import ContactLaw, View
from octo.dynamics.parameters import Layout, section
from octo.dynamics.slots import mutual_ends
from octo.errors import ModelError
from octo.interrupts import postponed
from octo.model.body import Body, Joint
from octo.model.character import Character
from octo.model.element import Element, names_of
from octo.model.solid import surface
from octo.model.terrain import Ground, World, distance, looked, normal
from octo.world.jet import SIZES

Pose = tuple[ca.SX, ca.SX]  # rotation (3, 3), translation (3,) m: body frame to world


def pose_of(numbers: ca.SX) -> Pose:
    """(R, t) from the twelve numbers of a pose in the C text: R row by row, then t."""
    return ca.reshape(numbers[:9], 3, 3).T, numbers[9:12]


def perturbed(numbers: ca.SX, twist: ca.SX) -> ca.SX:
    """(1 + twist^)·T of the twelve numbers of T; twist is (ω, v of the point at the world's
    origin)."""
    rotation, position = pose_of(numbers)
    turn = ca.SX.eye(3) + ca.skew(twist[:3])
    return ca.vertcat(ca.vec((turn @ rotation).T), turn @ position + twist[3:])


def _joint_pose(joint: Joint, displacement: ca.SX) -> Pose:
    """Pose (R, t) of one joint at ``displacement`` (rad or m) from its reference."""
    if joint.kind == "slide":
        return ca.SX.eye(3), ca.SX(joint.axis) * displacement
    cross = ca.skew(ca.DM(joint.axis))
    sine, cosine = ca.sin(displacement), ca.cos(displacement)
    rotation = ca.SX.eye(3) + sine * cross + (1.0 - cosine) * (cross @ cross)
    if not joint.anchor.any():
        return rotation, ca.SX.zeros(3)
    anchor = ca.SX(joint.anchor)
    return rotation, anchor - rotation @ anchor


def _compose(left: Pose, right: Pose) -> Pose:
    return left[0] @ right[0], left[0] @ right[1] + left[1]


def body_poses(character: Character, x: ca.SX) -> list[Pose]:
    """World pose (R, t) of every body at the configuration x (n,)."""
    return _poses_and_twists(character, x)[0]


def joint_twists(character: Character, x: ca.SX) -> list[tuple[ca.SX, ca.SX]]:
    """(ω, v of the point at the world's origin) of every degree of freedom, (3,) each, in world
    axes."""
    return _poses_and_twists(character, x)[1]


def _poses_and_twists(
    character: Character, x: ca.SX
) -> tuple[list[Pose], list[tuple[ca.SX, ca.SX]]]:
    poses: list[Pose] = []
    twists: list[tuple[ca.SX, ca.SX]] = []
    for body in character.bodies:
        pose = (ca.SX(ca.DM(body.rotation)), ca.SX(ca.DM(body.position)))
        if body.parent >= 0:
            pose = _compose(poses[body.parent], pose)
        for joint in body.joints:
            axis, displacement = pose[0] @ ca.SX(joint.axis), x[len(twists)] - joint.reference
            if joint.kind == "slide":
                twists.append((ca.SX(3, 1), axis))
            else:
                twists.append((axis, ca.cross(pose[0] @ ca.SX(joint.anchor) + pose[1], axis)))
            pose = _compose(pose, _joint_pose(joint, displacement))
        poses.append(pose)
    return poses, twists


def center_of_mass(character: Character, x: ca.SX) -> ca.SX:
    """World position (3,) m of the centre of mass of the whole character."""
    poses = body_poses(character, x)
    moment = ca.SX.zeros(3)
    for body, mass, (R, t) in zip(character.bodies, character.masses, poses, strict=True):
        moment += (R @ ca.SX(body.com) + t) * mass
    return moment / character.mass


@dataclass(frozen=True, eq=False)
class ContactState:
    """One contact at x_next, seen from x: what Eq. 6 and the contact costs are made of."""

    depth: ca.SX  # m, positive inside the ground
    point: ca.SX  # (3,) m, world: the point of the sphere nearest to the ground
    normal: ca.SX  # (3,) outward
    velocity: ca.SX  # (3,) m/s, Eq. 4 for the material point
    force: ca.SX  # (3,) N on the body, world axes


def contact_height(radius: float | ca.SX, center: ca.SX, terrain: Ground, view: View) -> ca.SX:
    """Distance (m) of the sphere's surface from the ground, negative inside."""
    return distance(terrain, center, section(view, "terrain.")) - radius


def contact_places(
    local: ca.SX, radius: float | ca.SX, pose: Pose, previous: Pose, terrain: Ground, view: View
) -> tuple[ca.SX, ca.SX]:
    """Of a sphere of ``radius`` (m) at ``local`` (3,) m of a body now at ``pose``, one step ago at
    ``previous``: its centre, and where the body's point that is nearest to the ground now was one
    step ago; (3,) m each, world."""
    (R, t), (R_old, t_old) = pose, previous
    center = R @ local + t
    outward = normal(terrain, center, section(view, "terrain."))
    return center, R_old @ local + t_old - radius * (R_old @ (R.T @ outward))


def contact_state(
    center: ca.SX,
    before: ca.SX,
    radius: float | ca.SX,
    law: ContactLaw,
    terrain: Ground,
    view: View,
) -> ContactState:
    """A sphere of ``radius`` (m) from its places (:func:`contact_places`)."""
    depth = -contact_height(radius, center, terrain, view)
    outward = normal(terrain, center, section(view, "terrain."))
    point = center - radius * outward
    velocity = (point - before) / view["dt"]
    own = section(view, "contact.")
    inside = law.force(depth, outward, velocity, own)
    force = ca.if_else(depth > -law.reach(own), inside, ca.SX.zeros(3))
    return ContactState(depth, point, outward, velocity, force)


# of a world, of each contact: where it was looked up (3,) m, and its jet there
LOOKED = 3 + SIZES[-1]


def looked_size(character: Character, terrain: Ground) -> int:
    """How many numbers the functions of a step get behind p: of a world those of each contact at
    x_next, else none."""
    return LOOKED * len(character.terrain_contacts) if isinstance(terrain, World) else 0


def views(character: Character, terrain: Ground, layout: Layout, p: ca.SX) -> list[View]:
    """What each terrain contact sees of p and of what stands behind it (:func:`looked_size`)."""
    view, count = layout.view(p), len(character.terrain_contacts)
    if not isinstance(terrain, World):
        return [view] * count
    own = ca.vertsplit(p[layout.size :], LOOKED) if count else []
    return [looked(view, one[3:], one[:3]) for one in own]


def contact_states(
    character: Character,
    x_next: ca.SX,
    x: ca.SX,
    law: ContactLaw,
    terrain: Ground,
    seen: Sequence[View],
) -> list[ContactState]:
    """The state of every terrain contact, in the order of ``character.terrain_contacts``; ``seen``:
    of :func:`views`."""
    poses, previous = body_poses(character, x_next), body_poses(character, x)
    states = []
    for k, view in zip(character.terrain_contacts, seen, strict=True):
        sphere = character.contacts[k]
        place = (ca.SX(sphere.position), sphere.radius, poses[sphere.body], previous[sphere.body])
        states.append(
            contact_state(*contact_places(*place, terrain, view), sphere.radius, law, terrain, view)
        )
    return states


def joint_force(
    joint: Joint | dict[str, ca.SX], x_next: ca.SX, x: ca.SX, x_prev: ca.SX, view: View
) -> ca.SX:
    """Armature, damping, spring and limit (§4.2) of one joint: its own scalar part of FD, N m or
    N."""
    own = joint if isinstance(joint, dict) else vars(joint)
    dt = view["dt"]
    force = own["armature"] * ((x_next - x) - (x - x_prev)) / dt**2
    force = force + own["damping"] * (x_next - x) / dt
    force += own["stiffness"] * (x_next - own["rest"])
    above, below = x_next - own["upper"], own["lower"] - x_next
    limit = ca.if_else(above > 0.0, above**2, 0.0) - ca.if_else(below > 0.0, below**2, 0.0)
    return force + 3.0 * view["w_joint"] * limit


def pair_potential(squared_distance: ca.SX, radii: float | ca.SX, view: View) -> ca.SX:
    """-w_self min(sqrt(d² + ε²) - radii, 0)³ of §4.2 (its printed sign attracts), J."""
    gap = ca.sqrt(squared_distance + view["pair_epsilon"] ** 2) - radii
    return ca.if_else(gap < 0.0, -view["w_self"] * gap**3, 0.0)


@postponed()
def element_law(element: Element) -> ca.Function:
    """Force (3,) N on point b of an element. Inputs: points a and b of the next node, then of the
    present one, (3,) m each; its parameters; dt.

    Raises
    ------
    ModelError: the element's ``force`` fails, or gives no three numbers of its arguments.
    """
    names = ("a", "b", "a_now", "b_now")
    a, b, a_now, b_now = places = [ca.SX.sym(name, 3) for name in names]
    own, dt = ca.SX.sym("own", len(element.parameters)), ca.SX.sym("dt")
    view = {name: own[k] for k, name in enumerate(element.parameters)}
    what = f"force of element {type(element).__name__}"
    try:
        f = ca.SX(element.force(a, (a - a_now) / dt, b, (b - b_now) / dt, view))
        function = ca.Function("force", [*places, own, dt], [ca.densify(f)], {"cse": True})
    except ModelError:
        raise
    except Exception as error:  # a user's code may raise anything
        said = str(error).strip().split("\n")[0]
        raise ModelError(f"{what} cannot be built: {type(error).__name__}: {said}") from error
    if f.shape != (3, 1):
        raise ModelError(f"{what} has shape {f.shape}, must be (3, 1)")
    return function


def element_force(
    character: Character, k: int, poses: list[Pose], now: list[Pose], view: View
) -> tuple[ca.SX, ca.SX]:
    """Force (3,) N on point b of element ``k``, and the way (3,) m from its point a to b."""
    element, name = character.elements[k], names_of(character.elements)[k]
    points = (ca.SX(ca.DM(point)) for point in (element.point_a, element.point_b))
    ends = list(zip((element.body_a, element.body_b), points, strict=True))
    places = [
        # of the world (None) the point itself
        local if body is None else _place(node[character.body_index(body)], local)
        for node in (poses, now)
        for body, local in ends
    ]
    own = ca.vertcat(ca.SX(0, 1), *section(view, f"{name}.").values())
    return element_law(element)(*places, own, view["dt"]), places[1] - places[0]


def _place(pose: Pose, local: ca.SX) -> ca.SX:
    """World place (3,) m of a body's point."""
    return pose[0] @ local + pose[1]


def mutual_force(
    character: Character, k: int, poses: list[Pose], now: list[Pose], law: ContactLaw, view: View
) -> tuple[ca.SX, ca.SX]:
    """Contact between bodies ``k`` (an index into ``character.touches``): the force (3,) N on the
    sphere's body, and where it acts (3,) m, world.

    The velocity is that of the sphere's material point relative to the solid's body, as one that
    turns with the body sees it.
    """
    c, s = character.touches[k]
    sphere, solid = character.contacts[c], character.solids[s]
    (R, t), (R_now, t_now) = poses[sphere.body], now[sphere.body]
    (R_b, t_b), (R_b_now, t_b_now) = poses[solid.body], now[solid.body]
    center = R @ ca.SX(sphere.position) + t
    rotation, position, numbers = np.split(solid.numbers, (9, 12))
    local = ca.SX.sym("local", 3)  # in the body's frame
    place = ca.SX(ca.DM(rotation.reshape(3, 3))), ca.SX(position)
    phi = surface(solid, local, *place, ca.SX(numbers))
    slope = ca.gradient(phi, local)
    at = R_b.T @ (center - t_b)
    value, slope = ca.Function("phi", [local], [phi, slope])(at)
    outward = R_b @ (slope / ca.norm_2(slope))
    point = center - sphere.radius * outward
    before = R_now @ (R.T @ (point - t)) + t_now
    carried = R_b @ (R_b_now.T @ (before - t_b_now)) + t_b
    own = section(view, "contact.")
    depth = sphere.radius - value
    inside = law.force(depth, outward, (point - carried) / view["dt"], own)
    return ca.if_else(depth > -law.reach(own), inside, ca.SX.zeros(3)), point


def mass_matrix_of_points(body: Body) -> np.ndarray:
    """∫ρ p̄p̄ᵀ (3, 3) kg m² of a body about its centre of mass, from its rotational inertia."""
    return 0.5 * np.trace(body.inertia) * np.eye(3) - body.inertia


def inertial_energy(body: Body, pose: Pose, now: Pose, previous: Pose, view: View) -> ca.SX:
    """½/dt² tr((T - 2T' + T'')M(…)ᵀ) - m g·com of one body, whose gradient in x_next is its part of
    FD."""
    com, second_moment = ca.SX(body.com), ca.SX(ca.DM(mass_matrix_of_points(body)))
    # differences first: the mass matrix would amplify their rounding
    turn = pose[0] - 2.0 * now[0] + previous[0]
    move = turn @ com + (pose[1] - 2.0 * now[1] + previous[1])
    squares = ca.trace(turn @ second_moment @ turn.T) + body.mass * ca.dot(move, move)
    energy = 0.5 * squares / view["dt"] ** 2
    gravity = ca.vertcat(view["gravity_x"], view["gravity_y"], view["gravity_z"])
    return energy - body.mass * ca.dot(gravity, pose[0] @ com + pose[1])


@postponed()
def forward_dynamics(
    character: Character, law: ContactLaw, terrain: Ground, layout: Layout
) -> ca.Function:
    """FD(x_next, x, x_prev, p) (n,) of §4 as one SX function: N m or N, equal to Uᵀu; behind p
    stands what a world says of the contacts at x_next (:func:`looked_size`)."""
    n = character.nx
    x_next, x, x_prev = ca.SX.sym("x_next", n), ca.SX.sym("x", n), ca.SX.sym("x_prev", n)
    p = ca.SX.sym("p", layout.size + looked_size(character, terrain))
    view = layout.view(p)
    poses, now, previous = (body_poses(character, node) for node in (x_next, x, x_prev))
    potential = ca.SX(0)
    for b, body in enumerate(character.bodies):
        potential += inertial_energy(body, poses[b], now[b], previous[b], view)
    for a, b in character.pairs:
        spheres = character.contacts[a], character.contacts[b]
        first, second = (_place(poses[s.body], ca.SX(s.position)) for s in spheres)
        radii = spheres[0].radius + spheres[1].radius
        potential += pair_potential(ca.dot(first - second, first - second), radii, view)
    work, held, values = ca.SX(0), [], []
    seen = views(character, terrain, layout, p)
    states = contact_states(character, x_next, x, law, terrain, seen)
    for k, state in zip(character.terrain_contacts, states, strict=True):
        sphere = character.contacts[k]
        # virtual work f·∂P at a fixed force and material point
        force, material = ca.SX.sym("f", 3), ca.SX.sym("P", 3)
        work += ca.dot(force, _place(poses[sphere.body], material))
        held += [force, material]
        own = poses[sphere.body][0].T @ state.normal
        values += [state.force, ca.SX(sphere.position) - sphere.radius * own]
    for k in range(len(character.elements)):
        law_force, way = element_force(character, k, poses, now, view)
        force = ca.SX.sym("f", 3)
        work += ca.dot(force, way)
        held += [force]
        values += [law_force]
    for k in range(len(character.touches)):
        law_force, where = mutual_force(character, k, poses, now, law, view)
        force, material = ca.SX.sym("f", 3), [ca.SX.sym("P", 3), ca.SX.sym("Q", 3)]
        for sign, b, local in zip((1.0, -1.0), mutual_ends(character)[k], material, strict=True):
            work += sign * ca.dot(force, _place(poses[b], local))
            held.append(local)
            values.append(poses[b][0].T @ (where - poses[b][1]))
        held += [force]
        values += [law_force]
    fd = ca.gradient(potential - work, x_next)
    if held:
        fd = ca.substitute(fd, ca.vertcat(*held), ca.vertcat(*values))
    pairs = enumerate(character.joints)
    fd = fd + ca.vertcat(*(joint_force(own, x_next[j], x[j], x_prev[j], view) for j, own in pairs))
    names = ["x_next", "x", "x_prev", "p"]
    return ca.Function("FD", [x_next, x, x_prev, p], [ca.densify(fd)], names, ["fd"], {"cse": True})
