"""A ball is kicked: a foot of a walk meets it in its swing, and it rolls to its place by itself.

A ball that rolls takes no load, so that a rod between robot and ball teaches them nothing. A foot
that swings has the speed that a ball needs: here the first guess has the two meet, which is contact
from the first iteration on.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import ClassVar, NamedTuple

import numpy as np

from octo.checks import Array
from octo.errors import ProblemError
from octo.model.feet import lowest_contacts
from octo.model.kinematics import sphere_centers
from octo.push.plan import Plan, Stage
from octo.push.task import Task

STEPS = 1.5  # ℓ, of the walk: a few strides
SHARE = 0.5  # of the foot's speed that the ball gets at most
FULL = 0.3  # of the foot's highest speed, from which on it is in full swing
LIFTED = 0.04  # ℓ, of a foot in the air
HIGH = 0.8  # of the highest foot that there is
DEEP = 0.5  # of the ball's radius: how deep a first guess may have the robot in it
STAGES = (
    Stage(0.0, 0.03, 0.13),
    Stage(0.0, 0.1, 0.13),
    Stage(0.0, 0.3, 0.06),
    Stage(0.0, 1.0, 0.03),
)


class Meeting(NamedTuple):
    """A foot of the walk meets the ball.

    Attributes
    ----------
    node: of the walk, at which it is. ahead: (2,) m, of the ball's middle seen from where the base
        begins, along the walk and to the left. duration: s, of the whole motion.
    """

    node: int
    ahead: Array
    duration: float


class Kick(Plan):
    """A short walk, of which one foot meets the ball."""

    stages: ClassVar[Sequence[Stage]] = STAGES
    iterations: ClassVar[int] = 300

    @classmethod
    def distance(cls, task: Task) -> float:
        return STEPS * task.length

    @cached_property
    def nodes(self) -> Array:
        """(N+1, nx) the walk, behind which the robot stands where the ball takes longer."""
        task, met = self.task, self.meeting
        made = self._laid(met.ahead)
        count = max(len(made), round(met.duration / task.dt) + 1)
        made = np.concatenate([made, np.repeat(made[-1:], count - len(made), axis=0)])
        share = np.clip((np.arange(count) - met.node) / (count - 1 - met.node), 0.0, 1.0)
        moved = share[:, None] * task.way
        made[:, task.first : task.first + 2] += moved
        # of its chart the innermost axis is taken
        turned = np.array([moved[:, 0], -moved[:, 1]])[int(task.chart == "zyx")]
        made[:, task.first + 5] += turned / task.depth
        return made

    @cached_property
    def meeting(self) -> Meeting:
        """The first of a foot that may touch the ball, so high that it does not lift it, and with
        the rest of the robot out of it: the sooner, the slower the ball rolls. Of five starts of a
        go2 that meets it late none converges, of five that meet it early four do.

        Raises
        ------
        ProblemError: there is none.
        """
        met = [self._met(foot, node) for foot in self._feet for node in self._swings(foot)]
        found = [one for one in met if one is not None]
        if not found:
            raise ProblemError(
                f"no foot of {self.task.robot.name}'s walk that may touch the ball "
                f"{self.task.body!r} meets it (its middle is {self._height:.3g} m high) and leaves "
                "it clear of where the robot ends: take a place farther away, or describe an "
                "octo.Problem"
            )
        least = min(deep for deep, _, _ in found)
        near = [one for one in found if one[0] <= max(DEEP * self.task.depth, least)]
        highest = max(high for _, high, _ in near)
        return min((met for _, high, met in near if high >= HIGH * highest), key=lambda m: m.node)

    @cached_property
    def _feet(self) -> list[int]:
        scene, b = self.task.scene, self.task.scene.body_index(self.task.body)
        may = {k for k, s in scene.touches if scene.solids[s].body == b}
        return [k for k in lowest_contacts(self.task.robot, self.task.leaning) if k in may]

    @cached_property
    def _radii(self) -> Array:
        return np.array([contact.radius for contact in self.task.robot.contacts])

    @cached_property
    def _centers(self) -> Array:
        """(N+1, contacts, 3) m, of the walk's spheres: along it, to the left, and above the ground,
        seen from where the base begins."""
        x, base = self.walk.x[1:], self.base
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        made = sphere_centers(self.task.robot, x)
        made[..., :2] = (made[..., :2] - x[0, base : base + 2]) @ np.array([[c, -s], [s, c]])
        return made

    @property
    def _height(self) -> float:
        """m, of the ball's middle."""
        return float(self.task.scene.start_pose[self.task.first + 2])

    def _swings(self, foot: int) -> list[int]:
        """Nodes at which a foot is in the air, moves ahead in full swing and is not above the
        ball."""
        ahead, _, z = self._centers[:, foot].T
        speed = np.gradient(ahead)
        free = z - self._radii[foot] > LIFTED * self.task.length
        beside = np.abs(z - self._height) < 0.9 * (self.task.depth + self._radii[foot])
        chosen = np.flatnonzero(free & beside & (speed > FULL * max(speed.max(), 0.0)))
        return [int(k) for k in chosen if 0 < k < len(z) - 1]

    def _met(self, foot: int, node: int) -> tuple[float, float, Meeting] | None:
        """How deep the robot is in the ball at most, m, how high the foot is, m, and the rest;
        None: the robot would end in the ball."""
        task, dt, radius = self.task, self.task.dt, self._radii
        along, left, z = self._centers[node, foot]
        away = np.sqrt((task.depth + radius[foot]) ** 2 - (z - self._height) ** 2)
        start = np.array([along + away, left, self._height])
        speed = (self._centers[node + 1, foot, 0] - self._centers[node - 1, foot, 0]) / (2.0 * dt)
        way, last = float(np.linalg.norm(task.way)), (len(self._centers) - 1 - node) * dt
        took = max(way / (SHARE * speed), last)
        time = dt * (np.arange(len(self._centers)) - node)
        ball = np.repeat(start[None], len(time), axis=0)
        ball[:, 0] += np.clip(time / took, 0.0, 1.0) * way
        gap = np.linalg.norm(self._centers - ball[:, None], axis=-1) - radius - task.depth
        end = np.linalg.norm(self._centers[-1] - start - [way, 0.0, 0.0], axis=-1)
        if (end - radius - task.depth).min() <= 0.0:
            return None
        deep, whole = max(0.0, -float(gap.min())), float(node * dt + took)
        return deep, float(z), Meeting(node, start[:2], whole)
