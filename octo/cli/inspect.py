"""``octo info`` and ``octo robots``: what a file, octo, or this machine has."""

from __future__ import annotations

import argparse
import json
import os
from typing import Any

from octo.cli.arguments import BASE, CONTACTS, add_options, add_world_arguments
from octo.cli.soft import body_of, is_soft
from octo.cli.world import world_of
from octo.cli.written import finite
from octo.devices import devices
from octo.errors import UsageError
from octo.model.character import Character
from octo.model.describe import describe
from octo.model.gallery import CHARACTERS
from octo.model.load import load
from octo.saved import opened
from octo.soft import describe as soft
from octo.world.describe import described, table


def add_info_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "file",
        metavar="FILE",
        nargs="?",
        help="a URDF or MJCF file, a gallery name, a soft body (ball, beam or a mesh file, sizes "
        "behind it as in beam:young=2e4), or what octo wrote: a solution or log (.npz), or its "
        "folder",
    )
    add_world_arguments(parser)
    add_options(
        parser,
        ("--base", None, "auto", BASE),
        ("--contacts", None, "few", CONTACTS, "few|vertices"),
        ("--devices", bool, False, "what this machine can solve on"),
        ("--json", bool, False, "print JSON and nothing else"),
    )
    parser.set_defaults(run=info)


def add_robots_arguments(parser: argparse.ArgumentParser) -> None:
    add_options(parser, ("--json", bool, False, "print JSON and nothing else"))
    parser.set_defaults(run=robots)


def info(arguments: argparse.Namespace) -> int:
    asked = (arguments.file is not None, arguments.devices, arguments.world is not None)
    if sum(asked) != 1:
        raise UsageError("octo info needs one of --world, FILE or --devices")
    file = arguments.file
    if arguments.devices:
        known = devices()
        width = max(len(key) for key in known) + 2
        lines = "\n".join(f"{key:{width}s}{value}" for key, value in known.items())
        print(as_json(known) if arguments.json else lines)
    elif arguments.world is not None:
        world = world_of(arguments.world, arguments.cell)
        print(as_json(described(world)) if arguments.json else table(world))
    elif file.endswith(".npz") or (os.path.isdir(file) and file not in CHARACTERS):
        found = opened(file)
        print(as_json(found.report()) if arguments.json else found)
    elif is_soft(file):
        body = body_of(file)
        print(as_json(soft.described(body)) if arguments.json else soft.table(body))
    else:
        robot = load(file, arguments.base, arguments.contacts)
        print(as_json(describe(robot)) if arguments.json else robot.summary())
    return 0


def robots(arguments: argparse.Namespace) -> int:
    characters = {name: make() for name, make in CHARACTERS.items()}
    if arguments.json:
        print(as_json({name: describe(character) for name, character in characters.items()}))
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


def as_json(values: Any) -> str:
    return json.dumps(finite(values), ensure_ascii=False)
