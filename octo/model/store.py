"""A character as plain lists and numbers and back, for files (JSON has no arrays and no infinity)."""

from __future__ import annotations

import dataclasses
import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from octo.errors import RobotFileError, said
from octo.model.character import Body, Character, ContactSphere, Joint


def to_plain(value: Any) -> Any:
    """Dataclasses as dicts, arrays as lists, infinities as strings."""
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


def _make(kind: type, plain: dict[str, Any], arrays: tuple[str, ...]) -> Any:
    values = {k: float(v) if v in ("inf", "-inf") else v for k, v in plain.items() if not isinstance(v, list)}
    values |= {k: np.asarray(v, dtype=float) if k in arrays else tuple(v) for k, v in plain.items() if isinstance(v, list)}
    return kind(**values)


def from_plain(plain: dict[str, Any]) -> Character:
    """The character that :func:`to_plain` took apart."""
    bodies = []
    for body in plain["bodies"]:
        joints = [_make(Joint, joint, ("axis", "anchor")) for joint in body["joints"]]
        bodies.append(_make(Body, {**body, "joints": joints}, ("position", "rotation", "com", "inertia")))
    contacts = tuple(_make(ContactSphere, contact, ("position",)) for contact in plain["contacts"])
    pairs = tuple((int(a), int(b)) for a, b in plain["pairs"])
    rest = {k: v for k, v in plain.items() if k not in ("bodies", "contacts", "pairs")}
    rest = {k: tuple(v) if k == "dropped" else v for k, v in rest.items()}
    if rest.get("default_pose") is not None:
        rest["default_pose"] = np.asarray(rest["default_pose"], dtype=float)
    if rest.get("poses") is not None:
        rest["poses"] = {name: np.asarray(pose, dtype=float) for name, pose in rest["poses"].items()}
    return Character(bodies=tuple(bodies), contacts=contacts, pairs=pairs, **rest)


def file_of(path: str | os.PathLike[str], name: str) -> Path:
    """The file itself, or the one of that name where ``path`` is a folder.

    Raises
    ------
    RobotFileError: a folder has no such file; says what octo's files in it are. Or it is no path at all.
    """
    try:
        given = Path(path)
    except TypeError:
        raise RobotFileError(f"path is {said(path)}, must be that of a file or a folder") from None
    if not os.path.isdir(given):  # which, unlike Path.is_dir, is false also of names that are too long
        return given
    if not os.path.isfile(given / name):
        others = sorted(entry.name for entry in given.glob("*.npz"))
        raise RobotFileError(f"folder {given} holds no {name}; of this kind it has {', '.join(others[:5]) or 'nothing'}")
    return given / name
