"""``octo.load``: a robot file or the name of a gallery character -> Character."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Literal
from xml.etree import ElementTree

from octo.errors import RobotFileError, UnknownNameError, UnsupportedFeatureError, ValueRangeError, said
from octo.model.character import Character
from octo.model.gallery import CHARACTERS
from octo.model.mjcf import load_mjcf
from octo.model.urdf import load_urdf

Base = Literal["auto", "floating", "fixed"]
BASES = ("auto", "floating", "fixed")


def load(path: str | os.PathLike[str], base: Base = "auto") -> Character:
    """The character of a URDF or MJCF file, or of a name of the gallery.

    Parameters
    ----------
    path: a file, or one of ``octo.model.gallery.CHARACTERS``.
    base: "floating" or "fixed"; "auto" is floating for a URDF and as written for an MJCF.
    """
    if base not in BASES:
        raise ValueRangeError(f"base is {said(base)}, must be one of {', '.join(BASES)}")
    name, file = os.fspath(path), Path(path)
    if name in CHARACTERS:
        character = CHARACTERS[name]()
        if base not in ("auto", character.base):
            raise ValueRangeError(f"character {name!r}: base is {said(base)}, must be auto or {character.base}")
        return character
    if not file.is_file():
        if not file.suffix and len(file.parts) == 1:
            raise UnknownNameError("robot", name, CHARACTERS)
        raise RobotFileError(f"{name}: no such file")
    return load_urdf(file, base) if _dialect(file) == "robot" else load_mjcf(file, base)


def _dialect(file: Path) -> str:
    """The top element of a robot file: "robot" (URDF) or "mujoco" (MJCF)."""
    if file.suffix == ".xacro":
        raise UnsupportedFeatureError(f"{file.name}: xacro macros are not expanded, must be a URDF or MJCF file")
    try:
        with file.open("rb") as stream:
            _, top = next(ElementTree.iterparse(stream, events=("start",)))
    except (ElementTree.ParseError, StopIteration) as error:
        raise RobotFileError(f"{file.name}: not well-formed XML: {error}") from None
    if top.tag not in ("robot", "mujoco"):
        raise RobotFileError(f"{file.name}: top element is <{top.tag}>, must be <robot> (URDF) or <mujoco> (MJCF)")
    return str(top.tag)
