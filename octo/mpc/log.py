"""What happened in a closed loop, and what it says."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo.model.feet import CARRYING, TOUCHDOWN
from octo.model.kinematics import body_poses, center_of_mass, sphere_centers
from octo.model.quantities import Array
from octo.mpc.record import NO_COMMAND, ROWS, Record, memory_in_use
from octo.result.solution import Solution, recorded
from octo.shown import Shown
from octo.world.drawn import sampled

__all__ = ["NO_COMMAND", "ROWS", "Log", "memory_in_use"]
GROUND = 1.0  # m, of ground around the motion in pictures
SETTLED = 2.0  # s from the start that tracking leaves out
ROUNDING = 1e-6  # of a limit
BOOT = 50  # calls from the start that latency leaves out


@dataclass(eq=False, repr=False)
class Log(Record, Shown):
    """Columns by tick: the state after it, the torques at its end, and the command it began with.

    The columns of k ticks are attributes: t (k,) s; q (k, nq), v (k, nv), MuJoCo's form; x (k, nx)
    octo's chart; u (k, nu) N m or N; force, point (k, c, 3) of the contacts that touch the ground,
    N and m; plan_x (k, nx), where the plan wanted to be; wanted (k, 3) m/s, m/s, rad/s, the
    command; seconds, prepare (k,) s of the controller's calls; energy, violation (mg), excess
    (|u|/limit), done (iterations), clipped and beyond (see :class:`octo.mpc.Command`). The last
    eight are NaN where no command came, or no measurement
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
    shapes: the plant's ground where it is an ``octo.World``; None on another.
    """

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
        """Columns of ``force`` that carry a twentieth of mg some time in the first
        second."""
        early = np.abs(self.force[: max(1, round(1.0 / self.tick)), :, 2]).max(axis=0)
        return np.flatnonzero(early > TOUCHDOWN * self._weight)

    @property
    def foot_height(self) -> Array:
        """(k, feet) m of the spheres' nearest points over the plant's shapes, or over the plane
        that the controller knows, over the world's level if none."""
        chosen = [self.robot.terrain_contacts[c] for c in self.feet]
        radius = np.array([self.robot.contacts[k].radius for k in chosen])
        if self.shapes is not None:
            centers = sphere_centers(self.robot, self.x)[:, chosen]
            above = self.shapes.distance(centers.reshape(-1, 3)).reshape(centers.shape[:2])
            return np.asarray(above - radius)
        normal, height = np.array(self.world["normal"]), self.world["height"]
        above = sphere_centers(self.robot, self.x)[:, chosen] - [0.0, 0.0, height]
        return np.asarray(above @ normal - radius)

    @property
    def foot_lift(self) -> float:
        """m, median over the steps of all feet of the greatest height of a swing."""
        heights, lifts = self.foot_height, []
        for c in range(heights.shape[1]):
            up = heights[:, c] > 0.01
            edges = np.flatnonzero(np.diff(np.r_[0, up.astype(int), 0])).reshape(-1, 2)
            lifts += [float(heights[a:b, c].max()) for a, b in edges]
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
        moved = np.einsum("kcij,kcj->kci", rotation[1:, bodies], local) + origin[1:, bodies]
        speed = np.linalg.norm((moved - below[:-1])[..., :2], axis=-1) / self.tick
        loaded = self.force[:, self.feet, 2] > CARRYING * self._weight
        return np.asarray(speed[loaded[1:] & loaded[:-1]])

    @property
    def slip(self) -> float:
        """m/s, root mean square of :attr:`slip_speeds`."""
        speeds = self.slip_speeds
        return float(np.sqrt(np.mean(speeds**2))) if speeds.size else 0.0

    def latency(self) -> dict[str, float]:
        seconds = self._of_calls("seconds")
        seconds = seconds[min(BOOT, len(seconds) // 2) :]
        found = {f"p{k}": float(np.percentile(seconds, k)) for k in (50, 95, 99)}
        return found | {"max": float(seconds.max())}

    def _of_calls(self, name: str) -> Array:
        """A column where the controller was called; one NaN where it never was."""
        called = np.isfinite(self.seconds)
        return self.columns[name][called] if called.any() else np.full(1, np.nan)

    def _counted(self, name: str) -> dict[str, float]:
        """Of a column that is 0 inside: the share of calls at which it is not, and the most."""
        found = np.nan_to_num(self._of_calls(name))
        return {"share": float((found > ROUNDING).mean()), "most": float(found.max())}

    def report(self) -> dict[str, Any]:
        """The numbers of report.json."""
        mean, wanted = self.tracked()
        off, late = mean - wanted, int((self.seconds > self.tick).sum())
        names = ("interrupted", "memory_start", "memory_end", "foot_lift", "slip")
        slip = self.slip_speeds
        return {
            "latency": self.latency(),
            "prepare_p50": float(np.median(self._of_calls("prepare"))),
            "device": "cpu",
            "rate": 1.0 / self.tick,
            "missed_deadlines": max(self.statuses.count(NO_COMMAND), late),
            "tracking_error": {
                "velocity": float(np.hypot(*off[:2])),
                "yaw_rate": float(abs(off[2])),
            },
            "velocity": [float(v) for v in mean],
            "command": [float(v) for v in wanted],
            "falls": len(self.falls),
            "fall_times": [float(v) for v in self.falls],
            "statuses": dict(Counter(self.statuses)),
            "torque_excess": float(self._of_calls("excess").max()),
            "clipped": self._counted("clipped"),
            "beyond": self._counted("beyond"),
            "pushes": [float(v) for v in self.impulses],
            **{name: getattr(self, name) for name in names},
            "slip_mean": float(np.mean(slip)) if slip.size else 0.0,
            "seconds": float(len(self.t) * self.tick),
        }

    def __str__(self) -> str:
        room = len(self.columns["t"])
        if self.count < max(room, 1):
            ticks = f"{self.count} of {room} ticks of {self.tick:g} s"
            return f"{self.robot.name}: {ticks} recorded so far"
        r = self.report()
        wall, went, wanted = r["latency"], r["velocity"], r["command"]
        statuses = ", ".join(f"{count} {name}" for name, count in r["statuses"].items())
        falls = f"{r['falls']} fall{'' if r['falls'] == 1 else 's'}"
        walked = (
            f"  ahead {went[0]:.2f} of {wanted[0]:.2f} m/s, left {went[1]:.2f} of {wanted[1]:.2f} "
            f"m/s, turning {went[2]:.2f} of {wanted[2]:.2f} rad/s; feet lift "
            f"{100 * r['foot_lift']:.1f} cm and slip {r['slip']:.3f} m/s\n"
        )
        return (
            f"{self.robot.name}, {r['seconds']:g} s at {r['rate']:g} Hz on cpu: {falls}; "
            f"{statuses}\n{walked if self.robot.base == 'floating' else ''}  step took "
            f"{1e3 * wall['p50']:.2f} ms (p50), {1e3 * wall['p99']:.2f} ms (p99); "
            f"{r['missed_deadlines']} missed deadlines; largest planned torque "
            f"{r['torque_excess']:.2f} of its limit"
        )

    def solution(self, every: float = 0.02) -> Solution:
        """The motion of the plant as a Solution, for pictures: every ``every`` s, with the forces
        and torques of that moment."""
        stride = max(1, min(round(every / self.tick), len(self.t) - 1))
        x, robot = self.x[::stride], self.robot
        force, point = self.force[::stride][1:], self.point[::stride][1:]
        normal = np.zeros_like(force)
        normal[..., 2] = 1.0
        place = body_poses(robot, x)[1][:, robot.base_body, :2]
        (x_low, y_low), (x_high, y_high) = place.min(axis=0) - GROUND, place.max(axis=0) + GROUND
        loaded = force[..., 2] > 0.0
        level = float(np.median(point[..., 2][loaded])) if loaded.any() else 0.0
        ground = {"x": np.array([x_low, x_high]), "y": np.array([y_low, y_high])}
        ground["z"] = np.full((2, 2), level)
        if self.shapes is not None:
            low, high = np.array([(x_low, y_low, level), (x_high, y_high, level)])
            ground = sampled(self.shapes.below, low, high)
        return recorded(
            character=robot,
            dt=stride * self.tick,
            x=np.concatenate([x[:1], x]),
            u=self.u[::stride][:-1],
            weight=self._weight,
            length=self.world["length"],
            contact_force=force,
            contact_point=point,
            contact_normal=normal,
            ground=ground,
            world=self.shapes,
            seconds=float(np.nansum(self.seconds)),
        )
