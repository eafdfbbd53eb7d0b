"""Walking on command: a controller's problem, and the references that follow the command."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from octo.checks import flag, instance, number, numbers, positive
from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.laws import Compliant, Coulomb
from octo.errors import ProblemError
from octo.model.character import Character
from octo.model.feet import gaps, low_contacts, terrain_bottoms
from octo.model.kinematics import body_poses, sphere_centers
from octo.model.quantities import GRAVITY, Array
from octo.model.terrain import World, plane_of
from octo.mpc.controller import Controller
from octo.mpc.footing import Footing
from octo.mpc.gait import Gait
from octo.mpc.ground import smooth_ground
from octo.mpc.stance import stance
from octo.problem.costs import Cost
from octo.problem.presets import locomotion
from octo.problem.problem import Problem
from octo.problem.tracking import FootHeightTracking

CONE = 0.75  # of the ground's friction, that is planned with
SINK = 0.25  # of ℓ: what a linear foot sinks under the whole weight
ONSET = 1.0 / 30.0  # of ℓ, the width of the contact's onset
CREEP = 0.117  # of √(gℓ), the creep speed of friction and the dissipation velocity of the contact
ACCELERATION = (1.0, 1.0)  # m/s², rad/s²
ACROSS = 9  # points along a body at which the height of a world is looked up
AROUND = 1.5  # of half the way between its feet, how far ahead and behind they are
PITCH = 0.7  # of the ground's slope along a body, that of the body
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
    gait: bool | None = None,
    **described: Any,
) -> Problem:
    """A horizon of ``steps`` steps of ``dt`` s with the terms of ``octo.costs.locomotion``, on feet
    of ``friction``.

    The pose that is held is ``pose`` (nx,), by default the robot's own start with its straight legs
    bent. With ``gait`` the feet swing in turn, in two groups; by default they do on a world, and
    nobody says when on other ground. A ``terrain`` that is an :class:`octo.World` is planned on as
    a smooth map of its mean heights (:func:`octo.mpc.smooth_ground`).

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
    world = described.get("terrain")
    if isinstance(world, World):
        place = body_poses(robot, placed)[1][robot.base_body]
        described["terrain"] = smooth_ground(world, place, draft.length)
    problem = Problem(robot, law=law, pose=held, **described)
    costs: list[Cost] = locomotion(length=problem.length)
    if flag("gait", isinstance(world, World) if gait is None else gait):
        costs += Gait(robot, problem.start, problem.length).terms()
    return problem.replace(costs=costs, x0=problem.start, pose=None)


def _on_the_ground(robot: Character, pose: Array, terrain: Any) -> Array:
    """``pose`` (nx,) with its lowest contact at height zero, or on the world; only heights are read
    of it."""
    placed, height = pose.copy(), robot.base_coordinate + 2
    placed[height] -= float(terrain_bottoms(robot, pose).min())
    if isinstance(terrain, World):
        placed[height] -= float(gaps(robot, terrain, {}, placed).min())
    return placed


class _Over:
    """The ground of a world under a controller's base, in the mean over its body's length."""

    def __init__(self, controller: Controller, world: World):
        problem = controller.problem
        robot, start = problem.character, problem.start
        assert robot is not None
        feet = sphere_centers(robot, start)[low_contacts(robot, start)]
        self.world, self.length = world, problem.length
        reach = AROUND * 0.5 * float(np.ptp(feet[:, :2], axis=0).max())
        self.along = np.linspace(-reach, reach, ACROSS)  # m
        self.first = controller.convention.base(start)[0]
        top = float(self.first[2])
        self.above = top - self.line(self.first[None, :2], np.zeros(1), top)[0][0]

    def line(self, target: Array, yaw: Array, top: float) -> tuple[Array, Array]:
        """Height (N,) m and slope (N,) along the headings (N,) rad of the ground under places
        (N, 2) m, as seen from a height of ``top`` m."""
        ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
        flat = (target + self.along[:, None, None] * ahead).reshape(-1, 2)
        points = np.column_stack([flat, np.full(len(flat), top)])
        heights = self.world.below(points).reshape(ACROSS, len(target))
        return heights.mean(axis=0), self.along @ heights / (self.along @ self.along)


class VelocityCommand:
    """A reference generator (``guide``) for the locomotion preset: speed ahead, sideways, turning,
    integrated by a reference governor: never far ahead of the robot.

    Attributes
    ----------
    velocity: (2,) m/s, ahead and to the left. yaw_rate: rad/s. May be changed at any time.
    acceleration: m/s² and rad/s², with which the command that is followed goes there.
    feel: on a plane, whether the plan's ground is the plane through the places where the feet stood
        last: for a robot that does not know the ground.
    """

    def __init__(
        self,
        velocity: Sequence[float] = (0.3, 0.0),
        yaw_rate: float = 0.0,
        acceleration: tuple[float, float] = ACCELERATION,
        feel: bool = False,
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
        self.feel = flag("feel", feel)
        self._of: tuple[Controller, _Over | None, Gait | None] | None = None  # who asked last
        self._footing: Footing | None = None

    def reset(self) -> None:
        """At the next call the command starts from rest, where the robot is then."""
        self._time, self._footing = np.nan, None

    def __call__(self, controller: Controller, t: float, x: Array) -> None:
        if self._of is None or self._of[0] is not controller:
            self._of, self._footing = (controller, *_helpers(controller)), None
        _, over, gait = self._of
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
        if over is not None:
            self._follow_the_world(controller, over, target, (yaw, float(origin[2])))
        else:
            if self.feel:
                self._footing = self._footing or Footing(controller, x)
                self._footing.take(controller, t, x)
            self._follow_the_slope(controller, velocity, target, yaw)
        if gait is not None:
            gait.write(controller, t, float(np.hypot(*self._now)) + abs(self._rate) * gait.length)
        controller.reference("BaseAngularVelocity", "velocity")[:, 2] = self._rate
        controller.reference("BaseOrientation", "roll_pitch_yaw")[:, 2] = yaw
        controller.reference("Position", "target")[:, :2] = target

    @staticmethod
    def _follow_the_world(
        controller: Controller, over: _Over, target: Array, base: tuple[Any, float]
    ) -> None:
        """Heights and pitch are those of the ground along the body at the command's places (N, 2);
        ``base``: its heading there (N,) rad, and how high it is now, m."""
        yaw, now = base
        heights, slope = over.line(target, yaw, now + over.length)
        controller.reference("BaseHeight", "height")[:, 0] = heights + over.above
        rise = np.gradient(heights, controller.dt)
        controller.reference("CenterOfMassVelocity", "velocity")[:, 2] = rise
        _pitch(controller, slope)

    def _follow_the_slope(
        self, controller: Controller, velocity: Array, target: Array, yaw: Any
    ) -> None:
        """On a slope they rise with it; on one that is felt the body leans with it too, at headings
        (N,) rad."""
        names, p = controller.problem.dynamics.layout.names, controller.compiled.p[0]
        plane = plane_of(dict(zip(names, p.tolist(), strict=True)))
        if plane is None:
            return
        normal, height = plane
        rise = -normal[:2] / normal[2]
        if not (rise.any() or self.feel):
            return
        start = controller.convention.base(controller.problem.start)[0]
        above = start[2] - (controller.first_ground + rise @ start[:2])
        controller.reference("BaseHeight", "height")[:, 0] = height + target @ rise + above
        controller.reference("CenterOfMassVelocity", "velocity")[:, 2] = velocity @ rise
        if self.feel:
            _pitch(controller, np.stack([np.cos(yaw), np.sin(yaw)], axis=1) @ rise)

    def _advance(self, seconds: float) -> None:
        """The command that is followed, and where it has led."""
        self._now = _toward(self._now, self.velocity - self._now, self.acceleration[0] * seconds)
        most = self.acceleration[1] * seconds
        self._rate += min(max(self.yaw_rate - self._rate, -most), most)
        self._place = self._place + seconds * _turned(self._now, self._yaw)
        self._yaw += seconds * self._rate


def _helpers(controller: Controller) -> tuple[_Over | None, Gait | None]:
    """What a controller's problem needs beside its velocity: on a world, and with a gait."""
    problem = controller.problem
    dynamics, gait = problem.dynamics, None
    if any(isinstance(term, FootHeightTracking) for term in problem.costs):
        gait = Gait(controller.robot, problem.start, problem.length)
    if isinstance(dynamics, RobotDynamics) and isinstance(dynamics.terrain, World):
        return _Over(controller, dynamics.terrain), gait
    return None, gait


def _pitch(controller: Controller, slope: Array) -> None:
    """Lean the body (N,) with the ground along it."""
    controller.reference("BaseOrientation", "roll_pitch_yaw")[:, 1] = -PITCH * np.arctan(slope)


def _toward(value: Array, change: Array, most: float) -> Array:
    """``value`` + ``change``, no further than ``most``."""
    return np.asarray(value + change * min(1.0, most / max(float(np.hypot(*change)), 1e-12)))


def _turned(velocity: Array, yaw: Any) -> Array:
    """(…, 2) ``velocity`` (2,) turned by ``yaw`` (…) rad."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack([c * velocity[0] - s * velocity[1], s * velocity[0] + c * velocity[1]], axis=-1)


__all__ = ["VelocityCommand", "foot_law", "walking_problem"]
