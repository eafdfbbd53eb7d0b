"""``--world``: shapes by name with their sizes, or out of a file, in place of ``--terrain``."""

from __future__ import annotations

import argparse
import inspect
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from octo.checks import one_of
from octo.cli.arguments import terrain_of
from octo.errors import RobotFileError, UnknownNameError, UsageError, ValueRangeError
from octo.files import is_file
from octo.model import terrain
from octo.model.world_file import ENDINGS, load_world
from octo.world.shapes import Ground
from octo.world.world import World
from octo.worlds import WORLDS

# what may follow a file's name: x, y and z are its place, ground is a level one beneath it
OF_FILES: dict[str, type] = dict.fromkeys(("cell", "height", "scale", "x", "y", "z"), float)
OF_FILES["ground"] = bool
EACH = 0.02  # m, between two places of a way that are looked at
TRUTHS = {"yes": True, "true": True, "1": True, "no": False, "false": False, "0": False}
WORDS = {int: "a whole number", float: "a number", str: "a word"}


def ground_of_words(arguments: argparse.Namespace) -> terrain.Ground:
    """The ground of ``--world``, or of ``--terrain``.

    Raises
    ------
    OctoError: no such name, size or file; options that do not go together.
    """
    if arguments.world is None:
        if arguments.cell is not None:
            raise UsageError("--cell is of a map or a mesh: it goes with --world FILE")
        return terrain_of(arguments.terrain)
    if arguments.terrain != "plane":
        raise UsageError("--world is the ground: it does not go with --terrain")
    return world_of(arguments.world, arguments.cell)


def world_of(word: str, cell: float | None = None) -> World:
    """The world of ``--world`` and ``--cell``."""
    name, colon, sizes = word.partition(":")
    if name in WORLDS and (colon or not is_file(Path(word))):
        if cell is not None:
            raise UsageError(f"--cell is of a map or a mesh: {name} has neither")
        known = {
            key: type(p.default) for key, p in inspect.signature(WORLDS[name]).parameters.items()
        }
        return WORLDS[name](**values_of(f"world {name!r}", sizes, known))
    path, colon, sizes = word.rpartition(":")
    if not colon or is_file(Path(word)):
        path, sizes = word, ""
    file = Path(path)
    if not is_file(file):
        if file.suffix or len(file.parts) > 1:
            raise RobotFileError(f"world file {path} does not exist")
        raise UnknownNameError("world", name, [*WORLDS, *(f"FILE{end}" for end in ENDINGS)])
    own = values_of(f"world {file.name!r}", sizes, OF_FILES)
    if cell is not None:
        own["cell"] = cell
    place, level = [own.pop(axis, 0.0) for axis in "xyz"], own.pop("ground", False)
    world = load_world(path, position=place, **own)
    return World([Ground(name="level ground"), *world.shapes]) if level else world


def check_covered(ground: terrain.Ground, way: Sequence[float]) -> None:
    """Refuse a world that ends, as seen from above, before a straight way (2,) m from the origin
    does.

    Raises
    ------
    ValueRangeError: how far there is a world.
    """
    if not isinstance(ground, World):
        return
    length = float(np.linalg.norm(way))
    shares = np.linspace(0.0, 1.0, 2 + int(length / EACH))
    there = ground.covers(np.column_stack([np.outer(shares, way), np.zeros(len(shares))]))
    if not there.all():
        far = float(length * shares[np.argmin(there)])
        raise ValueRangeError(
            f"the world has nothing below the way from {far:.2g} m on, which is {length:.3g} m "
            "long: put the file elsewhere (x=…, y=…), or add ground=yes"
        )


def values_of(what: str, text: str, known: Mapping[str, type]) -> dict[str, Any]:
    """The sizes of ``name=value,name=value``, each of the kind that is known of it."""
    found: dict[str, Any] = {}
    for part in text.split(",") if text else ():
        name, equals, value = part.partition("=")
        one_of(f"size of {what}", name, known)
        if not equals:
            raise UsageError(f"size {name!r} of {what} has no value, must be {name}=VALUE")
        if name in found:
            raise UsageError(f"size {name!r} of {what} is given twice")
        found[name] = _value(f"{name} of {what}", value, known[name])
    return found


def _value(what: str, text: str, kind: type) -> Any:
    if kind is bool:
        if text not in TRUTHS:
            raise ValueRangeError(f"{what} is {text!r}, must be yes or no")
        return TRUTHS[text]
    try:
        return kind(text)
    except ValueError:
        raise ValueRangeError(f"{what} is {text!r}, must be {WORDS[kind]}") from None
