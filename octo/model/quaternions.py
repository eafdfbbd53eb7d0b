"""Rotation matrices as quaternions and back, and the turn from each to the next."""

from __future__ import annotations

import numpy as np

from octo.model.quantities import Array


def quaternions(rotation: Array) -> Array:
    """(k, 4), real part first, of rotations (k, 3, 3); neighbours have the same sign."""
    diagonal = rotation[:, [0, 1, 2], [0, 1, 2]]
    squares = np.empty((len(rotation), 4))  # 4 w², 4 x², 4 y², 4 z²
    squares[:, 0] = 1.0 + diagonal.sum(axis=1)
    squares[:, 1:] = 1.0 - diagonal.sum(axis=1, keepdims=True) + 2.0 * diagonal
    R, S = rotation, rotation + rotation.transpose(0, 2, 1)
    wx, wy, wz = R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]
    (ww, xx, yy, zz), xy, xz, yz = squares.T, S[:, 0, 1], S[:, 0, 2], S[:, 1, 2]
    # 4·(product of the row's and the column's entry)
    rows = [ww, wx, wy, wz], [wx, xx, xy, xz], [wy, xy, yy, yz], [wz, xz, yz, zz]
    table = np.array(rows).transpose(2, 0, 1)
    out = table[np.arange(len(table)), np.argmax(squares, axis=1)]
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    sign = np.cumprod(np.where(np.sum(out[1:] * out[:-1], axis=1) < 0.0, -1.0, 1.0))
    out[1:] *= sign[:, None]
    return np.asarray(out if out[0, 0] >= 0.0 else -out)


def rotation_of(quaternion: Array) -> Array:
    """Rotation matrix (3, 3) of a quaternion (4,), real part first, of any length but zero."""
    # Python's own numbers: a third of the time
    w, x, y, z = (quaternion / np.linalg.norm(quaternion)).tolist()
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


def skew(r: Array) -> Array:
    """(3, 3): its product with a vector is the cross product of r (3,) with it."""
    return np.array([[0.0, -r[2], r[1]], [r[2], 0.0, -r[0]], [-r[1], r[0], 0.0]])


def turning(rotation: Array) -> Array:
    """(k-1, 3) rotation vectors, body axes, from each of rotations (k, 3, 3) to the next."""
    relative = quaternions(np.matmul(rotation[:-1].transpose(0, 2, 1), rotation[1:]))
    relative *= np.where(relative[:, :1] < 0.0, -1.0, 1.0)
    sine = np.linalg.norm(relative[:, 1:], axis=1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, relative[:, :1])
    return np.asarray(
        relative[:, 1:] * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 2.0)
    )
