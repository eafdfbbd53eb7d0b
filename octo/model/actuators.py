"""MuJoCo's actuators -> which joints are actuated, by how much at most, and what they add to the joint."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from octo.model.robot_file import RobotFile, import_mujoco


def joint_actuation(source: RobotFile, j: int) -> tuple[bool, float, float]:
    """Of MuJoCo's joint ``j``: actuated, torque limit (N m or N, of |u|), gear (torque per unit of control)."""
    model = source.model
    if source.effort is not None:
        name = model.joint(j).name
        return True, source.effort[name], 1.0
    actuators = actuators_of(model, j)
    if not actuators:
        return False, math.inf, 1.0
    limit = sum(torque_limit(model, a) for a in actuators)
    if model.jnt_actfrclimited[j]:
        limit = min(limit, float(np.abs(model.jnt_actfrcrange[j]).max()))
    return True, limit, gear(model, actuators[0])


def actuators_of(model: Any, j: int) -> list[int]:
    return [a for a in range(model.nactuator) if drives_joint(model, a) and model.actuator_trnid[a, 0] == j]


def reflected(model: Any, j: int, field: Any) -> float:
    """What a property of its actuators (inertia, damping) is at joint ``j``: times the square of the gear."""
    return sum(_transmission(model, a) ** 2 * float(field[a]) for a in actuators_of(model, j))


def control_index(model: Any, a: int) -> int:
    """Index of the first control of actuator ``a``: an actuator may have several."""
    return int(model.actuator_ctrladr[a])


def drives_joint(model: Any, a: int) -> bool:
    kinds = import_mujoco().mjtTrn
    return int(model.actuator_trntype[a]) in (int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT))


def is_motor(model: Any, a: int) -> bool:
    """Whether the actuator's force is a constant times its control."""
    mujoco = import_mujoco()
    kinds = (model.actuator_gaintype[a], model.actuator_biastype[a], model.actuator_dyntype[a])
    plain = (mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtDyn.mjDYN_NONE)
    return [int(kind) for kind in kinds] == [int(kind) for kind in plain]


def gear(model: Any, a: int) -> float:
    """Joint torque per unit of control of a motor; of force for any other actuator."""
    strength = float(model.actuator_gainprm[a, 0]) if is_motor(model, a) else 1.0
    return _transmission(model, a) * strength


def torque_limit(model: Any, a: int) -> float:
    """N m or N: the tighter of control range (of a motor) and force range, through the gear."""
    force = math.inf
    if model.actuator_forcelimited[a]:
        force = float(np.abs(model.actuator_forcerange[a]).max())
    control = control_index(model, a)
    if is_motor(model, a) and model.actuator_ctrllimited[control]:
        strength = abs(float(model.actuator_gainprm[a, 0]))
        force = min(force, strength * float(np.abs(model.actuator_ctrlrange[control]).max()))
    return abs(_transmission(model, a)) * force if math.isfinite(force) else math.inf


def _transmission(model: Any, a: int) -> float:
    """Signed ratio of a hinge or slide; the length of the torque axis of a ball joint."""
    six = model.actuator_gear[a]
    return float(six[0]) if not six[1:].any() else float(np.linalg.norm(six))
