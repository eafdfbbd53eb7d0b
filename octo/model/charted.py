"""A robot whose floating base turns by another chart: the same motions in other coordinates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from octo.model.character import Character
from octo.model.chart import Chart, chart_angles, rotation_of_angles
from octo.model.quantities import Array


def charted(robot: Character, chart: Chart) -> Character:
    """The robot with the hinges of its floating base in the order of ``chart``; its poses are the
    same orientations."""
    if robot.chart == chart:
        return robot
    b, first = robot.base_body, 3  # three slides come before the hinges
    joints = robot.bodies[b].joints
    hinges = {"xyz"[int(np.argmax(np.abs(one.axis)))]: one for one in joints[first : first + 3]}
    turned = (*joints[:first], *(hinges[axis] for axis in chart), *joints[first + 3 :])
    bodies = tuple(
        replace(body, joints=turned) if k == b else body for k, body in enumerate(robot.bodies)
    )
    poses = {name: in_chart(robot, pose, chart) for name, pose in robot.poses.items()}
    default = None if robot.default_pose is None else in_chart(robot, robot.start_pose, chart)
    return replace(robot, bodies=bodies, chart=chart, poses=poses, default_pose=default)


def in_chart(robot: Character, pose: Array, chart: Chart) -> Array:
    """A pose (nx,) of the robot as one of :func:`charted`: the base's angles in that chart, the
    middle one at most a quarter turn."""
    own, pose = base_angles(robot), np.array(pose, dtype=float)
    reference = np.array([robot.joints[j].reference for j in range(own.start, own.stop)])
    turn = rotation_of_angles(pose[own] - reference, robot.chart)
    order = [robot.chart.index(axis) for axis in chart]
    pose[own] = np.asarray(chart_angles(turn, chart)) + reference[order]
    return pose


def base_angles(robot: Character) -> slice:
    """Where the chart's three angles are in a configuration."""
    first = robot.base_coordinate + 3
    return slice(first, first + 3)
