"""A motion on level ground laid over a world: a first guess of the motion there.

Every stance gets a foothold, the nearest place on which the whole foot can stand; between two of
them a foot goes as a taut string over what is in its way, as high above that as it swung over level
ground; the base is lifted and tilted as the ground under the feet is, in the mean. Joints follow by
inverse kinematics.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from octo.checks import Array
from octo.model.character import Character
from octo.model.feet import CARRYING, stances
from octo.model.kinematics import sphere_centers
from octo.model.terrain import World
from octo.result.solution import Solution

Indices = NDArray[np.intp]

GRID = 0.05  # ℓ, from one place that is looked at to the next
FARTHEST = 1.0  # ℓ, of a foothold from where the foot stood
MARGIN = 0.1  # ℓ, beyond its radius, around a foot that is to be as high as where it stands
# what a place costs, beside the square of the way there: the squares of how uneven it is and of how
# much higher or lower than the last foothold. So the floor of a gap is no foothold, and a tread is
UNEVEN, OTHER = 30.0, 0.25
AROUND = 8  # points on the rim of a place
SMOOTH = 0.15  # s, over which the base follows the feet
ROUNDS, PASSES = 3, 4  # of the base's way, and of inverse kinematics in each
SMALL = 1e-6  # rad or m, of differences
LEAP = 0.3  # rad or m, of a coordinate in one pass
JOINTS, BASE = 1e-3, 0.1  # ℓ², what keeps joints and the base where they were


@dataclass(frozen=True, eq=False)
class Laid:
    """A motion over level ground of height ``level`` m, and the world that it is laid over."""

    motion: Solution
    world: World
    level: float

    @property
    def robot(self) -> Character:
        robot = self.motion.character
        assert robot is not None
        return robot

    @cached_property
    def feet(self) -> list[int]:
        """Contacts that carry the robot."""
        motion = self.motion
        carrying = motion.normal_force.mean(axis=0) >= CARRYING * motion.weight
        own = np.flatnonzero(carrying & motion.own_contacts)
        return [self.robot.terrain_contacts[k] for k in own]

    @cached_property
    def standing(self) -> Array:
        """(N+1, feet) whether each stands."""
        contacts = list(self.robot.terrain_contacts)
        rows = [contacts.index(k) for k in self.feet]
        on = stances(self.motion.normal_force[:, rows], self.motion.weight)
        return np.concatenate([on[:1], on])

    def nodes(self) -> Array:
        """(N+1, nx) the configurations x_0 … x_N."""
        robot, feet, nodes = self.robot, self.feet, self.motion.x[1:].copy()
        centers = sphere_centers(robot, nodes)[:, feet]
        moved = np.stack([self._moved(k, centers[:, k]) for k in range(len(feet))], axis=1)
        targets, width = centers + moved, SMOOTH / self.motion.dt
        first, joints = robot.base_coordinate, robot.actuated
        nodes[:, first : first + 3] += gaussian_filter1d(moved.mean(axis=1), width, axis=0)
        base = first + np.array([0, 1, 2, 4, 5])  # all but its heading
        damping = self.motion.length**2 * np.repeat([JOINTS, BASE], [len(joints), len(base)])
        for _ in range(ROUNDS):  # the base goes where the feet can be reached, but smoothly
            free = reached(robot, nodes, feet, targets, np.append(joints, base), damping)
            nodes[:, base] += gaussian_filter1d(free[:, base] - nodes[:, base], width, axis=0)
            nodes[:, joints] = free[:, joints]
        return reached(robot, nodes, feet, targets, joints, damping[: len(joints)])

    def _moved(self, foot: int, centers: Array) -> Array:
        """(N+1, 3) m, by which a foot with these centres (N+1, 3) is moved."""
        on, last, moved = self.standing[:, foot], len(centers), np.zeros_like(centers)
        flips = (np.flatnonzero(on[1:] != on[:-1]) + 1).tolist()
        parts = [(a, b) for a, b in pairwise([0, *flips, last]) if on[a]]
        if not parts:
            return moved
        radius, height = self.robot.contacts[self.feet[foot]].radius, self.level
        for a, b in parts:
            place, shift = centers[a:b, :2].mean(axis=0), np.zeros(2)
            if a == 0 or b == last:  # where it is at rest it stays
                height = float(self._ground(place[None], height, 0.0)[0, 0])
            else:
                shift, height = self._foothold(place, height, radius)
            moved[a:b] = [*shift, height - self.level]
        for (_, a), (b, _) in pairwise(parts):
            self._swing(moved[a - 1 : b + 1], centers[a - 1 : b + 1], radius)
        moved[: parts[0][0]], moved[parts[-1][1] :] = moved[parts[0][0]], moved[parts[-1][1] - 1]
        return moved

    def _swing(self, moved: Array, centers: Array, radius: float) -> None:
        """Fill ``moved`` (k, 3) in between its first and its last row, at which the foot stands."""
        w = np.linspace(0.0, 1.0, len(moved))[:, None]
        part = 3.0 * w**2 - 2.0 * w**3
        moved[:, :2] = (1.0 - part) * moved[0, :2] + part * moved[-1, :2]
        ends = moved[[0, -1], 2] + self.level
        places = centers[:, :2] + moved[:, :2]
        ground = self._ground(places, float(ends.max()), radius).max(axis=1)
        ground[[0, -1]] = ends
        moved[:, 2] = taut(ground) - self.level

    def _foothold(self, place: Array, height: float, radius: float) -> tuple[Array, float]:
        """How far (2,) m beside a place a foot can stand that stood ``height`` m high, and how high
        it is there."""
        steps = np.arange(-FARTHEST, FARTHEST + 1e-9, GRID) * self.motion.length
        shifts = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
        ground = self._ground(place + shifts, height, radius)
        uneven = np.abs(ground[:, 1:] - ground[:, :1]).max(axis=1)
        cost = (shifts**2).sum(axis=1) + UNEVEN * uneven**2 + OTHER * (ground[:, 0] - height) ** 2
        best = int(np.argmin(cost))
        return shifts[best], float(ground[best, 0])

    def _ground(self, places: Array, height: float, radius: float) -> Array:
        """(k, 1 + AROUND) m, of the ground at places (k, 2) and on rims around feet there, seen
        from ℓ over ``height`` m."""
        length = self.motion.length
        turns = np.arange(AROUND) * 2.0 * np.pi / AROUND
        rim = (radius + MARGIN * length) * np.stack([np.cos(turns), np.sin(turns)], axis=1)
        flat = (places[:, None] + np.concatenate([np.zeros((1, 2)), rim])).reshape(-1, 2)
        found = self.world.below(np.column_stack([flat, np.full(len(flat), height + length)]))
        deepest = height - 10.0 * length  # where there is nothing
        return np.maximum(found, deepest).reshape(len(places), -1)


def reached(
    robot: Character, nodes: Array, feet: list[int], targets: Array, free: Indices, damping: Array
) -> Array:
    """Configurations (k, nx) whose coordinates ``free`` are moved until the contacts ``feet`` are
    at ``targets`` (k, feet, 3) m, as near as limits of joints let them: damped least squares.

    Parameters
    ----------
    damping: (free,) m² over rad² or m², what keeps each coordinate where it is in ``nodes``.
    """
    x, kept, lower, upper = nodes.copy(), np.diag(damping), robot.lower[free], robot.upper[free]
    for _ in range(PASSES):
        tried = np.repeat(x[:, None], len(free) + 1, axis=1)
        tried[:, np.arange(len(free)), free] += SMALL
        where = sphere_centers(robot, tried)[:, :, feet].reshape(*tried.shape[:2], -1)
        slope = (where[:, :-1] - where[:, -1:]) / SMALL  # (k, free, 3 feet)
        miss = targets.reshape(len(x), -1) - where[:, -1]
        push = (slope @ miss[..., None])[..., 0] + damping * (nodes - x)[:, free]
        stuck = (x[:, free] >= upper) & (push > 0.0) | (x[:, free] <= lower) & (push < 0.0)
        slope[stuck], push[stuck] = 0.0, 0.0
        change = np.linalg.solve(slope @ slope.swapaxes(1, 2) + kept, push[..., None])[..., 0]
        x[:, free] = np.clip(x[:, free] + np.clip(change, -LEAP, LEAP), lower, upper)
    return x


def taut(heights: Array) -> Array:
    """(k,) the least heights that are nowhere below ``heights`` (k,) and bend down alone: a taut
    string from the first to the last."""
    kept = [0]
    for k in range(1, len(heights)):
        while len(kept) > 1:
            i, j = kept[-2:]
            if (heights[j] - heights[i]) * (k - j) > (heights[k] - heights[j]) * (j - i):
                break
            kept.pop()
        kept.append(k)
    return np.interp(np.arange(len(heights)), kept, heights[kept])
