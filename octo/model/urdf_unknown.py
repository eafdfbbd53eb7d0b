"""What a URDF holds that is no URDF: macros and links out of place are refused, the rest said."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from xml.etree.ElementTree import Element

from octo.errors import RobotFileError, UnsupportedFeatureError

PARTS = ("link", "joint")
# of simulators and controllers: they name links and joints
EXTENSIONS = ("gazebo", "transmission", "ros2_control", "sensor")
OF_JOINT = "parent child origin axis limit dynamics mimic safety_controller calibration"
KNOWN = {
    "robot": {*PARTS, *EXTENSIONS, "material"},
    "link": {"inertial", "visual", "collision"},
    "joint": {*OF_JOINT.split()},
    "inertial": {"origin", "mass", "inertia"},
    "collision": {"origin", "geometry", "material"},
}
SHAPES = {"box", "cylinder", "sphere", "mesh", "capsule"}
ADVICE = "run xacro on the file"
EXPRESSIONS = ("${", "$(")


def check_elements(file: str, tree: Element) -> list[str]:
    """Sentences about the elements that octo does not know.

    Raises
    ------
    UnsupportedFeatureError: macros or expressions of xacro that were not expanded.
    RobotFileError: a link or a joint that is no child of <robot>: it would be lost.
    """
    for element in tree.iter():
        if not isinstance(element.tag, str):
            continue  # a comment or an instruction
        if "xacro" in element.tag:
            raise UnsupportedFeatureError(
                f"{file}: {_shown(element)}: macros of xacro are not expanded, {ADVICE}"
            )
    _check_expressions(file, tree)
    for child in tree:
        if not isinstance(child.tag, str):
            continue
        if child.tag not in PARTS and _local(child) in PARTS:
            raise RobotFileError(
                f"{file}: {_shown(child)} is no element of a URDF, must be <{_local(child)}>"
            )
        for inner in _descendants(child):
            if _local(inner) in PARTS and (child.tag not in EXTENSIONS or _is_part(inner)):
                where = f"is inside of {_shown(child)}, must be a child of <robot>"
                raise RobotFileError(f"{file}: {_shown(inner)} {where}")
    return _unknown(tree)


def _check_expressions(file: str, tree: Element) -> None:
    """Refuse ${…} and $(…) where octo reads: in links and joints, but not in their looks."""
    for part in [tree, *(child for child in tree if child.tag in PARTS)]:
        looks = {id(inner) for visual in part.findall("visual") for inner in visual.iter()}
        for element in [part] if part is tree else part.iter():
            for key, value in element.attrib.items():
                if id(element) not in looks and any(mark in value for mark in EXPRESSIONS):
                    where = _shown(part) if element is part else f"{_shown(part)}, <{element.tag}>"
                    what = f"{where}: {key} is {value!r}: expressions of xacro are not evaluated"
                    raise UnsupportedFeatureError(f"{file}: {what}, {ADVICE}")


def _is_part(element: Element) -> bool:
    """Whether an element inside of an extension is one of URDF; SDF has texts for attributes."""
    if _local(element) == "joint":
        return any("link" in end.attrib for end in element if end.tag in ("parent", "child"))
    mass = element.find("inertial/mass")
    return mass is not None and "value" in mass.attrib


def _unknown(tree: Element) -> list[str]:
    """One sentence about all unknown elements."""
    found: Counter[tuple[str, str]] = Counter()
    inside = (inner for child in tree if child.tag in PARTS for inner in child.iter())
    for parent in (tree, *inside):
        known = KNOWN.get(str(parent.tag), SHAPES if parent.tag == "geometry" else None)
        for child in parent:
            if known is not None and isinstance(child.tag, str) and child.tag not in known:
                found[child.tag, parent.tag] += 1
    if not found:
        return []
    names = [f"<{tag}> in {count} <{parent}>" for (tag, parent), count in found.items()]
    return [f"elements that are none of URDF's: {', '.join(names)}"]


def _descendants(element: Element) -> Iterator[Element]:
    return (e for e in element.iter() if e is not element and isinstance(e.tag, str))


def _local(element: Element) -> str:
    """The name of an element without its namespace, in small letters."""
    return str(element.tag).rpartition("}")[2].lower()


def _shown(element: Element) -> str:
    """An element as its file writes it, with the name that it goes by."""
    space, _, tag = str(element.tag).rpartition("}")
    prefix = "xacro:" if "xacro" in space else ""
    name = element.get("name")
    return f"<{prefix}{tag}>" if name is None else f"<{prefix}{tag}> {name!r}"
