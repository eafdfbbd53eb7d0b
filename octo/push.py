"""Pushing: a robot walks behind an object, pushes it to a place and stands, with no contact
given.

A contact that carries nothing has no slope, so a robot and an object that do not touch learn
nothing of each other. Here the first guess is a walk behind the object, to which a rod ties it. The
rod, which pulls and pushes, makes the two move together; then it softens, so that the robot closes
in on the object, and in the end it is gone and contact alone carries the load.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, Unpack

import numpy as np

from octo.checks import Array, asked, instance, numbers, positive, takes, time_step, whole
from octo.continuation.schedule import early
from octo.dynamics.laws import Coulomb, Smooth
from octo.dynamics.static_pose import balanced_pose
from octo.errors import ProblemError, UnknownNameError
from octo.goals import Goal
from octo.model.character import Character
from octo.model.chart import Chart
from octo.model.charted import charted
from octo.model.element import SpringDamper
from octo.model.feet import lowest_contacts, toward
from octo.model.kinematics import body_poses, sphere_centers
from octo.model.quantities import GRAVITY
from octo.model.scene import Scene
from octo.motions.budget import Budget
from octo.motions.steady import go_to
from octo.motions.transitions import JOINT, SUMS
from octo.problem import presets, scales
from octo.problem.cycle import TIME_STEP
from octo.problem.limits import StepLimit
from octo.problem.problem import Problem
from octo.ranking import best_of
from octo.result.solution import Solution
from octo.solve import LARGEST_SEED, MOST_STARTS, How, Usual, evaluated, solve
from octo.solver.options import SqpOptions
from octo.solver.status import Status
from octo.starts import smooth_noise

LOG = logging.getLogger("octo")

SPEED = 0.22  # √(gℓ), of the way: slow walks have short strides, which stay behind the object
GAP = 0.02  # ℓ, between the foremost point of the walk and the object
LEAP = 0.5  # rad and m, of a step
ROD = 10.0  # mg/ℓ, stiffness of the rod at first …
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
NEAR = 0.05  # ℓ and rad, of where the push begins: no walk leads there
TOES = 20  # steps of the joints in which the feet get to where they stand


@asked
@takes(Usual)
def push(
    scene: Scene,
    body: str,
    place: Sequence[float],
    seconds: float | None = None,
    *,
    mu: float = 0.6,
    dt: float = TIME_STEP,
    seeds: int = 5,
    seed: int = 0,
    **how: Unpack[How],
) -> Solution:
    """Push an object to a place: the robot walks behind it, pushes, and stands.

    Parameters
    ----------
    scene: a robot on level ground, and objects. Where its ``contacts`` are not given, all contact
        spheres of the robot may touch ``body``.
    body: name of the object.
    place: (2,) m, x and y in the world, where the middle of the object gets to.
    seconds: of the push; by default those of a slow walk. The way to the object comes before it.
    mu: friction of all contacts, more than 0.
    dt: s, of one step.
    seeds: starts that differ in the noise of the joints, solved as one batch; ``seed`` is the first
        one's number.
    passes, options, max_iterations, time_limit, tolerance, device, threads, progress, callback: as
        those of :func:`octo.solve`; ``time_limit`` is of the whole motion, ``passes`` are those of
        the strides.

    Returns
    -------
    The best converged of the starts, behind the way to the object; ``starts`` has a record of each.
    The object ends there: at rest, but for a ball, which rolls through it.

    Raises
    ------
    OctoError: what cannot be pushed is refused; nothing was computed.
    """
    task = Task.of(scene, body, place, mu, time_step(dt))
    whole("seeds", seeds, most=MOST_STARTS)
    whole("seed", seed, 0, LARGEST_SEED)
    time = None if seconds is None else positive("seconds", seconds, "s")
    budget = Budget({name: value for name, value in how.items() if value is not None})
    found = pushed(task, time, seeds, seed, budget)
    return Goal("push", place=task.place, body=body).said(found)


@dataclass(frozen=True, eq=False)
class Task:
    """An object of a scene and where it is to be.

    Attributes
    ----------
    scene: robot and objects. robot: alone. body: the object's name. place: (2,) m. mu: friction.
    """

    scene: Character
    robot: Character
    body: str
    place: Array
    mu: float
    dt: float

    @classmethod
    def of(cls, scene: Scene, body: str, place: Sequence[float], mu: float, dt: float) -> Task:
        """What was asked for, checked."""
        instance("scene", scene, Scene, "an octo.Scene of a robot and objects")
        robot, made = scene.robot, scene.character
        if robot is None or robot.base != "floating" or robot.nu == 0 or not robot.own_contacts:
            raise ProblemError(
                "scene has no robot that can walk: its base must be floating, a joint actuated, "
                "and it must touch the ground"
            )
        if body not in made.objects:
            raise UnknownNameError("object", body, made.objects)
        b = made.body_index(body)
        if len(made.bodies[b].joints) != 6:
            raise ProblemError(f"object {body!r} is held by the world, must be a free body to push")
        where = numbers("place", place, (2,))
        scene, made = _rolling(scene, body, where)
        solids = [s for s, solid in enumerate(made.solids) if solid.body == b]
        if scene.contacts is None:
            every = ((k, s) for k in robot.own_contacts for s in solids)
            made = replace(made, touches=tuple(dict.fromkeys([*made.touches, *every])))
        if not any(s in solids for _, s in made.touches):
            raise ProblemError(f"object {body!r} is touched by nothing, name it in contacts")
        if np.linalg.norm(where - made.start_pose[made.first_joint[b] :][:2]) < 1e-3:
            raise ProblemError(f"place is where {body!r} is, must be elsewhere")
        return cls(made, robot, body, where, positive("mu", mu), dt)

    @property
    def first(self) -> int:
        """Of the object's coordinates in x: x, y, z, and three angles."""
        return int(self.scene.first_joint[self.scene.body_index(self.body)])

    @property
    def way(self) -> Array:
        """(2,) m, of the object."""
        return self.place - self.scene.start_pose[self.first : self.first + 2]

    @property
    def heading(self) -> float:
        """rad, of the way."""
        return float(np.arctan2(self.way[1], self.way[0]))

    @cached_property
    def length(self) -> float:
        """m, ℓ of the robot that stands."""
        return scales.length(self.robot, balanced_pose(self.robot))

    @property
    def speed(self) -> float:
        """m/s, √(gℓ)."""
        return float(np.sqrt(GRAVITY * self.length))

    @property
    def rolls(self) -> bool:
        """Whether the object is a ball."""
        b = self.scene.body_index(self.body)
        return all(one.kind == "sphere" for one in self.scene.solids if one.body == b)

    @property
    def chart(self) -> Chart:
        """Of the object's angles."""
        inner = self.scene.joints[self.first + 5].axis
        return "zxy" if abs(inner[1]) > 0.5 else "zyx"

    @cached_property
    def depth(self) -> float:
        """m, how far the object reaches from its middle to the side of the robot."""
        b = self.scene.body_index(self.body)
        pose, back = self.scene.start_pose, -np.append(self.way / np.linalg.norm(self.way), 0.0)
        spheres = [(k, one) for k, one in enumerate(self.scene.contacts) if one.body == b]
        middle, centers = pose[self.first : self.first + 3], sphere_centers(self.scene, pose)
        return max(float((centers[k] - middle) @ back) + one.radius for k, one in spheres)

    @cached_property
    def leaning(self) -> Array:
        """(nx,) the robot's balanced pose, its feet moved back by as much as the centre of pressure
        is moved by the force that the object's friction takes."""
        robot, pose = self.robot, balanced_pose(self.robot).copy()
        mass = self.scene.bodies[self.scene.body_index(self.body)].mass
        back = 0.0 if self.rolls else min(self.mu * mass / robot.mass, 0.5) * self.length
        feet = lowest_contacts(robot, pose)
        heading = body_poses(robot, pose)[0][robot.base_body, :, 0]
        targets = sphere_centers(robot, pose)[feet] - back * heading
        for _ in range(TOES):
            pose[robot.actuated] += toward(robot, pose, feet, targets)
        return pose

    def law(self, creep: float) -> Smooth:
        """Dry friction that is at 0.7 of its limit at ``creep`` √(gℓ)."""
        return Smooth(friction=Coulomb(mu=self.mu, creep=creep * self.speed))


def _rolling(scene: Scene, body: str, place: Array) -> tuple[Scene, Character]:
    """The scene, a ball that is to roll in the chart whose innermost angle turns the way it goes:
    the middle one is singular at a quarter turn."""
    made = scene.character
    b = made.body_index(body)
    if not all(one.kind == "sphere" for one in made.solids if one.body == b):
        return scene, made
    x, y = np.abs(place - made.start_pose[made.first_joint[b] :][:2])
    of = [k for k, own in enumerate(scene.objects) for one in own.bodies if one.parent < 0]
    ball, objects = of[made.objects.index(body)], list(scene.objects)
    objects[ball] = charted(objects[ball], "zxy" if x > y else "zyx")
    scene = replace(scene, objects=objects)
    return scene, scene.character


def pushed(task: Task, seconds: float | None, seeds: int, seed: int, budget: Budget) -> Solution:
    """The motion of a task: the way to the object, and the best of the pushes."""
    walk = _walk(task, np.array([np.linalg.norm(task.way), 0.0, 0.0]), seconds, budget)
    if walk.status is Status.INTERRUPTED:
        return walk
    plan = Plan(task, walk)
    members: list[Any] = _starts(plan, seeds, seed)
    for number, stage in enumerate((*STAGES, STAGES[-1])):
        members = _solved(plan, stage, members, number, budget)
        if any(one.status is Status.INTERRUPTED for one in members):
            break
    best = best_of([replace(one, seed=seed + k) for k, one in enumerate(members)])
    return _behind(plan, best, budget)


def _walk(task: Task, place: Array, seconds: float | None, budget: Budget) -> Solution:
    """A walk of the robot alone, in the pose in which it pushes."""
    options = budget.left("the walk") | {"law": task.law(FRICTION), "pose": task.leaning}
    speed = SPEED * task.speed
    return go_to(task.robot, place, seconds, speed=speed, dt=task.dt, **options)


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
            stiff = rod * ROD * task.robot.mass * GRAVITY / task.length
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


def _starts(plan: Plan, seeds: int, seed: int) -> list[Array]:
    """First guesses: the walk with the noise of each seed in the joints."""
    first = plan.problem(STAGES[0])
    made = []
    for k in range(seeds):
        nodes = plan.nodes.copy()
        nodes[1:-1, first.dynamics.actuated] += smooth_noise(first, seed + k)[:-1]
        made.append(nodes)
    return made


def _solved(
    plan: Plan, stage: Stage, members: Sequence[Any], number: int, budget: Budget
) -> list[Solution]:
    """A stage of all starts, from where each was after the one before; the last is solved to its
    end."""
    problem = plan.problem(stage)
    nodes = [one.x[1:] if isinstance(one, Solution) else one for one in members]
    guesses = [own + (problem.start - own[0]) for own in nodes]
    options = budget.left(f"pushing, stage {number + 1} of {len(STAGES) + 1}") | {"passes": None}
    if number < len(STAGES):
        own = replace(options.get("options") or SqpOptions(), hessian="dynamics")
        options["options"] = early(own) if number + 1 < len(STAGES) else own
        options["max_iterations"] = stage.iterations
    made = solve([problem] * len(guesses), start=guesses, **options)
    LOG.info("stage %d: %s", number + 1, ", ".join(one.status.label for one in made))
    return [_after(*pair) for pair in zip(members, made, strict=True)]


def _after(before: Any, made: Solution) -> Solution:
    """A start with what it took before too."""
    if not isinstance(before, Solution):
        return made
    sums = {name: getattr(before, name) + getattr(made, name) for name in SUMS}
    return replace(made, passes=(*before.passes, *made.passes), **sums)


def _behind(plan: Plan, best: Solution, budget: Budget) -> Solution:
    """The push behind the way to where it begins, where the robot is not there yet."""
    task, base = plan.task, plan.base
    begin, stands = best.x[1], task.scene.start_pose
    off = begin[base : base + 2] - stands[base : base + 2]
    yaw = float(stands[base + 3])
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = (off @ np.array([[c, -s], [s, c]])).tolist()
    turn = float(begin[base + 3]) - yaw
    if np.hypot(x, y) < NEAR * task.length and abs(turn) < NEAR:
        return best
    if best.status is Status.INTERRUPTED:
        return best
    way = _walk(task, np.array([x, y, turn]), None, budget)
    nodes = np.tile(begin, (way.steps + 1, 1))
    nodes[:, : task.robot.nx] = way.x[1:]
    nodes[:, base : base + 2] += begin[base : base + 2] - way.x[-1, base : base + 2]
    nodes[:, base + 3] += begin[base + 3] - way.x[-1, base + 3]
    problem = plan.problem(STAGES[-1])
    both = np.concatenate([nodes, best.x[2:]])
    whole = problem.replace(steps=len(both) - 1, x0=both[0], pose=None, displacement=None)
    raw = evaluated(whole, both, Status.JOINED)
    lawful = way.converged and best.converged and raw.violation <= JOINT * raw.weight
    spent: dict[str, Any] = {name: getattr(way, name) + getattr(best, name) for name in SUMS}
    kept: dict[str, Any] = {name: getattr(best, name) for name in ("seed", "starts", "passes")}
    return replace(raw, status=Status.JOINED if lawful else Status.STALLED, **kept, **spent)
