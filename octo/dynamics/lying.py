"""A robot that lies: a pose that is let down on the ground with its joints held, and where it comes
to rest."""

from __future__ import annotations

from typing import Literal

import numpy as np

from octo.dynamics.balance import TOLERANCE, UPRIGHT, Balance
from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.rest import at_rest
from octo.dynamics.static_pose import balanced_pose
from octo.errors import StaticPoseError
from octo.model.character import Array, Character
from octo.model.chart import chart_angles
from octo.model.charted import base_angles
from octo.model.feet import low_contacts
from octo.model.kinematics import axis_rotation, body_poses
from octo.model.quaternions import rotation_of

WITHIN = 0.1  # of a joint's range, kept from its limits
Side = Literal["back", "front"]
RANGE = 1.0  # rad or m, either side of the default pose, of joints without limits


def drawn(robot: Character, rng: np.random.Generator) -> Array:
    """(nx,) the base turned at random, any orientation as likely as any other, and joints at random
    places within their limits."""
    pose, joints = robot.start_pose, robot.actuated
    limited = np.isfinite(robot.lower) & np.isfinite(robot.upper)
    lower = np.where(limited, robot.lower, pose - RANGE)
    upper = np.where(limited, robot.upper, pose + RANGE)
    margin = WITHIN * (upper - lower)
    turn = rotation_of(rng.standard_normal(4))
    pose[joints] = rng.uniform(lower + margin, upper - margin)[joints]
    pose[base_angles(robot)] = chart_angles(turn, robot.chart)
    return pose


def on_its(side: Side, robot: Character) -> Array:
    """(nx,) the balanced pose with the base turned over: of a robot whose trunk is taller than long
    (a humanoid) backward or forward, of another one (a dog) upside down, or as it was."""
    pose = balanced_pose(robot).copy()
    rotations, _ = body_poses(robot, pose)
    back = side == "back"
    axis, angle = np.array([1.0, 0.0, 0.0]), np.pi if back else 0.0
    if _upright(robot, pose, rotations):
        axis, angle = np.array([0.0, 1.0, 0.0]), -0.5 * np.pi if back else 0.5 * np.pi
    b, own = robot.base_body, base_angles(robot)
    turn = robot.bodies[b].rotation.T @ axis_rotation(axis, angle) @ rotations[b]
    reference = [robot.joints[j].reference for j in range(own.start, own.stop)]
    pose[own] = np.asarray(chart_angles(turn, robot.chart)) + reference
    return pose


def _upright(robot: Character, pose: Array, rotations: Array) -> bool:
    """Whether the bodies that carry no foot are more spread along z than along x."""
    legs = {robot.contacts[k].body for k in low_contacts(robot, pose)}
    for b in range(len(robot.bodies) - 1, -1, -1):  # parents come first
        if b in legs and robot.bodies[b].parent >= 0:
            legs.add(robot.bodies[b].parent)
    trunk = [b for b in np.flatnonzero(robot.own) if b not in legs or b == robot.base_body]
    mass = robot.masses[trunk]
    center = body_poses(robot, pose)[1][trunk] + np.stack(
        [rotations[b] @ robot.bodies[b].com for b in trunk]
    )
    apart = center - mass @ center / mass.sum()
    inertia = np.stack([rotations[b] @ robot.bodies[b].inertia @ rotations[b].T for b in trunk])
    # ∫z² - ∫x² of a body is I_xx - I_zz
    taller = (inertia[:, 0, 0] - inertia[:, 2, 2]).sum() + mass @ (
        apart[:, 2] ** 2 - apart[:, 0] ** 2
    )
    return bool(taller > 0.0)


def settled(dynamics: RobotDynamics, p: Array, pose: Array) -> Array | None:
    """Where the robot comes to rest when it is let down from ``pose`` (nx,) with its joints held,
    (nx,); None where it does not."""
    balance = Balance(dynamics, p, pose)
    found, residual = balance.newton(balance.settled(falling=True), sliding=False)
    return found if residual <= TOLERANCE and balance.stable(found) else None


def static_near(dynamics: RobotDynamics, p: Array, pose: Array, lean: float = UPRIGHT) -> Array:
    """The static pose (nx,) nearest to ``pose`` (nx,), objects where they rest; with the joints of
    the pose where these hold it and the base tilts by ``lean`` rad at most.

    Raises
    ------
    StaticPoseError: none is near; says why.
    """
    robot = dynamics.character
    try:
        found = Balance(dynamics, p, pose).nearest(lean)
    except StaticPoseError as error:
        raise StaticPoseError(f"{robot.name}: the given pose does not rest ({error})") from None
    return at_rest(dynamics, p, found) if robot.objects else found
