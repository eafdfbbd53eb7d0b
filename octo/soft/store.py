"""A soft body as plain values and arrays and back: what the file of a solution keeps of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo.errors import ValueRangeError
from octo.model.archive import Archive
from octo.soft.body import Body
from octo.soft.coordinates import Coordinates

ARRAYS = ("points", "faces", "modes", "inertia", "stiffness", "stvk")
MATERIAL = ("young", "poisson", "density")
COUNTS = ("elements", "nodes")


def to_plain(coordinates: Coordinates) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """What is JSON of a body, and its arrays by name."""
    body = coordinates.body
    plain = {name: getattr(body, name) for name in ("name", *MATERIAL, *COUNTS)}
    plain |= {"actuated": [int(j) - 6 for j in coordinates.driven]}
    plain |= {"chart": coordinates.chart, "alpha": body.damping[0], "beta": body.damping[1]}
    arrays = {name: getattr(body, name) for name in ARRAYS if getattr(body, name) is not None}
    return plain, arrays | {"faces": np.ravel(body.faces)}


def of_file(plain: Any, arrays: Mapping[str, NDArray[Any]], prefix: str) -> Coordinates | None:
    """The body of a file whose arrays of it begin with ``prefix``; None where it has none.

    Raises
    ------
    OctoError: names what is missing or not allowed.
    """
    if plain is None:
        return None
    if not isinstance(plain, dict):
        raise ValueRangeError("soft is no record of a body")
    own = Archive(
        {name.removeprefix(prefix): v for name, v in arrays.items() if name.startswith(prefix)},
        plain,
    )
    points = own.array("points", (None, 3))
    corners = own.indices("faces", int(np.size(own.arrays.get("faces", ()))), len(points))
    if corners.size % 3:
        raise ValueRangeError(f"faces has {corners.size} corners, must have three a triangle")
    modes = own.array("modes", (len(points), None, 3))
    r = modes.shape[1]
    values: dict[str, Any] = {
        "inertia": own.array("inertia", (3 * r + 4, 3 * r + 4)),
        "stiffness": own.array("stiffness", (r, r)),
        "damping": (own.number("alpha"), own.number("beta")),
        **{name: own.number(name) for name in MATERIAL},
        **{name: own.whole(name) for name in COUNTS},
    }
    if "stvk" in own.arrays:
        values["stvk"] = own.array("stvk", (r + r * (r + 1) // 2,) * 2)
    body = Body(own.word("name"), points, corners.reshape(-1, 3), modes, **values)
    chart: Any = own.word("chart")
    driven = plain.get("actuated")
    if not isinstance(driven, list) or not all(type(k) is int for k in driven):
        raise ValueRangeError("actuated must be a list of modes")
    return Coordinates(body, chart, driven)
