"""The chart of a floating base: three angles, outermost first, as rotations and back."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np

from octo.model.quantities import Array

Chart = Literal["zyx", "zxy"]
SINGULAR = 1e-5  # cosine of the middle angle under which the outer two cannot be told apart


def rotation_of_angles(angles: Array, chart: str) -> Array:
    """(3, 3) of the chart's three angles, outermost (yaw) first."""
    numbers = np.asarray(angles).tolist()
    (ca, cb, cc), (sa, sb, sc) = map(math.cos, numbers), map(math.sin, numbers)
    if chart == "zyx":
        return np.array(
            [
                [ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc],
                [sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc],
                [-sb, cb * sc, cb * cc],
            ]
        )
    return np.array(
        [
            [ca * cc - sa * sb * sc, -sa * cb, ca * sc + sa * sb * cc],
            [sa * cc + ca * sb * sc, ca * cb, sa * sc - ca * sb * cc],
            [-cb * sc, sb, cb * cc],
        ]
    )


def angles_of(rotation: Array, chart: str, near: Any) -> tuple[float, float, float]:
    """The chart's angles of a rotation (3, 3) that are nearest to ``near`` (3,)."""
    R, near = rotation.tolist(), np.asarray(near).tolist()
    middle, across = (-R[2][0], R[1][0]) if chart == "zyx" else (R[2][1], -R[0][1])
    along = R[0][0] if chart == "zyx" else R[1][1]
    cosine = math.hypot(across, along)
    b = math.atan2(middle, cosine)
    if cosine > SINGULAR:
        a = math.atan2(across, along)
        c = math.atan2(R[2][1], R[2][2]) if chart == "zyx" else math.atan2(-R[2][0], R[2][2])
    else:  # only a ± c is known: the outer angle stays
        a = near[0]
        ca, sa = math.cos(a), math.sin(a)
        if chart == "zyx":
            c = math.atan2(sa * R[0][2] - ca * R[1][2], ca * R[1][1] - sa * R[0][1])
        else:
            c = math.atan2(ca * R[0][2] + sa * R[1][2], ca * R[0][0] + sa * R[1][0])
    choices = [_near((a, b, c), near), _near((a + math.pi, math.pi - b, c + math.pi), near)]
    return min(
        choices, key=lambda choice: sum((v - w) ** 2 for v, w in zip(choice, near, strict=True))
    )


def _near(angles: tuple[float, float, float], near: list[float]) -> tuple[float, float, float]:
    a, b, c = (
        value + 2.0 * math.pi * round((aim - value) / (2.0 * math.pi))
        for value, aim in zip(angles, near, strict=True)
    )
    return a, b, c


def body_axes(angles: Array, chart: str) -> Array:
    """(3, 3) angular velocity in body axes for the rates of the chart's angles."""
    _, b, c = angles
    cb, sb, cc, sc = math.cos(b), math.sin(b), math.cos(c), math.sin(c)
    if chart == "zyx":
        return np.array([[-sb, 0.0, 1.0], [cb * sc, cc, 0.0], [cb * cc, -sc, 0.0]])
    return np.array([[-cb * sc, cc, 0.0], [sb, 0.0, 1.0], [cb * cc, sc, 0.0]])


def turned_by(vector: Array) -> Array:
    """(3, 3) the rotation about a vector (3,) rad (Rodrigues' formula)."""
    x, y, z = vector.tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    s = math.sin(angle) / angle if angle > 1e-8 else 1.0
    c = (1.0 - math.cos(angle)) / angle**2 if angle > 1e-8 else 0.5
    return np.array(
        [
            [1.0 - c * (y * y + z * z), c * x * y - s * z, c * x * z + s * y],
            [c * x * y + s * z, 1.0 - c * (x * x + z * z), c * y * z - s * x],
            [c * x * z - s * y, c * y * z + s * x, 1.0 - c * (x * x + y * y)],
        ]
    )


def chart_angles(rotation: Array, chart: str) -> list[float]:
    """The three angles (rad) of the chart's hinges, outermost first, that turn by ``rotation`` (3,
    3)."""
    R = rotation
    if chart == "zyx":
        return [
            math.atan2(R[1, 0], R[0, 0]),
            math.asin(-np.clip(R[2, 0], -1.0, 1.0)),
            math.atan2(R[2, 1], R[2, 2]),
        ]
    return [
        math.atan2(-R[0, 1], R[1, 1]),
        math.asin(np.clip(R[2, 1], -1.0, 1.0)),
        math.atan2(-R[2, 0], R[2, 2]),
    ]


def least_singular_chart(rotation: Array) -> Chart:
    """zyx, unless the base stands so near to its singular pitch that zxy is better."""
    # sines of the middle angles of zyx and of zxy
    pitch, roll = abs(rotation[2, 0]), abs(rotation[2, 1])
    return "zxy" if pitch > 0.87 and roll < pitch else "zyx"
