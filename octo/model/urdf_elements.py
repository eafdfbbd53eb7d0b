"""The elements of a URDF, checked; errors name file, element and value."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from functools import partial
from xml.etree.ElementTree import Element

import numpy as np

from octo.errors import ModelError, RobotFileError, UnsupportedFeatureError
from octo.model.kinematics import axis_rotation
from octo.model.quantities import LARGEST, Array
from octo.model.robot_file import Inertial, Limit
from octo.model.xml_file import line_of

DEEPEST = 1000  # links in a row: MuJoCo's limit is near, and its time grows with the square
# attributes of one number
SIZES = {"sphere": ("radius",), "cylinder": ("radius", "length"), "capsule": ("radius", "length")}
VECTORS = {"box": ("size",), "mesh": ("scale",)}  # of three
MOVABLE = ("revolute", "continuous", "prismatic")
ENDLESS = (-math.inf, math.inf)  # rad or m
Note = Callable[[str], None]
ALLOWED = "allowed are revolute, continuous, prismatic, fixed and, at the root, floating"


def attribute(element: Element, child: str, key: str, default: str = "nan") -> str:
    found = element.find(child)
    return default if found is None else found.get(key, default)


def number(file: str, what: str, text: str, line: int = 0) -> float:
    """A number of the file; ``line`` is where it is, 0 if that is not known."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= LARGEST:
        most = f" of at most {LARGEST:.0e}" if math.isfinite(value) else ""
        raise wrong(file, f"{what} is {text!r}, must be a finite number{most}", line)
    return value


def wrong(file: str, what: str, line: int = 0) -> RobotFileError:
    """What is wrong with a file, and on which line, if that is known."""
    return RobotFileError(f"{file}: {what}" + (f" (line {line})" if line else ""))


def line_in(element: Element, child: str) -> int:
    """The line of a child, or the element's own."""
    found = element.find(child)
    return line_of(element if found is None else found)


def numbers(
    file: str, what: str, element: Element, child: str, key: str, default: str = "0 0 0"
) -> Array:
    """Three numbers (3,) of an attribute of a child."""
    words, line = attribute(element, child, key, default).split(), line_in(element, child)
    found = f"{what} {key} is {' '.join(words)!r}, must be three numbers"
    if len(words) != 3:
        raise wrong(file, found, line)
    try:
        return np.array([number(file, f"{what} {key}", word, line) for word in words])
    except RobotFileError:
        if any("," in word for word in words):
            raise wrong(file, f"{found} with spaces between them", line) from None
        raise


def ends(joint: Element) -> tuple[str, str]:
    """Parent and child link of a checked joint."""
    return attribute(joint, "parent", "link"), attribute(joint, "child", "link")


def check_names(file: str, tree: Element) -> None:
    for tag in ("link", "joint"):
        names = Counter(element.get("name") for element in tree.findall(tag))
        for element in tree.findall(tag):
            name = element.get("name")
            if not name:
                raise wrong(file, f"a <{tag}> has no name, every one must", line_of(element))
            if names[name] > 1:
                times = f"occurs {names[name]} times, names must differ"
                raise wrong(file, f"{tag} name {name!r} {times}")
    if not tree.findall("link"):
        raise wrong(file, "has no <link>, must have one at least")


def find_root(file: str, tree: Element) -> str:
    """Name of the one link that is nobody's child."""
    links = dict.fromkeys(str(link.get("name")) for link in tree.findall("link"))
    parents: dict[str, str] = {}
    for joint in tree.findall("joint"):
        for end in ("parent", "child"):
            link = attribute(joint, end, "link", "")
            if link not in links:
                what = f"joint {joint.get('name')!r}: {end} link is {link!r}"
                raise wrong(file, f"{what}, must be a link of the file", line_in(joint, end))
        parent, child = ends(joint)
        if child in parents:
            raise UnsupportedFeatureError(
                f"{file}: link {child!r} is the child of two joints; closed loops are not modelled"
            )
        parents[child] = parent
    roots = [link for link in links if link not in parents]
    if len(roots) != 1:
        which = ", ".join(roots) or "all are in a loop"
        raise wrong(file, f"{len(roots)} links have no parent ({which}), exactly one must")
    children: dict[str, list[str]] = {}
    for child, parent in parents.items():
        children.setdefault(parent, []).append(child)
    reached = [(roots[0], 1)]
    for link, depth in reached:  # which grows meanwhile
        reached += [(child, depth + 1) for child in children.get(link, ())]
    if len(reached) != len(links):
        looped = ", ".join(links.keys() - {link for link, _ in reached})
        raise UnsupportedFeatureError(
            f"{file}: links {looped} form a loop; closed loops are not modelled"
        )
    link, depth = reached[-1]
    if depth > DEEPEST:
        raise UnsupportedFeatureError(
            f"{file}: link {link!r} hangs on {depth - 1} others in a row, at most {DEEPEST - 1} may"
        )
    return roots[0]


def check_joint(file: str, joint: Element) -> None:
    """Type and axis of one joint."""
    name, kind = joint.get("name"), joint.get("type")
    if kind == "planar":
        raise UnsupportedFeatureError(f"{file}: joint {name!r} is planar; {ALLOWED}")
    if kind not in (*MOVABLE, "fixed", "floating"):
        raise wrong(file, f"joint {name!r}: type is {kind!r}; {ALLOWED}", line_of(joint))
    for key in ("xyz", "rpy"):
        numbers(file, f"joint {name!r}: origin", joint, "origin", key)
    for key in ("damping", "friction"):
        value = attribute(joint, "dynamics", key, "0")
        number(file, f"joint {name!r}: {key}", value, line_in(joint, "dynamics"))
    what = f"joint {name!r}: axis"
    if kind in MOVABLE and not numbers(file, what, joint, "axis", "xyz", "1 0 0").any():
        raise wrong(file, f"{what} is 0 0 0, must have a direction", line_in(joint, "axis"))


def check_shapes(file: str, link: Element) -> None:
    """The numbers of a link's collision shapes."""
    what = f"link {str(link.get('name'))!r}: collision"
    for collision in link.findall("collision"):
        for key in ("xyz", "rpy"):
            numbers(file, f"{what} origin", collision, "origin", key)
        for shape in collision.findall("geometry/*"):
            for key in SIZES.get(str(shape.tag), ()):
                size = f"{what}: {key} of its {shape.tag}"
                number(file, size, shape.get(key, "nan"), line_of(shape))
            for key in set(VECTORS.get(str(shape.tag), ())) & shape.attrib.keys():
                holder = Element("shape")
                holder.append(shape)
                numbers(file, f"{what}: {shape.tag}", holder, shape.tag, key)


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
        kinds = "principal inertias that no rigid body has are used as written"
        dropped.append(f"{kinds}: {', '.join(unphysical)}")
    return inertials


def _inertial(file: str, link: str, element: Element | None) -> Inertial:
    """Mass properties of one link, in the link's axes; zero without <inertial>."""
    if element is None:
        return Inertial(0.0, np.zeros(3), np.zeros((3, 3)))
    what, line = f"link {link!r}: mass", line_in(element, "mass")
    mass = number(file, what, attribute(element, "mass", "value"), line)
    if mass < 0.0:
        raise wrong(file, f"{what} is {mass} kg, must not be negative", line)
    com, angles = (
        numbers(file, f"link {link!r}: inertial origin", element, "origin", key)
        for key in ("xyz", "rpy")
    )
    keys = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    line = line_in(element, "inertia")
    xx, yy, zz, xy, xz, yz = (
        number(file, f"link {link!r}: inertia {k}", attribute(element, "inertia", k, "0"), line)
        for k in keys
    )
    roll, pitch, yaw = (
        axis_rotation(axis, angle) for axis, angle in zip(np.eye(3), angles, strict=True)
    )
    turn = yaw @ pitch @ roll
    return Inertial(mass, com, turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T)


def check_mass(file: str, tree: Element, inertials: Mapping[str, Inertial]) -> None:
    """The robot must have mass, and every movable joint must carry some."""
    total = sum(inertial.mass for inertial in inertials.values())
    if total <= 0.0:
        raise wrong(file, f"total mass is {total} kg, must be positive")
    parent_joint = {ends(joint)[1]: joint for joint in tree.findall("joint")}
    carried = {link: inertial.mass for link, inertial in inertials.items()}
    # children that have not been added to a link
    waiting = Counter(ends(joint)[0] for joint in parent_joint.values())
    done = [link for link in carried if not waiting[link]]
    for link in done:  # which grows meanwhile: leaves first
        if link in parent_joint:
            above = ends(parent_joint[link])[0]
            carried[above] += carried[link]
            waiting[above] -= 1
            done += [above] * (waiting[above] == 0)
    for child, joint in parent_joint.items():
        if carried[child] == 0.0 and joint.get("type") in MOVABLE:
            what = f"joint {joint.get('name')!r} moves link {child!r} of mass 0 kg and nothing else"
            raise ModelError(f"{file}: {what}, must move some mass")


def drop_joint_features(file: str, tree: Element, dropped: list[str]) -> None:
    """Note and remove what joints say and octo does not model, one sentence for each kind of
    thing."""
    rubbing, guarded = [], []
    for joint in tree.findall("joint"):
        name, mimic, dynamics = str(joint.get("name")), joint.find("mimic"), joint.find("dynamics")
        if mimic is not None and joint.get("type") in MOVABLE:
            times, more = mimic.get("multiplier", "1"), mimic.get("offset", "0")
            tie = f"{times}·{mimic.get('joint')} + {more}"
            dropped.append(f"mimic joint {name}: it moves on its own, {name} = {tie} is lost")
        friction = "0" if dynamics is None else dynamics.attrib.pop("friction", "0")
        if number(file, f"joint {name!r}: friction", friction) != 0.0:
            rubbing.append(name)
        if joint.find("safety_controller") is not None:
            guarded.append(name)
    for what, names in (("dry friction", rubbing), ("safety controllers", guarded)):
        if names:
            dropped.append(f"{what} of joints {', '.join(names)}")
    transmissions = tree.findall("transmission")
    if transmissions:
        dropped.append(f"{len(transmissions)} transmissions: u is the torque at the joint")


# -- limits: missing bounds are 0, infinite ones none, placeholders are said ----------------------


def take_limits(file: str, tree: Element, dropped: list[str]) -> dict[str, Limit]:
    """The limits by joint; they are taken out of the tree, as MuJoCo reads them in its own way."""
    limits: dict[str, Limit] = {}
    notes: dict[str, list[str]] = {}
    for joint in tree.findall("joint"):
        if joint.get("type") not in MOVABLE:
            continue
        name, found = str(joint.get("name")), joint.find("limit")
        attributes = {} if found is None else found.attrib
        note: Note = partial(_note, notes, name)
        effort, velocity = (
            _size(file, name, key, attributes, note) for key in ("effort", "velocity")
        )
        bounds = _range(file, name, str(joint.get("type")), attributes, note)
        limits[name] = Limit(*bounds, effort, velocity)
        for written in joint.findall("limit"):
            joint.remove(written)
        if joint.get("type") == "revolute":
            joint.set("type", "continuous")  # MuJoCo wants a range of every other
    dropped += [
        note.format(f"joint{'s' * (len(names) > 1)} {', '.join(names)}")
        for note, names in notes.items()
    ]
    return limits


def _note(notes: dict[str, list[str]], joint: str, sentence: str) -> None:
    """Sentences hold {} for their joints."""
    notes.setdefault(sentence, []).append(joint)


def _range(
    file: str, joint: str, kind: str, attributes: dict[str, str], note: Note
) -> tuple[float, float]:
    """Lower and upper limit (rad or m); none where none is written, or nothing but zeros."""
    lower, upper = (
        _limit_number(file, joint, f"limit {end}", attributes.get(end, "0"))
        for end in ("lower", "upper")
    )
    if lower > upper or (lower == upper and math.isinf(lower)):
        missing = "" if {"lower", "upper"} <= set(attributes) else " (one that is missing is 0)"
        what = f"lower limit is {lower}, must not be above the upper limit {upper}{missing}"
        raise wrong(file, f"joint {joint!r}: {what}")
    if kind == "continuous":
        if math.isfinite(lower) and math.isfinite(upper) and lower < upper:
            note("{}: continuous, the range in <limit> does not count")
        return ENDLESS
    written = [attributes[end] for end in ("lower", "upper") if end in attributes]
    held = any(float(attributes.get(key, "0")) != 0.0 for key in ("effort", "velocity"))
    if not written or (lower == upper == 0.0 and not held):
        note("{}: no range in <limit>, taken as unlimited")
        return ENDLESS
    if lower == upper:
        note("{}: the lower limit is the upper limit, it is held there")
    return lower, upper


def _size(file: str, joint: str, key: str, attributes: dict[str, str], note: Note) -> float:
    """The size of a limit; infinite for an infinite one, for zero and for none."""
    what, word = ("velocity limit", "speed") if key == "velocity" else (key, key)
    bound = _limit_number(file, joint, what, attributes.get(key, "inf"))
    if bound == 0.0:
        note(f"{{}}: {word} 0 in <limit>, taken as unlimited")
        return math.inf
    if bound < 0.0 and math.isfinite(bound):
        note(f"{{}}: negative {word} in <limit>, its size counts")
    return abs(bound)


def _limit_number(file: str, joint: str, what: str, text: str) -> float:
    """A number that may be infinite: Infinity, -inf and 1e400 are."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isnan(value):
        raise wrong(file, f"joint {joint!r}: {what} is {text!r}, must be a number")
    return value
