"""An object of a scene, where it is to be, and how the robot stands when it pushes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from octo.checks import Array, instance, numbers, positive
from octo.dynamics.laws import Coulomb, Smooth
from octo.dynamics.static_pose import balanced_pose
from octo.errors import ProblemError, UnknownNameError
from octo.model.character import Character
from octo.model.chart import Chart
from octo.model.charted import base_angles, charted
from octo.model.feet import lowest_contacts, toward
from octo.model.kinematics import body_poses, sphere_centers
from octo.model.quantities import GRAVITY
from octo.model.scene import Scene, is_ball
from octo.problem import scales

SPEED = 0.22  # √(gℓ), of the way: slow walks have short strides, which stay behind the object
TOES = 20  # steps of the joints in which the feet get to where they stand


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
        return is_ball(self.scene, self.scene.body_index(self.body))

    @property
    def chart(self) -> Chart:
        """Of the object's angles."""
        inner = self.scene.joints[self.first + 5].axis
        return "zxy" if abs(inner[1]) > 0.5 else "zyx"

    def _reach(self, direction: Array) -> float:
        """m, how far the object reaches from its middle along a unit vector (3,)."""
        b = self.scene.body_index(self.body)
        pose = self.scene.start_pose
        spheres = [(k, one) for k, one in enumerate(self.scene.contacts) if one.body == b]
        middle, centers = pose[self.first : self.first + 3], sphere_centers(self.scene, pose)
        return max(float((centers[k] - middle) @ direction) + one.radius for k, one in spheres)

    @cached_property
    def depth(self) -> float:
        """m, how far the object reaches from its middle to the side of the robot."""
        return self._reach(-np.append(self.way / np.linalg.norm(self.way), 0.0))

    @cached_property
    def tipping(self) -> float:
        """rad, tilted by which the object falls over forwards."""
        ahead = np.append(self.way / np.linalg.norm(self.way), 0.0)
        return float(np.arctan2(self._reach(ahead), self._reach(np.array([0.0, 0.0, -1.0]))))

    @property
    def mass(self) -> float:
        """kg, of the object."""
        return self.scene.bodies[self.scene.body_index(self.body)].mass

    @property
    def load(self) -> float:
        """N, what it takes to push the object: its friction; a ball rolls by itself."""
        return 0.0 if self.rolls else self.mu * self.mass * GRAVITY

    @cached_property
    def leaning(self) -> Array:
        """(nx,) the robot's balanced pose, its feet moved back by as much as the centre of pressure
        is moved by the force that the object's friction takes."""
        robot, pose = self.robot, balanced_pose(self.robot).copy()
        back = min(self.load / (robot.mass * GRAVITY), 0.5) * self.length
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
    the middle one is singular at a quarter turn. It begins unturned, for all balls are alike."""
    made = scene.character
    b = made.body_index(body)
    if not is_ball(made, b):
        return scene, made
    x, y = np.abs(place - made.start_pose[made.first_joint[b] :][:2])
    of = [k for k, own in enumerate(scene.objects) for one in own.bodies if one.parent < 0]
    ball, objects = of[made.objects.index(body)], list(scene.objects)
    turned = charted(objects[ball], "zxy" if x > y else "zyx")
    pose, angles = turned.start_pose.copy(), base_angles(turned)
    pose[angles] = [joint.reference for joint in turned.joints[angles]]
    objects[ball] = replace(turned, default_pose=pose)
    scene = replace(scene, objects=objects)
    return scene, scene.character
