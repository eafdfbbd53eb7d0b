"""Walking on command: a controller's problem, and the references that follow the command."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from octo.checks import instance, number, numbers, positive
from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.laws import Compliant, Coulomb
from octo.errors import ProblemError
from octo.model.character import Character
from octo.model.feet import gaps, low_contacts, terrain_bottoms
from octo.model.kinematics import sphere_centers
from octo.model.quantities import GRAVITY, Array
from octo.model.terrain import World, plane_of
from octo.mpc.controller import Controller
from octo.mpc.stance import stance
from octo.problem.presets import locomotion
from octo.problem.problem import Problem

CONE = 0.75  # of the ground's friction, that is planned with
SINK = 0.25  # of ℓ: what a linear foot sinks under the whole weight
ONSET = 1.0 / 30.0  # of ℓ, the width of the contact's onset
CREEP = 0.117  # of √(gℓ), the creep speed of friction and the dissipation velocity of the contact
ACCELERATION = (1.0, 1.0)  # m/s², rad/s²
ACROSS = 7  # points along a body at which the height of a world is looked up
GOVERNOR = (0.15, 0.25)  # m and rad: how far the integrated command may be ahead


def foot_law(
    robot: Character, length: float, feet: int, friction: float = 0.8, gravity: float = GRAVITY
) -> Compliant:
    """The soft contact that control plans with, for a robot with its base ``length`` (m) over the
    ground.

    Three quarters of the ``friction`` are planned with, under a ``gravity`` in m/s². Its offset is
    what it sinks under the weight on ``feet`` contacts, so that at rest hard feet carry what soft
    ones do.
    """
    speed = CREEP * float(np.sqrt(gravity * length))
    stiffness, sigma = robot.mass * gravity / (SINK * length), ONSET * length
    share = SINK * length / feet / sigma  # relative to mg, over stiffness·sigma
    return Compliant(
        stiffness=stiffness,
        sigma=sigma,
        dissipation_velocity=speed,
        offset=sigma * float(np.log(np.expm1(share))),
        friction=Coulomb(mu=CONE * friction, creep=speed),
    )


def walking_problem(
    robot: Character,
    steps: int = 25,
    dt: float = 0.04,
    *,
    friction: float = 0.8,
    pose: Array | None = None,
    **described: Any,
) -> Problem:
    """A horizon of ``steps`` steps of ``dt`` s with the terms of ``octo.costs.locomotion``, on feet
    of ``friction``.

    The pose that is held is ``pose`` (nx,), by default the robot's own start with its straight legs
    bent.

    Raises
    ------
    ProblemError: the base does not float, or no sphere can touch the ground; what
        :class:`octo.Problem` refuses.
    """
    instance("robot", robot, Character, "a Character: what octo.load gives")
    for name in {"costs", "law", "x0"} & described.keys():
        raise ProblemError(
            f"{name} is chosen by walking_problem: change it in the Problem, by .replace({name}=…)"
        )
    positive("friction", friction)
    if robot.base != "floating":
        raise ProblemError(
            f"walking needs a floating base, robot {robot.name!r} is fixed: try base='floating'"
        )
    if not robot.own_contacts:
        raise ProblemError(
            f"walking needs feet, robot {robot.name!r} has no contact spheres that can touch the "
            "ground"
        )
    held = stance(robot) if pose is None else numbers("pose", pose, (robot.nx,))
    described |= {"steps": steps, "dt": dt, "costs": locomotion()}
    placed = _on_the_ground(robot, held, described.get("terrain"))
    draft = Problem(robot, x0=placed, **described)
    if draft.gravity == 0.0:
        raise ProblemError("walking needs a weight: the parameters' gravity is 0")
    law = foot_law(robot, draft.length, len(low_contacts(robot, held)), friction, draft.gravity)
    problem = Problem(robot, law=law, pose=held, **described)
    return problem.replace(costs=locomotion(length=problem.length), x0=problem.start, pose=None)


def _on_the_ground(robot: Character, pose: Array, terrain: Any) -> Array:
    """``pose`` (nx,) with its lowest contact at height zero, or on the world; only heights are read
    of it."""
    placed, height = pose.copy(), robot.base_coordinate + 2
    placed[height] -= float(terrain_bottoms(robot, pose).min())
    if isinstance(terrain, World):
        placed[height] -= float(gaps(robot, terrain, {}, placed).min())
    return placed


class _Over:
    """How high a controller's base is over a world, in the mean over its body's length."""

    def __init__(self, controller: Controller, world: World):
        problem = controller.problem
        robot, start = problem.character, problem.start
        assert robot is not None
        feet = sphere_centers(robot, start)[low_contacts(robot, start)]
        self.world, self.length = world, problem.length
        self.reach = 0.5 * float(np.ptp(feet[:, :2], axis=0).max())
        self.first = controller.convention.base(start)[0]

    def heights(self, target: Array, yaw: Array, now: float) -> Array:
        """(N,) m, of a base over places (N, 2) m with headings (N,) rad, that is ``now`` m high; as
        high over the ground as at the start, over what is under it with the first heading."""
        ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
        along = np.linspace(-self.reach, self.reach, ACROSS)[:, None, None] * ahead
        top = float(self.first[2])
        above = self.first[2] - self._under(self.first[:2] + along[:, :1], top)[0]
        return self._under(target + along, now + self.length) + above

    def _under(self, places: Array, top: float) -> Array:
        flat = places.reshape(-1, 2)
        points = np.column_stack([flat, np.full(len(flat), top)])
        return self.world.below(points).reshape(places.shape[:-1]).mean(axis=0)


class VelocityCommand:
    """A reference generator (``guide``) for the locomotion preset: speed ahead, sideways, turning,
    integrated by a reference governor: never far ahead of the robot.

    Attributes
    ----------
    velocity: (2,) m/s, ahead and to the left. yaw_rate: rad/s. May be changed at any time.
    acceleration: m/s² and rad/s², with which the command that is followed goes there.
    """

    def __init__(
        self,
        velocity: Sequence[float] = (0.3, 0.0),
        yaw_rate: float = 0.0,
        acceleration: tuple[float, float] = ACCELERATION,
    ):
        self.velocity = numbers("velocity", velocity, (2,)).copy()
        self.yaw_rate = number("yaw_rate", yaw_rate)
        pair = zip(
            numbers("acceleration", acceleration, (2,)).tolist(), ("m/s²", "rad/s²"), strict=True
        )
        self.acceleration = tuple(positive("acceleration", value, unit) for value, unit in pair)
        self._now, self._rate = np.zeros(2), 0.0
        self._time = np.nan
        self._place, self._yaw = np.zeros(2), 0.0
        self._over: tuple[Controller, _Over] | None = None  # of the controller that asked last

    def reset(self) -> None:
        """At the next call the command starts from rest, where the robot is then."""
        self._time = np.nan

    def __call__(self, controller: Controller, t: float, x: Array) -> None:
        N, dt = controller.problem.steps, controller.dt
        origin, rotation = controller.convention.base(x)
        ahead = np.arctan2(rotation[1, 0], rotation[0, 0])
        # the first call, after a reset, or after a gap
        if not t >= self._time or t - self._time > 1.0:
            self._place, self._yaw = origin[:2].copy(), ahead
            self._now, self._rate = np.zeros(2), 0.0
        else:
            self._advance(t - self._time)
        self._time = t
        apart = self._place - origin[:2]
        far = max(float(np.hypot(*apart)), 1e-9)
        self._place = origin[:2] + apart * min(1.0, GOVERNOR[0] / far)
        turn = (self._yaw - ahead + np.pi) % (2.0 * np.pi) - np.pi
        self._yaw = ahead + min(max(turn, -GOVERNOR[1]), GOVERNOR[1])
        yaw = self._yaw + self._rate * dt * np.arange(1, N + 1)
        velocity = _turned(self._now, yaw)
        target = self._place + dt * np.cumsum(velocity, axis=0)
        controller.reference("CenterOfMassVelocity", "velocity")[:, :2] = velocity
        self._follow_the_ground(controller, velocity, target, (yaw, float(origin[2])))
        controller.reference("BaseAngularVelocity", "velocity")[:, 2] = self._rate
        controller.reference("BaseOrientation", "roll_pitch_yaw")[:, 2] = yaw
        controller.reference("Position", "target")[:, :2] = target

    def _follow_the_ground(
        self, controller: Controller, velocity: Array, target: Array, base: tuple[Any, float]
    ) -> None:
        """Heights are those of the ground under the command's places (N, 2); ``base``: its heading
        there (N,) rad, and how high it is now, m."""
        dynamics = controller.problem.dynamics
        if isinstance(dynamics, RobotDynamics) and isinstance(dynamics.terrain, World):
            self._follow_the_world(controller, dynamics.terrain, target, base)
        else:
            self._follow_the_slope(controller, velocity, target)

    def _follow_the_world(
        self, controller: Controller, world: World, target: Array, base: tuple[Any, float]
    ) -> None:
        """On a world, they are the mean over a body's length along the heading."""
        if self._over is None or self._over[0] is not controller:
            self._over = controller, _Over(controller, world)
        heights = self._over[1].heights(target, *base)
        controller.reference("BaseHeight", "height")[:, 0] = heights
        rise = np.gradient(heights, controller.dt)
        controller.reference("CenterOfMassVelocity", "velocity")[:, 2] = rise

    @staticmethod
    def _follow_the_slope(controller: Controller, velocity: Array, target: Array) -> None:
        """On a slope they rise with it."""
        names, p = controller.problem.dynamics.layout.names, controller.compiled.p[0]
        plane = plane_of(dict(zip(names, p.tolist(), strict=True)))
        if plane is None:
            return
        normal, height = plane
        rise = -normal[:2] / normal[2]
        if not rise.any():
            return
        start = controller.convention.base(controller.problem.start)[0]
        above = start[2] - (controller.first_ground + rise @ start[:2])
        controller.reference("BaseHeight", "height")[:, 0] = height + target @ rise + above
        controller.reference("CenterOfMassVelocity", "velocity")[:, 2] = velocity @ rise

    def _advance(self, seconds: float) -> None:
        """The command that is followed, and where it has led."""
        self._now = _toward(self._now, self.velocity - self._now, self.acceleration[0] * seconds)
        most = self.acceleration[1] * seconds
        self._rate += min(max(self.yaw_rate - self._rate, -most), most)
        self._place = self._place + seconds * _turned(self._now, self._yaw)
        self._yaw += seconds * self._rate


def _toward(value: Array, change: Array, most: float) -> Array:
    """``value`` + ``change``, no further than ``most``."""
    return np.asarray(value + change * min(1.0, most / max(float(np.hypot(*change)), 1e-12)))


def _turned(velocity: Array, yaw: Any) -> Array:
    """(…, 2) ``velocity`` (2,) turned by ``yaw`` (…) rad."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack([c * velocity[0] - s * velocity[1], s * velocity[0] + c * velocity[1]], axis=-1)


__all__ = ["VelocityCommand", "foot_law", "walking_problem"]
