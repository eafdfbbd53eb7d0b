"""A character as an MJCF: the way back from octo.model.mjcf, and the plant's model."""

from __future__ import annotations

import os
from collections.abc import Iterable
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from octo.checks import ending, instance, number, numbers
from octo.errors import ModelError
from octo.files import replacing
from octo.model.body import Body, Joint
from octo.model.character import Character
from octo.model.element import named
from octo.model.export_world import add_world, spelled
from octo.model.kinematics import body_poses
from octo.model.quantities import GRAVITY, Array
from octo.model.quaternions import quaternions
from octo.model.terrain import Plane
from octo.world.shapes import Box, Capsule, Cylinder, Sphere
from octo.world.world import World

UNLIMITED = 1e6  # rad or m: the side of a range that has no limit, MJCF has no infinity
NARROWEST = 1e-6  # rad or m: MuJoCo takes an empty range for none
LEAST_MASS = 1e-12  # kg, kg m²: MuJoCo refuses massless bodies that move; octo does not
LEAST_RADIUS = 1e-5  # m: MuJoCo refuses spheres without a size
LEAST_TORQUE = 1e-9  # N m or N: MuJoCo refuses an empty control range
# MuJoCo's default torsional and rolling friction, unused by its default condim 3
ROLLING = "0.005 0.0001"


def export_mjcf(
    character: Character,
    path: str | os.PathLike[str],
    *,
    terrain: Plane | None = None,
    world: World | None = None,
    friction: float = 0.8,
    timestep: float = 0.002,
    gravity: Iterable[float] = (0.0, 0.0, -GRAVITY),
) -> None:
    """Write ``character`` as an MJCF file.

    The tree, masses, inertias, joints (armature, damping, springs, limits, references) and
    keyframes (``default`` and the character's poses) are octo's. A floating base becomes a free
    joint. Every actuated joint gets a torque motor, in the order of u: its control is u/gear, and
    its range the torque limit. Contact spheres become geoms without mass that collide with the
    ground, and with each other only where the character has a pair; solids collide with the spheres
    that touch them; contact is MuJoCo's own. A SpringDamper becomes a spatial tendon between two
    sites.

    Parameters
    ----------
    path: the file, written beside and then renamed.
    terrain: the ground; level by default. friction: sliding coefficient of ground and spheres.
    world: shapes in place of a ground: geoms of the same kinds, with sharp edges; a map is an
        hfield, of straight lines between its samples; a mesh that is not convex, and a grid of
        distances, a rigid flex of its triangles.
    timestep: s. gravity: (3,) m/s².

    Raises
    ------
    ModelError: what MJCF cannot say: unequal armature or damping of a free base, an inertia that no
        mass distribution has, an element that is no tendon. OutputError: the file cannot be
        written.
    """
    target = ending("path", path, (".xml", ".mjcf"))
    text = mjcf_text(
        character,
        terrain=terrain,
        world=world,
        friction=friction,
        timestep=timestep,
        gravity=gravity,
    )
    with replacing(target) as beside:
        beside.write_text(text, encoding="utf-8")


def mjcf_text(
    character: Character,
    *,
    terrain: Plane | None = None,
    world: World | None = None,
    friction: float = 0.8,
    timestep: float = 0.002,
    gravity: Iterable[float] = (0.0, 0.0, -GRAVITY),
    bumps: Iterable[tuple[Array, Array]] = (),
) -> str:
    """The text of :func:`export_mjcf`. ``bumps``: centres (3,) m in the plane's axes and half sizes
    (3,) m of boxes on it."""
    instance("character", character, Character, "a Character: what octo.load gives")
    if terrain is not None:
        instance("terrain", terrain, Plane, "an octo.Plane: shapes are given as world")
    if world is not None:
        instance("world", world, World, "an octo.World")
        if terrain is not None:
            raise ModelError("terrain and world are both given: a world is the ground itself")
    for name, value in (("friction", friction), ("timestep", timestep)):
        number(name, value)
    numbers("gravity", gravity, (3,))
    top = Element("mujoco", model=character.name)
    SubElement(top, "compiler", angle="radian", autolimits="true", inertiafromgeom="false")
    SubElement(top, "option", timestep=spelled(timestep), gravity=spelled(gravity))
    still = SubElement(top, "worldbody")
    rubs = f"{friction:.10g} {ROLLING}"
    if world is None:
        _add_ground(still, terrain or Plane(), rubs, bumps)
    else:
        look = {"contype": "1", "conaffinity": "0", "friction": rubs}
        taken = {contact.name for contact in character.contacts}
        taken |= {solid_name(character, s) for s in range(len(character.solids))}
        add_world(top, still, world, look, taken)
    elements: list[Element] = []
    for b, body in enumerate(character.bodies):
        parent = elements[body.parent] if body.parent >= 0 else still
        elements.append(_add_body(parent, character, b))
    for contact in character.contacts:
        sphere = {"name": contact.name, "type": "sphere", "mass": "0", "contype": "0"}
        sphere["size"] = spelled(max(contact.radius, LEAST_RADIUS))
        sphere["pos"] = spelled(contact.position)
        sphere["conaffinity"] = str(int(contact.touches_terrain))
        SubElement(elements[contact.body], "geom", sphere, friction=rubs)
    _add_solids(elements, character)
    _add_pairs(top, character, friction)
    _add_elements(top, still, elements, character)
    motors = SubElement(top, "actuator")
    for j in character.actuated:
        _add_motor(motors, character.joints[j])
    _add_keys(top, character)
    ElementTree.indent(top)
    return ElementTree.tostring(top, encoding="unicode") + "\n"


def plane_rotation(terrain: Plane) -> Array:
    """(3, 3): the plane's axes in the world; its z axis is the normal, its x axis lies over the
    world's x axis."""
    p = terrain.parameters
    normal = np.array([p["normal_x"], p["normal_y"], p["normal_z"]])
    along = np.array([1.0, 0.0, -normal[0] / normal[2]])
    along /= np.linalg.norm(along)
    return np.stack([along, np.cross(normal, along), normal], axis=1)


def _add_ground(
    world: Element, terrain: Plane, friction: str, bumps: Iterable[tuple[Array, Array]]
) -> None:
    rotation, origin = plane_rotation(terrain), np.array([0.0, 0.0, terrain.height])
    common = {"quat": spelled(quaternions(rotation[None])[0])}
    common |= {"contype": "1", "conaffinity": "0", "friction": friction}
    plane = {"name": "ground", "type": "plane", "size": "0 0 0.1"}
    SubElement(world, "geom", plane | common, pos=spelled(origin))
    for center, half in bumps:
        box = {"type": "box", "pos": spelled(origin + rotation @ center), "size": spelled(half)}
        SubElement(world, "geom", box | common)


def _add_body(parent: Element, character: Character, b: int) -> Element:
    body = character.bodies[b]
    floats = character.base == "floating" and b == character.base_body
    position, rotation, joints = body.position, body.rotation, body.joints
    if floats:
        pose = character.start_pose
        rotations, origins = body_poses(character, pose)
        position, rotation = origins[b], rotations[b]
    # MuJoCo's own name of what does not move
    name = body.name if body.name != "world" else "_world"
    turn = spelled(quaternions(np.asarray(rotation)[None])[0])
    element = SubElement(parent, "body", name=name, pos=spelled(position), quat=turn)
    if floats:
        _add_free_joint(element, body)
        joints = joints[6:]
    for joint in joints:
        _add_joint(element, joint)
    _add_inertial(element, body)
    return element


def _add_free_joint(element: Element, body: Body) -> None:
    six = body.joints[:6]
    values = {}
    for name in ("armature", "damping"):
        found = {float(getattr(joint, name)) for joint in six}
        if len(found) > 1:
            raise ModelError(
                f"body {body.name!r}: its base joints differ in {name}, MuJoCo's free joint has "
                "one number for all"
            )
        values[name] = spelled(found.pop())
    SubElement(element, "joint", {"name": f"{body.name}_free", "type": "free", **values})


def _add_joint(element: Element, joint: Joint) -> None:
    values = {"name": joint.name, "type": joint.kind, "axis": spelled(joint.axis)}
    values |= {"pos": spelled(joint.anchor), "ref": spelled(joint.reference)}
    values |= {"springref": spelled(joint.rest)}
    for name in ("armature", "damping", "stiffness"):
        values[name] = spelled(getattr(joint, name))
    if joint.limited:
        lower, upper = max(joint.lower, -UNLIMITED), min(joint.upper, UNLIMITED)
        apart = NARROWEST if upper - lower < NARROWEST else 0.0
        values["range"] = spelled([lower - apart, upper + apart])
    SubElement(element, "joint", values)


def _add_inertial(element: Element, body: Body) -> None:
    mass, inertia = body.mass, np.asarray(body.inertia)
    moments = np.linalg.eigvalsh(inertia)
    largest = (1.0 + 1e-6) * (moments[0] + moments[1]) + LEAST_MASS
    if moments[0] < -LEAST_MASS or moments[2] > largest:
        raise ModelError(
            f"body {body.name!r}: principal moments {spelled(moments)} kg m² are of no mass "
            "distribution (the largest must be at most the sum of the others): MuJoCo does not "
            "compile it"
        )
    lift = max(0.0, LEAST_MASS - float(moments[0]))
    # rounding of a thin rod, within 1e-6
    lift += 0.5 * max(0.0, float(moments[2] - moments[1] - moments[0]) - lift)
    full = (inertia + lift * np.eye(3))[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    values = {"pos": spelled(body.com), "mass": spelled(max(mass, LEAST_MASS))}
    SubElement(element, "inertial", values, fullinertia=spelled(full))


def _add_solids(bodies: list[Element], character: Character) -> None:
    """Geoms of the solids that something touches: they collide in its pairs alone. Boxes and
    cylinders lose their rounding."""
    for s in sorted({s for _, s in character.touches}):
        solid = character.solids[s]
        shape = solid.shape
        size: list[float] = []
        if isinstance(shape, Box):
            size = [float(edge) / 2.0 for edge in np.asarray(shape.size)]
        elif isinstance(shape, Sphere):
            size = [shape.radius]
        elif isinstance(shape, (Capsule, Cylinder)):
            size = [shape.radius, 0.5 * shape.length]
        values = {"name": solid_name(character, s), "type": solid.kind, "size": spelled(size)}
        values |= {"mass": "0", "contype": "0", "conaffinity": "0"}
        values["pos"] = spelled(np.asarray(shape.position))
        values["quat"] = spelled(quaternions(np.asarray(shape.rotation)[None])[0])
        SubElement(bodies[solid.body], "geom", values)


def solid_name(character: Character, s: int) -> str:
    """Of a solid's geom: its own, or another where a sphere has that."""
    name = f"{character.solids[s].name}_solid"
    while name in [contact.name for contact in character.contacts]:
        name = f"{name}_"
    return name


def _add_pairs(top: Element, character: Character, friction: float) -> None:
    if not character.pairs and not character.touches:
        return
    contact = SubElement(top, "contact")
    common = {"condim": "3", "friction": f"{friction:.10g} {friction:.10g} {ROLLING} 0.0001"}
    for first, second in character.pairs:
        names = {"geom1": character.contacts[first].name, "geom2": character.contacts[second].name}
        SubElement(contact, "pair", names | common)
    for c, s in character.touches:
        names = {"geom1": character.contacts[c].name, "geom2": solid_name(character, s)}
        SubElement(contact, "pair", names | common)


def _add_elements(
    top: Element, world: Element, bodies: list[Element], character: Character
) -> None:
    """The tendons of the character's elements, of sites where they act."""
    if not character.elements:
        return
    tendons = SubElement(top, "tendon")
    for name, element in named(character.elements):
        values = element.tendon
        if values is None:
            raise ModelError(
                f"element {name} is a {type(element).__name__}, must be one that MuJoCo has a "
                "tendon for, as SpringDamper: leave it out with "
                "dataclasses.replace(robot, elements=())"
            )
        words = {key: spelled(value) for key, value in values.items()}
        tendon = SubElement(tendons, "spatial", {"name": name} | words)
        ends = (("a", element.body_a, element.point_a), ("b", element.body_b, element.point_b))
        for end, body, point in ends:
            on = world if body is None else bodies[character.body_index(body)]
            SubElement(on, "site", name=f"{name}_{end}", pos=spelled(point), size="0.005")
            SubElement(tendon, "site", site=f"{name}_{end}")


def _add_motor(motors: Element, joint: Joint) -> None:
    gear = joint.gear or 1.0
    values = {"name": joint.name, "joint": joint.name, "gear": spelled(gear)}
    if np.isfinite(joint.torque_limit):
        most = max(joint.torque_limit, LEAST_TORQUE) / abs(gear)
        values["ctrlrange"] = spelled([-most, most])
    SubElement(motors, "motor", values)


def _add_keys(top: Element, character: Character) -> None:
    poses = {"default": character.default_pose, **character.poses}
    found = {name: pose for name, pose in poses.items() if pose is not None}
    if not found:
        return
    keys, order = SubElement(top, "keyframe"), depth_first(character)
    for name, pose in found.items():
        q = _qpos(character, np.asarray(pose, dtype=float), order)
        SubElement(keys, "key", name=name, qpos=spelled(q))


def depth_first(character: Character) -> list[int]:
    """Indices of the bodies in the order in which MuJoCo numbers them."""
    children: dict[int, list[int]] = {b: [] for b in range(-1, len(character.bodies))}
    for b, body in enumerate(character.bodies):
        children[body.parent].append(b)
    order, left = [], children[-1][::-1]
    while left:
        b = left.pop()
        order.append(b)
        left += children[b][::-1]
    return order


def _qpos(character: Character, x: Array, order: list[int]) -> Array:
    """MuJoCo's configuration (nq,) of x (nx,) in the exported file."""
    values: list[float] = []
    for b in order:
        first, count = int(character.first_joint[b]), len(character.bodies[b].joints)
        if character.base == "floating" and b == character.base_body:
            rotation, origin = (value[b] for value in body_poses(character, x))
            values += [*origin, *quaternions(rotation[None])[0]]
            first, count = first + 6, count - 6
        values += [*x[first : first + count]]
    return np.array(values)
