"""A motion over a world of shapes: the one on level ground, carried along while the world rises
under it.

No stride repeats itself on stairs. So the motion is found where the robot stands, on level ground,
and the world comes up through that ground a little at a time, each time solved from the last
motion: what is higher than the robot's feet rises, and the level ground sinks until what is lower
shows. A stage goes as far as the feet can follow.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from octo.checks import Array
from octo.errors import StaticPoseError
from octo.model.character import Character
from octo.model.feet import terrain_bottoms
from octo.model.kinematics import sphere_centers
from octo.model.terrain import Plane, World
from octo.motions.budget import Budget, Interrupted, going_on
from octo.motions.journey import Journey
from octo.motions.path import ground_law
from octo.motions.transitions import SUMS
from octo.problem.problem import Problem
from octo.result.solution import Solution
from octo.solve import solve
from octo.solver.status import Status
from octo.world.shapes import Ground, Shape

LOG = logging.getLogger("octo")

FOLLOWED = 0.08  # ℓ, that the ground may move under a foot from one stage to the next
STAGES = 40  # at most
ITERATIONS = 150  # of a stage: it need not converge, the next one begins elsewhere
BLEND = 0.2  # ℓ, of shapes that still rise: corners are round until the world stands
SMOOTH = 0.15  # s, over which the base is lifted
NEAR = 0.03  # ℓ, of a contact over the ground that stands on it
DEEPEST = 2.0  # ℓ, that level ground sinks before it is taken away


def over(
    journey: Journey, world: World, budget: Budget, on_level: Callable[[Journey], Solution]
) -> Solution:
    """The motion of a journey over a world.

    Parameters
    ----------
    on_level: gives the motion of the same journey on level ground.
    """
    rise = Rise.under(journey, world)
    flat = on_level(replace(journey, terrain=Plane(height=rise.level)))
    if flat.status is Status.INTERRUPTED:
        return flat
    warn_of_its_end(world, journey.robot, flat)
    motion, part, spent = flat, 0.0, [flat]
    try:
        for stage in range(STAGES):
            reached = part
            part = rise.next(motion, part) if stage + 1 < STAGES else 1.0
            last = part == 1.0
            problem = _problem(journey if last else journey.priced, rise.at(part), flat)
            doing = f"over the world, {100 * part:.0f} % of it"
            # to its end with the contacts' curvature: without it the last stage of five steps
            # of 5 cm took 3,000 iterations and more, with it 1,836, to a lower E
            options = budget.left(doing) | {"passes": None} if last else budget.near(doing)
            if not last:
                options["max_iterations"] = ITERATIONS
            guess = rise.lifted(motion, reached, part)
            motion = going_on(solve(problem, start=guess, **options))
            spent.append(motion)
            LOG.info(
                "the world has risen to %.0f %%: %s after %d iterations",
                100.0 * part,
                motion.status,
                motion.iterations,
            )
            if last:
                if problem.displacement is None:
                    LOG.warning("the robot cannot stand where it was sent: its end is left free")
                break
    except Interrupted:
        return replace(motion, status=Status.INTERRUPTED)
    sums = {name: sum(getattr(one, name) for one in spent) for name in SUMS}
    return replace(motion, seed=flat.seed, starts=flat.starts, **sums)


def warn_of_its_end(world: World, robot: Character, motion: Solution) -> None:
    """Say where a motion leaves the shapes and maps of a world."""
    x, y, nodes = robot.base_coordinate, robot.base_coordinate + 1, motion.x[1:]
    places = np.column_stack([nodes[:, x], nodes[:, y], np.zeros(len(nodes))])
    outside = np.flatnonzero(np.logical_not(world.covers(places)))
    if len(outside):
        first = int(outside[0])
        LOG.warning(
            "the world ends under the motion: from %.2f s on, at x = %.2f m, y = %.2f m, it has no "
            "shape or map above or below the robot",
            *(first * motion.dt, *places[first, :2]),
        )


def _problem(journey: Journey, world: World, flat: Solution) -> Problem:
    """From rest to rest on a world, as stiff as the motion on level ground; where the robot cannot
    stand at the end, its end is free."""
    own = replace(journey, terrain=world)
    problem = own.whole.replace(parameters=ground_law(flat))
    try:
        return problem.replace(costs=own.terms, displacement=own.way())
    except StaticPoseError:
        return problem


@dataclass(frozen=True, eq=False)
class Rise:
    """A world that rises out of level ground.

    Attributes
    ----------
    level: m, of the ground. length: ℓ, m.
    """

    robot: Character
    world: World
    level: float
    length: float

    @classmethod
    def under(cls, journey: Journey, world: World) -> Rise:
        """Out of the level that the robot stands on."""
        problem = replace(journey, terrain=world).whole
        bottoms = terrain_bottoms(journey.robot, problem.start)
        return cls(journey.robot, world, float(bottoms.min()), problem.length)

    def at(self, part: float) -> World:
        """The world of which a part has risen, from 0 to 1."""
        if part >= 1.0:
            return self.world
        shapes: list[Shape] = [self._sunk(shape, part) for shape in self.world.shapes]
        sea = Ground(height=self.level - part**2 * DEEPEST * self.length)
        return World([*shapes, sea], max(self.world.blend, BLEND * self.length))

    def _sunk(self, shape: Shape, part: float) -> Shape:
        top = float(shape.bounds()[1, 2])
        if not np.isfinite(top) or top <= self.level:
            return shape
        down = np.array([0.0, 0.0, (1.0 - part) * (top - self.level)])
        return shape.moved(np.asarray(shape.position) - down, None)

    def next(self, motion: Solution, part: float) -> float:
        """How far the world may rise from ``part`` on for the feet to follow."""
        before = self._phi(motion, part)

        def followed(other: float) -> bool:
            """Whether the ground comes up under a foot, or moves under one that stands, by little
            beyond what the base is lifted."""
            lift, up, stands = self._lift(motion, before, other)
            beyond = up - lift[:, None]
            moved = float(np.where(stands, np.abs(beyond), beyond).max(initial=0.0))
            return moved <= FOLLOWED * self.length

        if followed(1.0):
            return 1.0
        low, high = part, 1.0
        for _ in range(12):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if followed(middle) else (low, middle)
        return max(low, part + 1e-3)

    def lifted(self, motion: Solution, reached: float, part: float) -> Array:
        """The nodes x_0 … x_N (N+1, nx) of a motion, its base moved up with the ground."""
        nodes = motion.x[1:].copy()
        before = self._phi(motion, reached)
        nodes[:, self.robot.base_coordinate + 2] += self._lift(motion, before, part)[0]
        return nodes

    def _phi(self, motion: Solution, part: float) -> Array:
        """(N+1, contacts) m between the centres of the contacts of a motion and the world of which
        a part has risen."""
        robot, own = self.robot, list(self.robot.terrain_contacts)
        centers = sphere_centers(robot, motion.x[1:])[:, own]
        phi = self.at(part).distance(centers.reshape(-1, 3)).reshape(centers.shape[:2])
        return phi

    def _lift(self, motion: Solution, before: Array, part: float) -> tuple[Array, Array, Array]:
        """How far the base is lifted (N+1,) m; how far the ground comes up under each contact
        (N+1, contacts) m, and which of them stand on it; ``before``: :meth:`_phi` then."""
        robot = self.robot
        above = before - np.array([robot.contacts[k].radius for k in robot.terrain_contacts])
        stands = above < NEAR * self.length
        up = np.where(above < self.length, before - self._phi(motion, part), 0.0)
        # where some stand, as those do; all others must only not be buried
        most = np.where(stands, up, -np.inf).max(axis=1)
        known = np.isfinite(most)
        most = np.interp(np.arange(len(most)), np.flatnonzero(known), most[known])
        width = SMOOTH / motion.dt
        lift = gaussian_filter1d(maximum_filter1d(most, max(1, round(width))), width)
        return lift, up, np.asarray(stands)
