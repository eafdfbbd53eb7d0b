"""Feet that swing in turn: what a controller on a world is told besides its velocity."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from octo.model.character import Character
from octo.model.feet import low_contacts
from octo.model.kinematics import sphere_centers
from octo.model.quantities import GRAVITY, Array
from octo.problem.tracking import FootHeightTracking

if TYPE_CHECKING:
    from octo.mpc.controller import Controller

PERIOD = 2.7  # of √(ℓ/g), of a swing and a stance: docs/notes/mpc.md
STANCE = 0.55  # of the period
LIFT = 0.25  # of ℓ, of the middle of a swing over the ground
WEIGHT = 10.0  # over ℓ²
STANDING = 0.01  # of √(gℓ), speed of the command below which all feet stand


class Gait:
    """Two groups of feet that swing in turn: of four legs the diagonal pairs, of six the tripods.

    A foot belongs to the group of its place along its side, the first on the left with the second
    on the right.

    Parameters
    ----------
    robot: whose feet. pose: (nx,) in which they stand. length: ℓ, m.
    """

    def __init__(self, robot: Character, pose: Array, length: float):
        self.feet = low_contacts(robot, pose)
        self.names = [robot.contacts[k].name for k in self.feet]
        self.length = length
        self.period = PERIOD * float(np.sqrt(length / GRAVITY))  # s
        places = sphere_centers(robot, pose)[self.feet]
        left = places[:, 1] > places[:, 1].mean()
        rank = np.zeros(len(self.feet), dtype=int)
        for side in (left, ~left):
            own = np.flatnonzero(side)
            rank[own[np.argsort(-places[own, 0], kind="stable")]] = np.arange(len(own))
        self.begins = 0.5 * ((rank + left) % 2)  # of the period, when each stance begins

    def terms(self) -> list[FootHeightTracking]:
        """One a foot, that the heights are written to."""
        weight = WEIGHT / self.length**2
        return [
            FootHeightTracking(name=label, weight=weight, contacts=(name,))
            for label, name in zip(self.labels, self.names, strict=True)
        ]

    @property
    def labels(self) -> list[str]:
        """Of the terms."""
        return [f"FootHeight {name}" for name in self.names]

    def heights(self, times: Any) -> Array:
        """(feet, N) m over the ground at ``times`` (N,) s."""
        phase = (times / self.period + self.begins[:, None]) % 1.0
        swing = np.clip((phase - STANCE) / (1.0 - STANCE), 0.0, 1.0)
        return np.asarray(LIFT * self.length * np.sin(np.pi * swing) ** 2)

    def write(self, controller: Controller, t: float, speed: float) -> None:
        """The references of a plan that begins at ``t`` s, under a command of ``speed`` m/s; all
        feet on the ground where it asks for none."""
        times = t + controller.dt * np.arange(1, controller.problem.steps + 1)
        heights = self.heights(times)
        if speed < STANDING * np.sqrt(GRAVITY * self.length):
            heights[:] = 0.0
        for label, height in zip(self.labels, heights, strict=True):
            controller.reference(label, "height")[:, 0] = height
