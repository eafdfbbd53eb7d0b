"""MuJoCo's compiled model -> Character: trees, welded links fused, joints, masses."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from octo.errors import RobotFileError
from octo.model.actuators import BallMotors, Motor, ball_motors, joint_motor, reflected
from octo.model.body import Body, Joint, floating_base, joined
from octo.model.character import Character
from octo.model.chart import Chart, chart_angles, least_singular_chart
from octo.model.contacts import Contacts, contact_spheres, self_collision_pairs
from octo.model.looks import carried
from octo.model.mass_matrix import check_mass_matrix
from octo.model.quantities import LARGEST, Array
from octo.model.quaternions import rotation_of
from octo.model.robot_file import Carrier, Limit, RobotFile, import_mujoco, name_of, named
from octo.model.solids import solids_of

WORDS = {"pos": "position", "quat": "rotation", "ipos": "centre of mass"}
# of the hinges of a ball joint; the body's own axes unless its motors pull about others
BALL_CHART = "zyx"


@dataclass
class Tree:
    """The character's bodies as they are collected, and where every MuJoCo body went."""

    chart: Chart = "zyx"
    bodies: list[Body] = field(default_factory=list)
    source: list[int] = field(default_factory=list)  # MuJoCo's index of each body
    carriers: dict[int, Carrier] = field(default_factory=dict)
    fused: list[tuple[str, str]] = field(default_factory=list)
    # MuJoCo's ball joints -> axes (3, 3) of the hinges, outermost first
    balls: dict[int, Array] = field(default_factory=dict)


def character_of(
    source: RobotFile, dropped: Iterable[str] = (), contacts: Contacts = "few", solid: bool = False
) -> Character:
    """The character of a compiled model: links welded together become one body, masses are kept
    exactly. ``solid``: others may touch its bodies."""
    model, notes = source.model, list(dropped)
    _check_numbers(source)
    tree = Tree()
    if source.free_body is not None:
        tree.chart = least_singular_chart(rotation_of(model.body_quat[source.free_body]))
    with named(source.file):
        for b in _body_order(source):
            _add_body(tree, source, b, notes)
    if tree.fused:
        notes.append(
            "links welded to their parents are fused into them: "
            f"{', '.join(f'{a} into {b}' for a, b in tree.fused)}"
        )
    base: Literal["floating", "fixed"] = "fixed" if source.free_body is None else "floating"
    with named(source.file):
        bodies = tuple(_with_mass(tree, source, k) for k in range(len(tree.bodies)))
        pose = configuration(tree, source, model.qpos0)
        plain = Character(source.name, bodies, base=base, chart=tree.chart, default_pose=pose)
    if plain.nx == 0:
        raise RobotFileError(
            f"{source.file}: has no joints and nothing moves; base='floating' makes its body free"
        )
    check_mass_matrix(plain, source.file)
    with named(source.file):
        spheres = contact_spheres(plain, source, tree.carriers, notes, contacts)
        model = source.model
        poses = {
            name_of(model, "key", k): configuration(tree, source, model.key_qpos[k])
            for k in range(model.nkey)
        }
        character = replace(
            plain,
            contacts=spheres,
            dropped=tuple(notes),
            poses=poses,
            looks=carried(source.looks, tree.carriers),
            solids=solids_of(source, tree.carriers, notes) if solid else (),
        )
    return replace(character, pairs=self_collision_pairs(character))


def _check_numbers(source: RobotFile) -> None:
    """Refuse places and sizes that are no numbers, or too large to be reckoned with."""
    fields = {
        "body": ("pos", "quat", "ipos", "mass", "inertia"),
        "jnt": ("pos", "axis"),
        "geom": ("pos", "quat", "size"),
    }
    for kind, names in fields.items():
        for name in names:
            values = getattr(source.model, f"{kind}_{name}")
            values = values[:, None] if values.ndim == 1 else values
            bad = np.argwhere(~(np.abs(values) <= LARGEST))
            if kind == "geom" and len(bad):
                bad = bad[source.model.geom_type[bad[:, 0]] != import_mujoco().mjtGeom.mjGEOM_PLANE]
            if len(bad):
                index, column = (int(k) for k in bad[0])
                element = {"jnt": "joint"}.get(kind, kind)
                which = f"{element} {name_of(source.model, element, index)!r}"
                if kind == "geom":
                    body = int(source.model.geom_bodyid[index])
                    which += f" of body {name_of(source.model, 'body', body)!r}"
                what = f"{WORDS.get(name, name)} has the entry {values[index, column]}"
                raise RobotFileError(
                    f"{source.file}: {which}: {what}, must be finite and at most {LARGEST:.0e}"
                )


def _body_order(source: RobotFile) -> list[int]:
    """MuJoCo's bodies of the robot, parents first, the floating tree before all others."""
    model = source.model
    kept = [b for b in range(1, model.nbody) if b not in source.left_out]
    if source.free_body is None:
        return kept
    root = model.body_rootid[source.free_body]
    return sorted(kept, key=lambda b: model.body_rootid[b] != root)


def _add_body(tree: Tree, source: RobotFile, b: int, notes: list[str]) -> None:
    model = source.model
    position, rotation = model.body_pos[b].copy(), rotation_of(model.body_quat[b])
    parent = tree.carriers.get(int(model.body_parentid[b]))
    name = name_of(model, "body", b)
    welded = model.body_jntnum[b] == 0 and b != source.free_body
    if parent is not None:
        position = parent.position + parent.rotation @ position
        rotation = parent.rotation @ rotation
        if welded:
            tree.carriers[b] = Carrier(parent.body, rotation, position)
            tree.fused.append((name, tree.bodies[parent.body].name))
            return
    elif welded and not _holds_anything(model, b):
        return
    if b == source.free_body:
        joints = _free_joints(model, b, tree.chart, notes)
        position, rotation = np.zeros(3), np.eye(3)
    else:
        made = [_joints(tree, source, j, notes) for j in _joints_of(model, b)]
        joints = tuple(joint for group in made for joint in group)
    tree.carriers[b] = Carrier(len(tree.bodies), np.eye(3), np.zeros(3))
    above = -1 if parent is None else parent.body
    tree.bodies.append(Body(name, above, joints, position, rotation))
    tree.source.append(b)


def _holds_anything(model: Any, b: int) -> bool:
    """Whether a body fixed to the world has mass or carries what moves: marks do not."""
    if model.body_subtreemass[b] > 0.0:
        return True
    return any(
        model.body_jntnum[c] > 0 and model.body_rootid[c] == model.body_rootid[b]
        for c in range(b, model.nbody)
    )


def _joints_of(model: Any, b: int) -> range:
    return range(model.body_jntadr[b], model.body_jntadr[b] + model.body_jntnum[b])


def _free_joints(model: Any, b: int, chart: Chart, notes: list[str]) -> tuple[Joint, ...]:
    """The floating base, with the armature and damping of the file's free joint if it has one."""
    endings = [joint.name.removeprefix("base") for joint in floating_base("base", chart)]
    joints = floating_base(_free_prefix(model, "base", endings), chart)
    if model.body_jntnum[b] == 0:
        return joints
    first = model.body_dofadr[b]
    armature, damping = model.dof_armature[first : first + 6], model.dof_damping[first : first + 6]
    if armature[3:].any() or damping[3:].any():
        notes.append(
            f"armature and damping of the free joint of {name_of(model, 'body', b)}: taken about "
            "yaw, pitch and roll"
        )
    return tuple(
        replace(j, armature=float(a), damping=float(d))
        for j, a, d in zip(joints, armature, damping, strict=True)
    )


def _free_prefix(model: Any, prefix: str, endings: list[str]) -> str:
    """``prefix``, with underscores in front while the file has joints of names made of it."""
    taken = {name_of(model, "joint", j) for j in range(model.njnt)}
    while any(prefix + ending in taken for ending in endings):
        prefix = f"_{prefix}"
    return prefix


def _joints(tree: Tree, source: RobotFile, j: int, notes: list[str]) -> tuple[Joint, ...]:
    """Of MuJoCo's joint ``j``: itself, a ball's three hinges, nothing of a removed free one."""
    mujoco, model = import_mujoco(), source.model
    kind, name, dof = model.jnt_type[j], name_of(model, "joint", j), model.jnt_dofadr[j]
    if kind == mujoco.mjtJoint.mjJNT_FREE:
        return ()
    common = {
        "anchor": model.jnt_pos[j].copy(),
        "armature": float(model.dof_armature[dof]) + reflected(model, j, model.actuator_armature),
        "damping": float(model.dof_damping[dof]) + reflected(model, j, model.actuator_damping),
        "stiffness": float(model.jnt_stiffness[j]),
    }
    if kind == mujoco.mjtJoint.mjJNT_BALL:
        ball = ball_motors(model, j)
        notes.append(_ball_note(model, j, name, ball))
        tree.balls[j] = ball.axes
        prefix = _free_prefix(model, name, [f"_{c}" for c in BALL_CHART])
        return tuple(
            Joint(f"{prefix}_{c}", "hinge", axis, **_driven(motor), **common)
            for c, axis, motor in zip(BALL_CHART, ball.axes, ball.motors, strict=True)
        )
    address = model.jnt_qposadr[j]
    lower, upper = model.jnt_range[j] if model.jnt_limited[j] else (-math.inf, math.inf)
    limit = Limit(lower, upper) if source.limits is None else source.limits[name]
    return (
        Joint(
            name,
            "slide" if kind == mujoco.mjtJoint.mjJNT_SLIDE else "hinge",
            model.jnt_axis[j].copy(),
            lower=float(limit.lower),
            upper=float(limit.upper),
            velocity_limit=limit.velocity,
            reference=float(model.qpos0[address]),
            rest=float(model.qpos_spring[address]),
            **_driven(joint_motor(source, j)),
            **common,
        ),
    )


def _driven(motor: Motor) -> dict[str, Any]:
    return {"actuated": motor.actuated, "torque_limit": motor.limit, "gear": motor.gear}


def _ball_note(model: Any, j: int, name: str, ball: BallMotors) -> str:
    extra = []
    if model.jnt_limited[j]:
        extra.append(f"its cone limit of {model.jnt_range[j, 1]:.3g} rad is left out")
    dof = model.jnt_dofadr[j]
    if model.dof_armature[dof] or model.dof_damping[dof] or model.jnt_stiffness[j]:
        extra.append("armature, damping and spring act about each hinge")
    extra += [ball.note] if ball.note else []
    about = "about z, y, x"
    if not np.array_equal(ball.axes, np.eye(3)[::-1]):
        about += " of axes in which x is its motor's"
    return "; ".join([f"ball joint {name} is three hinges {about} (singular at y = ±90°)", *extra])


def _with_mass(tree: Tree, source: RobotFile, k: int) -> Body:
    """Body ``k`` with mass, centre of mass and inertia of all links fused into it."""
    parts = []
    for b, carrier in tree.carriers.items():
        own = source.inertial(b)
        if carrier.body == k and (own.mass > 0.0 or own.inertia.any()):
            R = carrier.rotation
            parts.append((own.mass, carrier.position + R @ own.com, R @ own.inertia @ R.T))
    mass, com, inertia = joined(parts)
    return replace(tree.bodies[k], mass=mass, com=com, inertia=inertia)


def configuration(tree: Tree, source: RobotFile, qpos: Array) -> Array:
    """x (nx,) of MuJoCo's qpos (nq,)."""
    mujoco, model = import_mujoco(), source.model
    x: list[float] = []
    for b in tree.source:
        if b == source.free_body and model.body_jntnum[b] == 0:
            x += [*model.body_pos[b], *chart_angles(rotation_of(model.body_quat[b]), tree.chart)]
        for j in _joints_of(model, b):
            address = model.jnt_qposadr[j]
            if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_FREE:
                if b == source.free_body:
                    turn = rotation_of(qpos[address + 3 : address + 7])
                    x += [*qpos[address : address + 3], *chart_angles(turn, tree.chart)]
            elif model.jnt_type[j] == mujoco.mjtJoint.mjJNT_BALL:
                frame = tree.balls[j][::-1]  # (3, 3) rows x', y', z'
                turn = frame @ rotation_of(qpos[address : address + 4]) @ frame.T
                x += chart_angles(turn, BALL_CHART)
            else:
                x.append(qpos[address])
    return np.array(x, dtype=float)
