"""A solved stride as the reference of a controller, carried on for as long as it runs."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from octo.checks import instance, positive
from octo.errors import ProblemError
from octo.model.character import Character
from octo.model.feet import low_contacts
from octo.model.quantities import Array, interpolated
from octo.model.terrain import plane_of
from octo.mpc.controller import Controller
from octo.mpc.stance import stance
from octo.mpc.walking import GOVERNOR, foot_law
from octo.problem.problem import Problem
from octo.problem.tracking import tracking
from octo.replay.plan import ground_of
from octo.result.solution import Solution
from octo.result.stride import Stride

SAMPLES = 0.0025  # s, at most, between the samples of a stride that references are read from


def tracking_problem(
    stride: Solution, steps: int = 25, dt: float = 0.04, *, friction: float = 0.8, **described: Any
) -> Problem:
    """A horizon that tracks a solved cycle: the problem of a controller whose guide is a
    :class:`StrideReference`. It begins where the stride does.

    Parameters
    ----------
    stride: a Solution of a Problem with a cycle.
    steps: of the horizon. dt: s, of each. friction: of the ground.
    described: what else a Problem takes, as constraints.

    Raises
    ------
    ProblemError: the stride is no cycle of a robot, or its ground no plane; what
        :class:`octo.Problem` refuses.
    """
    robot = _robot(stride)
    for name in {"costs", "law", "x0", "v0", "terrain"} & described.keys():
        raise ProblemError(
            f"{name} is chosen by tracking_problem: change it in the Problem, by .replace({name}=…)"
        )
    positive("friction", friction)
    feet = len(low_contacts(robot, stance(robot)))
    length, gravity = stride.length, stride.weight / robot.mass
    return Problem(
        robot,
        steps=steps,
        dt=dt,
        costs=tracking(robot, length),
        law=foot_law(robot, length, feet, friction, gravity),
        terrain=ground_of(stride),
        x0=stride.x[1],
        v0=(stride.x[1] - stride.x[0]) / stride.dt,
        **described,
    )


def _robot(stride: Solution) -> Character:
    instance("stride", stride, Solution, "a Solution of a cycle")
    if stride.cycle is None or stride.character is None:
        raise ProblemError(
            "stride is no cycle, a reference goes on for ever: solve a Problem with "
            "cycle=octo.Cycle(…)"
        )
    return stride.character


class StrideReference:
    """A reference generator (``guide``) for :func:`tracking_problem`: a solved cycle, mirrored or
    not, stride after stride, with its configurations, rates and torques.

    At a reset of the controller the stride is entered at the phase whose joints are nearest to the
    robot's, where the robot is and heads. From then on it goes by the clock. A governor, as of
    :class:`VelocityCommand`, carries it along where a robot falls behind, is ahead or turned by
    more than 0.15 m or 0.25 rad.

    Parameters
    ----------
    stride: a Solution of a Problem with a cycle.

    Attributes
    ----------
    velocity: (2,) m/s, ahead and to the left. yaw_rate: rad/s. Both of the stride.
    """

    def __init__(self, stride: Solution):
        robot, cycle = _robot(stride), stride.cycle
        assert cycle is not None
        self.velocity = np.array([cycle.speed, cycle.sideways])
        self.yaw_rate = cycle.turn / cycle.period
        self._first = robot.base_coordinate
        self._joints = robot.actuated
        whole = cycle.times(2) if cycle.mirrored else cycle
        self._shift = np.asarray(whole.shift)  # (3,) m, of a point at the origin in a stride
        self._x, self._u = _sampled(stride, whole)
        self._period = len(stride.u) * stride.dt * (2 if cycle.mirrored else 1)  # s, of tiled ones
        ground = plane_of(stride.parameters)
        normal = np.array([0.0, 0.0, 1.0]) if ground is None else ground[0]
        self._rise = -normal[:2] / normal[2]
        self._time = np.nan
        self._began, self._strides = 0.0, 0  # s; strides done since then
        self._yaw, self._place = 0.0, np.zeros(3)  # of the present stride, in the world

    def reset(self) -> None:
        """At the next call the stride begins anew where the robot is then."""
        self._time = np.nan

    def __call__(self, controller: Controller, t: float, x: Array) -> None:
        N, dt = controller.problem.steps, controller.dt
        if not t >= self._time or t - self._time > 1.0:  # the first call, or after a gap
            self._enter(t, x)
        self._time = t
        while t - self._began >= (self._strides + 1) * self._period:
            self._yaw, self._place = self._later(1)
            self._strides += 1
        begun = t - self._began - self._strides * self._period
        times = np.asarray(begun + dt * np.arange(N + 1), dtype=float)
        nodes, torques = self._at(times)
        if self._govern(nodes[0], x):
            nodes, torques = self._at(times)
        controller.reference("ConfigurationTracking", "target")[:] = nodes[1:]
        controller.reference("RateTracking", "rate")[:] = np.diff(nodes, axis=0) / dt
        controller.reference("TorqueTracking", "torque")[:] = torques[:-1]

    def _enter(self, t: float, x: Array) -> None:
        """Begin at the phase whose joints are nearest, at the robot's place and heading."""
        away = self._x[:, self._joints] - x[self._joints]
        nearest = int(np.argmin((away**2).sum(axis=1)))
        self._began, self._strides = t - nearest * self._period / (len(self._x) - 1), 0
        here, j = self._x[nearest], self._first
        self._yaw, self._place = 0.0, np.zeros(3)
        self._turn(x[j + 3] - here[j + 3], here)
        self._move(x[j : j + 2] - here[j : j + 2])

    def _later(self, strides: int) -> tuple[float, Array]:
        """Where the stride is so many strides later."""
        yaw, place = self._yaw, self._place
        for _ in range(strides):
            place = place + _turned(yaw) @ self._shift
            yaw += self.yaw_rate * self._period
        return yaw, place

    def _at(self, times: Array) -> tuple[Array, Array]:
        """Configurations (N+1, n) in the world and torques (N+1, nu), at ``times`` (N+1,) s after
        the present stride began."""
        strides = np.floor(times / self._period).astype(int)
        phase = times / self._period - strides
        nodes, torques = (interpolated(a, phase * (len(a) - 1)) for a in (self._x, self._u))
        j = self._first
        for k in range(int(strides[-1]) + 1):
            own, (yaw, place) = strides == k, self._later(k)
            nodes[own, j : j + 3] = nodes[own, j : j + 3] @ _turned(yaw).T + place
            nodes[own, j + 3] += yaw
        return nodes, torques

    def _govern(self, wanted: Array, x: Array) -> bool:
        """Bring the reference ``wanted`` (n,) near the robot at x (n,); whether that moved it."""
        j = self._first
        apart, turned = x[j : j + 2] - wanted[j : j + 2], x[j + 3] - wanted[j + 3]
        far = max(float(np.hypot(*apart)), 1e-9)
        move, turn = max(0.0, 1.0 - GOVERNOR[0] / far), max(0.0, abs(turned) - GOVERNOR[1])
        if move == turn == 0.0:
            return False
        self._turn(float(np.copysign(turn, turned)), wanted)
        self._move(move * apart)
        return True

    def _move(self, way: Array) -> None:
        """Move the reference by a level way (2,) m along the ground."""
        self._place += [*way, self._rise @ way]

    def _turn(self, angle: float, around: Array) -> None:
        """Turn the reference by an angle (rad) about where the base is in ``around`` (n,)."""
        middle = np.append(around[self._first : self._first + 2], 0.0)
        self._place = middle + _turned(angle) @ (self._place - middle)
        self._yaw += angle


def _sampled(stride: Solution, whole: Stride) -> tuple[Array, Array]:
    """Configurations and torques of a whole stride, evenly from its beginning to its end, at its
    nodes too."""
    tiled, each = stride.tile(3), int(np.ceil(stride.dt / SAMPLES))
    count = len(tiled.u) // 3
    # the one in the middle, where the motion goes on before it and after
    times = count + np.linspace(0.0, count, count * each + 1)
    x = CubicSpline(np.arange(3 * count + 1), tiled.x[1:], axis=0)(times)
    return (x - whole.constant) @ np.linalg.inv(whole.matrix).T, interpolated(tiled.u, times)


def _turned(yaw: float) -> Array:
    """(3, 3)."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
