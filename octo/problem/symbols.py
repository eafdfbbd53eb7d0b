"""What a cost may look at: the symbols of one time step, of one contact, and the setting of a
problem."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from octo.checks import Array
from octo.dynamics import symbolic
from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.laws import ContactLaw
from octo.dynamics.symbolic import Pose
from octo.errors import ProblemError
from octo.model.character import Character
from octo.model.feet import touching
from octo.model.kinematics import body_poses, center_of_mass
from octo.model.quantities import GRAVITY
from octo.model.terrain import ADDRESS, Ground, World, looked
from octo.problem.calls import Call
from octo.problem.code_stage import CodeStage
from octo.problem.look_up import look_up
from octo.world.jet import SIZES

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Setting:
    """The numbers a cost's references and scales may depend on; they do not change during a
    solve."""

    nx: int  # coordinates
    actuated: NDArray[np.intp]  # (nu,) indices into x
    steps: int  # N
    dt: float  # s
    x0: Array  # (nx,) the start
    torque_limit: Array  # (nu,)
    torque_reference: float  # N m, u_ref of the effort (Problem.torque_reference)
    character: Character | None  # None for user-written dynamics
    terrain: Ground | None = None  # the same
    names: tuple[str, ...] | None = None  # (nx,) of the coordinates, where there is no character

    @cached_property
    def feet(self) -> list[int]:
        """Contacts that touch the ground at the start."""
        robot = self._robot("a contact")
        assert self.terrain is not None
        return touching(robot, self.terrain, self.x0)

    @cached_property
    def com(self) -> Array:
        """(3,) m, centre of mass at the start."""
        return center_of_mass(self._robot("the centre of mass"), self.x0)

    def point(self, body: str | None, local: Array) -> Array:
        """(3,) m, world position at the start of a point of a body."""
        robot = self._robot("a point of a body")
        rotation, position = (part[_body(robot, body)] for part in body_poses(robot, self.x0))
        return np.asarray(rotation @ local + position)

    def up(self, body: str | None, pose: Array) -> Array:
        """(3,) the world's up in the axes of a body, in a pose (nx,)."""
        robot = self._robot("the tilt of a body")
        return np.asarray(body_poses(robot, pose)[0][_body(robot, body)][2])

    def _robot(self, what: str) -> Character:
        if self.character is None:
            raise ProblemError(
                f"{what} is asked of user-written dynamics, which have no bodies: use a CustomCost"
            )
        return self.character


@dataclass(frozen=True, eq=False)
class StepSymbols:
    """One time step: residual i looks at x_{i+1} (``x_next``), x_i (``x``), x_{i−1} (``x_prev``)
    and u_i."""

    x_next: ca.SX  # (nx,)
    x: ca.SX  # (nx,)
    x_prev: ca.SX  # (nx,)
    u: ca.SX  # (nu,)
    dynamics: dict[str, ca.SX]  # the run-time parameters of FD by name
    actuated: NDArray[np.intp]  # (nu,) indices into x
    robot: RobotDynamics | None  # None for user-written dynamics
    calls: list[Call] = field(default_factory=list)  # of stages of code, so far

    def call(self, stage: CodeStage, argument: ca.SX) -> ca.SX:
        """The values (outputs,) of a stage that is code, at an argument made of this step's symbols
        and of values of other calls.

        Parameters
        ----------
        stage: what is called. argument: (inputs,).

        Raises
        ------
        ProblemError, ShapeError: it is no :class:`octo.CodeStage`, or takes another number of
            arguments.
        """
        self.calls.append(Call.of(stage, argument, len(self.calls)))
        return self.calls[-1].value

    @property
    def character(self) -> Character | None:
        return None if self.robot is None else self.robot.character

    @property
    def dt(self) -> ca.SX:
        return self.dynamics["dt"]

    def _robot(self) -> Character:
        if self.character is None:
            raise ProblemError(
                "user-written dynamics have no bodies: use a CustomCost over x_next, x, x_prev, u"
            )
        return self.character

    def joints(self, x: ca.SX) -> ca.SX:
        """The actuated entries (nu,) of a configuration."""
        return x[[int(j) for j in self.actuated]]

    @cached_property
    def com(self) -> ca.SX:
        """Centre of mass (3,) m at x_next."""
        return symbolic.center_of_mass(self._robot(), self.x_next)

    @cached_property
    def com_velocity(self) -> ca.SX:
        """(com(x_next) − com(x))/dt (3,) m/s, as in Eq. 17."""
        return (self.com - symbolic.center_of_mass(self._robot(), self.x)) / self.dt

    @cached_property
    def _poses(self) -> list[Pose]:
        return symbolic.body_poses(self._robot(), self.x_next)

    @cached_property
    def _poses_before(self) -> list[Pose]:
        return symbolic.body_poses(self._robot(), self.x)

    def pose(self, body: str | None = None) -> Pose:
        """Rotation and position of a body (the base by default) at x_next."""
        return self._poses[_body(self._robot(), body)]

    def pose_before(self, body: str | None = None) -> Pose:
        """Rotation and position of a body (the base by default) at x."""
        return self._poses_before[_body(self._robot(), body)]

    @cached_property
    def _poses_earlier(self) -> list[Pose]:
        return symbolic.body_poses(self._robot(), self.x_prev)

    def contact(self, name: str) -> ContactSymbols:
        """A contact of the robot, by name: heights, velocities and forces, for a term over several
        of them.

        Raises
        ------
        UnknownNameError: there is none of this name. ProblemError: user-written dynamics.
        """
        character = self._robot()
        assert self.robot is not None
        sphere = character.contacts[character.contact_index(name)]
        next_, now, previous = (
            poses[sphere.body] for poses in (self._poses, self._poses_before, self._poses_earlier)
        )
        position = ca.SX(ca.DM(sphere.position))
        radius = ca.SX(sphere.radius)
        terrain, poses = self.robot.terrain, (next_, now, previous)
        seen: Sequence[Mapping[str, ca.SX]] = (self.dynamics, self.dynamics)
        if isinstance(terrain, World):
            seen = Lazy([partial(self._looked, position, pose) for pose in poses[:2]])

        def place(k: int) -> tuple[ca.SX, ca.SX]:
            center, before = symbolic.contact_places(
                position, radius, poses[k], poses[k + 1], terrain, seen[k]
            )
            return seen[k].get("terrain.at", center), before

        places = Lazy([partial(place, k) for k in range(2)])
        law, weight = self.robot.law, character.mass * GRAVITY
        return ContactSymbols(poses, places, radius, law, terrain, self.dynamics, weight, seen)

    def _looked(self, position: ca.SX, pose: Pose) -> dict[str, ca.SX]:
        """The parameters, with what the world says at a point (3,) m of a body at ``pose``."""
        center = pose[0] @ position + pose[1]
        value = self.call(look_up(), ca.vertcat(center, self.dynamics[ADDRESS]))
        return looked(self.dynamics, ca.vertcat(value, ca.SX(SIZES[-1] - SIZES[1], 1)), center)


def _body(robot: Character, name: str | None) -> int:
    return robot.base_body if name is None else robot.body_index(name)


class Lazy(Sequence[T]):
    """Values that are made when they are first asked for: a look-up that no term asks for is not
    made."""

    def __init__(self, makers: Sequence[Callable[[], T]]):
        self._makers: Sequence[Callable[[], T]] = makers
        self._made: dict[int, T] = {}

    def __len__(self) -> int:
        return len(self._makers)

    def __getitem__(self, k: Any) -> Any:
        if k not in self._made:
            self._made[k] = self._makers[k]()
        return self._made[k]


@dataclass(frozen=True, eq=False)
class ContactSymbols:
    """One contact sphere in one time step; forces in units of the weight mg."""

    poses: tuple[Pose, Pose, Pose]  # of its body at x_next, x, x_prev
    # of contact_places: of this step, and of the one before
    places: Sequence[tuple[ca.SX, ca.SX]]
    radius: ca.SX  # m
    law: ContactLaw  # of the problem
    terrain: Ground  # of the problem
    dynamics: dict[str, ca.SX]  # the run-time parameters of FD by name
    weight: float  # N, mg
    # the same parameters in this step and in the one before, with what a world says there
    seen: Sequence[Mapping[str, ca.SX]]

    def call(self, stage: object, argument: ca.SX) -> ca.SX:
        """Stages of code are called by terms over a step alone: take ``step.contact(name)`` there.

        Raises
        ------
        ProblemError: always.
        """
        raise ProblemError(
            "a term over contacts cannot call a stage of code: write an octo.Cost, in which "
            "step.contact(name) has the same as a contact here"
        )

    def _state(self, step: int) -> symbolic.ContactState:
        return symbolic.contact_state(
            *self.places[step], self.radius, self.law, self.terrain, self.seen[step]
        )

    @cached_property
    def _now(self) -> symbolic.ContactState:
        return self._state(0)

    @property
    def height(self) -> ca.SX:
        """m, of the sphere's lowest point above the terrain."""
        return -self._now.depth

    @property
    def normal(self) -> ca.SX:
        """(3,) outward normal of the terrain."""
        return self._now.normal

    @property
    def velocity(self) -> ca.SX:
        """(3,) m/s, of the material point at the contact (Eq. 4)."""
        return self._now.velocity

    @property
    def tangential_velocity(self) -> ca.SX:
        return self.velocity - self.normal * ca.dot(self.normal, self.velocity)

    @property
    def force(self) -> ca.SX:
        """(3,) of mg, on the body."""
        return self._now.force / self.weight

    @property
    def normal_force(self) -> ca.SX:
        return ca.dot(self.normal, self.force)

    @property
    def tangential_force(self) -> ca.SX:
        return self.force - self.normal * self.normal_force

    @cached_property
    def force_before(self) -> ca.SX:
        """(3,) of mg, one step earlier (from x and x_prev)."""
        return self._state(1).force / self.weight
