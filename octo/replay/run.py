"""Replays of a plan from its own start or from perturbed ones, and what became of each."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from octo.checks import one_of, positive, whole
from octo.errors import ProblemError, ValueRangeError
from octo.model.character import Character
from octo.model.element import missing, with_parameters
from octo.model.quantities import Array
from octo.plant import MujocoPlant, from_chart
from octo.plant.fall import fallen
from octo.replay.control import Controller, Gains
from octo.replay.plan import Plan, ground_of
from octo.result.even import even
from octo.result.solution import Solution, solution_of
from octo.solver.status import Status

FEEDBACKS = ("base", "none")
LOOK = 0.01  # s, between two looks at whether it fell
USUAL = 0.001  # s, of plant and control; of a plan of another dt the whole part that is nearest
WHOLE = 1e-6  # of a time step, by which a plan's dt may miss a number of them
# m (uniform, 0 to it), rad, rad, m/s and rad/s (normal)
RAISED, TILTED, BENT, MOVING = 0.01, 0.04, 0.02, 0.05


@dataclass(frozen=True)
class Start:
    """What became of one start.

    Attributes
    ----------
    start: its number, 0 for the plan's own. fell: whether the base came under half its start height
        or tilted over 60°.
    seconds_upright: s, until then, or all of the plan. drift: m, horizontal distance of the base
        from the planned one at
    that time. tracking_error: rad (or m), root mean square over the actuated joints while upright.
    torque_use: largest |torque|/limit asked for before it was clipped, of the joints with a
        positive limit; 0 without.
    """

    start: int
    fell: bool
    seconds_upright: float
    drift: float
    tracking_error: float
    torque_use: float


@dataclass(frozen=True, eq=False)
class Replay:
    """All starts of one plan; ``motion`` is the first one as a Solution, for pictures beside the
    plan."""

    plan: Solution
    motion: Solution
    starts: tuple[Start, ...]
    settings: dict[str, Any] = field(default_factory=dict)

    def report(self) -> dict[str, Any]:
        """The numbers of report.json."""
        names = ("seconds_upright", "drift", "tracking_error")
        return {
            "falls": sum(start.fell for start in self.starts),
            **{name: float(np.mean([getattr(s, name) for s in self.starts])) for name in names},
            "seconds": self.plan.steps * self.plan.dt,
            "robot": self.plan.name,
            "plan_status": self.plan.status.label,
            **self.settings,
            "starts": [asdict(start) for start in self.starts],
        }

    def __str__(self) -> str:
        duration, count = self.plan.steps * self.plan.dt, len(self.starts)
        stood = count - sum(start.fell for start in self.starts)
        times = ", ".join(f"{start.seconds_upright:.2f}" for start in self.starts)
        report = self.report()
        return (
            f"{self.plan.name} in MuJoCo, feedback {self.settings['feedback']}: {stood} of {count} "
            f"stood for {duration:g} s (upright for {times} s); drift {report['drift']:.3f} m, "
            f"joints off by {report['tracking_error']:.3f} rad"
        )


def replay(
    solution: Solution | str | os.PathLike[str],
    *,
    kp: float | None = None,
    kd: float | None = None,
    friction: float = 0.8,
    starts: int | None = None,
    seed: int = 0,
    feedback: str = "base",
    timestep: float | None = None,
) -> Replay:
    """Run a plan, a Solution or the path of one, in MuJoCo.

    Planned torques are feed-forward, beside a PD on the joints and, with ``feedback`` "base", a
    wrench that pulls the base to the plan through the feet planned to be in stance. Torques are
    clipped to the robot's limits. A run ends with the plan or with a fall.

    Parameters
    ----------
    kp: N m/rad, of every joint; by default in proportion to the robot.
    kd: N m s/rad, of every joint; by default in proportion to the robot.
    friction: of the plant.
    starts: so many perturbed starts (base raised 0–1 cm; normal noise on roll and pitch .04 rad,
        joints .02 rad, base velocity .05 m/s and rad/s), drawn from ``seed``; None is the plan's
        own start alone.
    timestep: s, of plant and control, a whole part of the plan's dt; by default about 1 ms.

    Raises
    ------
    ProblemError: no robot, no floating base or no actuator, a user-written ground, or elements
        that the robot does not have. ModelError: an element for which MuJoCo has no tendon.
        ValueRangeError, UnknownNameError.
    """
    one_of("feedback", feedback, FEEDBACKS)
    whole("seed", seed, 0)
    for name, value in (("kp", kp), ("kd", kd)):
        if value is not None:
            positive(name, value)
    whole("starts", 1 if starts is None else starts, most=100_000)
    solution = even(solution_of(solution))
    timestep = _fitting(solution.dt, timestep)
    robot = _robot(solution)
    gravity = [solution.parameters[f"gravity_{c}"] for c in "xyz"]
    plant = MujocoPlant(
        robot, terrain=ground_of(solution), friction=friction, timestep=timestep, gravity=gravity
    )
    gains = Gains.of(solution, kp, kd, friction)
    held = gains if feedback == "base" else gains.without_base()
    controller = Controller(Plan.of(solution, timestep), held, plant, solution.length)
    rng = np.random.default_rng(seed)
    records, motion = [], None
    for number in range(starts or 1):
        x, rate = started(solution) if starts is None else perturbed(solution, rng)
        tracks = _run(controller, *from_chart(robot, x, rate), solution.dt)
        records.append(tracks.record(number))
        motion = motion or tracks.solution(solution)
    settings = {"feedback": feedback, "kp": gains.kp, "kd": gains.kd, "friction": friction}
    settings |= {"timestep": timestep, "perturbed": starts is not None, "seed": seed}
    assert motion is not None
    return Replay(solution, motion, tuple(records), settings)


def _fitting(dt: float, timestep: float | None) -> float:
    """s, of plant and control, for a plan of steps of ``dt`` s; raises as :func:`replay` does."""
    many = dt / (USUAL if timestep is None else positive("timestep", timestep))
    if abs(many - round(many)) <= WHOLE:
        return USUAL if timestep is None else timestep
    if timestep is None:
        return dt / max(1, round(many))
    raise ValueRangeError(f"timestep is {timestep} s, must be a whole part of the plan's {dt} s")


def _robot(solution: Solution) -> Character:
    """The robot of a plan that can be replayed; raises as :func:`replay` does."""
    robot = solution.character
    if robot is None or robot.base != "floating" or robot.nu == 0:
        raise ProblemError(
            "replay needs a robot with a floating base and actuated joints: nothing else can fall"
        )
    lost = missing(robot.elements, solution.parameters)
    if lost:
        raise ProblemError(
            f"the plan was made with the elements {', '.join(lost)}, which its robot does not "
            "have: a file keeps octo's own only"
        )
    return replace(robot, elements=with_parameters(robot.elements, solution.parameters))


@dataclass(eq=False)
class _Tracks:
    """What the plant did in one run, at the plan's nodes and in sums over the control steps."""

    controller: Controller
    nodes: list[Array] = field(default_factory=list)  # x, at times 0, dt, 2 dt …
    torques: list[Array] = field(default_factory=list)
    forces: list[tuple[Array, Array]] = field(default_factory=list)
    squares: float = 0.0
    steps: int = 0
    torque_use: float = 0.0
    drift: float = 0.0
    fell: bool = False

    def keep(self) -> None:
        """Where the plant is now as the next node."""
        plant = self.controller.plant
        self.nodes.append(plant.x)
        self.torques.append(plant.torque)
        self.forces.append(plant.contacts())

    def record(self, number: int) -> Start:
        error = float(np.sqrt(self.squares / max(self.steps, 1)))
        upright = self.steps * self.controller.plan.timestep
        return Start(number, self.fell, round(upright, 6), self.drift, error, self.torque_use)

    def solution(self, plan: Solution) -> Solution:
        """The motion as a Solution, with the plan's robot, ground and time step."""
        x = np.array([self.nodes[0], *self.nodes])
        force, point = (np.array([pair[k] for pair in self.forces]) for k in (0, 1))
        normal = self.controller.plant.ground(point.reshape(-1, 3))[1]
        empty: dict[str, Any] = {"terms": {}, "history": {}, "passes": (), "starts": ()}
        return replace(
            plan,
            name=f"{plan.name} in MuJoCo",
            x=x,
            u=np.array(self.torques),
            contact_force=force,
            contact_point=point,
            contact_normal=normal.reshape(force.shape),
            contact_velocity=np.zeros_like(force),
            contact_depth=np.zeros(force.shape[:2]),
            status=Status.SIMULATED,
            iterations=0,
            factorizations=0,
            **empty,
        )


def _run(controller: Controller, q: Array, v: Array, dt: float) -> _Tracks:
    """The plan from one state; nodes are kept every ``dt`` s."""
    plant, plan = controller.plant, controller.plan
    plant.reset(q, v)
    tracks = _Tracks(controller, [plant.x])
    every = round(dt / plan.timestep)
    standing = plant.height
    j = controller.first
    limits, often = controller.plan.character.torque_limit, max(1, round(LOOK / plan.timestep))
    limited = limits > 0.0
    for k in range(plan.steps):
        u = controller(k)
        used = float(np.max(np.abs(u[limited]) / limits[limited], initial=0.0))
        tracks.torque_use = max(tracks.torque_use, used)
        error = plan.q[k, controller.in_q] - plant.q[controller.in_q]
        tracks.squares += float(np.mean(error**2))
        plant.step(u)
        tracks.steps += 1
        if tracks.steps % every == 0:
            tracks.keep()
        if tracks.steps % often and tracks.steps < plan.steps:
            continue
        tracks.drift = float(np.linalg.norm(plan.q[k + 1, j : j + 2] - plant.base_place[:2]))
        up = float(plant.base_rotation[:, 2] @ controller.upright)
        if fallen(plant.height, standing, up):
            tracks.fell = True
            break
    # it fell before the first node: its end is one, or there would be no motion to show
    if not tracks.torques:
        tracks.keep()
    return tracks


def started(solution: Solution) -> tuple[Array, Array]:
    """x (nx,) and its rate (nx,) at the plan's start: those of x_{-1} and x_0."""
    return solution.x[1].copy(), (solution.x[1] - solution.x[0]) / solution.dt


def perturbed(solution: Solution, rng: np.random.Generator) -> tuple[Array, Array]:
    """x (nx,) and its rate (nx,): the plan's start with noise."""
    robot = solution.character
    assert robot is not None
    x, rate = started(solution)
    first = robot.base_coordinate
    x[first + 2] += rng.uniform(0.0, RAISED)
    x[first + 4 : first + 6] += TILTED * rng.standard_normal(2)  # pitch and roll, in either chart
    x[robot.actuated] += BENT * rng.standard_normal(robot.nu)
    rate[first : first + 6] += MOVING * rng.standard_normal(6)
    return x, rate
