"""How alike two moments of two motions are (Kovar et al. 2002): the distance between clouds of
points over a window of frames, the least over where and which way the second motion stands.

    D = min over ψ, t of Σ_m w_m ‖p_m − (R_z(ψ) q_m + t)‖²,   t on the ground

With horizontal places as complex numbers, and centred, the sum is Σw|p|² + Σw|q|² − 2 Re(e^{−iψ} Σw
p q̄) beside what heights differ: the best ψ is the argument of Σw p q̄, and all pairs of two lists of
windows cost one product of matrices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from octo.checks import Array, numbers
from octo.errors import ShapeError, ValueRangeError
from octo.model.kinematics import body_poses, sphere_centers
from octo.model.tree import Tree


@dataclass(frozen=True)
class Alignment:
    """Of each pair of windows of two motions.

    Attributes
    ----------
    distance: (a, b) m, √ of D over the sum of weights: root mean square of how far points are.
    yaw: (a, b) rad, by which the second motion is turned about z.
    shift: (a, b, 2) m, by which it is then carried along the ground.
    """

    distance: Array
    yaw: Array
    shift: Array


def points_of(robot: Tree, x: Array) -> Array:
    """(…, points, 3) m, the cloud of a character at x (…, nx): where its bodies and its contacts
    are."""
    places = body_poses(robot, x)[1]
    return np.concatenate([places, sphere_centers(robot, x)], axis=-2)


def windows(points: Array, frames: NDArray[np.intp], length: int, way: int = 1) -> Array:
    """(n, length, points, 3) around some frames of a cloud (N, points, 3): from a frame on, or to a
    frame (``way`` −1). Before the first frame and after the last the motion is held.

    Parameters
    ----------
    frames: (n,) of 0 … N − 1. length: of a window, at least 1.
    """
    over = np.arange(length) if way > 0 else np.arange(1 - length, 1)
    return points[np.clip(frames[:, None] + over, 0, len(points) - 1)]


def aligned(one: Array, other: Array, weights: Array | None = None) -> Alignment:
    """All windows of one motion with all of another.

    Parameters
    ----------
    one, other: (a, …, 3) and (b, …, 3) m, clouds over windows of as many points.
    weights: (…) of the points, not negative; by default all alike.

    Raises
    ------
    ShapeError, ValueRangeError: naming the field and what is allowed.
    """
    p, q = numbers("one", one), numbers("other", other)
    if p.ndim < 3 or p.shape[1:] != q.shape[1:] or p.shape[-1] != 3:
        raise ShapeError("other", q.shape, f"(windows, {', '.join(map(str, p.shape[1:]))})")
    given = np.ones(p.shape[1:-1]) if weights is None else weights
    w = numbers("weights", given, p.shape[1:-1]).ravel()
    if (w < 0.0).any() or not w.sum() > 0.0:
        raise ValueRangeError("weights must not be negative, and not all zero")
    w = w / w.sum()
    (a, up_a, middle_a), (b, up_b, middle_b) = (_flat(v, w) for v in (p, q))
    both = (w * a) @ b.conj().T
    yaw = np.angle(both)
    square = _sum(a, w)[:, None] + _sum(b, w) - 2.0 * np.abs(both)
    square += _sum(up_a, w)[:, None] + _sum(up_b, w) - 2.0 * (w * up_a) @ up_b.T
    shift = middle_a[:, None] - np.exp(1j * yaw) * middle_b
    distance = np.sqrt(np.maximum(square, 0.0))  # of what is the same rounding may be negative
    return Alignment(distance, yaw, np.stack([shift.real, shift.imag], axis=-1))


def _flat(clouds: Array, w: Array) -> tuple[NDArray, Array, NDArray]:
    """Horizontal places (n, m) about their middles, heights (n, m), and the middles (n,)."""
    flat = clouds.reshape(len(clouds), -1, 3)
    ground = flat[..., 0] + 1j * flat[..., 1]
    middle = ground @ w
    return ground - middle[:, None], flat[..., 2], middle


def _sum(values: NDArray, w: Array) -> Array:
    """(n,) Σw|v|² of (n, m)."""
    return np.asarray(np.abs(values) ** 2 @ w)
