"""A motion as MuJoCo's qpos and qvel, Pinocchio's q and v, a table of numbers."""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from octo.checks import Array, ending
from octo.errors import ProblemError, UnknownNameError
from octo.files import replacing
from octo.model.character import Character
from octo.model.kinematics import axis_rotation, body_poses
from octo.model.quaternions import quaternions, turning
from octo.result.trajectory import Trajectory


def to_mujoco(motion: Trajectory) -> tuple[Array, Array]:
    """qpos (N+1, nq) and qvel (N+1, nv) at x_0 … x_N.

    A floating base is place (m, world), quaternion (w, x, y, z), velocity (m/s, world) and angular
    velocity (rad/s, body axes); a ball joint is a quaternion and an angular velocity (child's
    axes). Joints keep the order of the robot's tree.
    """
    positions, velocities = [], []
    for part in _parts(motion):
        place, turn, moved, spun = part.place, part.rotation, part.velocity, part.angular
        positions += [place] if turn is None else [place, quaternions(turn)]
        velocities += [moved] if spun is None else [moved, spun]
    return np.concatenate(positions, axis=1), np.concatenate(velocities, axis=1)


def to_pinocchio(
    motion: Trajectory, joints: Sequence[str] | None = None, circular: Collection[str] = ()
) -> tuple[Array, Array]:
    """q (N+1, nq) and v (N+1, nv) at x_0 … x_N, of a model with a free flyer at the root where the
    base floats.

    The free flyer is place (m, world), quaternion (x, y, z, w), velocity (m/s) and angular velocity
    (rad/s), both in body axes; a velocity is the change since the node before over dt. ``joints``:
    names of the other joints in the order of the Pinocchio model (``model.names`` without the first
    two); by default the order of the robot's tree. ``circular``: joints that Pinocchio keeps as
    cosine and sine (``continuous`` ones of a URDF).
    """
    parts = _parts(motion)
    named = {part.name: part for part in parts if part.name}
    for name in (*(joints or ()), *circular):
        if name not in named:
            raise UnknownNameError("joint", name, named)
    if joints is not None:
        parts = [part for part in parts if not part.name] + [named[name] for name in joints]
    positions: list[Array] = []
    velocities: list[Array] = []
    for part in parts:
        if part.rotation is None or part.angular is None:
            circle = part.name in circular
            positions += [np.cos(part.place), np.sin(part.place)] if circle else [part.place]
            velocities.append(part.velocity)
        else:
            in_body = part.velocity
            if in_body.shape[1]:
                in_body = np.einsum("ikj,ik->ij", part.rotation, in_body)
            positions += [part.place, quaternions(part.rotation)[:, [1, 2, 3, 0]]]
            velocities += [in_body, part.angular]
    return np.concatenate(positions, axis=1), np.concatenate(velocities, axis=1)


def to_csv(motion: Trajectory, path: str | os.PathLike[str]) -> None:
    """A table with one row for each of x_0 … x_N; the first line has names and units.

    Time, coordinates, the torques from this row to the next (none after the last), the contact
    forces in world axes (none at x_0). What does not exist is nan.
    """
    target = ending("path", path, (".csv",))
    forces = [f"force {name} {axis}" for name in motion.contact_names for axis in "xyz"]
    what = "torque" if motion.soft is None else "force"
    names = [
        "time (s)",
        *_headed(motion.joint_names, motion.units),
        *_headed([f"{what} {name}" for name in motion.actuated_names], motion.effort_units),
        *_headed(forces, ["N"] * len(forces)),
    ]
    force = motion.contact_force.reshape(len(motion.contact_force), -1)
    torque = np.concatenate([motion.u, np.full((1, motion.u.shape[1]), np.nan)])
    force = np.concatenate([np.full((1, force.shape[1]), np.nan), force])
    rows = np.concatenate([motion.times[:, None], motion.x[1:], torque, force], axis=1)
    head, how = ",".join(names), {"delimiter": ",", "comments": "", "fmt": "%.10g"}
    with replacing(target) as beside:
        np.savetxt(beside, rows, header=head, encoding="utf-8", **how)


def _headed(names: Sequence[str], units: Sequence[str]) -> list[str]:
    """Names with their units, without a table's own marks: commas, quotes, line breaks."""
    headed = [f"{name} ({unit})" if unit else name for name, unit in zip(names, units, strict=True)]
    return [" ".join(name.replace(",", ";").replace('"', "'").split()) for name in headed]


class _Part(NamedTuple):
    """One joint of the other tool: a free base, a ball, or one coordinate."""

    name: str
    place: Array  # (N+1, 3, 1 or 0 of a ball)
    velocity: Array
    rotation: Array | None = None  # (N+1, 3, 3)
    angular: Array | None = None  # (N+1, 3) rad/s, turning axes


def _parts(motion: Trajectory) -> list[_Part]:
    robot = motion.character
    if robot is None:
        raise ProblemError("user-written dynamics have no bodies: x is all there is")
    x, dt = motion.x, motion.row_intervals[:, None]  # (N+1, 1) s
    rate = np.diff(x, axis=0) / dt
    parts = []
    for b, (body, start) in enumerate(zip(robot.bodies, robot.first_joint, strict=True)):
        j, end = int(start), int(start) + len(body.joints)
        if robot.base == "floating" and b == robot.base_body:
            rotation, origin = (value[:, b] for value in body_poses(robot, x))
            moved = (origin[1:], np.diff(origin, axis=0) / dt)
            parts.append(_Part("", *moved, rotation[1:], turning(rotation) / dt))
            j += 6
        while j < end:
            ball = _ball(robot, j, end)
            if ball:
                turn = _turn(robot, x, j)
                parts.append(_Part(ball, x[1:, :0], rate[:, :0], turn[1:], turning(turn) / dt))
            else:
                parts.append(_Part(robot.joints[j].name, x[1:, j : j + 1], rate[:, j : j + 1]))
            j += 3 if ball else 1
    return parts


def _ball(robot: Character, j: int, end: int) -> str:
    """The ball joint whose three hinges begin at coordinate ``j``; "" where there is none."""
    hinges = robot.joints[j : min(j + 3, end)]
    prefix = hinges[0].name.removesuffix("_z")
    if [hinge.name for hinge in hinges] != [f"{prefix}_z", f"{prefix}_y", f"{prefix}_x"]:
        return ""
    free = all(hinge.kind == "hinge" and not hinge.limited for hinge in hinges)
    alike = free and all(np.array_equal(hinge.anchor, hinges[0].anchor) for hinge in hinges)
    outer, middle, inner = (hinge.axis for hinge in hinges)
    return prefix if alike and np.allclose(np.cross(outer, inner), middle, atol=1e-9) else ""


def _turn(robot: Character, x: Array, j: int) -> Array:
    """(N+2, 3, 3) rotation of three hinges."""
    turn = np.broadcast_to(np.eye(3), (len(x), 3, 3))
    for k in range(j, j + 3):
        joint = robot.joints[k]
        turn = turn @ axis_rotation(joint.axis, x[:, k] - joint.reference)
    return np.asarray(turn)
