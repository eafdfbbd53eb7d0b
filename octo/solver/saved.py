"""The fields of a saved solution, each checked: a file may come from anywhere."""

from __future__ import annotations

from typing import Any

import numpy as np

from octo.errors import ShapeError, UnknownNameError, ValueRangeError
from octo.model import store
from octo.model.archive import Archive, Array
from octo.model.character import Character
from octo.problem.asked import Asked
from octo.solver.stride import ARRAYS, Stride

DEFAULTS: dict[str, Any] = {  # of fields that a file of an earlier version may lack
    "processor_seconds": 0.0,
    "seed": 0,
    "device": "cpu",
    "stages": {},
    "passes": [],
    "starts": [],
    "asked": [],
}
VECTORS = ("contact_force", "contact_point", "contact_velocity", "contact_normal")


def fields_of(file: Archive, failed: bool) -> dict[str, Any]:
    """The arguments of a Solution but for its status.

    ``failed``: the status says that the motion is not finite; then only its nodes must be.

    Raises
    ------
    OctoError: naming the field, what it is and what it must be.
    """
    file = Archive(file.arrays, {**DEFAULTS, **file.plain})
    finite, dt = not failed, file.number("dt", positive=True)
    robot = (
        None if file.plain.get("character") is None else store.from_plain(file.plain["character"])
    )
    x = file.array("x", (None, None if robot is None else robot.nx))
    names = file.words("contact_names")
    steps, contacts = len(x) - 2, len(names)
    if steps < 1 or x.shape[1] < 1:
        raise ShapeError("x", x.shape, "(N+2, nx) of at least one step")
    u = file.array("u", (steps, None if robot is None else robot.nu), finite=finite)
    if robot is not None and contacts != len(robot.terrain_contacts):
        raise ValueRangeError(
            f"contact_names has {contacts} names, the robot has {len(robot.terrain_contacts)} "
            "such contacts"
        )
    limit = file.array("torque_limit", (u.shape[1],), finite=False)
    if np.isnan(limit).any():
        raise ValueRangeError("torque_limit is not a number")
    values: dict[str, Any] = {
        "name": file.word("name"),
        "character": robot,
        "dt": dt,
        "basis": file.word("basis"),
        "x": x,
        "u": u,
        "torque_limit": limit,
        "contact_names": names,
        "device": file.word("device"),
        "cycle": _stride(file, x, u, robot),
        "contact_depth": file.array("contact_depth", (steps, contacts), finite=finite),
        "ground": _ground(file),
        "history": file.group("history_"),
        "parameters": file.numbers("parameters"),
        "stages": file.numbers("stages"),
        "asked": tuple(_asked(record, finite) for record in file.records("asked")),
        "terms": file.numbers("terms", finite=finite),
        "passes": file.records("passes"),
        "starts": file.records("starts"),
    }
    values |= {name: file.array(name, (steps, contacts, 3), finite=finite) for name in VECTORS}
    values |= {name: _variables(file, name, finite) for name in ("unknowns", "multipliers")}
    values |= {name: file.whole(name) for name in ("iterations", "factorizations", "seed")}
    values |= {name: file.number(name, positive=True) for name in ("weight", "length")}
    values |= {
        name: file.number(name, finite=finite) for name in ("violation", "pointwise_residual")
    }
    values |= {
        name: file.number(name) for name in ("seconds", "setup_seconds", "processor_seconds")
    }
    for name in file.plain:
        if name not in values and name != "status":
            raise UnknownNameError("entry", name, values)
    return values


def _variables(file: Archive, name: str, finite: bool) -> Array:
    """The solver's own variables (K, …); of a motion that no solver found there may be none, in any
    shape."""
    found = file.arrays.get(name)
    shape = found.shape if found is not None and found.size == 0 else (None, None)
    return file.array(name, shape, finite=finite)


def _ground(file: Archive) -> dict[str, Array]:
    """Heights z (a, b) over x (a,) and y (b,); empty without contacts."""
    if not any(name.startswith("ground_") for name in file.arrays):
        return {}
    x, y = file.array("ground_x", (None,)), file.array("ground_y", (None,))
    return {"x": x, "y": y, "z": file.array("ground_z", (len(x), len(y)))}


def _asked(record: dict[str, Any], finite: bool) -> Asked:
    """What :meth:`Asked.plain` made."""
    pair = {name: np.asarray(record.get(name)) for name in ("found", "wanted")}
    own = Archive(pair, {"each": False, **record})
    found = own.array("found", (None,), finite=finite)
    wanted = own.array("wanted", found.shape)
    return Asked(
        own.word("name"),
        own.word("what"),
        tuple(found.tolist()),
        tuple(wanted.tolist()),
        own.word("unit"),
        own.number("size", positive=True),
        own.flag("each"),
    )


def _stride(file: Archive, x: Array, u: Array, robot: Character | None) -> Stride | None:
    found = file.plain.get("cycle")
    if found is None:
        return None
    if not isinstance(found, dict):
        raise ValueRangeError(f"cycle is of type {type(found).__name__}, must be a record")
    arrays = {
        name: file.arrays[f"cycle_{name}"] for name in ARRAYS if f"cycle_{name}" in file.arrays
    }
    own = Archive(arrays, {"asymmetry": 0.0, **found})
    n, nu, contacts = x.shape[1], u.shape[1], 0 if robot is None else len(robot.terrain_contacts)
    return Stride(
        period=own.number("period", positive=True),
        speed=own.number("speed"),
        sideways=own.number("sideways"),
        turn=own.number("turn"),
        mirrored=own.flag("mirrored"),
        asymmetry=own.number("asymmetry"),
        matrix=own.array("matrix", (n, n)),
        constant=own.array("constant", (n,)),
        torque=own.array("torque", (nu, nu)),
        rotation=own.array("rotation", (3, 3)),
        shift=own.array("shift", (3,)),
        contacts=own.indices("contacts", contacts, contacts),
    )
