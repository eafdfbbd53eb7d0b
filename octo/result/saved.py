"""The file of a solution: how its fields are written and read, each checked."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from octo.errors import ShapeError, UnknownNameError, ValueRangeError
from octo.files import replacing
from octo.model import store
from octo.model.archive import Archive, Array
from octo.model.character import Character
from octo.problem.asked import Asked
from octo.result.bounds import Bound
from octo.result.residuals import Residual
from octo.result.stride import ARRAYS, Stride
from octo.result.trajectory import NONE, TOUCHES, VECTORS
from octo.soft import store as soft_store
from octo.soft.coordinates import Coordinates
from octo.solver.status import Status
from octo.world import store as world_store

# of fields that a file of an earlier version may lack
DEFAULTS: dict[str, Any] = {"processor_seconds": 0.0, "seed": 0, "device": "cpu", "stages": {}}
DEFAULTS |= {"passes": [], "starts": [], "asked": [], "bounds": [], "residuals": [], "phases": 0}
WORLD = "world_"  # how the names of a world's arrays begin
SOFT = "soft_"  # … of a soft body's
PHASE = "phase"  # how the names of a phase's entries begin, behind which its number is
SINGLE = ("x", "u", "unknowns", "multipliers", "torque_limit", "contact_depth")
SOLUTION_ARRAYS = (*SINGLE, *VECTORS, *TOUCHES)


def write(target: Path, values: Mapping[str, Any]) -> None:
    """Write the fields of a Solution as an .npz file: arrays, and the rest as JSON."""
    arrays = packed(values)
    for k, phase in enumerate(values["phases"]):
        own = packed({each.name: getattr(phase, each.name) for each in fields(phase)})
        arrays |= {f"{PHASE}{k}_{name}": value for name, value in own.items()}
    with replacing(target) as beside, beside.open("wb") as file:
        np.savez_compressed(file, **arrays)


def packed(values: Mapping[str, Any]) -> dict[str, Any]:
    """The entries of a file, without those of phases; what is no array is JSON in one of them."""
    arrays = {name: values[name] for name in SOLUTION_ARRAYS}
    plain = {name: value for name, value in values.items() if name not in arrays}
    for name in ("ground", "history", "slacks"):
        arrays |= {f"{name}_{key}": value for key, value in plain.pop(name).items()}
    cycle, robot, world = values["cycle"], values["character"], values["world"]
    if world is not None:
        plain["world"], own = world_store.to_plain(world)
        arrays |= {f"{WORLD}{name}": value for name, value in own.items()}
    if values["soft"] is not None:
        plain["soft"], own = soft_store.to_plain(values["soft"])
        arrays |= {f"{SOFT}{name}": value for name, value in own.items()}
    if cycle is not None:
        arrays |= {f"cycle_{name}": getattr(cycle, name) for name in ARRAYS}
        plain["cycle"] = cycle.plain()
    plain["status"] = values["status"].label
    for name in ("asked", "bounds", "residuals"):
        plain[name] = [one.plain() for one in values[name]]
    plain["character"] = None if robot is None else store.to_plain(robot)
    plain["phases"] = len(values["phases"])
    arrays["plain"] = np.array(json.dumps(plain))
    return arrays


def fields_of(file: Archive) -> dict[str, Any]:
    """The arguments of a Solution, but those of each phase in place of the phase; OctoError names
    the field, what it is and what it must be."""
    count = Archive({}, {**DEFAULTS, **file.plain}).whole("phases")
    own = {name: value for name, value in file.arrays.items() if not name.startswith(PHASE)}
    made = _fields_of(Archive(own, file.plain))
    phases = tuple(_phase(file, k) for k in range(count))
    if phases:
        _check_joined(made["x"], [phase["x"] for phase in phases])
    return {**made, "phases": phases}


def _check_joined(whole: Array, parts: Sequence[Array]) -> None:
    """Refuse phases x (N+2, nx) that are not as many steps, or coordinates, as the motion."""
    steps, wanted = [len(x) - 2 for x in parts], len(whole) - 2
    if sum(steps) != wanted:
        counts = " + ".join(map(str, steps))
        raise ValueRangeError(f"phases have {counts} steps, must have {wanted} as x has")
    for k, x in enumerate(parts):
        if x.shape[1] != whole.shape[1]:
            raise ShapeError(f"{PHASE}{k}_x", x.shape, f"(N+2, {whole.shape[1]}) as x")


def _phase(file: Archive, k: int) -> dict[str, Any]:
    """The arguments of the Solution of a phase."""
    prefix = f"{PHASE}{k}_"
    entries = file.arrays.items()
    own = {name.removeprefix(prefix): value for name, value in entries if name.startswith(prefix)}
    plain = json.loads(str(own.pop("plain")))
    if not isinstance(plain, dict):
        raise ValueRangeError(f"{prefix}plain is no JSON object")
    return _fields_of(Archive(own, plain))


def _fields_of(file: Archive) -> dict[str, Any]:
    """The arguments of a Solution without phases."""
    file = Archive(file.arrays, {**DEFAULTS, **file.plain})
    status = _status(file.word("status"))
    # of a solve that failed only the nodes must be finite
    finite = status not in (Status.NOT_FINITE, Status.UNSOLVED, Status.INTERRUPTED)
    left = ("violation", "pointwise_residual")
    times = ("seconds", "setup_seconds", "processor_seconds")
    values = {
        **_motion(file, finite),
        "status": status,
        "device": file.word("device"),
        "ground": _ground(file),
        "world": world_store.of_file(file.plain.get("world"), file.arrays, WORLD),
        "soft": _soft(file),
        "history": file.group("history_"),
        "slacks": _slacks(file, finite),
        "asked": tuple(_asked(record, finite) for record in file.records("asked")),
        "bounds": tuple(_bound(record, finite) for record in file.records("bounds")),
        "residuals": tuple(_residual(record, finite) for record in file.records("residuals")),
        "terms": file.numbers("terms", finite=finite),
        **{name: file.numbers(name) for name in ("parameters", "stages")},
        **{name: file.records(name) for name in ("passes", "starts")},
        **{name: _variables(file, name, finite) for name in ("unknowns", "multipliers")},
        **{name: file.whole(name) for name in ("iterations", "factorizations", "seed")},
        **{name: file.number(name, positive=True) for name in ("weight", "length")},
        **{name: file.number(name, finite=finite) for name in left},
        **{name: file.number(name) for name in times},
        "phases": (),
    }
    for name in file.plain:
        if name not in values:
            raise UnknownNameError("entry", name, values)
    return values


def _soft(file: Archive) -> Coordinates | None:
    """The body of a soft body's motion, whose coordinates are x."""
    found = soft_store.of_file(file.plain.get("soft"), file.arrays, SOFT)
    if found is not None:
        file.array("x", (None, found.count))
        file.array("u", (None, len(found.driven)), finite=False)
    return found


def _status(label: str) -> Status:
    """The status of the name that reports use."""
    known = {status.label: status for status in Status}
    if label not in known:
        raise UnknownNameError("status", label, known)
    return known[label]


def _motion(file: Archive, finite: bool) -> dict[str, Any]:
    """Who moves how: the robot, x, u and the contacts, whose shapes follow from one another."""
    dt = file.number("dt", positive=True)
    plain = file.plain.get("character")
    robot = None if plain is None else store.from_plain(plain)
    x = file.array("x", (None, None if robot is None else robot.nx))
    names = file.words("contact_names")
    steps, contacts = len(x) - 2, len(names)
    if steps < 1 or x.shape[1] < 1:
        raise ShapeError("x", x.shape, "(N+2, nx) of at least one step")
    u = file.array("u", (steps, None if robot is None else robot.nu), finite=finite)
    if robot is not None and contacts != len(robot.terrain_contacts):
        there = f"the robot has {len(robot.terrain_contacts)} such contacts"
        raise ValueRangeError(f"contact_names has {contacts} names, {there}")
    limit = file.array("torque_limit", (u.shape[1],), finite=False)
    if np.isnan(limit).any():
        raise ValueRangeError("torque_limit is not a number")
    depth = file.array("contact_depth", (steps, contacts), finite=finite)
    return {
        **{name: file.word(name) for name in ("name", "basis")},
        **{"character": robot, "dt": dt, "x": x, "u": u, "torque_limit": limit},
        **{"contact_names": names, "contact_depth": depth, "cycle": _stride(file, x, u, robot)},
        **{name: file.array(name, (steps, contacts, 3), finite=finite) for name in VECTORS},
        **{name: _between(file, name, steps, robot, finite) for name in TOUCHES},
    }


def _between(file: Archive, name: str, steps: int, robot: Character | None, finite: bool) -> Array:
    """(N, m, 3) of contacts between bodies; none of a motion that nobody measured, nor in the file
    of an earlier version."""
    if robot is None or not np.size(file.arrays.get(name, ())):
        return NONE
    return file.array(name, (steps, len(robot.touches), 3), finite=finite)


def _variables(file: Archive, name: str, finite: bool) -> Array:
    """The solver's own variables (K, …); none, in any shape, where no solver was at work."""
    found = file.arrays.get(name)
    shape = found.shape if found is not None and found.size == 0 else (None, None)
    return file.array(name, shape, finite=finite)


def _slacks(file: Archive, finite: bool) -> dict[str, Array]:
    """Of the rows between bounds (N, rows) each, and the weight (1,) of their barrier."""
    if not any(name.startswith("slacks_") for name in file.arrays):
        return {}
    found = {"s": file.array("slacks_s", (None, None), finite=finite)}
    for name in ("lower", "upper", "equal"):
        found[name] = file.array(f"slacks_{name}", found["s"].shape, finite=finite)
    return found | {"mu": file.array("slacks_mu", (1,))}


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
    name, what, unit = (own.word(key) for key in ("name", "what", "unit"))
    size, each = own.number("size", positive=True), own.flag("each")
    return Asked(name, what, tuple(found.tolist()), tuple(wanted.tolist()), unit, size, each)


def _bound(record: dict[str, Any], finite: bool) -> Bound:
    """What :meth:`Bound.plain` made."""
    own = Archive({}, record)
    values: dict[str, Any] = {key: own.word(key) for key in ("name", "row", "unit", "side")}
    values |= {key: own.number(key, finite=finite) for key in ("value", "bound", "excess")}
    return Bound(**values, step=own.whole("step"), time=own.number("time"))


def _residual(record: dict[str, Any], finite: bool) -> Residual:
    """What :meth:`Residual.plain` made."""
    own = Archive({}, record)
    values: dict[str, Any] = {key: own.word(key) for key in ("row", "unit")}
    values |= {key: own.number(key, finite=finite) for key in ("value", "part")}
    return Residual(**values, step=own.whole("step"), time=own.number("time"))


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
    shapes: dict[str, tuple[int, ...]] = {"matrix": (n, n), "constant": (n,), "torque": (nu, nu)}
    shapes |= {"rotation": (3, 3), "shift": (3,)}
    values: dict[str, Any] = {name: own.array(name, shape) for name, shape in shapes.items()}
    values |= {name: own.number(name) for name in ("speed", "sideways", "turn", "asymmetry")}
    values["contacts"] = own.indices("contacts", contacts, contacts)
    period = own.number("period", positive=True)
    return Stride(period=period, mirrored=own.flag("mirrored"), **values)
