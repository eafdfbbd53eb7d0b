"""``octo info`` and ``octo robots``: what a file holds, what octo brings along, what this machine
can use."""

from __future__ import annotations

import argparse
import json
import os
from typing import Any

from octo.cli.solve import finite
from octo.devices import devices
from octo.errors import UsageError
from octo.model.character import Character
from octo.model.describe import describe
from octo.model.gallery import CHARACTERS
from octo.model.load import load
from octo.saved import opened


def add_info_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "file",
        metavar="FILE",
        nargs="?",
        help="a URDF or MJCF file, a gallery name, or what octo wrote: a solution or log (.npz), "
        "or its folder",
    )
    parser.add_argument(
        "--base",
        default="auto",
        help="auto, floating or fixed (auto: an MJCF as written, a URDF floating)",
    )
    parser.add_argument("--devices", action="store_true", help="what this machine can solve on")
    parser.add_argument("--json", action="store_true", help="print JSON and nothing else")
    parser.set_defaults(run=info)


def add_robots_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print JSON and nothing else")
    parser.set_defaults(run=robots)


def info(arguments: argparse.Namespace) -> int:
    if arguments.devices == (arguments.file is not None):
        raise UsageError("octo info needs a FILE or --devices, and not both")
    if arguments.devices:
        show(devices(), arguments.json)
    elif arguments.file.endswith(".npz") or (
        os.path.isdir(arguments.file) and arguments.file not in CHARACTERS
    ):
        found = opened(arguments.file)
        print(json.dumps(finite(found.report()), ensure_ascii=False) if arguments.json else found)
    else:
        robot = load(arguments.file, arguments.base)
        print(
            json.dumps(finite(describe(robot)), ensure_ascii=False)
            if arguments.json
            else robot.summary()
        )
    return 0


def robots(arguments: argparse.Namespace) -> int:
    characters = {name: make() for name, make in CHARACTERS.items()}
    if arguments.json:
        print(
            json.dumps(
                finite({name: describe(character) for name, character in characters.items()}),
                ensure_ascii=False,
            )
        )
        return 0
    for name, character in characters.items():
        print(f"{name:10s}{line_of(character)}")
    return 0


def line_of(character: Character) -> str:
    bodies = sum(1 for body in character.bodies if body.mass > 0.0)
    return (
        f"{character.nx} degrees of freedom, {character.nu} actuated, {bodies} bodies, "
        f"{character.mass:.1f} kg"
    )


def show(values: dict[str, Any], as_json: bool) -> None:
    """A dictionary as JSON or as one line a key."""
    if as_json:
        print(json.dumps(finite(values), ensure_ascii=False))
        return
    width = max(len(key) for key in values) + 2
    for key, value in values.items():
        print(f"{key:{width}s}{value}")
