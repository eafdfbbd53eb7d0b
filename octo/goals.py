"""What the command line asks for: as terms of E, and as one number that says how well."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np

from octo.checks import number, numbers, one_of
from octo.dynamics.static_pose import balanced_pose
from octo.errors import ProblemError, ShapeError, ValueRangeError
from octo.model.character import Character
from octo.model.kinematics import body_poses
from octo.problem import presets
from octo.problem.asked import Asked
from octo.problem.body_costs import BaseAngularVelocity, CenterOfMassVelocity
from octo.problem.costs import Cost
from octo.problem.joint_costs import Effort
from octo.problem.problem import Array
from octo.problem.scales import length
from octo.result.solution import Solution

LARGEST = 1e6  # m/s, rad/s or m
NEAR = 0.2  # m and rad, what the error of a place is in parts of: a tenth is 2 cm, or 1.1°
Kind = Literal["walk", "stride", "turn", "to", "jump", "up", "push", "stand"]
Preset = Literal["natural", "paper", "robot"]


@dataclass(frozen=True)
class Goal:
    """A goal by its name.

    Parameters
    ----------
    kind: "walk", "stride", "turn", "to", "jump", "up" (get up), "push" or "stand".
    speed: m/s (rad/s for turn, its sign the side).
    place: (3,) m, m and rad, where "to" ends: ahead, to the left and turned to the left; of "push"
        (2,) m, x and y in the world, where the body ends.
    distance: m, of a jump.
    height: m, of a jump's top.
    preset: the list of terms, "natural", "paper" or "robot".
    body: that is pushed.
    """

    kind: Kind = "walk"
    speed: float = 0.5
    distance: float = 0.5
    height: float = 0.2
    preset: Preset = field(default="paper")
    place: Sequence[float] = (1.0, 0.0, 0.0)
    body: str = ""

    def __post_init__(self) -> None:
        one_of("goal", self.kind, get_args(Kind))
        one_of("costs", self.preset, get_args(Preset))
        names = ("speed", "distance", "height")
        sizes = [(name, number(name, getattr(self, name))) for name in names]
        place = numbers("place", self.place)
        if self.kind == "push" and place.shape == (2,):
            place = np.append(place, 0.0)
        if place.shape != (3,):
            allowed = (
                "(2,): x and y in m" if self.kind == "push" else "(3,): x and y in m, yaw in rad"
            )
            raise ShapeError("place", place.shape, allowed)
        for name, value in [*sizes, *(("place", value) for value in place)]:
            if not abs(value) <= LARGEST:
                raise ValueRangeError(f"{name} is {value:g}, must be at most {LARGEST:g} in size")
        ahead, left, yaw = place.tolist()
        object.__setattr__(self, "place", (ahead, left, math.remainder(yaw, 2.0 * math.pi)))

    @property
    def velocity(self) -> tuple[float, float, float]:
        """m/s, wanted of the centre of mass."""
        along = {"walk": (self.speed, 0.0, 0.0), "stride": (0.0, self.speed, 0.0)}
        return along.get(self.kind, (0.0, 0.0, 0.0))

    def check(self, robot: Character) -> None:
        """Refuse what the robot cannot do.

        Raises
        ------
        ProblemError: no actuator, or no floating base to move.
        """
        if robot.nu == 0:
            allowed = "at least one joint must be actuated"
            raise ProblemError(f"robot {robot.name!r} has no actuator: {allowed}")
        if robot.base != "floating":
            fixed = f"robot {robot.name!r} is fixed: try base='floating'"
            raise ProblemError(f"goal {self.kind!r} needs a floating base, {fixed}")

    def costs(self, length: float = 0.3, times: Array | None = None) -> list[Cost]:
        """The terms of E, of a problem that no cycle and no fixed end tells how far to go.

        Parameters
        ----------
        length: m, of natural and robot. times: (N,) s, of robot.

        Raises
        ------
        ProblemError: a jump, whose terms go with its steps; a place, or getting up, which is no
            term.
        """
        if self.kind == "to":
            how = "octo.go_to finds the motion, as a fixed displacement of a Problem does"
            raise ProblemError(f"the goal 'to' is a place to end at and no term: {how}")
        if self.kind == "jump":
            how = "jump_problem of octo.jump describes one"
            raise ProblemError(f"the terms of a jump go with its steps: {how}")
        if self.kind == "push":
            how = "octo.push finds the motion"
            raise ProblemError(f"the goal 'push' is a place of an object and no term: {how}")
        if self.kind == "up":
            how = "octo.get_up finds the motion, from a pose that lies"
            raise ProblemError(f"the goal 'up' is a pose to end in and no term: {how}")
        yaw_rate = self.speed if self.kind == "turn" else 0.0
        terms = presets.paper(self.velocity)
        if self.preset == "natural":
            velocity = None if self.kind == "stand" else self.velocity
            terms = presets.natural(velocity, yaw_rate or None, length=length)
        elif self.preset == "robot":
            terms = presets.robot(self.velocity, yaw_rate, length=length, times=times)
        elif self.kind == "turn":
            turn = BaseAngularVelocity(velocity=(0.0, 0.0, self.speed), axes=(0.0, 0.0, 1.0))
            terms = [turn, CenterOfMassVelocity(weight=0.01), Effort()]
        return terms

    def asked(self, solution: Solution) -> Asked:
        """What the motion does and what was asked: mean yaw rate, distance and height of the top,
        or mean velocity (x, y)."""
        duration, name = solution.steps * solution.dt, f"goal {self.kind}"
        if self.kind == "turn":
            rate = (solution.yaw[-1] - solution.yaw[0]) / duration
            return Asked.of(name, "the base turns at", rate, self.speed, "rad/s")
        if self.kind == "to":
            what = "the base ends ahead, to the left and turned by"
            return Asked.of(name, what, self._ends(solution), self.place, "m and rad", NEAR)
        if self.kind == "up":
            return Asked.of(name, *_upright(solution), "m and rad", NEAR)
        if self.kind == "push":
            robot = solution.character
            assert robot is not None  # who has none has no goal
            found = body_poses(robot, solution.x[-1])[1][robot.body_index(self.body), :2]
            return Asked.of(name, f"{self.body} ends at", found, self.place[:2], "m", NEAR)
        moved = solution.com - solution.com[0]
        if self.kind == "jump":
            what = "the centre of mass ends ahead of its start and rises at its top by"
            reached = (moved[-1, 0], moved[:, 2].max())
            return Asked.of(name, what, reached, (self.distance, self.height), "m", each=True)
        axes = 3 if self.kind == "stand" else 2  # how far a walk rises is the ground's affair
        what, wanted = "the centre of mass moves at", self.velocity[:axes]
        return Asked.of(name, what, moved[-1, :axes] / duration, wanted, "m/s")

    def _ends(self, solution: Solution) -> Array:
        """(3,) m, m and rad: where the base ends, seen from where it began; turned by the angle
        nearest to the one that is wanted."""
        robot, yaw = solution.character, solution.yaw
        assert robot is not None  # who has none has no goal
        first, last = body_poses(robot, solution.x[[1, -1]])[1][:, robot.base_body]
        (x, y), c, s = (last - first)[:2], np.cos(yaw[0]), np.sin(yaw[0])
        off = math.remainder(yaw[-1] - yaw[0] - self.place[2], 2.0 * math.pi)
        return np.array([c * x + s * y, c * y - s * x, self.place[2] + off])

    def error(self, solution: Solution) -> float:
        """How far the motion is from the goal, in parts of it (0.1 is one tenth)."""
        return self.asked(solution).error

    def met(self, solution: Solution) -> bool:
        """Whether the motion misses the goal by a tenth of it at most."""
        return self.asked(solution).met

    def verdict(self, solution: Solution) -> str:
        """One line: whether the goal was met, what was asked, what came out, by how much it was
        missed."""
        return str(self.asked(solution))

    def said(self, solution: Solution) -> Solution:
        """The solution with this goal in place of what its terms ask for."""
        return replace(solution, asked=(self.asked(solution),))


def _upright(solution: Solution) -> tuple[str, Array, Array]:
    """How high the base ends over the lowest contact (m) and how far it is tilted (rad), in words
    and numbers (2,), and what both are in the balanced pose."""
    robot = solution.character
    assert robot is not None  # who has none has no goal
    poses = np.stack([solution.x[-1], balanced_pose(robot)])
    height = [length(robot, pose) for pose in poses]
    up = body_poses(robot, poses)[0][:, robot.base_body, 2]  # (2, 3) the world's up, seen from it
    tilt = np.arccos(np.clip(up[0] @ up[1], -1.0, 1.0))
    what = "the base ends over the lowest contact, and tilted, by"
    return what, np.array([height[0], tilt]), np.array([height[1], 0.0])
