"""Where the bodies of a character are, in NumPy; the optimiser uses CasADi's form."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from octo.checks import floats, instance
from octo.errors import ShapeError
from octo.model.quantities import Array
from octo.model.quaternions import skew
from octo.model.tree import Tree


def body_poses(character: Tree, x: NDArray) -> tuple[Array, Array]:
    """World pose of every body.

    Parameters
    ----------
    x: (..., nx) rad and m.

    Returns
    -------
    rotation (..., bodies, 3, 3) and origin (..., bodies, 3) m.
    """
    instance("character", character, Tree, "a Character: what octo.load gives")
    x = floats("x", x)
    if x.ndim == 0 or x.shape[-1] != character.nx:
        raise ShapeError("x", x.shape, f"(..., {character.nx})")
    lead = x.shape[:-1]
    rotation = np.empty((*lead, len(character.bodies), 3, 3))
    origin = np.empty((*lead, len(character.bodies), 3))
    for b, body in enumerate(character.bodies):
        if body.parent >= 0:
            R = rotation[..., body.parent, :, :] @ body.rotation
            t = origin[..., body.parent, :] + rotation[..., body.parent, :, :] @ body.position
        else:
            R = np.broadcast_to(body.rotation, (*lead, 3, 3))
            t = np.broadcast_to(body.position, (*lead, 3))
        for j, joint in enumerate(body.joints, start=int(character.first_joint[b])):
            q = x[..., j] - joint.reference
            if joint.kind == "slide":
                t = t + (R @ joint.axis) * q[..., None]
            else:
                turn = axis_rotation(joint.axis, q)
                t = t + (R @ (joint.anchor - turn @ joint.anchor)[..., None])[..., 0]
                R = R @ turn
        rotation[..., b, :, :], origin[..., b, :] = R, t
    return rotation, origin


def axis_rotation(axis: NDArray, angle: NDArray | float) -> Array:
    """Rotation matrices (..., 3, 3) about a unit ``axis`` (3,) by ``angle`` (...) rad (Rodrigues'
    formula)."""
    a = np.asarray(axis, dtype=float)
    cross = skew(a)
    angle = np.asarray(angle, dtype=float)[..., None, None]
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)


def sphere_centers(character: Tree, x: NDArray) -> Array:
    """Centres (..., contacts, 3) m of the contact spheres at x (..., nx)."""
    rotation, origin = body_poses(character, x)
    body = [contact.body for contact in character.contacts]
    local = np.array([contact.position for contact in character.contacts]).reshape(-1, 3)
    return origin[..., body, :] + np.einsum("...kij,kj->...ki", rotation[..., body, :, :], local)


def center_of_mass(character: Tree, x: NDArray) -> Array:
    """Centre of mass (..., 3) m at x (..., nx)."""
    rotation, origin = body_poses(character, x)
    mass = character.masses
    com = np.array([body.com for body in character.bodies])
    places = origin + np.einsum("...bij,bj->...bi", rotation, com)
    return np.einsum("b,...bi->...i", mass, places) / mass.sum()
