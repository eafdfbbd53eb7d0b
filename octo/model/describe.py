"""What a character is: as plain lists and numbers, and as a table to read."""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import numpy as np

from octo.checks import instance
from octo.model.body import Body, Joint
from octo.model.element import named
from octo.model.feet import terrain_bottoms
from octo.model.kinematics import body_poses, center_of_mass
from octo.model.quantities import Array
from octo.model.tree import Tree

UNITS = {"length": "m", "mass": "kg", "inertia": "kg m²", "hinge": "rad", "slide": "m"}
UNITS |= {"speed of a hinge": "rad/s", "speed of a slide": "m/s"}
UNITS |= {"torque of a hinge": "N m", "force of a slide": "N"}
SHOWN = 4  # meshes named in one sentence
MANY = 16  # contacts of one body that are named, at most


class Text(str):
    """Words that an interactive session shows as they are printed."""

    def __repr__(self) -> str:
        return str(self)


def describe(character: Tree) -> dict[str, Any]:
    """What a character is, as plain lists, names and numbers; None where there is no limit.

    Name, sizes and mass (kg); the names of bodies, contacts and pairs; what its file says and octo
    does not model; its ``elements`` (points in m, a body that is None is the world); ``objects``,
    ``solids`` (name and kind) and ``touches`` (contact spheres and solids); the base; ``height``
    (m) of the base over the lowest contact and ``inertia`` (3, 3) kg m² about the centre of mass,
    both in the default pose; ``joints`` in the order of the coordinates; ``links``: mass, centre of
    mass (m, body axes) and inertia (3, 3) about it; ``poses`` by name; ``units``.
    """
    instance("character", character, Tree, "a Character: what octo.load gives")
    names = [contact.name for contact in character.contacts]
    pose = character.start_pose
    poses = {"default": pose, **character.poses}
    return {
        **{name: getattr(character, name) for name in ("name", "nx", "nu", "mass")},
        "bodies": [body.name for body in character.bodies],
        "contacts": names,
        "pairs": [[names[a], names[b]] for a, b in character.pairs],
        "dropped": list(character.dropped),
        "elements": _elements(character),
        "objects": list(character.objects),
        "solids": [[solid.name, solid.shape.word] for solid in character.solids],
        "touches": [[names[c], character.solids[s].name] for c, s in character.touches],
        "base": character.base,
        "chart": character.chart,
        "height": default_height(character),
        "inertia": whole_inertia(character, pose).tolist(),
        "joints": [_joint(body, joint) for body in character.bodies for joint in body.joints],
        "links": [_link(body) for body in character.bodies],
        "poses": {name: np.asarray(values).tolist() for name, values in poses.items()},
        "units": UNITS,
    }


def _joint(body: Body, joint: Joint) -> dict[str, Any]:
    own = {"name": joint.name, "kind": joint.kind, "body": body.name, "actuated": joint.actuated}
    limits = {n: _finite(getattr(joint, n)) for n in ("lower", "upper", "velocity_limit")}
    return own | limits | {"torque_limit": _finite(joint.torque_limit) if joint.actuated else None}


def _link(body: Body) -> dict[str, Any]:
    own = {"name": body.name, "mass": body.mass}
    return own | {"com": body.com.tolist(), "inertia": body.inertia.tolist()}


def _elements(character: Tree) -> list[dict[str, Any]]:
    return [
        {
            "name": name,
            "kind": type(element).__name__,
            "bodies": [element.body_a, element.body_b],
            "points": [list(element.point_a), list(element.point_b)],
            "parameters": dict(element.parameters),
        }
        for name, element in named(character.elements)
    ]


def _touches(character: Tree) -> list[str]:
    """A line that says how many spheres touch each solid; none where there is none."""
    own = Counter(character.solids[s].name for _, s in character.touches)
    parts = [f"{name} with {count} sphere{'s' * (count > 1)}" for name, count in own.items()]
    return [f"touches   {len(character.touches)}: {', '.join(parts)}"] if parts else []


def lost_shapes(character: Tree) -> str:
    """Which collision meshes could not be read, in one sentence; empty where all could."""
    start = "collision mesh "
    lost = [note.removeprefix(start) for note in character.dropped if note.startswith(start)]
    if not lost:
        return ""
    more = f"; and {len(lost) - SHOWN} more, octo info lists all" if len(lost) > SHOWN else ""
    return (
        f"collision meshes are left out and nothing touches there: {'; '.join(lost[:SHOWN])}{more}"
    )


def summary(character: Tree) -> Text:
    """A table for people: sizes, then a line for each joint, each body and each pose."""
    pose = character.start_pose
    height = default_height(character)
    names = [contact.name for contact in character.contacts]
    principal = np.linalg.eigvalsh(whole_inertia(character, pose))
    moments = ", ".join(f"{value:.3g}" for value in principal)
    counted = {
        "bodies": [body.name for body in character.bodies],
        "contacts": _contacts(character),
        "pairs": [f"{names[a]} – {names[b]}" for a, b in character.pairs],
        "poses": list(character.poses),
        "dropped": list(character.dropped),
    }
    if character.elements:
        counted["elements"] = [
            f"{name} ({element.body_a or 'world'} – {element.body_b or 'world'})"
            for name, element in named(character.elements)
        ]
    if character.objects:
        counted["objects"] = list(character.objects)
    lines = [
        f"name      {character.name}",
        f"base      {character.base}"
        + (f", angles {character.chart}" if character.base == "floating" else ""),
        f"nx        {character.nx}",
        f"nu        {character.nu}",
        f"mass      {character.mass:.6g} kg",
        f"height    {'no contact' if height is None else f'{height:.4g} m'}, of the base over "
        "the lowest contact, default pose",
        f"inertia   ({moments}) kg m², principal, about the centre of mass, default pose",
        *(
            f"{key:10s}{_counted(values, key == 'dropped', len(getattr(character, key)))}"
            for key, values in counted.items()
        ),
        *_touches(character),
    ]
    poses = {"default": pose, **character.poses}
    return Text("\n".join([*lines, "", *_joint_rows(character, poses), "", *_body_rows(character)]))


def default_height(character: Tree) -> float | None:
    """m, of the base's origin over the lowest point of a contact in the default pose; None without
    contacts."""
    if not character.own_contacts:
        return None
    pose = character.start_pose
    lowest = terrain_bottoms(character, pose).min()
    return float(body_poses(character, pose)[1][character.base_body, 2] - lowest)


def whole_inertia(character: Tree, x: Array) -> Array:
    """(3, 3) kg m² of the robot's bodies about its centre of mass at x (nx,), world axes."""
    rotations, origins = body_poses(character, x)
    middle, total = center_of_mass(character, x), np.zeros((3, 3))
    for b in np.flatnonzero(character.own):
        body, rotation, origin = character.bodies[b], rotations[b], origins[b]
        arm = origin + rotation @ body.com - middle
        steiner = arm @ arm * np.eye(3) - np.outer(arm, arm)
        total += rotation @ body.inertia @ rotation.T + body.mass * steiner
    return total


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _contacts(character: Tree) -> list[str]:
    """Names; of a body with very many, as vertices of its mesh, how many."""
    count = Counter(contact.body for contact in character.contacts)
    many = [b for b, own in count.items() if own > MANY]
    names = [contact.name for contact in character.contacts if contact.body not in many]
    return names + [f"{count[b]} on {character.bodies[b].name}" for b in many]


def _counted(names: list[str], one_a_line: bool, count: int) -> str:
    between = f"\n{'':10s}" if one_a_line else ", "
    return f"{count}: {between.join(names)}" if names else "none"


def _joint_rows(character: Tree, poses: dict[str, Array]) -> list[str]:
    """One line a coordinate: its range, limits, and its value in each pose."""
    wide = max(8, *(len(joint.name) for joint in character.joints)) if character.joints else 8
    shown = list(poses)[:4]
    head = f"{'joint':{wide}s}  {'unit':5s}{'lower':>9s}{'upper':>9s}{'speed':>9s}{'torque':>9s}"
    rows = [head + "".join(f"{name[:9]:>10s}" for name in shown)]
    for j, joint in enumerate(character.joints):
        row = (
            f"{joint.name:{wide}s}  "
            f"{_unit(joint):5s}{_limit(joint.lower)}{_limit(joint.upper)}{_limit(joint.velocity_limit)}"
        )
        row += _limit(joint.torque_limit) if joint.actuated else f"{'free':>9s}"
        rows.append(row + "".join(f"{poses[name][j] + 0.0:10.4g}" for name in shown))
    rows.append(
        "lower, upper: rad (m of a slide); speed: rad/s (m/s); torque: N m (N), 'free' is "
        "not actuated; – is no limit"
    )
    return rows


def _body_rows(character: Tree) -> list[str]:
    wide = max(8, *(len(body.name) for body in character.bodies))
    rows = [f"{'body':{wide}s}{'mass':>9s}  {'centre of mass':32s}  principal inertia"]
    for body in character.bodies:
        place = " ".join(f"{value:10.3g}" for value in body.com + 0.0)
        moments = " ".join(f"{value:9.3g}" for value in np.linalg.eigvalsh(body.inertia))
        rows.append(f"{body.name:{wide}s}{body.mass:9.4g}  {place}  {moments}")
    rows.append(
        "mass: kg; centre of mass: m, in the body's axes; inertia: kg m², about the centre of mass"
    )
    return rows


def _unit(joint: Joint) -> str:
    return "rad" if joint.kind == "hinge" else "m"


def _limit(value: float) -> str:
    return f"{value:9.4g}" if math.isfinite(value) else f"{'–':>9s}"
