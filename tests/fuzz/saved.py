"""Saved solutions and logs, damaged or made up."""

from __future__ import annotations

import functools
import io
import json
import tempfile
import zipfile
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

import octo
from tests.fuzz.judge import call, command
from tests.fuzz.values import anything

BIPED = "biped"


@functools.cache
def originals() -> dict[str, bytes]:
    """A solution, a cycle and a log, as octo writes them."""
    from octo.cli.simulate import measured_motion
    from octo.dynamics.simulate import Motion

    robot = octo.gallery.CHARACTERS[BIPED]()
    problem = octo.Problem(robot, steps=4, dt=0.05, costs=[octo.Effort()])
    x = np.repeat(problem.start[None], 6, axis=0)
    standing = measured_motion(
        problem, Motion(x, np.zeros((4, robot.nu)), 0.05, np.ones(4, bool), np.zeros(1)), 0.1, 0.2
    )
    with tempfile.TemporaryDirectory() as folder:
        standing.save(Path(folder) / "solution.npz")
        _log(robot, standing.weight).save(Path(folder) / "log.npz")
        return {name: (Path(folder) / name).read_bytes() for name in ("solution.npz", "log.npz")}


def _log(robot: octo.Character, weight: float) -> octo.mpc.Log:
    from octo.mpc.log import Log
    from octo.mpc.record import ROWS, row_shapes

    shapes, ticks = row_shapes(robot, octo.mpc.Convention(robot)), 8
    columns = {name: np.zeros((ticks, *shapes.get(name, ()))) for name in ROWS}
    columns["t"] = 0.01 * np.arange(1.0, ticks + 1.0)
    columns["q"][:, 3] = 1.0
    world = {"weight": weight, "length": 0.5, "normal": [0.0, 0.0, 1.0], "height": 0.0}
    return Log(robot, 0.01, None, columns, ticks, ["solved"] * ticks, [], [], saved_world=world)


def _changed(value: Any, random: Random, depth: int = 0) -> Any:
    """JSON with one entry changed somewhere in it."""
    if isinstance(value, dict) and value and (depth == 0 or random.random() < 0.8):
        key = random.choice(sorted(value))
        rest = {
            name: entry for name, entry in value.items() if name != key or random.random() < 0.9
        }
        return {**rest, key: _changed(value[key], random, depth + 1)} if key in rest else rest
    if isinstance(value, list) and value and random.random() < 0.8:
        k = random.randrange(len(value))
        return [*value[:k], _changed(value[k], random, depth + 1), *value[k + 1 :]]
    return random.choice(
        (
            None,
            True,
            -1,
            0,
            1,
            1e200,
            1e308,
            float("nan"),
            float("inf"),
            10**30,
            "",
            "x" * 5000,
            "/../..",
            "\x1b[31m",
            [],
            {},
            [1],
            {"a": 1},
            "\ud800",
        )
    )


def _array(random: Random, old: Any) -> Any:
    which = random.randrange(7)
    if which == 0 and old.size and old.dtype.kind == "f":
        new = old.copy()
        new.flat[random.randrange(new.size)] = random.choice(
            (np.nan, np.inf, -np.inf, 1e200, 1e308, -1e9)
        )
        return new
    if which == 1:
        return old[..., :-1] if old.ndim else np.zeros(3)
    if which == 2:
        return old[:0] if old.ndim else np.zeros(0)
    if which == 3:
        return (
            old.astype(random.choice(("f4", "i8", "c16", "S3", "U3", "?")), casting="unsafe")
            if old.dtype.kind == "f"
            else np.zeros(2)
        )
    if which == 4:
        return np.repeat(old, 3, axis=0) if old.ndim else old
    if which == 5:
        try:
            return np.asarray(anything(random))
        except Exception:
            return np.zeros(1)
    return np.zeros((2,) * random.randrange(1, 6))


def damaged(data: bytes, plain: str, random: Random) -> bytes:
    """Bytes turned over, or arrays and JSON changed."""
    if random.random() < 0.35:
        found = bytearray(data)
        for _ in range(random.choice((1, 1, 4, 60))):
            place = random.randrange(max(1, len(found)))
            what = random.randrange(3)
            if what == 0:
                found[place : place + 1] = bytes([random.randrange(256)])
            else:
                del found[place : place + random.choice((1, 20, 10**6))]
        return bytes(found)
    with np.load(io.BytesIO(data)) as file:
        arrays = {name: file[name] for name in file.files}
    for _ in range(random.choice((1, 1, 2))):
        if random.random() < 0.5:
            words = json.dumps(_changed(json.loads(str(arrays[plain])), random))
            arrays[plain] = np.array(words)
        else:
            name = random.choice(sorted(arrays))
            if name != plain and random.random() < 0.8:
                arrays[name] = _array(random, arrays[name])
            elif name != plain:
                del arrays[name]
    stream = io.BytesIO()
    kept = {name: array for name, array in arrays.items() if array.dtype.kind != "O"}
    np.savez(stream, **kept)
    if random.random() < 0.1:
        with zipfile.ZipFile(stream, "a") as file:
            file.writestr(
                random.choice(("x.npy", "../../x.npy", "x.npy", "a/b")),
                b"\x93NUMPY" + bytes(random.randrange(200)),
            )
    return stream.getvalue()


def case(random: Random, folder: Path) -> None:
    name = random.choice(("solution.npz", "solution.npz", "log.npz"))
    path = folder / name
    path.write_bytes(damaged(originals()[name], "log" if name == "log.npz" else "plain", random))
    found = call(lambda: octo.mpc.Log.load(path) if name == "log.npz" else octo.Solution.load(path))
    if found is not None:
        call(lambda: (str(found), repr(found), json.dumps(found.report(), default=str)))
    if random.random() < 0.4:
        words = random.choice(
            (
                ["info", name],
                ["info", "--json", name],
                ["explain", name],
                ["explain", "--json", name],
                ["view", name, "--out", "m.html"],
                ["view", name, "--out", "m.csv"],
                ["info", "."],
            )
        )
        command(words, folder, may_run=False)
    if name == "solution.npz" and random.random() < 0.1:
        command(["replay", name, "--out", "out"], folder)
