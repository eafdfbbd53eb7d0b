"""One state in octo's chart (x, ẋ) and in MuJoCo's form (q, v), back and forth.

MuJoCo's form of a floating base is place (m, world), quaternion (real part first), velocity (m/s, world) and angular
velocity (rad/s, body axes); every other joint is its coordinate, in the order of the character's tree: the form of
``Solution.to_mujoco`` where there is no ball joint (here a ball joint is three hinges).
"""

from __future__ import annotations

import math

import numpy as np

from octo.checks import numbers
from octo.model.character import Array, Character
from octo.model.compiled import chart_angles
from octo.model.kinematics import axis_rotation
from octo.model.quaternions import quaternions
from octo.model.robot_file import rotation_of


def from_chart(character: Character, x: Array, rate: Array | None = None) -> tuple[Array, Array]:
    """q (nq,) and v (nv,) of x (nx,) rad and m and ẋ ``rate`` (nx,), by default at rest."""
    x = numbers("x", x, (character.nx,))
    rate = np.zeros(character.nx) if rate is None else numbers("rate", rate, (character.nx,))
    if character.base != "floating":
        return x.copy(), rate.copy()
    first = _base_start(character)
    place, rotation, rates = _base(character, x[first : first + 6])
    before, after = slice(0, first), slice(first + 6, None)
    q = np.concatenate([x[before], place, quaternions(rotation[None])[0], x[after]])
    return q, np.concatenate([rate[before], rates @ rate[first : first + 6], rate[after]])


def to_chart(character: Character, q: Array, v: Array, near: Array | None = None) -> tuple[Array, Array]:
    """x (nx,) and ẋ (nx,) of q (nq,) and v (nv,).

    Of the base's angles that say the same rotation, those nearest to ``near`` (nx,) are taken: a turning or falling base
    then has no jumps. At the chart's singularity ẋ is the smallest that fits best.
    """
    floating = character.base == "floating"
    q, v = numbers("q", q, (character.nx + floating,)), numbers("v", v, (character.nx,))
    if not floating:
        return q.copy(), v.copy()
    first = _base_start(character)
    body = character.bodies[character.base_body]
    place, turn = q[first : first + 3], rotation_of(q[first + 3 : first + 7])
    found = chart_angles(body.rotation.T @ turn, character.chart)
    angles = _nearest(found, np.zeros(3) if near is None else np.asarray(near, dtype=float)[first + 3 : first + 6])
    base = np.concatenate([body.rotation.T @ (place - body.position), angles])
    rates = _base(character, base)[2]
    rate = np.linalg.lstsq(rates, v[first : first + 6], rcond=1e-9)[0]
    x = np.concatenate([q[:first], base, q[first + 7 :]])
    return x, np.concatenate([v[:first], rate, v[first + 6 :]])


def _base_start(character: Character) -> int:
    """Index into x of the floating base's first coordinate."""
    return int(character.first_joint[character.base_body])


def _base(character: Character, x: Array) -> tuple[Array, Array, Array]:
    """Place (3,) m and rotation (3, 3) of the base at its six coordinates, and B (6, 6): v of the base is B times their rates."""
    body = character.bodies[character.base_body]
    rotation, columns = body.rotation, []
    for joint, value in zip(body.joints[:6], x, strict=True):
        columns.append(rotation @ joint.axis)
        if joint.kind == "hinge":
            rotation = rotation @ axis_rotation(joint.axis, value)
    rates = np.zeros((6, 6))
    rates[:3, :3] = np.array(columns[:3]).T
    rates[3:, 3:] = rotation.T @ np.array(columns[3:]).T
    return body.position + rates[:3, :3] @ x[:3], rotation, rates


def _nearest(angles: list[float], near: Array) -> Array:
    """The same rotation as ``angles`` (outermost first), written nearest to ``near`` (3,) rad."""
    outer, middle, inner = angles
    best, least = np.array(angles), math.inf
    for candidate in (np.array([outer, middle, inner]), np.array([outer + math.pi, math.pi - middle, inner + math.pi])):
        moved = candidate + 2.0 * math.pi * np.round((near - candidate) / (2.0 * math.pi))
        away = float(np.linalg.norm(moved - near))
        if away < least - 1e-9:
            best, least = moved, away
    return best
