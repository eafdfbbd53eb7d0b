"""A character as plain lists and numbers and back: JSON has no arrays and no infinity."""

from __future__ import annotations

import dataclasses
import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from octo.checks import numbers, one_of, whole
from octo.errors import RobotFileError, UnknownNameError, ValueRangeError, said
from octo.model.body import Body, ContactSphere, Joint
from octo.model.character import Character
from octo.model.element import DryFriction, Element, SpringDamper
from octo.model.look import Look
from octo.model.solid import Solid
from octo.world.shapes import Box, Capsule, Cylinder, Shape, Sphere

SHAPES: dict[str, tuple[int, ...]] = {"rotation": (3, 3), "inertia": (3, 3)}
SHAPES |= dict.fromkeys(("axis", "anchor", "position", "com", "size"), (3,))
# elements that a file can give back: those of octo
KINDS_OF_ELEMENTS: dict[str, type[Element]] = {
    kind.__name__: kind for kind in (SpringDamper, DryFriction)
}
SHAPES_OF_SOLIDS: dict[str, type[Shape]] = {
    kind.__name__: kind for kind in (Sphere, Box, Capsule, Cylinder)
}
# of the words of annotations
KINDS: dict[str, Any] = {"str": str, "bool": bool, "int": int, "float": (int, float)}


def to_plain(value: Any) -> Any:
    """Dataclasses as dicts, arrays as lists, infinities as strings."""
    if isinstance(value, Element):
        return _plain_element(value)
    if isinstance(value, Shape):
        fields = {f.name: to_plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
        return {"kind": value.word, **fields}
    if dataclasses.is_dataclass(value):
        return {f.name: to_plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, np.ndarray):
        return [to_plain(v) for v in value.tolist()]
    if isinstance(value, dict):
        return {k: to_plain(v) for k, v in value.items()}
    if isinstance(value, (tuple, list)):
        return [to_plain(v) for v in value]
    if isinstance(value, (float, np.floating)) and not math.isfinite(value):
        return str(value)
    return value.item() if isinstance(value, np.generic) else value


def _plain_element(element: Element) -> dict[str, Any]:
    """The name of its class, and its numbers; of a user's own only where it acts."""
    kind = type(element)
    known = KINDS_OF_ELEMENTS.get(kind.__name__) is kind
    fields = dataclasses.fields(element if known else Element)
    values = {f.name: to_plain(getattr(element, f.name)) for f in fields}
    return {"kind": kind.__name__, "known": known, **values}


def _solid(plain: dict[str, Any]) -> Solid:
    values = dict(plain.get("shape") or {})
    word = one_of("shape of a solid", values.pop("kind", None), SHAPES_OF_SOLIDS)
    kind = SHAPES_OF_SOLIDS[word]
    allowed = {field.name for field in dataclasses.fields(kind)}
    for name in values:
        one_of(f"field of a {word}", name, allowed)
    return Solid(
        str(plain.get("name")), whole("body of a solid", plain.get("body"), 0), kind(**values)
    )


def _look(plain: dict[str, Any]) -> Look:
    color = plain.get("color")
    given = None if color is None else numbers("color", color, (4,))
    look: Look = _make(Look, plain, color=given)
    return look


def _elements(plain: dict[str, Any]) -> tuple[tuple[Element, ...], list[str]]:
    """The elements that a file has whole, and sentences that name the others."""
    found: list[Element] = []
    lost = []
    for k, values in enumerate(_list("elements", plain) if "elements" in plain else ()):
        values = dict(values)
        name, known = str(values.pop("kind", "")), values.pop("known", False)
        kind = KINDS_OF_ELEMENTS.get(name) if known is True else None
        if kind is None:
            lost.append(
                f"element {k}, a user-written {name}: files have no code, give it again with "
                "dataclasses.replace(robot, elements=...)"
            )
            continue
        for field in dataclasses.fields(kind):
            if field.name not in values:
                raise ValueRangeError(f"{field.name} of element {k} is missing")
        if len(values) > len(dataclasses.fields(kind)):
            raise ValueRangeError(f"element {k} has fields that a {name} has not")
        found.append(kind(**values))
    return tuple(found), lost


def _make(kind: type, plain: dict[str, Any], **given: Any) -> Any:
    """A dataclass of plain fields, each of its declared type; ``given`` ones as they are."""
    values = dict(given)
    declared = {f.name: str(f.type) for f in dataclasses.fields(kind)}
    for name, value in plain.items():
        if name not in declared:
            raise UnknownNameError(f"field of a {kind.__name__.lower()}", name, declared)
        if name in given:
            continue
        if name in SHAPES:
            values[name] = numbers(name, value, SHAPES[name])
            continue
        word = declared[name].split("[")[0]
        infinite = word == "float" and value in ("inf", "-inf")
        alike = isinstance(value, bool) == (word == "bool")
        fits = alike and isinstance(value, KINDS.get(word, str))
        if not (fits or infinite):
            raise ValueRangeError(
                f"{name} is of type {type(value).__name__}, must be of type {word}"
            )
        values[name] = float(value) if word == "float" else value
    return kind(**values)


def from_plain(plain: dict[str, Any]) -> Character:
    """The character that :func:`to_plain` took apart.

    Raises
    ------
    OctoError: a field is missing, unknown, of another type or out of what a character allows.
    """
    bodies = [
        _make(Body, body, joints=tuple(_make(Joint, joint) for joint in _list("joints", body)))
        for body in _list("bodies", plain)
    ]
    contacts = tuple(_make(ContactSphere, contact) for contact in _list("contacts", plain))
    pairs = tuple((whole("pair", a, 0), whole("pair", b, 0)) for a, b in _list("pairs", plain))
    size = (sum(len(body.joints) for body in bodies),)
    solids = tuple(map(_solid, _list("solids", plain) if "solids" in plain else ()))
    touches = tuple(
        (whole("touch", a, 0), whole("touch", b, 0)) for a, b in plain.get("touches", ())
    )
    elements, lost = _elements(plain)
    pose, poses = plain.get("default_pose"), plain.get("poses") or {}
    return _make(
        Character,
        plain,
        bodies=tuple(bodies),
        contacts=contacts,
        pairs=pairs,
        default_pose=None if pose is None else numbers("default_pose", pose, size),
        poses={str(name): numbers(f"pose {name}", values, size) for name, values in poses.items()},
        dropped=tuple(str(sentence) for sentence in [*plain.get("dropped", ()), *lost]),
        elements=elements,
        solids=solids,
        touches=touches,
        objects=tuple(str(name) for name in plain.get("objects", ())),
        looks=tuple(map(_look, _list("looks", plain) if "looks" in plain else ())),
    )


def _list(name: str, plain: Any) -> list[Any]:
    if not isinstance(plain, dict) or not isinstance(plain.get(name), list):
        raise ValueRangeError(f"{name} is missing, must be a list")
    return list(plain[name])


def file_of(path: str | os.PathLike[str], name: str) -> Path:
    """The file itself, or the one of that name where ``path`` is a folder.

    Raises
    ------
    RobotFileError: a folder has no such file; says what octo's files in it are. Or it is no path at
        all.
    """
    try:
        given = Path(path)
    except TypeError:
        raise RobotFileError(f"path is {said(path)}, must be that of a file or a folder") from None
    # which, unlike Path.is_dir, is false also of names that are too long
    if not os.path.isdir(given):
        return given
    if not os.path.isfile(given / name):
        others = sorted(entry.name for entry in given.glob("*.npz"))
        raise RobotFileError(
            f"folder {given} holds no {name}; of this kind it has "
            f"{', '.join(others[:5]) or 'nothing'}"
        )
    return given / name
