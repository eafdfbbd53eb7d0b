"""A robot that lies: let down on the ground with its joints held, and where it comes to rest."""

from __future__ import annotations

import numpy as np

from octo.dynamics.balance import TOLERANCE, Balance
from octo.dynamics.evaluate import RobotDynamics
from octo.model.character import Array, Character
from octo.model.chart import chart_angles
from octo.model.charted import base_angles
from octo.model.quaternions import rotation_of

WITHIN = 0.1  # of a joint's range, kept from its limits
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


def settled(dynamics: RobotDynamics, p: Array, pose: Array) -> Array | None:
    """Where the robot comes to rest when it is let down from ``pose`` (nx,) with its joints held,
    (nx,); None where it does not."""
    balance = Balance(dynamics, p, pose)
    found, residual = balance.newton(balance.settled(falling=True), sliding=False)
    return found if residual <= TOLERANCE and balance.stable(found) else None
