"""Torques that keep a plant on a plan: feed-forward, PD, a wrench through the feet."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.optimize import nnls

from octo.model.mass_matrix import mass_matrix
from octo.model.quantities import GRAVITY, Array
from octo.model.quaternions import rotation_of, skew
from octo.model.terrain import Plane
from octo.plant import MujocoPlant
from octo.replay.plan import Plan
from octo.result.solution import Solution

# of the friction pyramid, tangential directions
EDGES = np.array([(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)])


@dataclass(frozen=True)
class Gains:
    """How hard the plan is held.

    Attributes
    ----------
    kp (N m/rad or N/m), kd (N m s/rad or N s/m): of every joint.
    base: N/m, tilt: N m/rad, of the wrench on the base, damped by base_damping (N s/m) and
        tilt_damping (N m s/rad).
    friction: that the spread forces may use.
    """

    kp: float
    kd: float
    base: float = 0.0
    tilt: float = 0.0
    base_damping: float = 0.0
    tilt_damping: float = 0.0
    friction: float = 0.5

    @staticmethod
    def of(
        solution: Solution, kp: float | None = None, kd: float | None = None, friction: float = 0.8
    ) -> Gains:
        """Gains in proportion to the robot: its weight mg, its length ℓ and the inertia of its
        turning base."""
        robot = solution.character
        assert robot is not None
        weight, length = solution.weight, solution.length
        time = np.sqrt(length / GRAVITY)  # s, of a fall
        stiff = JOINT * weight * length if kp is None else kp
        damping = JOINT_DAMPING * time * stiff if kd is None else kd
        base, tilt = BASE * weight / length, TILT * weight * length
        inertia = float(np.mean(np.diag(mass_matrix(robot, solution.x[1]))[3:6]))
        damped = (2.0 * np.sqrt(base * weight / GRAVITY), 2.0 * np.sqrt(tilt * inertia))
        return Gains(stiff, damping, base, tilt, *damped, friction=CONE * friction)

    def without_base(self) -> Gains:
        return replace(self, base=0.0, tilt=0.0, base_damping=0.0, tilt_damping=0.0)


# weight of a foot's change of force beside the wrench, both in mg: the wrench is met where it can
# be
SPREAD = 0.05
CONE = 0.75  # of the friction coefficient, that spread forces may use
# kp in mg·ℓ a radian: 94 N m/rad of a go2. With half of it, as well damped, 10 of 25 replays of a
# mammal's walks of 10 s stand without base feedback, not 15, of a go2's 15, not 18; with more of
# it no more
JOINT = 2.0
JOINT_DAMPING = 0.127  # kd/kp in √(ℓ/g)
BASE = 1.5  # in mg/ℓ: 750 N/m of a go2
TILT = 4.4  # in mg·ℓ a radian: 200 N m/rad of a go2


class Controller:
    """Torques (nu,) for a plant at step k of a plan."""

    def __init__(self, plan: Plan, gains: Gains, plant: MujocoPlant, length: float):
        self.plan, self.gains, self.plant, self.length = plan, gains, plant, length
        robot = plan.character
        self.joints = robot.actuated
        self.first = robot.base_coordinate
        # a quaternion has one number more than the angles it stands for
        self.in_q = robot.actuated + 1
        # (3 k, 4 k) of k feet on a plane
        self.edges: list[Array] = []
        if isinstance(plant.terrain, Plane):
            pyramid: Array = _pyramid(plant.ground(np.zeros((1, 3)))[1][0], gains.friction)
            self.edges = [
                np.asarray(np.kron(np.eye(k), pyramid)) for k in range(plan.stance.shape[1] + 1)
            ]
        self.upright = rotation_of(plan.q[0, self.first + 3 : self.first + 7])[:, 2]
        self.weight = robot.mass * GRAVITY

    def __call__(self, k: int) -> Array:
        plan, gains = self.plan, self.gains
        q, v = self.plant.q, self.plant.v
        error, rate = plan.q[k, self.in_q] - q[self.in_q], plan.v[k, self.joints] - v[self.joints]
        u = plan.u[k] + gains.kp * error + gains.kd * rate
        if gains.base > 0.0 and plan.stance[k].any():
            u = u + self.spread(k, self.wrench(k, q, v))
        return np.asarray(u)

    def wrench(self, k: int, q: Array, v: Array) -> Array:
        """(6,) N and N m, world axes, about the base's origin: springs and dampers to the planned
        base."""
        plan, gains, j = self.plan, self.gains, self.first
        turn, wanted = rotation_of(q[j + 3 : j + 7]), rotation_of(plan.q[k, j + 3 : j + 7])
        tilt = turn @ _between(q[j + 3 : j + 7], plan.q[k, j + 3 : j + 7])
        spin = wanted @ plan.v[k, j + 3 : j + 6] - turn @ v[j + 3 : j + 6]
        away, slow = plan.q[k, j : j + 3] - q[j : j + 3], plan.v[k, j : j + 3] - v[j : j + 3]
        force = gains.base * away + gains.base_damping * slow
        return np.concatenate([force, gains.tilt * tilt + gains.tilt_damping * spin])

    def spread(self, k: int, wrench: Array) -> Array:
        """Torques (nu,) whose feet add ``wrench`` to what they were planned to give."""
        feet = np.flatnonzero(self.plan.stance[k])
        points, jacobians = self.plant.feet(feet)
        forces = self.forces(k, feet, points - self.plant.base_place, wrench)
        change = forces - self.plan.force[k, feet]
        return np.asarray(-np.einsum("fij,fi->j", jacobians[..., self.joints], change))

    def _edges(self, arms: Array) -> Array:
        """(3 k, 4 k): the friction pyramids of feet at ``arms`` (k, 3) m from the base."""
        if self.edges:
            return self.edges[len(arms)]
        normals = self.plant.ground(arms + self.plant.base_place)[1]
        return np.asarray(block_diag(*[_pyramid(n, self.gains.friction) for n in normals]))

    def forces(self, k: int, feet: NDArray[np.intp], arms: Array, wrench: Array) -> Array:
        """Forces (feet, 3) N at ``arms`` (feet, 3) m that give the planned wrench and ``wrench``,
        inside the friction pyramid.

        f = edges · β with β ≥ 0: least squares of the wrench's error and, weakly, of the change of
        every foot's force.
        """
        # (6, 3 feet)
        G = np.concatenate([np.concatenate([np.eye(3), skew(arm)]) for arm in arms], axis=1)
        planned, edges = self.plan.force[k, feet].ravel(), self._edges(arms)
        scale = np.array([1.0, 1.0, 1.0, *[1.0 / self.length] * 3]) / self.weight
        rows = np.concatenate([scale[:, None] * (G @ edges), SPREAD / self.weight * edges])
        wanted = np.concatenate([scale * (G @ planned + wrench), SPREAD / self.weight * planned])
        try:
            return np.asarray(edges @ nnls(rows, wanted)[0]).reshape(-1, 3)
        # out of iterations, as with a friction of 1e9: the planned forces stay
        except RuntimeError:
            return planned.reshape(-1, 3)


def _between(first: Array, second: Array) -> Array:
    """(3,) rotation vector, in the first one's axes, from one quaternion to another."""
    a, b = first.tolist(), second.tolist()
    w = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
    x = a[0] * b[1] - a[1] * b[0] - a[2] * b[3] + a[3] * b[2]
    y = a[0] * b[2] - a[2] * b[0] - a[3] * b[1] + a[1] * b[3]
    z = a[0] * b[3] - a[3] * b[0] - a[1] * b[2] + a[2] * b[1]
    sine, sign = math.sqrt(x * x + y * y + z * z), -1.0 if w < 0.0 else 1.0
    factor = sign * 2.0 * math.atan2(sine, abs(w)) / sine if sine > 1e-12 else 2.0 * sign
    return factor * np.array([x, y, z])


def _pyramid(normal: Array, friction: float) -> Array:
    """(3, 4): the edges of the friction pyramid around ``normal``."""
    first = np.cross(normal, [0.0, 1.0, 0.0] if abs(normal[1]) < 0.9 else [1.0, 0.0, 0.0])
    first /= np.linalg.norm(first)
    tangents = np.stack([first, np.cross(normal, first)], axis=1)
    return normal[:, None] + friction * tangents @ EDGES.T
