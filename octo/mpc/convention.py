"""Configurations and velocities as a robot reports them, and as octo's chart has them, in microseconds.

Of the angles that give one rotation those nearest to the configuration before are taken, so that a base may turn for
ever, and fall through the chart's singularity.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo.errors import UnknownNameError
from octo.model.character import Character

Array = NDArray[np.float64]
CONVENTIONS = ("mujoco", "pinocchio")
SINGULAR = 1e-5  # cosine of the middle angle under which the outer two cannot be told apart
DAMPING = 1e-4  # of the chart's rates there


class Convention:
    """q (nq,), v (nv,) of one robot in the form of MuJoCo or of Pinocchio; a fixed base has none of the first seven.

    mujoco: base position (m), quaternion (w, x, y, z), velocity (m/s, world), angular velocity (rad/s, body axes).
    pinocchio: base position, quaternion (x, y, z, w), velocity and angular velocity, both in body axes.
    Then each joint's coordinate in the order of the character's tree; a ball joint is three hinges, as in octo.plant.
    """

    def __init__(self, robot: Character, name: str = "mujoco"):
        if name not in CONVENTIONS:
            raise UnknownNameError("convention", name, CONVENTIONS)
        self.robot, self.name, self.real_first = robot, name, name == "mujoco"
        self.floating = robot.base == "floating"
        self.nq, self.nv = robot.nx + self.floating, robot.nx
        base = robot.bodies[robot.base_body]
        first = int(robot.first_joint[robot.base_body])
        self._p, self._r, self._joints = slice(first, first + 3), slice(first + 3, first + 6), slice(first + 6, None)
        self._before, self.quaternion, self._after = slice(0, first), slice(first + 3, first + 7), slice(first + 7, None)
        self._origin, self._frame, self.chart = base.position, base.rotation, robot.chart
        self.actuated_q = robot.actuated + np.where(robot.actuated >= first + 6, int(self.floating), 0)

    def to_octo(self, q: Array, v: Array, dt: float, near: Array) -> tuple[Array, Array]:
        """x_0 (nx,) in the chart nearest to ``near`` (nx,), and x_{-1} = x_0 − dt·v_0, where the velocity came from."""
        if not self.floating:
            return q.copy(), q - dt * v
        x = np.concatenate((q[self._before], near[self._p], near[self._r], q[self._after]))
        before = x - dt * v
        rotation = rotation_from(q[self.quaternion], self.real_first)
        turn = self._frame.T @ rotation
        x[self._r] = angles_of(turn, self.chart, near[self._r])
        before[self._r] = angles_of(turn @ turned_by(-dt * v[self._r]), self.chart, x[self._r])
        speed = v[self._p] if self.real_first else rotation @ v[self._p]
        x[self._p] = self._frame.T @ (q[self._p] - self._origin)
        before[self._p] = x[self._p] - dt * (self._frame.T @ speed)
        return x, before

    def of_mujoco(self, q: Array, v: Array) -> tuple[Array, Array]:
        """q (nq,) and v (nv,) of MuJoCo's form in this one."""
        if self.real_first or not self.floating:
            return q, v
        place, speed = q.copy(), v.copy()
        place[self.quaternion] = q[self.quaternion][[1, 2, 3, 0]]
        speed[self._p] = rotation_from(q[self.quaternion], True).T @ v[self._p]
        return place, speed

    def from_octo(self, x: Array, rate: Array) -> tuple[Array, Array]:
        """q (nq,) and v (nv,) of a configuration and the rates (nx,) of its chart."""
        if not self.floating:
            return x.copy(), rate.copy()
        angles, v = x[self._r], rate.copy()
        rotation = self._frame @ rotation_of(angles, self.chart)
        quaternion = quaternion_of(rotation)
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
        return self._origin + self._frame @ x[self._p], self._frame @ rotation_of(x[self._r], self.chart)

    def tangent(self, x: Array) -> Array:
        """(nx, nv) the rates of the chart for a velocity in this convention; damped where the chart is singular."""
        matrix = np.eye(self.nv)
        if self.floating:
            axes = body_axes(x[self._r], self.chart)
            matrix[self._r, self._r] = np.linalg.solve(axes.T @ axes + DAMPING**2 * np.eye(3), axes.T)
            turn = rotation_of(x[self._r], self.chart)
            matrix[self._p, self._p] = self._frame.T if self.real_first else turn
        return matrix


def rotation_from(q: Array, real_first: bool) -> Array:
    """(3, 3) of a quaternion (4,) of any length."""
    numbers = q.tolist()  # Python's own numbers: a third of the time
    w, x, y, z = numbers if real_first else (numbers[3], *numbers[:3])
    s = 2.0 / (w * w + x * x + y * y + z * z)
    return np.array([
        [1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
        [s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x)],
        [s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y)],
    ])  # fmt: skip


def rotation_of(angles: Array, chart: str) -> Array:
    """(3, 3) of the chart's three angles, outermost (yaw) first."""
    numbers = np.asarray(angles).tolist()
    (ca, cb, cc), (sa, sb, sc) = map(math.cos, numbers), map(math.sin, numbers)
    if chart == "zyx":
        return np.array([
            [ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc],
            [sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc],
            [-sb, cb * sc, cb * cc],
        ])  # fmt: skip
    return np.array([
        [ca * cc - sa * sb * sc, -sa * cb, ca * sc + sa * sb * cc],
        [sa * cc + ca * sb * sc, ca * cb, sa * sc - ca * sb * cc],
        [-cb * sc, sb, cb * cc],
    ])  # fmt: skip


def angles_of(rotation: Array, chart: str, near: Any) -> tuple[float, float, float]:
    """The chart's angles of a rotation (3, 3) that are nearest to ``near`` (3,)."""
    R, near = rotation.tolist(), np.asarray(near).tolist()
    middle, across = (-R[2][0], R[1][0]) if chart == "zyx" else (R[2][1], -R[0][1])
    along = R[0][0] if chart == "zyx" else R[1][1]
    cosine = math.hypot(across, along)
    b = math.atan2(middle, cosine)
    if cosine > SINGULAR:
        a = math.atan2(across, along)
        c = math.atan2(R[2][1], R[2][2]) if chart == "zyx" else math.atan2(-R[2][0], R[2][2])
    else:  # only a ± c is known: the outer angle stays
        a = near[0]
        ca, sa = math.cos(a), math.sin(a)
        if chart == "zyx":
            c = math.atan2(sa * R[0][2] - ca * R[1][2], ca * R[1][1] - sa * R[0][1])
        else:
            c = math.atan2(ca * R[0][2] + sa * R[1][2], ca * R[0][0] + sa * R[1][0])
    choices = [_near((a, b, c), near), _near((a + math.pi, math.pi - b, c + math.pi), near)]
    distance = [sum((value - aim) ** 2 for value, aim in zip(choice, near, strict=True)) for choice in choices]
    return choices[0] if distance[0] <= distance[1] else choices[1]


def _near(angles: tuple[float, float, float], near: list[float]) -> tuple[float, float, float]:
    a, b, c = (value + 2.0 * math.pi * round((aim - value) / (2.0 * math.pi)) for value, aim in zip(angles, near, strict=True))
    return a, b, c


def body_axes(angles: Array, chart: str) -> Array:
    """(3, 3) angular velocity in body axes for the rates of the chart's angles."""
    _, b, c = angles
    cb, sb, cc, sc = math.cos(b), math.sin(b), math.cos(c), math.sin(c)
    if chart == "zyx":
        return np.array([[-sb, 0.0, 1.0], [cb * sc, cc, 0.0], [cb * cc, -sc, 0.0]])
    return np.array([[-cb * sc, cc, 0.0], [sb, 0.0, 1.0], [cb * cc, sc, 0.0]])


def turned_by(vector: Array) -> Array:
    """(3, 3) the rotation about a vector (3,) rad (Rodrigues' formula)."""
    x, y, z = vector.tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    s = math.sin(angle) / angle if angle > 1e-8 else 1.0
    c = (1.0 - math.cos(angle)) / angle**2 if angle > 1e-8 else 0.5
    return np.array([
        [1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y],
        [c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x],
        [c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)],
    ])  # fmt: skip


def quaternion_of(rotation: Array) -> Array:
    """(4,) real part first and not negative."""
    R = rotation
    squares = np.array([
        1.0 + R[0, 0] + R[1, 1] + R[2, 2], 1.0 + R[0, 0] - R[1, 1] - R[2, 2],
        1.0 - R[0, 0] + R[1, 1] - R[2, 2], 1.0 - R[0, 0] - R[1, 1] + R[2, 2],
    ])  # fmt: skip
    k = int(np.argmax(squares))
    wx, wy, wz = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    xy, xz, yz = R[0, 1] + R[1, 0], R[0, 2] + R[2, 0], R[1, 2] + R[2, 1]
    table = ((squares[0], wx, wy, wz), (wx, squares[1], xy, xz), (wy, xy, squares[2], yz), (wz, xz, yz, squares[3]))
    q = np.array(table[k])
    q /= math.copysign(np.sqrt(q @ q), q[0])
    return np.asarray(q)
