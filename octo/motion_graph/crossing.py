"""The problem of a transition (§8.6): from a moment of one motion to a moment of another, both ends
fixed, and where the second one stands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array
from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.laws import ContactLaw
from octo.errors import ProblemError
from octo.model.character import Character
from octo.model.tree import Tree
from octo.motion_graph.neighbours import apart
from octo.motion_graph.similarity import Alignment, aligned, points_of, windows
from octo.motions.path import blend, ground_law
from octo.problem.constraints import Constraint
from octo.problem.costs import Cost
from octo.problem.hard import beside, standing
from octo.problem.joint_costs import Effort
from octo.problem.problem import Problem
from octo.replay.plan import ground_of
from octo.result.solution import Solution
from octo.solve import evaluated
from octo.solver.status import Status

Steps = NDArray[np.intp]
Cloud = Callable[[Tree, Array], Array]
SAME = 1e-9  # relative, of time steps and of the numbers of a contact law
LEVEL = 1e-6  # rad, of a plane


@dataclass(frozen=True)
class Placement:
    """Where a motion is laid: turned by ``yaw`` rad about z, then carried by ``shift`` (2,) m."""

    yaw: float
    shift: Array

    def moved(self, x: Array, first: int) -> Array:
        """Configurations (…, nx) of a floating base whose coordinates begin at ``first``."""
        made, ground = x.copy(), slice(first, first + 2)
        made[..., ground] = self._laid(x[..., ground])
        made[..., first + 3] += self.yaw
        return made

    @property
    def back(self) -> Placement:
        """The way back."""
        turned = Placement(-self.yaw, np.zeros(2))
        return Placement(-self.yaw, -turned._laid(self.shift))

    def then(self, other: Placement) -> Placement:
        """Where what lies at ``other`` of a motion is that lies here."""
        return Placement(self.yaw + other.yaw, self._laid(other.shift))

    def turned(self, vectors: Array) -> Array:
        """Vectors (…, 3) of the motion."""
        turn = Placement(self.yaw, np.zeros(2))
        return np.concatenate([turn._laid(vectors[..., :2]), vectors[..., 2:]], axis=-1)

    def _laid(self, ground: Array) -> Array:
        """Places (…, 2) m of the motion."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        return np.asarray(ground @ np.array([[c, s], [-s, c]]) + self.shift)


HERE = Placement(0.0, np.zeros(2))


def stands(x: Array, base: int) -> Placement:
    """Where a robot at x (nx,) stands and heads."""
    return Placement(float(x[base + 3]), x[base : base + 2])


@dataclass(frozen=True, eq=False)
class Crossing:
    """What all transitions between two motions share.

    Attributes
    ----------
    one, other: the motions; of the same robot, on the same level ground, with the same law and dt.
    steps: of a transition. costs, constraints: of its problem. law: of contact, as a Problem's.
    window: steps over which moments are compared, from one that is left and to one that is reached;
        by default those of a transition.
    cloud: (…, points, 3) m of a robot at x (…, nx), the points that are compared.
    """

    one: Solution
    other: Solution
    steps: int
    costs: Sequence[Cost]
    constraints: Sequence[Constraint] = ()
    law: ContactLaw | None = None
    window: int | None = None
    cloud: Cloud = points_of

    def __post_init__(self) -> None:
        check_alike(self.one, self.other)
        check_one_law(self.one, self.other)

    @property
    def robot(self) -> Character:
        robot = self.one.character
        assert robot is not None
        return robot

    @cached_property
    def dynamics(self) -> RobotDynamics:
        """Of all problems: what is generated of one of them is that of all."""
        return RobotDynamics(self.robot, self.law, ground_of(self.one))

    @cached_property
    def limits(self) -> list[Constraint]:
        """The constraints, as they are meant of the robot that stands; once they are made they are
        sent to other processes with the rest."""
        rest = Problem(self.robot, steps=3, dt=self.one.dt, costs=self.costs, law=self.law)
        return [standing(own.placed(rest.setting), rest.start) for own in self.constraints]

    def similarity(self, every: int = 1, held: bool = False) -> tuple[Alignment, Steps, Steps]:
        """How alike the two are around each pair of moments, and which these are, steps of the one
        and of the other, ``every`` so many: (a, b) of moments (a,) and (b,).

        Parameters
        ----------
        held: also moments so near to an end that a motion is held still while it is crossed.
        """
        clouds, moments = [], []
        length = (self.steps if self.window is None else self.window) + 1
        for motion, leads in ((self.one, False), (self.other, True)):
            own = np.arange(0, motion.steps + 1, every)
            if held:
                own = own[own < motion.steps]
            else:
                own = own[own >= self.steps] if leads else own[own <= motion.steps - self.steps]
            points = self.cloud(self.robot, motion.x[1:])
            clouds.append(windows(points, own, length, -1 if leads else 1))
            moments.append(own)
        return aligned(*clouds), moments[0], moments[1]

    def apart(self, moments: Steps, leads: bool) -> Array:
        """(m, m) rms, how far what is crossed is apart, of moments (m,) at which the second motion
        is reached, where the transition ``leads`` there, or the first one left; wherever they
        stand and head."""
        motion, back = (self.other, self.steps) if leads else (self.one, 0)
        base, made = self.robot.base_coordinate, []
        for step in moments:
            x = nodes_of(motion, int(step) - back, self.steps)
            made.append(stands(x[0], base).back.moved(x, base))
        return apart(np.stack(made))

    def placed(self, at: int, to: int) -> tuple[Alignment, Placement]:
        """Where the second motion stands when step ``at`` of the first is left for step ``to``."""
        spans = (
            nodes_of(self.one, at, self.steps),
            nodes_of(self.other, to - self.steps, self.steps),
        )
        found = aligned(*(self.cloud(self.robot, x)[None] for x in spans))
        heading = self.robot.base_coordinate + 3
        # of headings that count whole turns the one next to that which is there
        off = float(found.yaw[0, 0] + (spans[1] - spans[0])[:, heading].mean())
        yaw = float(found.yaw[0, 0]) - 2.0 * np.pi * round(off / (2.0 * np.pi))
        return found, Placement(yaw, found.shift[0, 0])

    def begins(self, at: int) -> Placement:
        """Where the first motion stands at step ``at``."""
        return stands(nodes_of(self.one, at, 0)[0], self.robot.base_coordinate)

    def problem(
        self, at: int, to: int, placed: Placement, begins: Placement = HERE
    ) -> tuple[Problem, Array]:
        """From step ``at`` of the first motion to step ``to`` of the second, and a first guess
        (steps + 1, nx): the one blended into the other; as seen from where it ``begins``."""
        base, dt = self.robot.base_coordinate, self.one.dt
        before = nodes_of(self.one, at - 1, self.steps + 1)
        after = placed.moved(nodes_of(self.other, to - self.steps - 1, self.steps + 1), base)
        before, after = (begins.back.moved(x, base) for x in (before, after))
        problem = Problem(
            self.dynamics,
            steps=self.steps,
            dt=dt,
            costs=beside(self.constraints, self.costs),
            constraints=self.limits,
            x0=before[1],
            v0=(before[1] - before[0]) / dt,
            x_end=after[-1],
            v_end=(after[-1] - after[-2]) / dt,
            parameters=ground_law(self.one),
        )
        guess = blend(before[1:], after[1:])
        guess[-2] = after[-2]
        return problem, guess


def laid_end_to_end(x: Array, motion: Solution, law: ContactLaw | None = None) -> Solution:
    """x_{-1} … x_N (N+2, nx) of pieces of motions, whose ground and law are those of ``motion``,
    evaluated as one motion: its ‖C‖∞ is that of its parts."""
    robot = motion.character
    assert robot is not None
    problem = Problem(
        robot,
        steps=len(x) - 2,
        dt=motion.dt,
        costs=[Effort()],
        terrain=ground_of(motion),
        law=law,
        x0=x[1],
        v0=(x[1] - x[0]) / motion.dt,
        parameters=ground_law(motion),
    )
    return evaluated(problem, x[1:], Status.JOINED)


def nodes_of(motion: Solution, first: int, steps: int) -> Array:
    """(steps + 1, nx) x_first …; x_{-1} before a motion, x_N behind it."""
    at = np.clip(np.arange(first, first + steps + 1), -1, motion.steps)
    return np.asarray(motion.x[at + 1])


def check_alike(one: Solution, other: Solution) -> None:
    """Raises
    ------
    ProblemError: from the one to the other there is no transition: names what differs."""
    for motion in (one, other):
        robot = motion.character
        if robot is None or robot.base != "floating" or robot.objects:
            raise ProblemError(
                f"a motion is of {motion.name}, must be of one robot with a floating base"
            )
        ground = ground_of(motion)
        if motion.world is not None or abs(getattr(ground, "slope", 0.0)) > LEVEL:
            raise ProblemError(
                f"a motion of {motion.name} is on another ground than a level plane: it cannot be "
                "laid elsewhere"
            )
    a, b = one.character, other.character
    assert a is not None and b is not None
    if a.name != b.name or a.nx != b.nx or a.chart != b.chart:
        raise ProblemError(f"the motions are of {a.name} and of {b.name}, must be of one robot")
    if abs(one.dt - other.dt) > SAME * one.dt:
        raise ProblemError(f"dt is {one.dt:g} s of the one motion, {other.dt:g} s of the other")


def check_one_law(one: Solution, other: Solution) -> None:
    """Raises
    ------
    ProblemError: the motions have other numbers of a contact law: names what differs."""
    law, its = ground_law(one), ground_law(other)
    for name in sorted({*law, *its}):
        first, second = law.get(name), its.get(name)
        if first is None or second is None or abs(first - second) > SAME * max(abs(first), 1.0):
            raise ProblemError(f"{name} is {first} of the one motion, {second} of the other")
