"""The mass matrix in NumPy, and whether every direction of x moves some inertia."""

from __future__ import annotations

import numpy as np

from octo.errors import ModelError
from octo.model.character import Character
from octo.model.kinematics import axis_rotation, body_poses
from octo.model.quantities import Array

# of the eigenvalues of the mass matrix scaled to a unit diagonal; the robot files at hand have 1e-4
# and more
SMALLEST = 1e-9


def joint_twists(character: Character, x: Array) -> Array:
    """(nx, 6): angular velocity and velocity (m) of the point at the world's origin, per unit speed
    of each joint."""
    rotation, origin = body_poses(character, x)
    twists = np.zeros((character.nx, 6))
    for b, body in enumerate(character.bodies):
        if body.parent >= 0:
            R = rotation[body.parent] @ body.rotation
            t = origin[body.parent] + rotation[body.parent] @ body.position
        else:
            R, t = body.rotation, body.position
        for j, joint in enumerate(body.joints, start=int(character.first_joint[b])):
            displacement, axis = x[j] - joint.reference, R @ joint.axis
            if joint.kind == "slide":
                twists[j, 3:] = axis
                t = t + axis * displacement
            else:
                anchor = t + R @ joint.anchor
                twists[j] = np.concatenate([axis, np.cross(anchor, axis)])
                R = R @ axis_rotation(joint.axis, displacement)
                t = anchor - R @ joint.anchor
    return twists


def mass_matrix(character: Character, x: Array) -> Array:
    """M (nx, nx) at x (nx,), armatures included: kg m², kg m or kg."""
    rotation, origin = body_poses(character, x)
    twists = joint_twists(character, np.asarray(x, dtype=float))
    M = np.diag([joint.armature for joint in character.joints]).astype(float)
    for b, body in enumerate(character.bodies):
        path = list(character.path[b])
        if not path:
            continue
        com = origin[b] + rotation[b] @ body.com
        angular, linear = twists[path, :3], twists[path, 3:] + np.cross(twists[path, :3], com)
        inertia = rotation[b] @ body.inertia @ rotation[b].T
        M[np.ix_(path, path)] += body.mass * linear @ linear.T + angular @ inertia @ angular.T
    return M


def check_mass_matrix(character: Character, file: str) -> None:
    """Refuse a character some of whose motions move no inertia: its forward dynamics would have no
    solution.

    Several poses are looked at: in a single one hinges may be in line (a shoulder in gimbal lock).
    """
    best, motion = -np.inf, np.zeros(character.nx)
    for pose in np.random.default_rng(1).uniform(-1.0, 1.0, (3, character.nx)):
        M = mass_matrix(character, pose)
        scale = np.sqrt(np.maximum(np.diag(M), 1e-300))
        values, vectors = np.linalg.eigh(M / np.outer(scale, scale))
        if values[0] > best:
            best, motion = values[0], vectors[:, 0] / scale
    if not best > SMALLEST:
        share = np.abs(motion) / np.abs(motion).max()
        involved = [character.joints[j].name for j in np.flatnonzero(share > 0.1)]
        of_base = character.base == "floating" and bool((share[:6] > 0.1).any())
        hint = "; base='fixed' takes the base away" if of_base else ""
        raise ModelError(
            f"{file}: joints {', '.join(involved)}: a motion of theirs has no inertia "
            f"({best:.0e}), every one must{hint}"
        )
