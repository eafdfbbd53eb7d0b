"""What a controller does not know: pushes on the base, and the noise of the sensors."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from octo.checks import number, positive
from octo.model.character import Character
from octo.model.quantities import Array

# Standard deviations of noise 1, each tick (about that of a robot's state estimator).
PLACE, TURN, JOINT = 1.5e-3, 3e-3, 3e-3  # m, rad, rad
SPEED, SPIN, JOINT_SPEED = 0.015, 0.03, 0.09  # m/s, rad/s, rad/s


@dataclass(frozen=True)
class Push:
    """``force`` N on the base for ``seconds`` s from ``start`` s on, ``degrees`` from the heading
    (90 is to the left)."""

    force: float
    seconds: float = 0.2
    degrees: float = 0.0
    start: float = 5.0

    def __post_init__(self) -> None:
        for name in ("force", "degrees", "start"):
            number(f"push.{name}", getattr(self, name))
        positive("push.seconds", self.seconds, "s")

    def at(self, t: float, rotation: Array) -> Array:
        """(3,) N, world axes, level."""
        if not self.start - 1e-9 <= t < self.start + self.seconds - 1e-9:
            return np.zeros(3)
        angle = np.arctan2(rotation[1, 0], rotation[0, 0]) + np.radians(self.degrees)
        return self.force * np.array([np.cos(angle), np.sin(angle), 0.0])


@dataclass
class Sensors:
    """What the controller sees of the plant: noise in multiples of a robot's, the same for the same
    seed."""

    robot: Character
    noise: float = 0.0
    seed: int = 0
    _rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)
        floating = self.robot.base == "floating"
        self._first = self.robot.base_coordinate if floating else 0
        joints = self.robot.nx - 6 if floating else self.robot.nx
        self._size = (np.full(joints, JOINT), np.full(joints, JOINT_SPEED))
        self._floating = floating
        self.draw()

    def draw(self) -> None:
        """New errors, one set a tick."""
        rng, k = self._rng, self.noise
        self._dq, self._dv = (k * size * rng.standard_normal(len(size)) for size in self._size)
        self._place = k * PLACE * rng.standard_normal(3)
        self._turn = k * TURN * rng.standard_normal(3)
        self._speed = k * SPEED * rng.standard_normal(3)
        self._spin = k * SPIN * rng.standard_normal(3)

    def read(self, q: Array, v: Array) -> tuple[Array, Array]:
        if self.noise == 0.0:
            return q, v
        if not self._floating:
            return q + self._dq, v + self._dv
        q, v, f = q.copy(), v.copy(), self._first
        w, x, y, z = q[f + 3 : f + 7]
        a, b, c = 0.5 * self._turn
        q[f + 3 : f + 7] += (
            -x * a - y * b - z * c,
            w * a + y * c - z * b,
            w * b + z * a - x * c,
            w * c + x * b - y * a,
        )
        q[f + 3 : f + 7] /= np.linalg.norm(q[f + 3 : f + 7])
        q[f : f + 3] += self._place
        v[f : f + 3] += self._speed
        v[f + 3 : f + 6] += self._spin
        others = np.r_[0:f, f + 7 : len(q)]
        q[others] += self._dq
        v[np.r_[0:f, f + 6 : len(v)]] += self._dv
        return q, v
