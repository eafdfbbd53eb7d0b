"""A world as plain lists and arrays and back: what the file of a solution keeps of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo.checks import one_of
from octo.errors import ValueRangeError
from octo.world import shapes
from octo.world.shapes import Shape
from octo.world.world import World

SHAPES: dict[str, type[Shape]] = {
    name: getattr(shapes, name) for name in shapes.__all__ if name != "Shape"
}
LISTED = 16  # numbers of an array that is a list; longer ones are arrays in the file


def to_plain(world: World) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """What is JSON of a world, and its arrays by name."""
    arrays: dict[str, NDArray[Any]] = {}
    records = []
    for k, shape in enumerate(world.shapes):
        own: dict[str, Any] = {"kind": type(shape).__name__}
        for name in (field.name for field in fields(shape) if field.init):
            value = getattr(shape, name)
            if isinstance(value, np.ndarray) and value.size > LISTED:
                arrays[f"{k}_{name}"] = value
            else:
                own[name] = value.tolist() if isinstance(value, np.ndarray) else value
        records.append(own)
    return {"blend": world.blend, "shapes": records}, arrays


def of_file(plain: Any, arrays: Mapping[str, NDArray[Any]], prefix: str) -> World | None:
    """The world of a file whose arrays of it begin with ``prefix``; None where it has none."""
    own = {name.removeprefix(prefix): v for name, v in arrays.items() if name.startswith(prefix)}
    return None if plain is None else from_plain(plain, own)


def from_plain(plain: Any, arrays: Mapping[str, NDArray[Any]]) -> World:
    """The world of :func:`to_plain`.

    Raises
    ------
    OctoError: names what is missing, unknown or not allowed.
    """
    if not isinstance(plain, dict) or not isinstance(plain.get("shapes"), list):
        raise ValueRangeError("world is no record of shapes")
    made = []
    for k, record in enumerate(plain["shapes"]):
        if not isinstance(record, dict):
            raise ValueRangeError(f"shape {k} of the world is no record")
        kind = SHAPES[one_of("kind of a shape", record.get("kind"), SHAPES)]
        known = {field.name for field in fields(kind) if field.init}
        own = {name: value for name, value in record.items() if name != "kind"}
        own |= {
            name.removeprefix(f"{k}_"): value
            for name, value in arrays.items()
            if name.startswith(f"{k}_")
        }
        for name in own:
            one_of(f"field of a {kind.__name__}", name, known)
        try:
            made.append(kind(**own))
        except TypeError as error:
            raise ValueRangeError(f"shape {k} of the world: {error}") from None
    return World(made, plain.get("blend", World.blend))
