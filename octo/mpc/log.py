"""What happened in a closed loop, tick by tick, and what it says."""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from octo.errors import OutputError
from octo.model.character import Character
from octo.model.kinematics import body_poses, center_of_mass, sphere_centers
from octo.mpc.command import Command

if TYPE_CHECKING:
    from octo.mpc.controller import Controller
    from octo.mpc.loop import Plant

Array = NDArray[np.float64]
LOADED = 0.02  # of the weight: a foot that carries more is loaded
SETTLED = 2.0  # s from the start that tracking leaves out
BOOT = 50  # calls from the start that latency leaves out
ROWS = ("t", "q", "v", "x", "plan_x", "u", "force", "point", "seconds", "prepare", "energy", "violation", "excess", "done", "wanted")


@dataclass(eq=False)
class Log:
    """Columns by tick: the state after it, the torques at its end, and the command it began with.

    Attributes
    ----------
    t (k,) s; q (k, nq), v (k, nv), MuJoCo's form; x (k, nx) octo's chart; u (k, nu) N m or N; force, point (k, c, 3) of the
    contacts that touch the ground, N and m; plan_x (k, nx), where the plan wanted to be; wanted (k, 3) m/s, m/s, rad/s, the
    command; seconds, prepare (k,) s of the controller's calls; energy, violation (mg), excess (|u|/limit), done (iterations).
    falls: s; impulses: N s.
    """

    robot: Character
    tick: float
    controller: Controller
    columns: dict[str, Any]
    statuses: list[str] = field(default_factory=list)
    falls: list[float] = field(default_factory=list)
    impulses: list[float] = field(default_factory=list)
    memory_start: int = 0
    memory_end: int = 0
    torque: Array = field(default_factory=lambda: np.zeros(0))

    @staticmethod
    def empty(robot: Character, tick: float, controller: Controller) -> Log:
        return Log(robot, tick, controller, {name: [] for name in ROWS})

    def record(self, t: float, plant: Plant, command: Command) -> None:
        force, point = plant.contacts()
        guide = self.controller.guide
        wanted = (*getattr(guide, "velocity", (0.0, 0.0)), getattr(guide, "yaw_rate", 0.0))
        x, rate = self.controller.convention.to_octo(plant.q, plant.v, 1.0, self.columns["x"][-1] if self.columns["x"] else self.controller.problem.start)
        row = {
            "t": t + self.tick, "q": plant.q.copy(), "v": plant.v.copy(), "x": x, "u": self.torque,
            "plan_x": self.controller.plan.at(t + self.tick)[0], "force": force, "point": point, "seconds": command.seconds,
            "prepare": command.prepare, "energy": command.energy, "violation": command.violation,
            "excess": command.torque_excess, "done": command.iterations, "wanted": wanted,
        }  # fmt: skip
        for name, value in row.items():
            self.columns[name].append(value)
        self.statuses.append(command.status.label)

    def finish(self) -> None:
        self.columns = {name: np.array(values) for name, values in self.columns.items()}

    def __getattr__(self, name: str) -> Array:
        columns = self.__dict__.get("columns", {})
        if name not in columns:
            raise AttributeError(name)
        return np.asarray(columns[name])

    # -- what it says ---------------------------------------------------------------------------------------------------

    @property
    def velocity(self) -> Array:
        """(k, 2) m/s of the centre of mass, ahead and to the left of the heading, and (k, 3) with the yaw rate in rad/s."""
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
        """Columns of ``force`` that ever carry a twentieth of the weight at the start."""
        early = np.abs(self.force[: max(1, len(self.t) // 4), :, 2]).max(axis=0)
        return np.flatnonzero(early > 0.05 * self.robot.mass * 9.81)

    @property
    def foot_height(self) -> Array:
        """(k, feet) m of the spheres' lowest points."""
        chosen = [self.robot.terrain_contacts[c] for c in self.feet]
        radius = np.array([self.robot.contacts[k].radius for k in chosen])
        return np.asarray(sphere_centers(self.robot, self.x)[:, chosen, 2] - radius)

    @property
    def foot_lift(self) -> float:
        """m, median over the steps of all feet of the greatest height of a swing."""
        heights, lifts = self.foot_height, []
        for c in range(heights.shape[1]):
            up = heights[:, c] > 0.01
            edges = np.flatnonzero(np.diff(np.r_[0, up.astype(int), 0]))
            lifts += [float(heights[a:b, c].max()) for a, b in zip(edges[::2], edges[1::2], strict=True)]
        return float(np.median(lifts)) if lifts else 0.0

    @property
    def slip(self) -> float:
        """m/s, root mean square of the level velocity of loaded feet."""
        chosen = [self.robot.terrain_contacts[c] for c in self.feet]
        speed = np.linalg.norm(np.gradient(sphere_centers(self.robot, self.x)[:, chosen, :2], self.tick, axis=0), axis=-1)
        loaded = self.force[:, self.feet, 2] > LOADED * self.robot.mass * 9.81
        loaded &= np.roll(loaded, 1, axis=0) & np.roll(loaded, -1, axis=0)
        return float(np.sqrt(np.mean(speed[loaded] ** 2))) if loaded.any() else 0.0

    def latency(self) -> dict[str, float]:
        seconds = self.seconds[min(BOOT, len(self.seconds) // 2) :]
        return {**{f"p{k}": float(np.percentile(seconds, k)) for k in (50, 95, 99)}, "max": float(seconds.max())}

    def report(self) -> dict[str, Any]:
        """The numbers of report.json."""
        mean, wanted = self.tracked()
        return {
            "latency": self.latency(),
            "prepare_p50": float(np.median(self.prepare)),
            "rate": 1.0 / self.tick,
            "missed_deadlines": int((self.seconds > self.tick).sum()),
            "tracking_error": {"velocity": float(np.hypot(*(mean - wanted)[:2])), "yaw_rate": float(abs(mean[2] - wanted[2]))},
            "velocity": [float(v) for v in mean],
            "command": [float(v) for v in wanted],
            "falls": len(self.falls),
            "fall_times": [float(v) for v in self.falls],
            "statuses": dict(Counter(self.statuses)),
            "torque_excess": float(self.excess.max()),
            "pushes": [float(v) for v in self.impulses],
            "memory_start": self.memory_start,
            "memory_end": self.memory_end,
            "foot_lift": self.foot_lift,
            "slip": self.slip,
            "seconds": float(len(self.t) * self.tick),
        }

    def save(self, path: str | os.PathLike[str]) -> None:
        try:
            with Path(path).open("wb") as file:
                np.savez_compressed(file, statuses=np.array(self.statuses), falls=np.array(self.falls), **self.columns)
        except OSError as error:
            raise OutputError(f"{path} cannot be written: {error.strerror or error}") from error


def memory_in_use() -> int:
    """Bytes of this process in memory; 0 where the system does not say."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return 0
