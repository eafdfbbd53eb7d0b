"""The limits of a URDF's joints: missing bounds are 0, infinite ones none, placeholders said."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from xml.etree.ElementTree import Element

from octo.errors import RobotFileError
from octo.model.urdf_elements import MOVABLE

ENDLESS = (-math.inf, math.inf)
Note = Callable[[str], None]


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
        _number(file, joint, f"limit {end}", attributes.get(end, "0")) for end in ("lower", "upper")
    )
    if lower > upper or (lower == upper and math.isinf(lower)):
        missing = "" if {"lower", "upper"} <= set(attributes) else " (one that is missing is 0)"
        what = f"lower limit is {lower}, must not be above the upper limit {upper}{missing}"
        raise RobotFileError(f"{file}: joint {joint!r}: {what}")
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
    bound = _number(file, joint, what, attributes.get(key, "inf"))
    if bound == 0.0:
        note(f"{{}}: {word} 0 in <limit>, taken as unlimited")
        return math.inf
    if bound < 0.0 and math.isfinite(bound):
        note(f"{{}}: negative {word} in <limit>, its size counts")
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
