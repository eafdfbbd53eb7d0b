"""The limits of a URDF's joints: missing bounds are 0, infinite ones none, placeholders said."""

from __future__ import annotations

import math
from dataclasses import dataclass
from xml.etree.ElementTree import Element

from octo.errors import RobotFileError
from octo.model.urdf_elements import MOVABLE

ENDLESS = (-math.inf, math.inf)


@dataclass(frozen=True)
class Limit:
    """What <limit> says of one joint; infinite where there is no limit."""

    lower: float  # rad or m
    upper: float  # rad or m
    effort: float  # N m or N
    velocity: float  # rad/s or m/s


def take_limits(file: str, tree: Element, dropped: list[str]) -> dict[str, Limit]:
    """The limits by joint; they are taken out of the tree, as MuJoCo reads them in its own way."""
    limits: dict[str, Limit] = {}
    notes: dict[str, list[str]] = {}
    for joint in tree.findall("joint"):
        if joint.get("type") not in MOVABLE:
            continue
        name, found = str(joint.get("name")), joint.find("limit")
        attributes = {} if found is None else found.attrib
        effort = _size(file, name, "effort", attributes, notes)
        velocity = _size(file, name, "velocity", attributes, notes)
        limits[name] = Limit(
            *_range(file, name, str(joint.get("type")), attributes, notes), effort, velocity
        )
        for written in joint.findall("limit"):
            joint.remove(written)
        if joint.get("type") == "revolute":
            joint.set("type", "continuous")  # MuJoCo wants a range of every other
    dropped += [
        note.format(f"joint{'s' * (len(names) > 1)} {', '.join(names)}")
        for note, names in notes.items()
    ]
    return limits


def _range(
    file: str, joint: str, kind: str, attributes: dict[str, str], notes: dict[str, list[str]]
) -> tuple[float, float]:
    """Lower and upper limit (rad or m); none where none is written, or nothing but zeros."""
    lower, upper = (
        _number(file, joint, f"limit {end}", attributes.get(end, "0")) for end in ("lower", "upper")
    )
    if lower > upper or (lower == upper and math.isinf(lower)):
        missing = "" if {"lower", "upper"} <= set(attributes) else " (one that is missing is 0)"
        what = f"lower limit is {lower}, must not be above the upper limit {upper}{missing}"
        raise RobotFileError(f"{file}: joint {joint!r}: {what}")
    if kind == "continuous":
        if math.isfinite(lower) and math.isfinite(upper) and lower < upper:
            notes.setdefault("{}: continuous, the range in <limit> does not count", []).append(
                joint
            )
        return ENDLESS
    written = [attributes[end] for end in ("lower", "upper") if end in attributes]
    held = any(float(attributes.get(key, "0")) != 0.0 for key in ("effort", "velocity"))
    if not written or (lower == upper == 0.0 and not held):
        notes.setdefault("{}: no range in <limit>, taken as unlimited", []).append(joint)
        return ENDLESS
    if lower == upper:
        notes.setdefault("{}: the lower limit is the upper limit, it is held there", []).append(
            joint
        )
    return lower, upper


def _size(
    file: str, joint: str, key: str, attributes: dict[str, str], notes: dict[str, list[str]]
) -> float:
    """The size of a limit; infinite for an infinite one, for zero and for none."""
    bound = _number(
        file, joint, "velocity limit" if key == "velocity" else key, attributes.get(key, "inf")
    )
    word = "speed" if key == "velocity" else key
    if bound == 0.0:
        notes.setdefault(f"{{}}: {word} 0 in <limit>, taken as unlimited", []).append(joint)
        return math.inf
    if bound < 0.0 and math.isfinite(bound):
        notes.setdefault(f"{{}}: negative {word} in <limit>, its size counts", []).append(joint)
    return abs(bound)


def _number(file: str, joint: str, what: str, text: str) -> float:
    """A number that may be infinite: Infinity, -inf and 1e400 are."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isnan(value):
        raise RobotFileError(f"{file}: joint {joint!r}: {what} is {text!r}, must be a number")
    return value
