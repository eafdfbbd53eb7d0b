"""Configurations and velocities as a robot reports them, and as octo's chart has them, in
microseconds.

Of the angles that give one rotation those nearest to the configuration before are taken, so that a
base may turn for ever, and fall through the chart's singularity.
"""

from __future__ import annotations

import numpy as np

from octo.checks import numbers, one_of
from octo.model.character import Character
from octo.model.chart import angles_of, body_axes, rotation_of_angles, turned_by
from octo.model.quantities import Array
from octo.model.quaternions import quaternions, rotation_of

CONVENTIONS = ("mujoco", "pinocchio")
DAMPING = 1e-4  # of the chart's rates there


class Convention:
    """q (nq,), v (nv,) of one robot in the form ``name``, "mujoco" or "pinocchio"; a fixed base has
    none of the first seven.

    mujoco: base position (m), quaternion (w, x, y, z), velocity (m/s, world), angular velocity
    (rad/s, body axes). pinocchio: base position, quaternion (x, y, z, w), velocity and angular
    velocity, both in body axes. Then each joint's coordinate in the order of the character's tree:
    the form of ``Solution.to_mujoco`` where there is no ball joint (here a ball joint is three
    hinges).
    """

    def __init__(self, robot: Character, name: str = "mujoco"):
        one_of("convention", name, CONVENTIONS)
        self.robot, self.name, self.real_first = robot, name, name == "mujoco"
        self.floating = robot.base == "floating"
        self.nq, self.nv = robot.nx + self.floating, robot.nx
        base = robot.bodies[robot.base_body]
        first = robot.base_coordinate
        self._p = slice(first, first + 3)
        self._r = slice(first + 3, first + 6)
        self._joints = slice(first + 6, None)
        self._before = slice(0, first)
        self.quaternion = slice(first + 3, first + 7)
        self._after = slice(first + 7, None)
        self._origin, self._frame, self.chart = base.position, base.rotation, robot.chart
        behind = robot.actuated >= first + 6
        self.actuated_q = robot.actuated + np.where(behind, int(self.floating), 0)

    def to_octo(self, q: Array, v: Array, dt: float, near: Array) -> tuple[Array, Array]:
        """x_0 (nx,) in the chart nearest to ``near`` (nx,), and x_{-1} = x_0 − dt·v_0, where the
        velocity came from."""
        if not self.floating:
            return q.copy(), q - dt * v
        x = np.concatenate((q[self._before], near[self._p], near[self._r], q[self._after]))
        before = x - dt * v
        rotation = self._rotation(q)
        turn = self._frame.T @ rotation
        x[self._r] = angles_of(turn, self.chart, near[self._r])
        before[self._r] = angles_of(turn @ turned_by(-dt * v[self._r]), self.chart, x[self._r])
        speed = v[self._p] if self.real_first else rotation @ v[self._p]
        x[self._p] = self._frame.T @ (q[self._p] - self._origin)
        before[self._p] = x[self._p] - dt * (self._frame.T @ speed)
        return x, before

    def _rotation(self, q: Array) -> Array:
        """(3, 3) of the base, to the world's axes."""
        quaternion = q[self.quaternion]
        return rotation_of(quaternion if self.real_first else quaternion[[3, 0, 1, 2]])

    def rates(self, x: Array, v: Array) -> Array:
        """(nx,) rates of the chart at x (nx,) for v (nv,); where the chart is singular the smallest
        that fit best."""
        if not self.floating:
            return v.copy()
        rate, turn = v.copy(), rotation_of_angles(x[self._r], self.chart)
        rate[self._p] = self._frame.T @ v[self._p] if self.real_first else turn @ v[self._p]
        axes = body_axes(x[self._r], self.chart)
        rate[self._r] = np.linalg.lstsq(axes, v[self._r], rcond=1e-9)[0]
        return rate

    def of_mujoco(self, q: Array, v: Array) -> tuple[Array, Array]:
        """q (nq,) and v (nv,) of MuJoCo's form in this one."""
        if self.real_first or not self.floating:
            return q, v
        place, speed = q.copy(), v.copy()
        place[self.quaternion] = q[self.quaternion][[1, 2, 3, 0]]
        speed[self._p] = rotation_of(q[self.quaternion]).T @ v[self._p]
        return place, speed

    def from_octo(self, x: Array, rate: Array) -> tuple[Array, Array]:
        """q (nq,) and v (nv,) of a configuration and the rates (nx,) of its chart."""
        if not self.floating:
            return x.copy(), rate.copy()
        angles, v = x[self._r], rate.copy()
        rotation = self._frame @ rotation_of_angles(angles, self.chart)
        quaternion = quaternions(rotation[None])[0]
        if not self.real_first:
            quaternion = quaternion[[1, 2, 3, 0]]
        place, speed = self._origin + self._frame @ x[self._p], self._frame @ rate[self._p]
        v[self._p] = speed if self.real_first else rotation.T @ speed
        v[self._r] = body_axes(angles, self.chart) @ rate[self._r]
        return np.concatenate((x[self._before], place, quaternion, x[self._joints])), v

    def base(self, x: Array) -> tuple[Array, Array]:
        """Place (3,) m and rotation (3, 3) of a floating base; of a fixed one, the world's."""
        if not self.floating:
            return np.zeros(3), np.eye(3)
        turn = rotation_of_angles(x[self._r], self.chart)
        return self._origin + self._frame @ x[self._p], self._frame @ turn

    def tangent(self, x: Array) -> Array:
        """(nx, nv) the rates of the chart for a velocity in this convention; damped where the chart
        is singular."""
        matrix = np.eye(self.nv)
        if self.floating:
            axes = body_axes(x[self._r], self.chart)
            damped = axes.T @ axes + DAMPING**2 * np.eye(3)
            matrix[self._r, self._r] = np.linalg.solve(damped, axes.T)
            turn = rotation_of_angles(x[self._r], self.chart)
            matrix[self._p, self._p] = self._frame.T if self.real_first else turn
        return matrix


def from_chart(character: Character, x: Array, rate: Array | None = None) -> tuple[Array, Array]:
    """q (nq,) and v (nv,) in MuJoCo's form of x (nx,) rad and m and ẋ ``rate`` (nx,), by default at
    rest."""
    x = numbers("x", x, (character.nx,))
    rate = np.zeros(character.nx) if rate is None else numbers("rate", rate, (character.nx,))
    return Convention(character).from_octo(x, rate)


def to_chart(
    character: Character, q: Array, v: Array, near: Array | None = None
) -> tuple[Array, Array]:
    """x (nx,) and ẋ (nx,) of q (nq,) and v (nv,) in MuJoCo's form.

    Of the base's angles that say the same rotation, those nearest to ``near`` (nx,) are taken: a
    turning or falling base then has no jumps. At the chart's singularity ẋ is the smallest that
    fits best.
    """
    convention = Convention(character)
    q, v = numbers("q", q, (convention.nq,)), numbers("v", v, (convention.nv,))
    x = convention.to_octo(
        q, v, 0.0, np.zeros(character.nx) if near is None else np.asarray(near, dtype=float)
    )[0]
    return x, convention.rates(x, v)
