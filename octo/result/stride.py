"""What a solved cycle is carried on with."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array
from octo.problem.problem import Problem


@dataclass(frozen=True, eq=False)
class Stride:
    """A motion whose last state is its first one carried on: x_N = matrix x_0 + constant."""

    period: float  # s, of a whole stride
    speed: float  # m/s
    sideways: float  # m/s
    turn: float  # rad a stride
    mirrored: bool  # the motion is half a stride, the other half its mirror image
    matrix: Array  # (n, n)
    constant: Array  # (n,)
    torque: Array  # (nu, nu), of u
    rotation: Array  # (3, 3), of a point of the world; reflected where mirrored
    shift: Array  # (3,) m, of a point of the world
    contacts: NDArray[np.intp]  # (c,) the contact that each one's place is taken by
    # N, ‖U_/FD‖∞ of the mirror image (moments over ℓ): that of the motion itself where the robot's
    # left and right are exactly alike, more by what its file says of differences between them
    asymmetry: float = 0.0

    @classmethod
    def of(cls, problem: Problem) -> Stride | None:
        """The stride of a problem's cycle; None of a problem without one."""
        cycle, closure, robot = problem.cycle, problem.closure, problem.character
        if cycle is None or closure is None or robot is None:
            return None
        first, mirrored = robot.base_coordinate, closure.mirrored
        rotation = closure.forward[first : first + 3, first : first + 3]
        if mirrored:
            rotation = np.diag([1.0, -1.0, 1.0])
        touching = list(robot.terrain_contacts)
        images = np.arange(len(touching))
        if closure.mirror is not None and mirrored:
            images = np.array([touching.index(int(closure.mirror.contacts[k])) for k in touching])
        return cls(
            period=problem.steps * problem.dt * (2.0 if mirrored else 1.0),
            speed=cycle.velocity,
            sideways=cycle.sideways,
            turn=cycle.turn,
            mirrored=mirrored,
            matrix=closure.forward,
            constant=closure.forward_constant,
            torque=closure.forward[np.ix_(robot.actuated, robot.actuated)],
            rotation=rotation,
            shift=closure.forward_constant[first : first + 3],
            contacts=images,
        )

    def on(self, x: Array) -> Array:
        """Configurations (…, n) one solved piece later."""
        return np.asarray(x @ self.matrix.T + self.constant)

    def times(self, count: int) -> Stride:
        """The same motion ``count`` pieces long as one piece."""
        whole = self
        for _ in range(count - 1):
            whole = replace(
                whole,
                matrix=self.matrix @ whole.matrix,
                constant=self.matrix @ whole.constant + self.constant,
                torque=self.torque @ whole.torque,
                rotation=self.rotation @ whole.rotation,
                shift=self.rotation @ whole.shift + self.shift,
                contacts=whole.contacts[self.contacts],
            )
        return replace(whole, mirrored=False, asymmetry=0.0)

    def in_words(self, duration: float) -> str:
        """What moves on so, of a motion of ``duration`` s."""
        strides = round(duration / self.period)
        many = f"{strides} strides" if strides > 1 else "a cycle"
        words = [f"{many} of {self.period:.4g} s at {self.speed:g} m/s"]
        if self.sideways != 0.0:
            words.append(f"and {self.sideways:g} m/s sideways")
        if self.turn != 0.0:
            words.append(f"that turns by {self.turn:.3g} rad")
        return " ".join(words) + (", half of it solved for and mirrored" if self.mirrored else "")

    def plain(self) -> dict[str, Any]:
        """The numbers that are not arrays, for files."""
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ARRAYS}


ARRAYS = ("matrix", "constant", "torque", "rotation", "shift", "contacts")  # of a Stride


def plane_around(ground: dict[str, Array], points: Array) -> dict[str, Array]:
    """The sampled plane of a cycle under all of ``points`` (N, c, 3) m."""
    if not ground:
        return ground
    (x, y, z), margin = (ground[name] for name in "xyz"), 1.0
    slope_x, slope_y = (z[-1, 0] - z[0, 0]) / (x[-1] - x[0]), (z[0, -1] - z[0, 0]) / (y[-1] - y[0])
    (low, high) = (extreme(points.reshape(-1, 3), axis=0)[:2] for extreme in (np.min, np.max))
    wide = [
        np.linspace(min(a[0], lo - margin), max(a[-1], hi + margin), 2)
        for a, lo, hi in zip((x, y), low, high, strict=True)
    ]
    height = z[0, 0] + slope_x * (wide[0] - x[0])[:, None] + slope_y * (wide[1] - y[0])[None]
    return {"x": wide[0], "y": wide[1], "z": height}
