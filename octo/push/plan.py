"""A walk laid behind an object that slides, and the stages in which the rod between them goes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from octo.checks import Array
from octo.model.character import Character
from octo.model.element import SpringDamper
from octo.model.feet import lowest_contacts
from octo.model.kinematics import sphere_centers
from octo.problem import presets
from octo.problem.body_costs import Upright
from octo.problem.costs import Cost
from octo.problem.joint_costs import PoseTarget
from octo.problem.problem import Problem
from octo.push.task import Task
from octo.result.solution import Solution

GAP = 0.02  # ℓ, between the foremost point of the walk and the object
SHORTER = 0.02  # ℓ, by which the load of the object shortens the rod at first …
DAMPING = 0.6  # √(ℓ/g), … and what its damping is in parts of that
STAYS = 100.0  # of the square of how far the object is moved by the way to it, over all steps
TILT = 10.0  # of the sine of the object's tilt, in parts of that at which it falls over, squared


class Stage(NamedTuple):
    """Of the continuation: how stiff the rod is and contacts are, in parts of what they are at the
    beginning and in the walk, and the speed at which friction is at 0.7 of its limit, in √(gℓ)."""

    rod: float
    stiffness: float
    creep: float


# Of a mammal that pushes a third of its mass: with stiff contacts, or a speed of 0.03, from the
# first on the first stage stalls.
STAGES = (
    Stage(1.0, 0.1, 0.13),
    Stage(0.3, 0.1, 0.13),
    Stage(0.1, 0.1, 0.13),
    Stage(0.03, 0.1, 0.13),
    Stage(0.0, 0.1, 0.13),
    Stage(0.0, 0.3, 0.06),
    Stage(0.0, 1.0, 0.03),
)
FRICTION = STAGES[-1].creep


@dataclass(frozen=True, eq=False)
class Plan:
    """A walk laid behind the object.

    Attributes
    ----------
    walk: straight ahead, as long as :meth:`distance`. stages: of the continuation, of which all but
        the last take so many ``iterations`` at most.
    """

    task: Task
    walk: Solution
    stages: ClassVar[Sequence[Stage]] = STAGES
    iterations: ClassVar[int] = 100  # of a stage but the last

    @classmethod
    def distance(cls, task: Task) -> float:
        """m, that the robot walks: as far as the object is pushed."""
        return float(np.linalg.norm(task.way))

    @cached_property
    def reach(self) -> float:
        """m, from the base to the object's face, so that the walk does not touch it."""
        robot, x = self.task.robot, self.walk.x[1:]
        radius = np.array([contact.radius for contact in robot.contacts])
        turned = np.array([np.cos(self.yaw), np.sin(self.yaw)])
        ahead = sphere_centers(robot, x)[..., :2] - x[:, None, self.base : self.base + 2]
        return float((ahead @ turned + radius).max()) + GAP * self.task.length

    @property
    def base(self) -> int:
        return self.task.robot.base_coordinate

    @property
    def yaw(self) -> float:
        """rad, of the walk as it was found."""
        return float(self.walk.yaw[0])

    @cached_property
    def nodes(self) -> Array:
        """(N+1, nx) the walk behind the object, which moves as the base does."""
        task, base = self.task, self.base
        made = self._laid(np.array([self.reach + task.depth, 0.0]))
        moved = made[:, base : base + 2] - made[0, base : base + 2]
        made[:, task.first : task.first + 2] += moved
        return made

    def _laid(self, ahead: Array) -> Array:
        """(N+1, nx) the walk in the direction of the object's way, which begins with the object's
        middle ``ahead`` (2,) m of the base and to its left."""
        task, x, base = self.task, self.walk.x[1:], self.base
        turn, along = task.heading - self.yaw, task.way / np.linalg.norm(task.way)
        c, s = np.cos(turn), np.sin(turn)
        made = np.tile(task.scene.start_pose, (len(x), 1))
        made[:, : task.robot.nx] = x
        moved = (x[:, base : base + 2] - x[0, base : base + 2]) @ np.array([[c, s], [-s, c]])
        back = ahead @ np.array([along, [-along[1], along[0]]])
        middle = task.scene.start_pose[task.first : task.first + 2]
        made[:, base : base + 2] = middle - back + moved
        made[:, base + 3] += turn
        return made

    def model(self, stage: Stage) -> tuple[Character, dict[str, float]]:
        """The scene, with the rod where there is one, and its parameters."""
        task = self.task
        rod, stiffness, creep = stage
        own = {name: self.walk.parameters[f"contact.{name}"] for name in ("w_perp", "onset")}
        given = {
            "contact.w_perp": stiffness * own["w_perp"],
            "contact.onset": own["onset"] / np.sqrt(stiffness),
            "contact.creep": creep * task.speed,
        }
        model = task.scene
        if rod:
            ends = (task.robot.bodies[task.robot.base_body].name, task.body)
            tie = SpringDamper(ends[0], (0.0, 0.0, 0.0), ends[1], (0.0, 0.0, 0.0))
            model = replace(model, elements=(*model.elements, tie))
            name = f"spring{len(model.elements) - 1}"
            stiff = rod * task.load / (SHORTER * task.length)
            given[f"{name}.stiffness"] = stiff
            given[f"{name}.damping"] = stiff * DAMPING * task.length / task.speed
            given[f"{name}.rest_length"] = self._rod
        return model, given

    def problem(self, stage: Stage) -> Problem:
        """One stage of the continuation."""
        task = self.task
        model, given = self.model(stage)
        common: dict[str, Any] = {"steps": len(self.nodes) - 1, "dt": task.dt, "parameters": given}
        bare = Problem(
            model, costs=presets.paper(), law=task.law(stage.creep), pose=self.nodes[0], **common
        )
        feet = [task.robot.contacts[k].name for k in lowest_contacts(task.robot, task.leaning)]
        costs = presets.natural(length=bare.length, feet=tuple(feet), pose=bare.start)
        if not task.rolls:
            tilt = TILT / np.sin(task.tipping) ** 2
            costs.append(Upright(weight=tilt, pose=bare.start, body=task.body, name="Tilt"))
        return bare.replace(costs=costs, constraints=self._ends(bare.start))

    def _ends(self, start: Array) -> list[Cost]:
        """Where a motion that begins at ``start`` (nx,) ends: the robot at rest, as it stood, the
        object at its place, and turned as it was.

        That an object that slides ends level and at rest follows by itself. Fixed all the same, it
        has multipliers that grow 2.5-fold with every step since the object was let go, to 1e6, and
        a solve stalls.
        """
        first = self.task.first
        target = start.copy()
        places = [self.base, self.base + 1, first, first + 1]
        target[places] += (self.nodes[-1] - self.nodes[0])[places]
        robot, thing = self._ended()
        return [
            PoseTarget(target=target, coordinates=robot, at=(-2, -1), name="Stands"),
            PoseTarget(target=target, coordinates=thing, at="last", name="Place"),
        ]

    def approach(self, nodes: Array) -> Problem:
        """A motion from ``nodes[0]`` to rest at ``nodes[-1]``, (N+1, nx), that leaves the object
        where it is: what ``nodes`` are the first guess of."""
        robot, thing = self._ended()
        last = self.problem(self.stages[-1])
        stands = PoseTarget(target=nodes[-1], coordinates=robot, at=(-2, -1), name="Stands")
        # priced: what nobody touches stays by itself, and would be fixed twice
        stays = PoseTarget(target=nodes[-1], coordinates=thing, weight=STAYS, name="Stays")
        costs = [*last.costs, stays]
        own = {"x0": nodes[0], "pose": None, "constraints": [stands]}
        return last.replace(steps=len(nodes) - 1, costs=costs, **own)

    def _ended(self) -> tuple[Array, Array]:
        """(nx,) 1 for the coordinates of the robot, and of the object, that are fixed at an end."""
        task, first = self.task, self.task.first
        robot, thing = np.zeros((2, len(self.nodes[0])))
        robot[: task.robot.nx] = 1.0
        thing[[first, first + 1] if task.rolls else [first, first + 1, first + 3]] = 1.0
        return robot, thing

    @property
    def _rod(self) -> float:
        """m, between the base and the object."""
        first, base = self.task.first, self.base
        x = self.nodes[0]
        return float(np.linalg.norm(x[first : first + 3] - x[base : base + 3]))
