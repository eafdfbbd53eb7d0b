"""Where the objects of a scene rest, with the robot held: what a static start begins with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.simulate import Stepper
from octo.model.character import Array, Character
from octo.model.kinematics import body_poses
from octo.model.quantities import GRAVITY

NEAR = 0.05  # m, that an object may be from where it rests; another one is in the air, or slides
FIRST, LONGEST, GROWTH = 0.005, 0.2, 1.5  # s, of the steps from rest
STEPS = 60
LOADED = 1e-4  # of mg: what counts as a load on the robot
STEADY = 1e-7  # m/s and rad/s: changes of the rate of what rests, or creeps down a slope


def at_rest(dynamics: RobotDynamics, p: Array, x: Array) -> Array:
    """x (nx,) with each object where its contacts carry it, and the robot where it stands with
    them.

    Only what is within 5 cm of such a place is moved; an object that stands on nothing stays where
    it was put, and falls from there when the motion begins.

    Parameters
    ----------
    p: (NP,) the parameters of the dynamics.
    x: (nx,) a pose in which the robot stands.
    """
    robot = dynamics.character
    resting, moved = list(robot.objects), x
    while resting:
        free = np.array([j for name in resting for j in coordinates(robot, name)], dtype=np.intp)
        moved = _settled(dynamics, p, x, free, resting)
        gone = [name for name in resting if _way(robot, name, x, moved) > NEAR]
        if not gone:
            break
        resting, moved = [name for name in resting if name not in gone], x
    if not _carries(dynamics, p, x, moved):
        return moved
    base = robot.bodies[robot.base_body].name
    own = np.setdiff1d(robot.unactuated, robot.loose)
    free = np.concatenate([own, *(coordinates(robot, name) for name in resting)]).astype(np.intp)
    both = _settled(dynamics, p, moved, free, [base, *resting])
    kept = all(_way(robot, name, moved, both) <= NEAR for name in (base, *resting))
    return both if kept else moved


def _carries(dynamics: RobotDynamics, p: Array, before: Array, after: Array) -> bool:
    """Whether the objects, which moved, load the robot: its own rows of FD are others."""
    robot = dynamics.character
    own = np.setdiff1d(robot.unactuated, robot.loose)
    nodes = np.repeat(np.stack([before, after])[:, None], 3, axis=1)
    fd = dynamics.evaluate(nodes, np.repeat(p[None], 2, axis=0))[0][:, 0, own]
    return bool(np.abs(fd[1] - fd[0]).max(initial=0.0) > LOADED * robot.mass * GRAVITY)


def _settled(
    dynamics: RobotDynamics, p: Array, x: Array, free: NDArray[np.intp], names: list[str]
) -> Array:
    """Implicit steps of the ``free`` coordinates from rest, ever longer: that damps what they do.
    Ends where a named body has gone too far."""
    robot = dynamics.character
    place, start, duration = dynamics.layout.index("dt"), x, FIRST
    rate = np.full_like(x, np.inf)
    if not len(free):
        return x
    for _ in range(STEPS):
        own = p.copy()
        own[place] = duration
        moved, left = Stepper(dynamics, own, free)(x, x)
        if not left < 1e-6:
            duration *= 0.3
            continue
        before, rate, x = rate, (moved - x) / duration, moved
        steady = bool(np.max(np.abs(rate - before)) < STEADY)
        far = max(_way(robot, name, start, x) for name in names)
        if far > NEAR or (duration >= LONGEST and steady):
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
    """m, that the centre of mass of a body moved."""
    b = robot.body_index(name)
    places = []
    for x in (before, after):
        rotation, origin = body_poses(robot, x)
        places.append(origin[b] + rotation[b] @ robot.bodies[b].com)
    return float(np.linalg.norm(places[1] - places[0]))
