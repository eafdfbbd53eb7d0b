"""The start: a pose in which the joint torques alone hold the robot (§5)."""

from __future__ import annotations

import contextlib
from collections import OrderedDict
from collections.abc import Hashable, Iterator
from functools import lru_cache

import numpy as np

from octo.checks import numbers
from octo.dynamics.balance import UPRIGHT, Balance
from octo.dynamics.content import recent
from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.rest import at_rest
from octo.errors import StaticPoseError
from octo.model.character import Array, Character
from octo.model.describe import lost_shapes
from octo.model.feet import low_contacts
from octo.model.kinematics import center_of_mass, sphere_centers

MARGIN = 0.05  # of a joint's range
NUDGE = 0.05  # rad or m, that joints move where a pose that stands on hard ground tips over on soft


def static_pose(dynamics: RobotDynamics, p: Array, pose: Array | None = None) -> Array:
    """A static pose (nx,) near the given or the character's default one.

    Parameters
    ----------
    dynamics: the robot on its terrain.
    p: (NP,) its parameters.
    pose: (nx,) rad and m, whose actuated joints, place (x, y) and heading are kept. By default the
        character's default pose or zero; where that leans or falls, the joints are moved a little
        so that the centre of mass comes over the feet; after that every limited joint starts at the
        middle of its range. Where the base finds no balance with the joints held, as on ground so
        soft that a tall robot tips over, they are moved by up to 0.05 rad. Objects of a scene are
        moved to where they rest, if that is within 5 cm.

    Raises
    ------
    StaticPoseError: no such pose stands; says why.
    """
    given = None if pose is None else numbers("pose", pose, (dynamics.character.nx,))
    if dynamics.key is dynamics:
        standing = _standing(dynamics, p, given)
    else:
        key = dynamics.key, p.tobytes(), None if given is None else given.tobytes()
        standing = recent(_known, key, lambda: _standing(dynamics, p, given)).copy()
    return at_rest(dynamics, p, standing) if dynamics.character.objects else standing


_known: OrderedDict[Hashable, Array] = OrderedDict()  # of robots, laws and grounds of octo's own


def _standing(dynamics: RobotDynamics, p: Array, pose: Array | None) -> Array:
    """The pose of the robot, with the objects held."""
    robot = dynamics.character
    choices = _own_choice(robot) if pose is None else iter([("the given pose", [pose])])
    reasons, leaning = [], []
    for name, candidates in choices:
        fallen = []
        for candidate in candidates:
            start = inside_limits(robot, candidate)
            if len(np.setdiff1d(robot.unactuated, robot.loose)) == 0:
                return start
            balance = Balance(dynamics, p, start)
            try:
                found = balance.solve()
            except StaticPoseError as error:
                reasons.append(f"{name} does not stand ({error})")
                fallen.append(balance)
                continue
            if balance.tilt(found) <= UPRIGHT:
                return found
            leaning.append((balance.tilt(found), found))
        for balance in fallen:
            balanced = _by_joints(balance)
            if balanced is not None:
                return balanced
    if leaning:
        return min(leaning, key=lambda pair: pair[0])[1]
    advice = lost_shapes(robot) or "give a pose that stands with --pose NAME|FILE"
    raise StaticPoseError(f"{robot.name}: {'; '.join(dict.fromkeys(reasons))}; {advice}")


def _by_joints(balance: Balance) -> Array | None:
    """The pose (nx,) in which the joints balance a robot that its joints, held, do not; None where
    they would have to move far."""
    with contextlib.suppress(StaticPoseError):
        found, joints = balance.by_joints(), balance.dynamics.character.actuated
        if np.abs(found - balance.start)[joints].max(initial=0.0) <= NUDGE:
            return found
    return None


@lru_cache(maxsize=64)
def balanced_pose(robot: Character) -> Array:
    """(nx,) the default pose, or zero, with the joints moved a little so that the feet are below:
    all of them carry.

    Many files' default pose stands with the centre of mass over two of four feet: a stride that
    begins there hops on two.
    """
    pose = over_the_feet(robot, inside_limits(robot, robot.start_pose))
    pose.setflags(write=False)  # every pass of every start of a cycle asks for it
    return pose


def _own_choice(robot: Character) -> Iterator[tuple[str, list[Array]]]:
    """The poses that are tried when none is given: as they are, and with the feet moved below."""
    default = robot.start_pose
    middle = _middle(robot, default)
    named = {"the default pose": default, "the middle of the joints' ranges": middle}
    for name, candidate in named.items():
        yield name, [candidate, over_the_feet(robot, inside_limits(robot, candidate))]


def inside_limits(robot: Character, pose: Array) -> Array:
    """``pose`` (nx,), the joints on or beyond a limit moved inside by 5 % of their range (0.05
    where it is one-sided)."""
    inside, span = pose.copy(), robot.upper - robot.lower
    margin = np.where(np.isfinite(span), MARGIN * span, MARGIN)
    low, high = pose <= robot.lower, pose >= robot.upper
    low[robot.loose] = high[robot.loose] = False  # a closed door stays closed
    inside[low] = (robot.lower + margin)[low]
    inside[high] = (robot.upper - margin)[high]
    return inside


def _middle(robot: Character, pose: Array) -> Array:
    limited = np.isfinite(robot.lower) & np.isfinite(robot.upper)
    limited[robot.loose] = False
    middle = pose.copy()
    middle[limited] = 0.5 * (robot.lower[limited] + robot.upper[limited])
    return middle


def over_the_feet(robot: Character, pose: Array) -> Array:
    """``pose`` (nx,) with the actuated joints moved as little as brings the centre of mass over the
    lowest contacts."""
    joints = robot.actuated
    if not len(joints) or not robot.own_contacts:
        return pose
    feet = low_contacts(robot, pose)

    def offset(x: Array) -> Array:
        middle = sphere_centers(robot, x)[..., feet, :].mean(axis=-2)
        return (center_of_mass(robot, x) - middle)[..., :2]

    small = 1e-6  # rad or m
    for _ in range(10):
        moved = np.repeat(pose[None], len(joints), axis=0)
        moved[np.arange(len(joints)), joints] += small
        slope = (offset(moved) - offset(pose)).T / small  # (2, nu) m/rad
        change = np.linalg.lstsq(slope, -offset(pose), rcond=1e-3)[0]
        pose = pose.copy()
        pose[joints] += np.clip(change, -0.3, 0.3)
        pose = inside_limits(robot, pose)
    return pose
