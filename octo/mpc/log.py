"""What happened in a closed loop, tick by tick, and what it says."""

from __future__ import annotations

import json
import os
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from octo.checks import ending, numbers
from octo.errors import ShapeError, ValueRangeError
from octo.files import replacing
from octo.model import archive, store
from octo.model.character import Character
from octo.model.convention import Convention
from octo.model.kinematics import body_poses, center_of_mass, sphere_centers
from octo.mpc.command import Command
from octo.result.solution import Solution
from octo.shown import Shown
from octo.solver.status import HISTORY, Status

if TYPE_CHECKING:
    from octo.mpc.controller import Controller
    from octo.mpc.loop import Plant

Array = NDArray[np.float64]
GROUND = 1.0  # m, of ground around the motion in pictures
LOADED = 0.02  # of the weight: a foot that carries more is loaded
NO_COMMAND = "no new command"  # a tick's status, in real time, where none came by its end
NOTHING_YET = "nothing measured yet"  # where the delay has let no measurement through
SETTLED = 2.0  # s from the start that tracking leaves out
BOOT = 50  # calls from the start that latency leaves out
ROWS = (
    "t",
    "q",
    "v",
    "x",
    "plan_x",
    "u",
    "force",
    "point",
    "seconds",
    "prepare",
    "energy",
    "violation",
    "excess",
    "done",
    "wanted",
)


@dataclass(eq=False, repr=False)
class Log(Shown):
    """Columns by tick: the state after it, the torques at its end, and the command it began with.

    The columns of k ticks are attributes: t (k,) s; q (k, nq), v (k, nv), MuJoCo's form; x (k, nx)
    octo's chart; u (k, nu) N m or N; force, point (k, c, 3) of the contacts that touch the ground,
    N and m; plan_x (k, nx), where the plan wanted to be; wanted (k, 3) m/s, m/s, rad/s, the
    command; seconds, prepare (k,) s of the controller's calls; energy, violation (mg), excess
    (|u|/limit), done (iterations). The last six are NaN where no command came, or no measurement
    that one could come from.

    Attributes
    ----------
    robot: whose motion it is.
    tick: s, between two rows.
    controller: None of a log that was read from a file.
    columns: the arrays by name, of which ``count`` rows are filled.
    statuses: the label of the command's status, by tick.
    falls: s, when the robot fell.
    impulses: N s, of the push, if any.
    interrupted: by Ctrl-C, before its end.
    memory_start, memory_end: bytes that the process used.
    torque: (nu,) N m or N, the limits.
    saved_world: what ``world`` says of a log that was read from a file.
    """

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
        known = {
            "weight": self.robot.mass * problem.gravity,
            "length": problem.length,
            "normal": [0.0, 0.0, 1.0],
            "height": 0.0,
        }
        names = problem.dynamics.layout.names
        if "terrain.normal_x" in names:
            p, first = self.controller.compiled.p[0], names.index("terrain.normal_x")
            known |= {
                "normal": p[first : first + 3].tolist(),
                "height": float(p[names.index("terrain.height")]),
            }
        return known

    @staticmethod
    def empty(robot: Character, tick: float, controller: Controller, ticks: int) -> Log:
        """Room for so many ticks, touched now: what memory the loop takes on top is the loop's."""
        sizes = _sizes(robot, controller.convention)
        return Log(
            robot,
            tick,
            controller,
            {name: np.full((ticks, *sizes.get(name, ())), np.nan) for name in ROWS},
        )

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
        row: dict[str, Any] = {
            "t": t + self.tick,
            "q": plant.q,
            "v": plant.v,
            "x": x,
            "u": self.torque,
            "plan_x": self.controller.plan.at(t + self.tick)[0],
            "force": force,
            "point": point,
            "wanted": wanted,
        }
        if command is not None:
            row |= {
                "seconds": command.seconds,
                "prepare": command.prepare,
                "energy": command.energy,
                "violation": command.violation,
                "excess": command.torque_excess,
                "done": command.iterations,
            }
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

    # -- what it says ------------------------------------------------------------------------------

    @property
    def velocity(self) -> Array:
        """(k, 2) m/s of the centre of mass, ahead and to the left of the heading, and (k, 3) with
        the yaw rate in rad/s."""
        com = center_of_mass(self.robot, self.x)
        speed = np.gradient(com, self.tick, axis=0)[:, :2]
        rotation = body_poses(self.robot, self.x)[0][:, self.robot.base_body]
        yaw = np.unwrap(np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0]))
        c, s = np.cos(yaw), np.sin(yaw)
        ahead, left = c * speed[:, 0] + s * speed[:, 1], c * speed[:, 1] - s * speed[:, 0]
        return np.stack([ahead, left, np.gradient(yaw, self.tick)], axis=1)

    def tracked(self) -> tuple[Array, Array]:
        """Mean velocity (3,) and mean command (3,), after the first seconds."""
        kept = self.t >= min(SETTLED, 0.5 * self.t[-1])
        return self.velocity[kept].mean(axis=0), self.wanted[kept].mean(axis=0)

    @property
    def feet(self) -> NDArray[np.intp]:
        """Columns of ``force`` that carry a twentieth of the weight some time in the first
        second."""
        early = np.abs(self.force[: max(1, round(1.0 / self.tick)), :, 2]).max(axis=0)
        return np.flatnonzero(early > 0.05 * self._weight)

    @property
    def foot_height(self) -> Array:
        """(k, feet) m of the spheres' nearest points over the plane that the controller knows, over
        the world's level if none."""
        chosen = [self.robot.terrain_contacts[c] for c in self.feet]
        radius = np.array([self.robot.contacts[k].radius for k in chosen])
        normal, height = np.array(self.world["normal"]), self.world["height"]
        return np.asarray(
            (sphere_centers(self.robot, self.x)[:, chosen] - [0.0, 0.0, height]) @ normal - radius
        )

    @property
    def foot_lift(self) -> float:
        """m, median over the steps of all feet of the greatest height of a swing."""
        heights, lifts = self.foot_height, []
        for c in range(heights.shape[1]):
            up = heights[:, c] > 0.01
            edges = np.flatnonzero(np.diff(np.r_[0, up.astype(int), 0]))
            lifts += [
                float(heights[a:b, c].max()) for a, b in zip(edges[::2], edges[1::2], strict=True)
            ]
        return float(np.median(lifts)) if lifts else 0.0

    @property
    def slip_speeds(self) -> Array:
        """m/s, level speed of the material point under each foot, at all ticks between two at which
        the foot is loaded."""
        chosen = [self.robot.terrain_contacts[c] for c in self.feet]
        rotation, origin = body_poses(self.robot, self.x)
        bodies = [self.robot.contacts[k].body for k in chosen]
        radius = np.array([self.robot.contacts[k].radius for k in chosen])
        below = sphere_centers(self.robot, self.x)[:, chosen] - radius[:, None] * [0.0, 0.0, 1.0]
        local = np.einsum("kcji,kcj->kci", rotation[:-1, bodies], below[:-1] - origin[:-1, bodies])
        moved = (
            np.einsum("kcij,kcj->kci", rotation[1:, bodies], local)
            + origin[1:, bodies]
            - below[:-1]
        )
        loaded = self.force[:, self.feet, 2] > LOADED * self._weight
        return np.asarray(
            np.linalg.norm(moved[..., :2], axis=-1)[loaded[1:] & loaded[:-1]] / self.tick
        )

    @property
    def slip(self) -> float:
        """m/s, root mean square of :attr:`slip_speeds`."""
        speeds = self.slip_speeds
        return float(np.sqrt(np.mean(speeds**2))) if speeds.size else 0.0

    def latency(self) -> dict[str, float]:
        seconds = self._of_calls("seconds")
        seconds = seconds[min(BOOT, len(seconds) // 2) :]
        return {
            **{f"p{k}": float(np.percentile(seconds, k)) for k in (50, 95, 99)},
            "max": float(seconds.max()),
        }

    def _of_calls(self, name: str) -> Array:
        """A column where the controller was called; one NaN where it never was (in real time no
        command may come at all)."""
        called = np.isfinite(self.seconds)
        return self.columns[name][called] if called.any() else np.full(1, np.nan)

    def report(self) -> dict[str, Any]:
        """The numbers of report.json."""
        mean, wanted = self.tracked()
        return {
            "latency": self.latency(),
            "prepare_p50": float(np.median(self._of_calls("prepare"))),
            "device": "cpu",
            "rate": 1.0 / self.tick,
            "missed_deadlines": max(
                self.statuses.count(NO_COMMAND), int((self.seconds > self.tick).sum())
            ),
            "tracking_error": {
                "velocity": float(np.hypot(*(mean - wanted)[:2])),
                "yaw_rate": float(abs(mean[2] - wanted[2])),
            },
            "velocity": [float(v) for v in mean],
            "command": [float(v) for v in wanted],
            "falls": len(self.falls),
            "interrupted": self.interrupted,
            "fall_times": [float(v) for v in self.falls],
            "statuses": dict(Counter(self.statuses)),
            "torque_excess": float(self._of_calls("excess").max()),
            "pushes": [float(v) for v in self.impulses],
            "memory_start": self.memory_start,
            "memory_end": self.memory_end,
            "foot_lift": self.foot_lift,
            "slip": self.slip,
            "slip_mean": float(np.mean(self.slip_speeds)) if self.slip_speeds.size else 0.0,
            "seconds": float(len(self.t) * self.tick),
        }

    def __repr__(self) -> str:
        return str(self)

    def __str__(self) -> str:
        room = len(self.columns["t"])
        if self.count < max(room, 1):
            return (
                f"{self.robot.name}: {self.count} of {room} ticks of {self.tick:g} s "
                "recorded so far"
            )
        r = self.report()
        wall, went, wanted = r["latency"], r["velocity"], r["command"]
        statuses = ", ".join(f"{count} {name}" for name, count in r["statuses"].items())
        falls = f"{r['falls']} fall{'' if r['falls'] == 1 else 's'}"
        walked = (
            f"  ahead {went[0]:.2f} of {wanted[0]:.2f} m/s, left {went[1]:.2f} of "
            f"{wanted[1]:.2f} m/s, turning {went[2]:.2f} of "
            f"{wanted[2]:.2f} rad/s; feet lift {100 * r['foot_lift']:.1f} cm and slip "
            f"{r['slip']:.3f} m/s\n"
        )
        return (
            f"{self.robot.name}, {r['seconds']:g} s at {r['rate']:g} Hz on cpu: {falls}; "
            f"{statuses}\n"
            f"{walked if self.robot.base == 'floating' else ''}"
            f"  step took {1e3 * wall['p50']:.2f} ms (p50), {1e3 * wall['p99']:.2f} ms (p99); "
            f"{r['missed_deadlines']} missed "
            f"deadlines; largest planned torque {r['torque_excess']:.2f} of its limit"
        )

    def solution(self, every: float = 0.02) -> Solution:
        """The motion of the plant as a Solution, for pictures: every ``every`` s, with the forces
        and torques of that moment."""
        stride = max(1, min(round(every / self.tick), len(self.t) - 1))
        x, robot = self.x[::stride], self.robot
        force, point, count = self.force[::stride][1:], self.point[::stride][1:], len(x) - 1
        contacts = force.shape[1]
        normal = np.zeros((count, contacts, 3))
        normal[..., 2] = 1.0
        place = body_poses(robot, x)[1][:, robot.base_body, :2]
        low, high = place.min(axis=0) - GROUND, place.max(axis=0) + GROUND
        level = (
            float(np.median(point[..., 2][force[..., 2] > 0.0]))
            if (force[..., 2] > 0.0).any()
            else 0.0
        )
        return Solution(
            name=robot.name,
            character=robot,
            dt=stride * self.tick,
            basis="nodes",
            x=np.concatenate([x[:1], x]),
            u=self.u[::stride][:-1],
            unknowns=x[1:],
            multipliers=np.zeros((count, 0)),
            status=Status.SIMULATED,
            iterations=0,
            factorizations=0,
            terms={},
            violation=0.0,
            pointwise_residual=0.0,
            weight=self._weight,
            length=self.world["length"],
            torque_limit=robot.torque_limit,
            contact_names=tuple(robot.contacts[k].name for k in robot.terrain_contacts),
            contact_force=force,
            contact_point=point,
            contact_velocity=np.zeros_like(force),
            contact_normal=normal,
            contact_depth=np.zeros((count, contacts)),
            ground={
                "x": np.array([low[0], high[0]]),
                "y": np.array([low[1], high[1]]),
                "z": np.full((2, 2), level),
            },
            history={name: np.zeros(0) for name in HISTORY},
            parameters={},
            seconds=float(np.nansum(self.seconds)),
            setup_seconds=0.0,
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an .npz file: the columns, and the rest as JSON. Written beside, then renamed.

        Raises
        ------
        OutputError: it cannot be written, or its ending is not .npz.
        """
        target = ending("path", path, (".npz",))
        kept = {
            name: getattr(self, name)
            for name in ("tick", "interrupted", "memory_start", "memory_end", "world")
        }
        lists = {name: np.array(getattr(self, name), dtype=float) for name in ("falls", "impulses")}
        words = np.array(json.dumps({**kept, "robot": store.to_plain(self.robot)}))
        arrays: dict[str, Any] = {
            **self.columns,
            **lists,
            "statuses": np.array(self.statuses, dtype=str),
            "log": words,
        }
        with replacing(target) as beside, beside.open("wb") as file:
            np.savez_compressed(file, **arrays)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Log:
        """Read a log that :meth:`save` wrote: the file, or the folder of `octo mpc`.

        Raises
        ------
        RobotFileError: there is none, or something in it is not as octo writes it; one line that
            says what.
        """
        with archive.opened(store.file_of(path, Log.FILE), "log", "log") as file:
            robot = store.from_plain(file.plain["robot"])
            k, sizes = len(file.array("t", (None,))), _sizes(robot, Convention(robot))
            columns = {
                name: file.array(name, (k, *sizes.get(name, ())), finite=False) for name in ROWS
            }
            falls, impulses = (file.array(name, (None,)).tolist() for name in ("falls", "impulses"))
            begin, end = file.whole("memory_start"), file.whole("memory_end")
            return Log(
                robot,
                file.number("tick", positive=True),
                None,
                columns,
                k,
                _statuses(file, k),
                falls,
                impulses,
                file.flag("interrupted"),
                begin,
                end,
                saved_world=_world(file.plain["world"]),
            )


def _sizes(robot: Character, convention: Convention) -> dict[str, tuple[int, ...]]:
    """Of a row of each column that is no single number."""
    nx, contacts = robot.nx, len(robot.terrain_contacts)
    return {
        "q": (convention.nq,),
        "v": (nx,),
        "x": (nx,),
        "plan_x": (nx,),
        "u": (robot.nu,),
        "force": (contacts, 3),
        "point": (contacts, 3),
        "wanted": (3,),
    }


def _statuses(file: archive.Archive, count: int) -> list[str]:
    found = file.arrays["statuses"]
    if found.dtype.kind != "U":
        raise ValueRangeError(f"statuses holds {found.dtype.name} values, must be words")
    if found.shape != (count,):
        raise ShapeError("statuses", found.shape, (count,))
    return [archive.printable(str(word)) for word in found]


def _world(plain: Any) -> dict[str, Any]:
    """As of :attr:`Log.world`, each number checked."""
    if not isinstance(plain, dict):
        raise ValueRangeError(f"world is of type {type(plain).__name__}, must be a record")
    own = archive.Archive({}, plain)
    sizes = {name: own.number(name, positive=True) for name in ("weight", "length")}
    return {
        **sizes,
        "normal": numbers("normal", plain.get("normal"), (3,)).tolist(),
        "height": own.number("height"),
    }


def memory_in_use() -> int:
    """Bytes of this process in memory; 0 where the system does not say."""
    try:
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * os.sysconf(
            "SC_PAGE_SIZE"
        )
    except (OSError, ValueError, IndexError):
        return 0
