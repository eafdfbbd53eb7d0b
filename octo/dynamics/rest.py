"""Where the objects of a scene rest, with the robot held: what a static start begins with."""

from __future__ import annotations

import numpy as np

from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.simulate import Stepper
from octo.model.character import Array, Character
from octo.model.kinematics import body_poses

NEAR = 0.02  # m, that an object may be from where it rests; another one is in the air, or slides
FIRST, LONGEST, GROWTH = 0.005, 1.0, 1.5  # s, of the steps from rest
STEPS = 60
STILL = 1e-9  # m and rad, that a long step changes of what rests


def at_rest(dynamics: RobotDynamics, p: Array, x: Array) -> Array:
    """x (nx,) with each object where its contacts carry it.

    Only objects within 2 cm of such a place are moved; one that stands on nothing stays where it
    was put, and falls from there when the motion begins.

    Parameters
    ----------
    p: (NP,) the parameters of the dynamics.
    """
    robot = dynamics.character
    resting = list(robot.objects)
    while resting:
        moved = _settled(dynamics, p, x, resting)
        gone = [name for name in resting if _way(robot, name, x, moved) > NEAR]
        if not gone:
            return moved
        resting = [name for name in resting if name not in gone]
    return x


def _settled(dynamics: RobotDynamics, p: Array, x: Array, names: list[str]) -> Array:
    """Implicit steps of the named objects from rest, ever longer: that damps what they do. Ends
    where one has gone too far."""
    robot = dynamics.character
    free = np.array([j for name in names for j in coordinates(robot, name)], dtype=np.intp)
    place, start, duration = dynamics.layout.index("dt"), x, FIRST
    if not len(free):
        return x
    for _ in range(STEPS):
        own = p.copy()
        own[place] = duration
        moved, left = Stepper(dynamics, own, free)(x, x)
        if not left < 1e-6:
            duration *= 0.3
            continue
        change, x = float(np.max(np.abs(moved - x))), moved
        far = max(_way(robot, name, start, x) for name in names)
        if far > NEAR or (duration >= LONGEST and change < STILL):
            break
        duration = min(GROWTH * duration, LONGEST)
    return x


def coordinates(robot: Character, name: str) -> list[int]:
    """Indices into x of the coordinates of an object, by the name of its first body."""
    root = robot.body_index(name)
    inside = [False] * len(robot.bodies)
    found: list[int] = []
    for b, body in enumerate(robot.bodies):
        inside[b] = b == root or (body.parent >= 0 and inside[body.parent])
        if inside[b]:
            first = int(robot.first_joint[b])
            found += range(first, first + len(body.joints))
    return found


def _way(robot: Character, name: str, before: Array, after: Array) -> float:
    """m, that the centre of mass of an object's first body moved."""
    b = robot.body_index(name)
    places = []
    for x in (before, after):
        rotation, origin = body_poses(robot, x)
        places.append(origin[b] + rotation[b] @ robot.bodies[b].com)
    return float(np.linalg.norm(places[1] - places[0]))
