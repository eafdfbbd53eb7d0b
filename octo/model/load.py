"""``octo.load``: a robot file or the name of a gallery character -> Character."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Literal, get_args

from octo.errors import (
    RobotFileError,
    UnknownNameError,
    UnsupportedFeatureError,
    UsageError,
    ValueRangeError,
    said,
)
from octo.files import is_file
from octo.model import xml_file
from octo.model.character import Character
from octo.model.contacts import Contacts
from octo.model.gallery import CHARACTERS
from octo.model.mjcf import load_mjcf
from octo.model.urdf import load_urdf

Base = Literal["auto", "floating", "fixed"]
BASES = ("auto", "floating", "fixed")
CONTACTS = get_args(Contacts)


def load(
    path: str | os.PathLike[str], base: Base = "auto", contacts: Contacts = "few"
) -> Character:
    """The character of a URDF or MJCF file, or of a name of the gallery.

    Parameters
    ----------
    path: a file, or one of ``octo.model.gallery.CHARACTERS``.
    base: "floating" or "fixed"; "auto" is floating for a URDF and as written for an MJCF.
    contacts: "few" makes as few spheres of the collision shapes as will do. "vertices" keeps every
        vertex of their meshes and the corners of their boxes, as points: only those near the ground
        cost time. Its self-collision pairs are between spheres alone.
    """
    if not isinstance(base, str) or base not in BASES:
        raise ValueRangeError(f"base is {said(base)}, must be one of {', '.join(BASES)}")
    if not isinstance(contacts, str) or contacts not in CONTACTS:
        raise ValueRangeError(f"contacts is {said(contacts)}, must be one of {', '.join(CONTACTS)}")
    if not isinstance(path, (str, os.PathLike)):
        raise UsageError(
            f"path is {said(path)}, must be a robot file's path or a name of the gallery"
        )
    name, file = os.fspath(path), Path(path)
    if name in CHARACTERS:
        character = CHARACTERS[name]()
        if base not in ("auto", character.base):
            raise ValueRangeError(
                f"character {name!r}: base is {said(base)}, must be auto or {character.base}"
            )
        if contacts != "few":
            raise ValueRangeError(
                f"character {name!r}: contacts is {said(contacts)}, must be few: it has no meshes"
            )
        return character
    if not is_file(file):
        if not file.suffix and len(file.parts) == 1:
            raise UnknownNameError("robot", name, CHARACTERS)
        raise RobotFileError(f"{name}: no such file")
    read = load_urdf if dialect(file) == "robot" else load_mjcf
    return read(file, base, contacts)


def dialect(file: Path) -> str:
    """The top element of a robot file: "robot" (URDF) or "mujoco" (MJCF)."""
    if file.suffix == ".xacro":
        raise UnsupportedFeatureError(
            f"{file.name}: xacro macros are not expanded, must be a URDF or MJCF file"
        )
    top = xml_file.top_of(file)
    if top not in ("robot", "mujoco"):
        raise RobotFileError(
            f"{file.name}: top element is <{top}>, must be <robot> (URDF) or <mujoco> (MJCF)"
        )
    return top
