"""The elements of a URDF, read and checked: names, the tree, masses, joints. Errors name file, element and value."""

from __future__ import annotations

import math
from collections.abc import Mapping
from xml.etree.ElementTree import Element

import numpy as np

from octo.errors import ModelError, RobotFileError, UnsupportedFeatureError
from octo.model.character import LARGEST, Array
from octo.model.kinematics import axis_rotation
from octo.model.robot_file import Inertial

MOVABLE = ("revolute", "continuous", "prismatic")
ALLOWED = "allowed are revolute, continuous, prismatic, fixed and, at the root, floating"


def attribute(element: Element, child: str, key: str, default: str = "nan") -> str:
    found = element.find(child)
    return default if found is None else found.get(key, default)


def number(file: str, what: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= LARGEST:
        most = f" of at most {LARGEST:.0e}" if math.isfinite(value) else ""
        raise RobotFileError(f"{file}: {what} is {text!r}, must be a finite number{most}")
    return value


def numbers(file: str, what: str, element: Element, child: str, key: str, default: str = "0 0 0") -> Array:
    """Three numbers (3,) of an attribute of a child."""
    words = attribute(element, child, key, default).split()
    if len(words) != 3:
        raise RobotFileError(f"{file}: {what} {key} is {' '.join(words)!r}, must be three numbers")
    return np.array([number(file, f"{what} {key}", word) for word in words])


def ends(joint: Element) -> tuple[str, str]:
    """Parent and child link of a checked joint."""
    return attribute(joint, "parent", "link"), attribute(joint, "child", "link")


def check_names(file: str, tree: Element) -> None:
    for tag in ("link", "joint"):
        names = [element.get("name") for element in tree.findall(tag)]
        for name in names:
            if not name:
                raise RobotFileError(f"{file}: a <{tag}> has no name, every one must")
            if names.count(name) > 1:
                raise RobotFileError(f"{file}: {tag} name {name!r} occurs {names.count(name)} times, names must differ")
    if not tree.findall("link"):
        raise RobotFileError(f"{file}: has no <link>, must have one at least")


def find_root(file: str, tree: Element) -> str:
    """Name of the one link that is nobody's child."""
    links = [str(link.get("name")) for link in tree.findall("link")]
    parents: dict[str, str] = {}
    for joint in tree.findall("joint"):
        for end in ("parent", "child"):
            link = attribute(joint, end, "link", "")
            if link not in links:
                raise RobotFileError(f"{file}: joint {joint.get('name')!r}: {end} link is {link!r}, must be a link of the file")
        parent, child = ends(joint)
        if child in parents:
            raise UnsupportedFeatureError(f"{file}: link {child!r} is the child of two joints; closed loops are not modelled")
        parents[child] = parent
    roots = [link for link in links if link not in parents]
    if len(roots) != 1:
        raise RobotFileError(
            f"{file}: {len(roots)} links have no parent ({', '.join(roots) or 'all are in a loop'}), exactly one must"
        )
    reached = {roots[0]}
    for _ in links:
        reached |= {child for child, parent in parents.items() if parent in reached}
    if len(reached) != len(links):
        raise UnsupportedFeatureError(
            f"{file}: links {', '.join(set(links) - reached)} form a loop; closed loops are not modelled"
        )
    return roots[0]


def check_joint(file: str, joint: Element) -> None:
    """Type and axis of one joint."""
    name, kind = joint.get("name"), joint.get("type")
    if kind == "planar":
        raise UnsupportedFeatureError(f"{file}: joint {name!r} is planar; {ALLOWED}")
    if kind not in (*MOVABLE, "fixed", "floating"):
        raise RobotFileError(f"{file}: joint {name!r}: type is {kind!r}; {ALLOWED}")
    if kind in MOVABLE and not numbers(file, f"joint {name!r}: axis", joint, "axis", "xyz", "1 0 0").any():
        raise RobotFileError(f"{file}: joint {name!r}: axis is 0 0 0, must have a direction")


def read_inertials(file: str, tree: Element, dropped: list[str]) -> dict[str, Inertial]:
    """Mass properties of every link as written; links whose inertia no rigid body has are noted."""
    inertials, unphysical = {}, []
    for link in tree.findall("link"):
        name = str(link.get("name"))
        inertials[name] = _inertial(file, name, link.find("inertial"))
        small, middle, large = np.linalg.eigvalsh(inertials[name].inertia)
        slack = 1e-3 * large  # rounding of printed numbers
        if small < -slack or small + middle < large - slack:
            unphysical.append(f"{name} ({small:.2g}, {middle:.2g}, {large:.2g} kg m²)")
    if unphysical:
        dropped.append(f"principal inertias that no rigid body has are used as written: {', '.join(unphysical)}")
    total = sum(inertial.mass for inertial in inertials.values())
    if total <= 0.0:
        raise RobotFileError(f"{file}: total mass is {total} kg, must be positive")
    return inertials


def _inertial(file: str, link: str, element: Element | None) -> Inertial:
    """Mass, centre and inertia of one link, its inertia turned to the link's axes; zero without <inertial>."""
    if element is None:
        return Inertial(0.0, np.zeros(3), np.zeros((3, 3)))
    mass = number(file, f"link {link!r}: mass", attribute(element, "mass", "value"))
    if mass < 0.0:
        raise RobotFileError(f"{file}: link {link!r}: mass is {mass} kg, must not be negative")
    com, angles = (numbers(file, f"link {link!r}: inertial origin", element, "origin", key) for key in ("xyz", "rpy"))
    keys = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    xx, yy, zz, xy, xz, yz = (number(file, f"link {link!r}: inertia {k}", attribute(element, "inertia", k, "0")) for k in keys)
    roll, pitch, yaw = (axis_rotation(axis, angle) for axis, angle in zip(np.eye(3), angles, strict=True))
    turn = yaw @ pitch @ roll
    return Inertial(mass, com, turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T)


def check_moved_mass(file: str, tree: Element, inertials: Mapping[str, Inertial]) -> None:
    """Every movable joint must carry some mass."""
    parent_joint = {ends(joint)[1]: joint for joint in tree.findall("joint")}
    carried = {link: inertial.mass for link, inertial in inertials.items()}
    for link, inertial in inertials.items():
        above = link
        while above in parent_joint:
            above = ends(parent_joint[above])[0]
            carried[above] += inertial.mass
    for child, joint in parent_joint.items():
        if carried[child] == 0.0 and joint.get("type") in MOVABLE:
            what = f"joint {joint.get('name')!r} moves link {child!r} of mass 0 kg and nothing else"
            raise ModelError(f"{file}: {what}, must move some mass")


def drop_joint_features(file: str, tree: Element, dropped: list[str]) -> None:
    """Note and remove what joints say and octo does not model, one sentence for each kind of thing."""
    rubbing, guarded = [], []
    for joint in tree.findall("joint"):
        name, mimic, dynamics = str(joint.get("name")), joint.find("mimic"), joint.find("dynamics")
        if mimic is not None and joint.get("type") in MOVABLE:
            tie = f"{mimic.get('multiplier', '1')}·{mimic.get('joint')} + {mimic.get('offset', '0')}"
            dropped.append(f"mimic joint {name}: it moves on its own, {name} = {tie} is lost")
        if dynamics is not None and number(file, f"joint {name!r}: friction", dynamics.attrib.pop("friction", "0")) != 0.0:
            rubbing.append(name)
        if joint.find("safety_controller") is not None:
            guarded.append(name)
    for what, names in (("dry friction", rubbing), ("safety controllers", guarded)):
        if names:
            dropped.append(f"{what} of joints {', '.join(names)}")
    transmissions = tree.findall("transmission")
    if transmissions:
        dropped.append(f"{len(transmissions)} transmissions: u is the torque at the joint")
