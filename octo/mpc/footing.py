"""The plane under a robot that does not see: through the places where its feet stood last."""

from __future__ import annotations

import numpy as np

from octo.model.feet import low_contacts
from octo.model.kinematics import sphere_centers
from octo.model.quantities import GRAVITY, Array
from octo.model.terrain import OF_PLANE
from octo.mpc.controller import Controller

STILL = 0.1  # of √(gℓ), speed of a foot below which it stands
FLAT = 0.15  # of ℓ: how far apart feet are that say as much about a slope as that there is none


class Footing:
    """Where each foot stood last, and the plane through these places.

    Attributes
    ----------
    rise: (2,) of the plane along x and y. height: m, of the plane over the origin.
    """

    def __init__(self, controller: Controller, x: Array):
        robot = controller.robot
        self._feet = low_contacts(robot, controller.problem.start)
        self._radius = np.array([robot.contacts[k].radius for k in self._feet])
        self._places = self._now = self._bottoms(controller, x)  # (feet, 3) m
        self._time = np.nan
        self.rise, self.height = np.zeros(2), 0.0

    def take(self, controller: Controller, t: float, x: Array) -> None:
        """What is felt at ``t`` s and x (nx,) becomes the ground of the controller's plan."""
        now, length = self._bottoms(controller, x), controller.problem.length
        if t > self._time:
            speed = np.linalg.norm(now - self._now, axis=1) / (t - self._time)
            still = speed < STILL * np.sqrt(GRAVITY * length)
            self._places = np.where(still[:, None], now, self._places)
        self._now, self._time = now, t
        middle = self._places.mean(axis=0)
        along, height = np.split(self._places - middle, [2], axis=1)
        square = along.T @ along + (FLAT * length) ** 2 * np.eye(2)
        self.rise = np.linalg.solve(square, along.T @ height)[:, 0]
        self.height = float(middle[2] - self.rise @ middle[:2])
        normal = np.append(-self.rise, 1.0) / np.sqrt(1.0 + self.rise @ self.rise)
        plane = dict(zip(OF_PLANE, (*normal, self.height), strict=True))
        controller.set_parameters(plane)

    def _bottoms(self, controller: Controller, x: Array) -> Array:
        places = sphere_centers(controller.robot, x)[self._feet]
        places[:, 2] -= self._radius
        return places
