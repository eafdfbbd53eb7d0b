"""``octo solve --goal push BODY X,Y``: an object is pushed to a place."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from octo.checks import one_of
from octo.cli.arguments import number, numbers_of, solver_options
from octo.cli.world import values_of
from octo.errors import UsageError
from octo.goals import Goal
from octo.model import objects
from octo.model.character import Character
from octo.model.scene import Scene
from octo.model.scene_file import load_scene
from octo.result.solution import Solution

SHAPES = (
    "to push, on level ground: box:length=,width=,height=,mass=,x=,y= or ball:radius=,mass=,x=,y=; "
    "name= is another name. Several may be given"
)
PUSHES = 5  # starts


@dataclass(frozen=True)
class Kind:
    """A kind of object: its sizes where none are given, and what makes it of them."""

    sizes: Mapping[str, float]
    make: Callable[[Mapping[str, float], str], Character]


def _box(own: Mapping[str, float], name: str) -> Character:
    size = (own["length"], own["width"], own["height"])
    return objects.box(size, own["mass"], (own["x"], own["y"], 0.5 * own["height"]), name=name)


def _ball(own: Mapping[str, float], name: str) -> Character:
    radius = own["radius"]
    return objects.ball(radius, own["mass"], (own["x"], own["y"], radius), name=name)


KINDS = {
    "box": Kind(
        {"length": 0.3, "width": 0.4, "height": 0.3, "mass": 1.5, "x": 0.6, "y": 0.0}, _box
    ),
    "ball": Kind({"radius": 0.12, "mass": 0.5, "x": 0.6, "y": 0.0}, _ball),
}


def object_of(word: str) -> Character:
    """The object of ``--object KIND:SIZES``.

    Raises
    ------
    OctoError: no such kind, or size.
    """
    kind, _, sizes = word.partition(":")
    one_of("object", kind, KINDS)
    known: dict[str, type] = dict.fromkeys(KINDS[kind].sizes, float)
    found = values_of(f"object {kind!r}", sizes, {**known, "name": str})
    name = found.pop("name", kind)
    return KINDS[kind].make({**KINDS[kind].sizes, **found}, name)


def add_object_argument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--object", action="append", default=[], metavar="KIND[:SIZES]", dest="objects", help=SHAPES
    )


def target_of(words: str) -> tuple[str, tuple[float, float]]:
    """The object and the place (x, y) m of ``--goal push BODY X,Y``."""
    body, _, place = words.partition(" ")
    found = numbers_of(place)
    if len(found) != 2:
        raise UsageError(
            f"--goal push is followed by {words!r}, must be BODY X,Y: an object and where it gets "
            "to, m in the world"
        )
    return body, (found[0], found[1])


def check_push(arguments: argparse.Namespace, pushes: bool) -> None:
    """Refuse options that go with a push alone, or not with one.

    Raises
    ------
    UsageError: names the option.
    """
    if not pushes:
        if arguments.objects:
            raise UsageError("--object is to be pushed: it goes with --goal push BODY X,Y")
        return
    if not (arguments.objects or Path(arguments.robot).suffix == ".xml"):
        raise UsageError(
            "--goal push needs something to push: add --object box, or give an MJCF with free "
            "bodies"
        )
    given = {
        "--world": arguments.world is not None,
        "--terrain": arguments.terrain != "plane",
        "--pose": arguments.pose is not None,
        "--start": arguments.start is not None,
        "--limits": arguments.limits != "soft",
        "--basis": arguments.basis != "nodes",
        "--costs": arguments.costs != "natural",
        "--friction": arguments.friction != "viscous" and not _coefficient(arguments.friction),
    }
    for option, is_given in given.items():
        if is_given:
            raise UsageError(
                f"{option} does not go with --goal push, which is on level ground, with natural "
                "terms and dry friction (--friction MU)"
            )


def _coefficient(word: str) -> float | None:
    """Of ``--friction MU``; None of another law."""
    try:
        return number(word)
    except argparse.ArgumentTypeError:
        return None


def pushed(robot: Character, goal: Goal, arguments: argparse.Namespace, began: float) -> Solution:
    """The object of the goal, pushed to its place."""
    from octo.push import push

    things = [object_of(word) for word in arguments.objects]
    if things:
        scene = Scene(robot, things)
    else:
        scene = load_scene(arguments.robot, arguments.base, arguments.contacts)
    friction = _coefficient(arguments.friction)
    given: dict[str, Any] = {} if friction is None else {"mu": friction}
    prepared = time.perf_counter() - began
    solution: Solution = push(
        scene,
        goal.body,
        goal.place[:2],
        arguments.seconds,
        dt=arguments.dt,
        progress=True,
        **given,
        **solver_options(arguments) | {"seeds": arguments.seeds or PUSHES},
    )
    return replace(solution, setup_seconds=solution.setup_seconds + prepared)
