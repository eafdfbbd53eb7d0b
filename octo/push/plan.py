"""A walk laid behind an object, and the stages in which the rod between them goes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from octo.checks import Array
from octo.model.character import Character
from octo.model.element import SpringDamper
from octo.model.feet import lowest_contacts
from octo.model.kinematics import sphere_centers
from octo.problem import presets
from octo.problem.limits import StepLimit
from octo.problem.problem import Problem
from octo.push.task import Task
from octo.result.solution import Solution

GAP = 0.02  # ℓ, between the foremost point of the walk and the object
LEAP = 0.5  # rad and m, of a step
SHORTER = 0.02  # ℓ, by which the load of the object shortens the rod at first …
DAMPING = 0.6  # √(ℓ/g), … and what its damping is in parts of that


class Stage(NamedTuple):
    """Of the continuation: how stiff the rod is and contacts are, in parts of what they are at the
    beginning and in the walk; the speed at which friction is at 0.7 of its limit, in √(gℓ); and how
    many iterations it has, for it need not converge: the next one begins elsewhere."""

    rod: float
    stiffness: float
    creep: float
    iterations: int


# Of a mammal that pushes a third of its mass: with stiff contacts, or a speed of 0.03, from the
# first on the first stage stalls. The last one but one is without the contacts' curvature, with
# which the last one alone stalls in worse optima.
STAGES = (
    Stage(1.0, 0.1, 0.13, 100),
    Stage(0.3, 0.1, 0.13, 100),
    Stage(0.1, 0.1, 0.13, 100),
    Stage(0.03, 0.1, 0.13, 100),
    Stage(0.0, 0.1, 0.13, 100),
    Stage(0.0, 0.3, 0.06, 100),
    Stage(0.0, 1.0, 0.03, 400),
)
FRICTION = STAGES[-1].creep


@dataclass(frozen=True, eq=False)
class Plan:
    """A walk laid behind the object.

    Attributes
    ----------
    walk: straight ahead, as long as the object's way.
    """

    task: Task
    walk: Solution

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
        task, x, base = self.task, self.walk.x[1:], self.base
        turn = task.heading - self.yaw
        c, s = np.cos(turn), np.sin(turn)
        made = np.tile(task.scene.start_pose, (len(x), 1))
        made[:, : task.robot.nx] = x
        moved = (x[:, base : base + 2] - x[0, base : base + 2]) @ np.array([[c, s], [-s, c]])
        back = (self.reach + task.depth) * task.way / np.linalg.norm(task.way)
        middle = task.scene.start_pose[task.first : task.first + 2]
        made[:, base : base + 2] = middle - back + moved
        made[:, base + 3] += turn
        made[:, task.first : task.first + 2] += moved
        if task.rolls:
            made[:, task.first + 3 :] += self._rolled(moved)
        return made

    def _rolled(self, moved: Array) -> Array:
        """(N+1, 3) rad, the angles of a ball that rolls by ``moved`` (N+1, 2) m; of its chart the
        innermost axis is taken."""
        task = self.task
        angles = np.zeros((len(moved), 3))
        angles[:, 2] = np.array([moved[:, 0], -moved[:, 1]])[int(task.chart == "zyx")] / task.depth
        return angles

    def model(self, stage: Stage) -> tuple[Character, dict[str, float]]:
        """The scene, with the rod where there is one, and its parameters."""
        task = self.task
        rod, stiffness, creep, _ = stage
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
        common: dict[str, Any] = {"steps": self.walk.steps, "dt": task.dt, "parameters": given}
        bare = Problem(
            model, costs=presets.paper(), law=task.law(stage.creep), pose=self.nodes[0], **common
        )
        feet = [task.robot.contacts[k].name for k in lowest_contacts(task.robot, task.leaning)]
        costs = presets.natural(length=bare.length, feet=tuple(feet), pose=bare.start)
        moved = self.nodes[-1] - self.nodes[0]
        moved[np.setdiff1d(np.arange(len(moved)), self._goes)] = 0.0
        return bare.replace(costs=costs, displacement=moved, constraints=[StepLimit(LEAP)])

    @property
    def _goes(self) -> Array:
        """The coordinates that the motion changes: places, and the angles of a ball."""
        first, base = self.task.first, self.base
        turns = [first + 3, first + 4, first + 5] if self.task.rolls else []
        return np.array([base, base + 1, first, first + 1, *turns])

    @property
    def _rod(self) -> float:
        """m, between the base and the object."""
        first, base = self.task.first, self.base
        x = self.nodes[0]
        return float(np.linalg.norm(x[first : first + 3] - x[base : base + 3]))
