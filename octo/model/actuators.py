"""MuJoCo's actuators -> which joints are actuated, by how much at most, what else they add."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from octo.errors import ModelError
from octo.model.quantities import Array
from octo.model.robot_file import RobotFile, import_mujoco, name_of

PARALLEL = 1e-6  # sine or cosine of an angle below which two axes are parallel or perpendicular


@dataclass(frozen=True)
class Motor:
    """What drives one coordinate."""

    actuated: bool = False
    limit: float = math.inf  # N m or N, of |u|
    gear: float = 1.0  # torque per unit of control


@dataclass(frozen=True, eq=False)
class BallMotors:
    """The three hinges of a ball joint, outermost first, and what drives each.

    Attributes
    ----------
    axes: (3, 3) a row each, unit vectors of the body; last, middle and first are right-handed.
    note: in what the motors of the file are not those of the hinges; empty without motors.
    """

    axes: Array
    motors: tuple[Motor, ...]
    note: str = ""


def joint_motor(source: RobotFile, j: int) -> Motor:
    """Of MuJoCo's hinge or slide ``j``: only the first number of an actuator's gear acts on it."""
    model = source.model
    if source.limits is not None:
        return Motor(True, source.limits[model.joint(j).name].effort)
    actuators = actuators_of(model, j)
    motor = _motor(model, actuators, model.actuator_gear[actuators, 0])
    if motor.actuated and model.jnt_actfrclimited[j]:
        most = float(np.abs(model.jnt_actfrcrange[j]).max())
        return replace(motor, limit=min(motor.limit, most))
    return motor


def _motor(model: Any, actuators: Sequence[int], gear: Array) -> Motor:
    """Of one coordinate that ``actuators`` drive by the numbers ``gear``: with the sum of their
    limits."""
    if not len(actuators):
        return Motor()
    by = gear.tolist()
    limit = sum(force_limit(model, a) * abs(g) for a, g in zip(actuators, by, strict=True))
    return Motor(True, limit, by[0] * strength(model, actuators[0]))


def ball_motors(model: Any, j: int) -> BallMotors:
    """Of MuJoCo's ball joint ``j``, whose motors turn it about their gear vectors.

    A gear vector keeps its direction in the child (or in the parent), the axes of the hinges turn
    with one another: a torque of the hinges is that of the motors where the ball is not turned.
    """
    actuators = actuators_of(model, j)
    if not actuators:
        return BallMotors(np.eye(3)[::-1], (Motor(),) * 3)
    vectors = model.actuator_gear[actuators, :3]
    axes, apart = _hinge_axes(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))
    parts = vectors @ axes.T  # (actuators, hinges)
    driving = np.abs(parts) > PARALLEL * np.linalg.norm(vectors, axis=1, keepdims=True)
    motors = [
        _motor(model, [a for a, drives in zip(actuators, on, strict=True) if drives], gear[on])
        for on, gear in zip(driving.T, parts.T, strict=True)
    ]
    notes = [
        "its motors act about the hinges, which is about their own axes where it is not turned"
    ]
    if not apart:
        oblique = "they pull about oblique axes: one torque about each hinge"
        notes.append(f"{oblique}, with the sum of their limits")
    elif len(actuators) > driving.any(axis=0).sum():
        notes.append("those about one axis are one torque, with the sum of their limits")
    return BallMotors(axes, tuple(motors), "; ".join(notes))


def _hinge_axes(directions: Array) -> tuple[Array, bool]:
    """(3, 3) axes of hinges, outermost first, one along each of the unit vectors (k, 3).

    The body's z, y and x where these will do, or where there are none (then False).
    """
    usual = np.eye(3)[::-1]
    distinct: list[Array] = []
    for direction in directions:
        if all(np.linalg.norm(np.cross(direction, other)) > PARALLEL for other in distinct):
            distinct.append(direction)
    found = np.array(distinct)
    if np.abs(np.abs(found).max(axis=1) - 1.0).max() < PARALLEL**2:
        return usual, True
    if np.abs(found @ found.T - np.eye(len(found))).max() > PARALLEL:
        return usual, False
    inner = found[0]
    if len(found) > 1:
        middle = found[1]
    else:
        away = np.eye(3)[int(np.argmin(np.abs(inner)))]
        middle = (away - (away @ inner) * inner) / np.linalg.norm(away - (away @ inner) * inner)
    return np.array([np.cross(inner, middle), middle, inner]), True


def actuators_of(model: Any, j: int) -> list[int]:
    """Actuators that drive joint ``j``; one whose gear is zero does not."""
    driving = [a for a in range(model.nactuator) if drives_joint(model, a)]
    mine = [a for a in driving if model.actuator_trnid[a, 0] == j]
    for a in mine:
        gear = model.actuator_gear[a]
        if not np.isfinite(gear).all():
            name = name_of(model, "actuator", a)
            raise ModelError(f"actuator {name!r}: gear is {gear}, must be finite")
    return [a for a in mine if model.actuator_gear[a, : gears(model, j)].any()]


def gears(model: Any, j: int) -> int:
    """How many numbers of an actuator's gear act on joint ``j``."""
    kinds = import_mujoco().mjtJoint
    return {int(kinds.mjJNT_FREE): 6, int(kinds.mjJNT_BALL): 3}.get(int(model.jnt_type[j]), 1)


def reflected(model: Any, j: int, field: Any) -> float:
    """What a property of its actuators (inertia, damping) is at joint ``j``.

    MuJoCo takes the first number of the gear, also of a ball joint.
    """
    return sum(
        float(model.actuator_gear[a, 0]) ** 2 * float(field[a]) for a in actuators_of(model, j)
    )


def control_index(model: Any, a: int) -> int:
    """Index of the first control of actuator ``a``: an actuator may have several."""
    return int(model.actuator_ctrladr[a])


def drives_joint(model: Any, a: int) -> bool:
    kinds = import_mujoco().mjtTrn
    known = (int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT))
    return int(model.actuator_trntype[a]) in known


def is_motor(model: Any, a: int) -> bool:
    """Whether the actuator's force is a constant times its control."""
    mujoco = import_mujoco()
    kinds = (model.actuator_gaintype[a], model.actuator_biastype[a], model.actuator_dyntype[a])
    plain = (mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtDyn.mjDYN_NONE)
    return [int(kind) for kind in kinds] == [int(kind) for kind in plain]


def strength(model: Any, a: int) -> float:
    """Force before the gear per unit of control of a motor; 1 of any other actuator."""
    return float(model.actuator_gainprm[a, 0]) if is_motor(model, a) else 1.0


def force_limit(model: Any, a: int) -> float:
    """The tighter of force and control range (of a motor), before the gear; infinite if none."""
    force = math.inf
    if model.actuator_forcelimited[a]:
        force = float(np.abs(model.actuator_forcerange[a]).max())
    control = control_index(model, a)
    if is_motor(model, a) and model.actuator_ctrllimited[control]:
        most = float(np.abs(model.actuator_ctrlrange[control]).max())
        force = min(force, abs(strength(model, a)) * most)
    return force
