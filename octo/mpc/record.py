"""A closed loop, written down tick by tick, and its file."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from octo.checks import ending, numbers
from octo.errors import ShapeError, ValueRangeError
from octo.files import replacing
from octo.model import archive, store
from octo.model.character import Character
from octo.model.convention import Convention
from octo.model.quantities import Array
from octo.model.terrain import plane_of
from octo.mpc.command import Command
from octo.mpc.controller import Controller
from octo.mpc.machine import Plant
from octo.world import store as world_store
from octo.world.world import World

NO_COMMAND = "no new command"  # a tick's status, in real time, where none came by its end
NOTHING_YET = "nothing measured yet"  # where the delay has let no measurement through
ANSWERED = {  # columns of a command's own numbers, and what it calls them
    **{name: name for name in ("seconds", "prepare", "energy", "violation")},
    "excess": "torque_excess",
    "done": "iterations",
    "clipped": "clipped",
    "beyond": "beyond",
}
LATER = {"clipped", "beyond"}  # that files of older versions do not have
SHAPES = "shapes_"  # how the names of the arrays of a world begin
ROWS = ("t", "q", "v", "x", "plan_x", "u", "force", "point", *ANSWERED, "wanted")


@dataclass(eq=False, repr=False)
class Record:
    """The data of a :class:`octo.mpc.Log`, which says what each field is: written, kept, read."""

    FILE: ClassVar[str] = "log.npz"  # in a folder that octo wrote

    robot: Character
    tick: float
    controller: Controller | None
    columns: dict[str, Array]
    count: int = 0
    statuses: list[str] = field(default_factory=list)
    falls: list[float] = field(default_factory=list)
    impulses: list[float] = field(default_factory=list)
    interrupted: bool = False
    memory_start: int = 0
    memory_end: int = 0
    torque: Array = field(default_factory=lambda: np.zeros(0))
    saved_world: dict[str, Any] = field(default_factory=dict)
    shapes: World | None = None

    def __post_init__(self) -> None:
        self._convention = Convention(self.robot)  # the plant's, whatever the controller's
        self._weight = float(self.world["weight"])  # N

    @property
    def world(self) -> dict[str, Any]:
        """weight (N), length ℓ (m), and normal (3,) and height (m) of the plane that the controller
        knows, or the level one."""
        if self.controller is None:
            return self.saved_world
        problem = self.controller.problem
        known: dict[str, Any] = {
            "weight": self.robot.mass * problem.gravity,
            "length": problem.length,
        }
        known |= {"normal": [0.0, 0.0, 1.0], "height": 0.0}
        names, p = problem.dynamics.layout.names, self.controller.compiled.p[0]
        plane = plane_of(dict(zip(names, p.tolist(), strict=True)))
        if plane is not None:
            known |= {"normal": plane[0].tolist(), "height": plane[1]}
        return known

    @classmethod
    def empty(cls, robot: Character, tick: float, controller: Controller, ticks: int) -> Self:
        """Room for so many ticks, touched now: what memory the loop takes on top is the loop's."""
        shapes = row_shapes(robot, controller.convention)
        columns = {name: np.full((ticks, *shapes.get(name, ())), np.nan) for name in ROWS}
        return cls(robot, tick, controller, columns)

    def record(self, t: float, plant: Plant, command: Command | None, arrived: bool = True) -> None:
        """A tick that began at ``t`` s; ``arrived``: whether there was a measurement that
        ``command`` could come from."""
        assert self.controller is not None
        force, point = plant.contacts()
        guide = self.controller.guide
        wanted = (*getattr(guide, "velocity", (0.0, 0.0)), getattr(guide, "yaw_rate", 0.0))
        k = self.count
        near = self.columns["x"][k - 1] if k else self.controller.problem.start
        x = self._convention.to_octo(plant.q, plant.v, 1.0, near)[0]
        row: dict[str, Any] = {"t": t + self.tick, "q": plant.q, "v": plant.v, "x": x}
        row |= {"plan_x": self.controller.plan.at(t + self.tick)[0], "wanted": wanted}
        row |= {"u": self.torque, "force": force, "point": point}
        if command is not None:
            row |= {column: getattr(command, name) for column, name in ANSWERED.items()}
        for name, value in row.items():
            self.columns[name][k] = value
        none = NO_COMMAND if arrived else NOTHING_YET
        self.statuses.append(none if command is None else command.status.label)
        self.count = k + 1

    def finish(self) -> None:
        """Keep what was recorded."""
        self.columns = {name: values[: self.count] for name, values in self.columns.items()}
        self.statuses = self.statuses[: self.count]

    def __getattr__(self, name: str) -> Array:
        columns = self.__dict__.get("columns", {})
        if name not in columns:
            raise AttributeError(name)
        return np.asarray(columns[name])

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an .npz file: the columns, and the rest as JSON. Written beside, then renamed.

        Raises
        ------
        OutputError: it cannot be written, or its ending is not .npz.
        """
        target = ending("path", path, (".npz",))
        names = ("tick", "interrupted", "memory_start", "memory_end", "world")
        kept = {name: getattr(self, name) for name in names}
        kept["robot"] = store.to_plain(self.robot)
        arrays: dict[str, Any] = dict(self.columns)
        if self.shapes is not None:
            kept["shapes"], own = world_store.to_plain(self.shapes)
            arrays |= {f"{SHAPES}{name}": value for name, value in own.items()}
        arrays["log"] = np.array(json.dumps(kept))
        arrays["statuses"] = np.array(self.statuses, dtype=str)
        for name in ("falls", "impulses"):
            arrays[name] = np.array(getattr(self, name), dtype=float)
        with replacing(target) as beside, beside.open("wb") as file:
            np.savez_compressed(file, **arrays)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read a log that :meth:`save` wrote: the file, or the folder of `octo mpc`.

        Raises
        ------
        RobotFileError: there is none, or something in it is not as octo writes it; one line that
            says what.
        """
        with archive.opened(store.file_of(path, cls.FILE), "log", "log") as file:
            robot = store.from_plain(file.plain["robot"])
            k, shapes = len(file.array("t", (None,))), row_shapes(robot, Convention(robot))
            sizes = {name: (k, *shapes.get(name, ())) for name in ROWS}
            lacks = dict.fromkeys(LATER - file.arrays.keys(), np.full(k, np.nan))
            held = {n: size for n, size in sizes.items() if n not in lacks}
            columns = lacks | {n: file.array(n, size, finite=False) for n, size in held.items()}
            own: dict[str, Any] = {"saved_world": _world(file.plain["world"])}
            own |= {name: file.array(name, (None,)).tolist() for name in ("falls", "impulses")}
            own |= {name: file.whole(name) for name in ("memory_start", "memory_end")}
            own["shapes"] = world_store.of_file(file.plain.get("shapes"), file.arrays, SHAPES)
            own |= {"interrupted": file.flag("interrupted"), "statuses": _statuses(file, k)}
            return cls(robot, file.number("tick", positive=True), None, columns, k, **own)


def row_shapes(robot: Character, convention: Convention) -> dict[str, tuple[int, ...]]:
    """Of a row of each column that is no single number."""
    coordinates = dict.fromkeys(("v", "x", "plan_x"), (robot.nx,))
    vectors = {name: (len(robot.terrain_contacts), 3) for name in ("force", "point")}
    return {"q": (convention.nq,), "u": (robot.nu,), "wanted": (3,), **coordinates, **vectors}


def _statuses(file: archive.Archive, count: int) -> list[str]:
    found = file.arrays["statuses"]
    if found.dtype.kind != "U":
        raise ValueRangeError(f"statuses holds {found.dtype.name} values, must be words")
    if found.shape != (count,):
        raise ShapeError("statuses", found.shape, (count,))
    return [archive.printable(str(word)) for word in found]


def _world(plain: Any) -> dict[str, Any]:
    """As of :attr:`Record.world`, each number checked."""
    if not isinstance(plain, dict):
        raise ValueRangeError(f"world is of type {type(plain).__name__}, must be a record")
    own = archive.Archive({}, plain)
    found: dict[str, Any] = {n: own.number(n, positive=True) for n in ("weight", "length")}
    found["normal"] = numbers("normal", plain.get("normal"), (3,)).tolist()
    return found | {"height": own.number("height")}


def memory_in_use() -> int:
    """Bytes of this process in memory; 0 where the system does not say."""
    try:
        pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[1]
        return int(pages) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return 0
