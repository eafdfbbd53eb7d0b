"""A steady motion from rest to rest as it is described: its strides, how many, how fast."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from octo.checks import Array, positive, steps_in
from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.laws import ContactLaw
from octo.dynamics.static_pose import static_pose
from octo.errors import MirrorError
from octo.model.character import Character
from octo.model.feet import touching
from octo.model.mirror import mirror_of
from octo.model.terrain import Ground
from octo.problem import presets
from octo.problem.closure import along_arc, arc_to
from octo.problem.constraints import Constraint
from octo.problem.costs import Cost
from octo.problem.cycle import TIME_STEP, Cycle, usual_period
from octo.problem.hard import beside
from octo.problem.problem import Problem

PERIODS = (1.0, 1.25, 1.5)  # of the usual period of an animal of that size: what is tried
STARTS = 3  # of the cycle, for each period
BEGUN = 0.5  # of the stride's speed, the mean speed while it is entered or left
ENDS = 5.0  # √(ℓ/g), how long it is entered and left, and a stride at least: shorter ones stumble


@dataclass(frozen=True, eq=False)
class Journey:
    """A steady motion of ``velocity`` (2,) m/s in the body's axes and ``rate`` rad/s, begun from
    rest and ended at rest.
    """

    robot: Character
    velocity: tuple[float, float]
    rate: float
    seconds: float
    dt: float = TIME_STEP
    period: float | Sequence[float] | None = None  # s, of a stride; by default the robot's own
    starts: int = STARTS  # of the cycle, for each period
    seed: int = 0  # number of the first of them
    terrain: Ground | None = None
    law: ContactLaw | None = None
    pose: Array | None = None
    constraints: Sequence[Constraint] = ()  # what must hold in every piece of it

    @classmethod
    def to(
        cls,
        robot: Character,
        place: Sequence[float],
        seconds: float | None,
        speed: float,
        **given: Any,
    ) -> Journey:
        """The motion that ends at a place (x, y, yaw), m and rad, seen from where the robot stands.

        Parameters
        ----------
        seconds: s; None for what ``speed`` needs, m/s or rad/s of the strides.
        """
        turn, way = place[2], arc_to(np.array(place[:2]), place[2])
        time = max(float(np.hypot(*way)), abs(turn)) / speed  # s, of strides all the way

        def lasting(seconds: float) -> Journey:
            x, y = (way / seconds).tolist()
            return cls(robot, (x, y), turn / seconds, seconds, **given)

        if seconds is not None:
            return lasting(seconds)
        slow = lasting(max(time, given["dt"]))
        count = max(slow.periods())
        ends = slow.ends(count)
        least = (2 * ends + count) * slow.dt
        return lasting(slow.dt * np.ceil(max(time + ends * slow.dt, least) / slow.dt - 1e-9))

    @cached_property
    def priced(self) -> Journey:
        """The same with nothing that must hold: what has a limit is priced."""
        return replace(self, constraints=()) if self.constraints else self

    @property
    def steps(self) -> int:
        return max(1, steps_in(self.seconds, self.dt))

    @cached_property
    def whole(self) -> Problem:
        """The motion as one problem that begins at rest, without a cycle: natural terms, the speed
        and what must hold."""
        common: dict[str, Any] = {
            "terrain": self.terrain,
            "law": self.law,
            "costs": presets.natural(length=1.0),
        }
        pose: Any = "balanced" if self.pose is None else self.pose
        problem = Problem(self.robot, steps=self.steps, dt=self.dt, pose=pose, **common)
        held = [one.placed(problem.setting) for one in self.constraints]  # feet that stand at rest
        speed, rate = (*self.velocity, 0.0), self.rate or None
        costs = presets.natural(speed, rate, **self._body(problem))
        return problem.replace(costs=beside(held, costs), constraints=held)

    @cached_property
    def terms(self) -> list[Cost]:
        """Of problems whose ends say how far: natural terms alone."""
        return beside(self.whole.constraints, presets.natural(**self._body(self.whole)))

    @staticmethod
    def _body(problem: Problem) -> dict[str, Any]:
        """What the natural terms ask of the body that stands at rest, wherever they are used."""
        robot, dynamics = problem.character, problem.dynamics
        assert robot is not None and isinstance(dynamics, RobotDynamics)
        feet = touching(robot, dynamics.terrain, problem.setting.x0)
        names = tuple(robot.contacts[k].name for k in feet)
        return {"length": problem.length, "feet": names, "pose": problem.start}

    @cached_property
    def mirrored(self) -> bool:
        """Whether half a stride and its mirror image do: straight ahead, of a robot that has a
        mirror."""
        if self.rate != 0.0 or self.velocity[1] != 0.0:
            return False
        try:
            mirror_of(self.robot)
        except MirrorError:
            return False
        return True

    def periods(self) -> list[int]:
        """Steps of the strides that are tried."""
        own = self.period
        if own is None:
            length = self.whole.length
            usual = usual_period(length, float(np.hypot(*self.velocity)) + abs(self.rate) * length)
            own = [usual * part for part in PERIODS]
        wanted = [own] if isinstance(own, (int, float)) else list(own)
        grain = 2 if self.mirrored else 1
        counts = [positive("period", value, "s") / self.dt for value in wanted]
        return sorted({max(8, grain * round(count / grain)) for count in counts})

    def counts(self) -> list[int]:
        """Those of them that fit between rest and rest."""
        return [count for count in self.periods() if count + 2 * self.ends(count) <= self.steps]

    def ends(self, count: int) -> int:
        """Steps in which a stride of ``count`` steps is entered."""
        return max(count, round(ENDS * np.sqrt(self.whole.length / self.whole.gravity) / self.dt))

    def faster(self, count: int) -> float:
        """Speed of a stride of ``count`` steps over that of the whole motion, in which it is
        entered and left."""
        return self.steps / (self.steps - 2.0 * (1.0 - BEGUN) * self.ends(count))

    def cycle(self, count: int) -> Problem:
        """A stride of ``count`` steps."""
        period = count * self.dt
        speed, sideways, rate = (self.faster(count) * v for v in (*self.velocity, self.rate))
        way: Any = {"speed": speed, "sideways": sideways, "turn": rate * period}
        steady = Cycle(**way, period=period, mirror=self.mirrored)
        return self.whole.replace(steps=0, cycle=steady, costs=self.terms)

    def way(self) -> Array:
        """(nx,) from where the robot stands to where it stands after the motion."""
        robot, problem, duration = self.robot, self.whole, self.steps * self.dt
        assert isinstance(problem.dynamics, RobotDynamics)
        first, angle, moved = robot.base_coordinate, self.rate * duration, problem.start.copy()
        heading, velocity = float(moved[first + 3]), np.array(self.velocity)
        moved[first : first + 2] += along_arc(velocity, angle, duration, heading)
        moved[first + 3] += angle
        return static_pose(problem.dynamics, problem.p, moved) - problem.start
