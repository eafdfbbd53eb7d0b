"""The pose that walking is planned around: feet where they stand, knees bent."""

from __future__ import annotations

import numpy as np

from octo.dynamics.static_pose import inside_limits, over_the_feet
from octo.model.character import Character
from octo.model.feet import lowest_contacts, toward
from octo.model.kinematics import body_poses, sphere_centers
from octo.model.quantities import Array

BENT = 0.76  # of a leg's length, the height of its hip over its foot
STRAIGHT = 0.84  # from which a leg counts as straight
START = (0.3, -0.6)  # rad, of a straight leg's last two hinges, where the search begins
ITERATIONS = 60


def stance(robot: Character) -> Array:
    """The default pose (nx,) over its feet, with straight legs bent to 0.76 of their length; the
    base comes down.

    A leg is the chain of joints from the base to a body with a contact sphere near the ground. A
    robot without one, or with its knees bent already, keeps its pose.
    """
    pose = over_the_feet(robot, inside_limits(robot, robot.start_pose))
    if robot.base != "floating" or not robot.terrain_contacts:
        return pose
    feet = lowest_contacts(robot, pose)
    straight = max(_stretch(robot, pose, foot) for foot in feet)
    if straight <= STRAIGHT:
        return pose
    lift = robot.base_coordinate + 2
    begun = pose.copy()
    for foot in feet:
        joints = [j for j in robot.path[robot.contacts[foot].body] if robot.joints[j].actuated][-2:]
        for j, change in zip(joints, START, strict=False):
            begun[j] = pose[j] + change if _stretch(robot, pose, foot) > STRAIGHT else pose[j]
    target = sphere_centers(robot, pose)[feet]
    lengths = [_length(robot, foot) for foot in feet]
    begun[lift] -= (straight - BENT) * float(np.mean(lengths))
    return over_the_feet(robot, _reach(robot, inside_limits(robot, begun), feet, target))


def _chain(robot: Character, foot: int) -> list[int]:
    """Bodies from the first one that moves on the base to the foot's."""
    bodies, b = [], robot.contacts[foot].body
    while b != robot.base_body and b >= 0:
        bodies.append(b)
        b = robot.bodies[b].parent
    return bodies[::-1]


def _length(robot: Character, foot: int) -> float:
    """m, of the links from the hip to the foot, what they lie to the side left out."""
    offsets = [robot.bodies[b].position for b in _chain(robot, foot)[1:]]
    offsets.append(robot.contacts[foot].position)
    return float(sum(np.hypot(offset[0], offset[2]) for offset in offsets))


def _stretch(robot: Character, pose: Array, foot: int) -> float:
    """Height of the hip over the foot, relative to the leg's length."""
    chain = _chain(robot, foot)
    if not chain:
        return 0.0
    hip = body_poses(robot, pose)[1][chain[0], 2]
    return float(hip - sphere_centers(robot, pose)[foot, 2]) / max(_length(robot, foot), 1e-6)


def _reach(robot: Character, pose: Array, feet: list[int], target: Array) -> Array:
    """Damped least squares over the actuated joints."""
    for _ in range(ITERATIONS):
        change, pose = np.clip(toward(robot, pose, feet, target), -0.2, 0.2), pose.copy()
        pose[robot.actuated] += change
        pose = inside_limits(robot, pose)
    return pose
