"""The file of a library: the arrays of all motions stacked, and the rest of each as JSON.

Each motion is packed as a Solution's own file is (octo.result.saved). An array that has one shape
in all motions is stacked, (M, …); of another one, as the history of iterations, all numbers stand
one behind the other, beside their shapes. What all motions have alike is written once.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from octo.checks import Array
from octo.errors import ShapeError, ValueRangeError
from octo.files import replacing
from octo.model.archive import Archive, opened
from octo.result import saved
from octo.result.solution import Solution

COMMAND, VARYING, SHAPES, PLAIN = "command_", "varying_", "shapes_", "plain"
# what is there for readers alone, and made again from the motions
DERIVED = ("v", "terms", "term_names", "status", "converged", "iterations")
OWN = (*DERIVED, "gains", "problems", PLAIN)


def write(target: Path, library: Mapping[str, Any]) -> None:
    """Write the fields of a Library."""
    motions: Sequence[Solution] = library["motions"]
    packed = [
        saved.packed({each.name: getattr(motion, each.name) for each in fields(motion)})
        for motion in motions
    ]
    plains = [json.loads(str(own.pop(PLAIN))) for own in packed]
    arrays = _stacked(packed)
    for name, values in library["commands"].items():
        arrays[f"{COMMAND}{name}"] = values
    names = list(dict.fromkeys(name for motion in motions for name in motion.terms))
    arrays |= {
        "v": np.stack([motion.v for motion in motions]),
        "terms": np.array([[m.terms.get(name, 0.0) for name in names] for m in motions]),
        "term_names": np.array(names),
        "status": np.array([motion.status.label for motion in motions]),
        "converged": np.array([motion.converged for motion in motions]),
        "iterations": np.array([motion.iterations for motion in motions]),
        "problems": library["problems"],
    }
    if library["gains"] is not None:
        arrays["gains"] = library["gains"]
    alike, each = _split(plains)
    plain = {"library": 1, "alike": alike, "each": each, "interrupted": library["interrupted"]}
    arrays[PLAIN] = np.array(json.dumps(plain))
    with replacing(target) as beside, beside.open("wb") as file:
        np.savez_compressed(file, **arrays)


def read(path: str | os.PathLike[str]) -> dict[str, Any]:
    """The fields of a Library; OctoError names the file and what is wrong with it."""
    with opened(path, "library", PLAIN) as file:
        plain = file.plain
        if not isinstance(plain.get("alike"), dict):
            raise ValueRangeError("alike is missing, must be what all motions have")
        each = file.records("each")
        if not each:
            raise ValueRangeError("each is empty, must have a motion at least")
        tables = _unstacked(file.arrays, len(each))
        motions = _motions(tables, plain["alike"], each)
        count, commands = len(motions), {}
        for name, values in file.arrays.items():
            if name.startswith(COMMAND):
                shape = (count, *np.shape(values)[1:])
                commands[name.removeprefix(COMMAND)] = file.array(name, shape)
        return {
            "motions": motions,
            "commands": commands,
            "problems": file.indices("problems", count, 10**9),
            "gains": _gains(file, motions),
            "interrupted": file.flag("interrupted"),
        }


def _motions(
    tables: Sequence[dict[str, Any]], alike: dict[str, Any], each: Sequence[dict[str, Any]]
) -> tuple[Solution, ...]:
    """Each from its arrays and its record; one robot that all have is one object."""
    made: list[Solution] = []
    for own, record in zip(tables, each, strict=True):
        found = saved.fields_of(Archive(own, {**alike, **record}))
        if made and "character" in alike:
            found["character"] = made[0].character
        body = found["soft"]
        if made and body is not None and made[0].soft is not None and body.same_as(made[0].soft):
            found["soft"] = made[0].soft
        made.append(Solution(**found))
    return tuple(made)


def _gains(file: Archive, motions: Sequence[Solution]) -> Array | None:
    if "gains" not in file.arrays:
        return None
    N, nu = motions[0].u.shape
    return file.array("gains", (len(motions), N, nu, 2 * motions[0].x.shape[1]), finite=False)


def _stacked(packed: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Arrays by name, of all motions."""
    made: dict[str, Any] = {}
    for name in dict.fromkeys(name for own in packed for name in own):
        rows = [np.asarray(own.get(name, np.zeros(0))) for own in packed]
        if all(name in own for own in packed) and len({row.shape for row in rows}) == 1:
            made[name] = np.stack(rows)
            continue
        there = [name in own for own in packed]
        shapes = [[int(had), *row.shape] for had, row in zip(there, rows, strict=True)]
        widest = max(len(shape) for shape in shapes)
        table = [shape + [-1] * (widest - len(shape)) for shape in shapes]
        made[f"{VARYING}{name}"] = np.concatenate([row.ravel() for row in rows])
        made[f"{SHAPES}{name}"] = np.array(table, dtype=np.int64)
    return made


def _unstacked(arrays: Mapping[str, Any], count: int) -> list[dict[str, Any]]:
    """The arrays of each motion."""
    made: list[dict[str, Any]] = [{} for _ in range(count)]
    for name, values in arrays.items():
        if name in OWN or name.startswith((COMMAND, SHAPES)):
            continue
        if not name.startswith(VARYING):
            if values.shape[:1] != (count,):
                raise ShapeError(name, values.shape, f"({count}, …), one of each motion")
            for own, row in zip(made, values, strict=True):
                own[name] = row
            continue
        plain = name.removeprefix(VARYING)
        table, at = arrays[f"{SHAPES}{plain}"], 0
        if table.ndim != 2 or len(table) != count:
            raise ShapeError(f"{SHAPES}{plain}", table.shape, f"({count}, …)")
        for own, (had, *shape) in zip(made, table.tolist(), strict=True):
            sizes = tuple(size for size in shape if size >= 0)
            end = at + int(np.prod(sizes))
            if had:
                own[plain] = values[at:end].reshape(sizes)
            at = end
    return made


def _split(plains: Sequence[Mapping[str, Any]]) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """What all motions have alike, and the rest of each."""
    first = plains[0]
    alike = {
        name: value
        for name, value in first.items()
        if all(name in own and own[name] == value for own in plains)
    }
    return alike, [{k: v for k, v in own.items() if k not in alike} for own in plains]
