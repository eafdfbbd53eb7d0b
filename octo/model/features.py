"""What an MJCF says and octo does not model: one sentence each."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from octo.model.actuators import control_index, drives_joint, gears, is_motor
from octo.model.quantities import GRAVITY
from octo.model.robot_file import import_mujoco, name_of

# Flags of <option><flag> by which a file switches off something that octo models.
FLAGS = ("gravity", "spring", "damper", "contact", "limit", "actuation")


def left_out_features(model: Any, left_out: frozenset[int]) -> list[str]:
    """Sentences about what of the robot's part of ``model`` octo leaves out; ``left_out``: bodies
    that are not the robot's."""
    of_robot = [*_joint_features(model, left_out), *_actuator_features(model)]
    return [*of_robot, *_ties(model), *_world_features(model)]


def _listed(what: str, names: Iterable[str]) -> list[str]:
    names = list(names)
    return [f"{what}: {', '.join(names)}"] if names else []


def _joint_features(model: Any, left_out: frozenset[int]) -> list[str]:
    joints = [j for j in range(model.njnt) if int(model.jnt_bodyid[j]) not in left_out]
    bodies = [b for b in range(1, model.nbody) if b not in left_out]

    def named(condition: Any) -> list[str]:
        return [name_of(model, "joint", j) for j in joints if condition(j, model.jnt_dofadr[j])]

    rubbing = named(lambda j, d: model.dof_frictionloss[d] > 0.0)
    bent = named(lambda j, d: model.jnt_stiffnesspoly[j].any())
    damped = named(lambda j, d: model.dof_dampingpoly[d].any())
    plastic = named(lambda j, d: model.jnt_plasticadr[j] >= 0)
    heavy = [name_of(model, "body", b) for b in bodies if model.body_gravcomp[b] != 0.0]
    mocap = [name_of(model, "body", b) for b in bodies if model.body_mocapid[b] >= 0]
    return [
        *_listed("dry friction (frictionloss) of joints", rubbing),
        *_listed("springs that are not linear", bent),
        *_listed("damping that is not linear", damped),
        *_listed("plastic springs", plastic),
        *_listed("gravity compensation of bodies", heavy),
        *_listed("mocap bodies stand still", mocap),
    ]


def _actuator_features(model: Any) -> list[str]:
    mujoco = import_mujoco()
    sentences, laws, one_sided, idle = [], [], [], []
    owners: dict[int, list[str]] = {}
    for a in range(model.nactuator):
        name = name_of(model, "actuator", a)
        if not drives_joint(model, a):
            kind = mujoco.mjtTrn(model.actuator_trntype[a]).name.removeprefix("mjTRN_").lower()
            sentences.append(f"actuator {name} on a {kind}: only joints are actuated")
            continue
        j = int(model.actuator_trnid[a, 0])
        if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE:
            body = name_of(model, "body", int(model.jnt_bodyid[j]))
            sentences.append(f"actuator {name} on the free joint of {body}")
            continue
        if not model.actuator_gear[a, : gears(model, j)].any():
            idle.append(name)
            continue
        if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_BALL:  # of a ball joint its own note says it
            owners.setdefault(j, []).append(name)
        if not is_motor(model, a):
            laws.append(name)
        if _one_sided(model, a):
            one_sided.append(name)
    sentences += _listed("gear is zero of actuators, which then drive nothing", idle)
    sentences += _listed(
        "control laws (servo, activation, muscle), u is the torque at the joint, of actuators", laws
    )
    sentences += _listed(
        "ranges that are not symmetric, the larger side counts, of actuators", one_sided
    )
    for j, names in owners.items():
        if len(names) > 1:
            joint = name_of(model, "joint", j)
            sentences.append(
                f"joint {joint} has {len(names)} actuators ({', '.join(names)}): one torque, "
                "with the sum of their limits"
            )
    return sentences


def _one_sided(model: Any, a: int) -> bool:
    """Whether a range that bounds the torque of actuator ``a`` is not symmetric."""
    control = control_index(model, a)
    ranges = [(model.actuator_forcelimited[a], model.actuator_forcerange[a])]
    if is_motor(model, a):
        ranges.append((model.actuator_ctrllimited[control], model.actuator_ctrlrange[control]))
    return any(limited and not np.isclose(-lower, upper) for limited, (lower, upper) in ranges)


def _ties(model: Any) -> list[str]:
    """Equality constraints and tendons."""
    mujoco, sentences = import_mujoco(), []
    for e in range(model.neq):
        kind = mujoco.mjtEq(model.eq_type[e]).name.removeprefix("mjEQ_").lower()
        sentences.append(f"equality constraint {name_of(model, 'equality', e)} ({kind})")
    for t in range(model.ntendon):
        fields = ("limited", "stiffness", "damping", "armature", "frictionloss")
        acts = [field for field in fields if getattr(model, f"tendon_{field}")[t]]
        sentences.append(
            f"tendon {name_of(model, 'tendon', t)}{': ' if acts else ''}{', '.join(acts)}"
        )
    return sentences


def _world_features(model: Any) -> list[str]:
    option, sentences = model.opt, []
    if option.density or option.viscosity or np.any(option.wind):
        sentences.append(
            f"fluid (density {option.density:g} kg/m³, viscosity {option.viscosity:g} Pa s, wind)"
        )
    if not np.allclose(option.gravity, (0.0, 0.0, -GRAVITY), atol=0.02):
        gravity = ", ".join(f"{value:g}" for value in option.gravity)
        sentences.append(
            f"gravity ({gravity}) m/s²: gravity is a parameter of the problem, 9.81 down unless "
            "said otherwise"
        )
    bits = import_mujoco().mjtDisableBit
    switches = {flag: int(getattr(bits, f"mjDSBL_{flag.upper()}")) for flag in FLAGS}
    off = [flag for flag, bit in switches.items() if option.disableflags & bit]
    sentences += _listed("flags that switch off", off)
    if model.nflex and model.flex_rigid.all():
        sentences.append(f"{model.nflex} rigid flex bodies: their shapes touch nothing")
    if model.nplugin:
        sentences.append(f"{model.nplugin} plugins")
    if model.npair or {float(friction) for friction in model.geom_friction[:, 0]} - {1.0}:
        sentences.append(
            "contact parameters of geoms (friction, solref, margin): the contact law is the "
            "problem's"
        )
    if model.nexclude:
        sentences.append(
            f"{model.nexclude} contact exclusions: self-collision pairs are chosen by octo"
        )
    return sentences
