"""Where a motion may start: not under the ground, and by default in a static pose."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from typing import Literal

import numpy as np

from octo.checks import Array
from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.parameters import section
from octo.errors import ProblemError, StaticPoseError
from octo.model.character import Character
from octo.model.feet import gaps
from octo.model.terrain import Ground, Plane, World

BURIED = 0.05  # m of ground over the top of a contact sphere that make a state illegal


def check_above(
    name: str,
    x: Array | None,
    robot: Character | None,
    terrain: Ground | None,
    values: Mapping[str, float],
) -> None:
    """Refuse a state in which a whole contact sphere is buried: Eq. 6 would shoot it out.

    values: the run-time parameters of FD by name.
    """
    if x is None or robot is None or not robot.terrain_contacts:
        return
    spheres = [robot.contacts[k] for k in robot.terrain_contacts]
    radius = np.array([sphere.radius for sphere in spheres])
    center = gaps(robot, terrain or Plane(), section(values, "terrain."), x) + radius
    top = center + radius
    k = int(np.argmin(top))
    if top[k] < -BURIED:
        where = f"contact {spheres[k].name!r} is {-center[k]:.3g} m deep"
        raise ProblemError(f"{name} is under the ground: {where}, must be above it or touch it")


def static_start(
    dynamics: RobotDynamics, p: Array, pose: Array | Literal["balanced"] | None, cyclic: bool
) -> Array:
    """(nx,) a static pose near ``pose``; near the balanced one where that is asked for, or where a
    cycle names none and it stands."""
    from octo.dynamics.static_pose import balanced_pose, static_pose

    if isinstance(pose, str) or (pose is None and cyclic):
        with contextlib.suppress(StaticPoseError):  # octo's own choices are more
            return static_pose(dynamics, p=p, pose=balanced_pose(dynamics.character))
        pose = None
    try:
        return static_pose(dynamics, p=p, pose=pose)
    except StaticPoseError as error:
        _check_under(dynamics, dynamics.character.start_pose if pose is None else pose, error)
        raise


def _check_under(dynamics: RobotDynamics, pose: Array, error: StaticPoseError) -> None:
    """Say so where a robot cannot stand because its world ends before it."""
    robot, world = dynamics.character, dynamics.terrain
    if not isinstance(world, World) or robot.base != "floating":
        return
    place = pose[robot.base_coordinate :][:3]
    if not (world.covers(place[None])[0] or np.isfinite(world.below(place[None])[0])):
        raise StaticPoseError(
            f"{robot.name} cannot stand at x = {place[0]:g} m, y = {place[1]:g} m: terrain has no "
            "shape or map there, must have one under the robot, or give x0"
        ) from error
