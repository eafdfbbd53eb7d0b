"""What MuJoCo says about the robot a character was read from: the same configuration, its poses,
its mass matrix."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import mujoco
import numpy as np

from octo.model import urdf
from octo.model.character import Character
from octo.model.kinematics import body_poses


def urdf_model(path: Path, floating: bool = True) -> mujoco.MjModel:
    """MuJoCo's model of a URDF without its meshes, with the file's inertias also where MuJoCo's
    compiler refuses them."""
    prepared = urdf.prepare(path)
    for link in prepared.tree.iter("link"):
        for collision in link.findall("collision"):
            link.remove(collision)
    spec = urdf.make_spec(prepared)
    if floating:
        spec.body(prepared.root).add_freejoint()
    model = spec.compile()
    for name, inertial in prepared.inertials.items():
        moments, axes = np.linalg.eigh(inertial.inertia)
        axes = axes * np.sign(np.linalg.det(axes))
        body = model.body(name)
        body.mass[:], body.inertia[:], body.ipos[:] = inertial.mass, moments, inertial.com
        mujoco.mju_mat2Quat(body.iquat, axes.ravel())
        # a shortcut of the compiled, other inertia
        body.sameframe[:] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def qpos_of(character: Character, model: mujoco.MjModel, x: np.ndarray) -> np.ndarray:
    """MuJoCo's configuration (nq,) of x (nx,), joint by joint by name."""
    qpos = model.qpos0.copy()
    for address, kind, first in _addresses(character, model):
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            qpos[address : address + 3] = x[:3]
            mujoco.mju_euler2Quat(qpos[address + 3 : address + 7], x[3:6], character.chart)
        elif kind == mujoco.mjtJoint.mjJNT_BALL:
            mujoco.mju_euler2Quat(qpos[address : address + 4], x[first : first + 3], "zyx")
        else:
            qpos[address] = x[first]
    return qpos


@lru_cache(maxsize=8)
def _addresses(character: Character, model: mujoco.MjModel) -> list[tuple[int, int, int]]:
    """Of every joint of MuJoCo's that the character has: its place in qpos, its kind, its place in
    x."""
    index = {joint.name: k for k, joint in enumerate(character.joints)}
    found = []
    for j in range(model.njnt):
        name, kind = model.joint(j).name or f"joint{j}", int(model.jnt_type[j])
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            base = character.bodies[character.base_body].name
            if (
                character.base == "floating"
                and (model.body(model.jnt_bodyid[j]).name or base) == base
            ):
                found.append((int(model.jnt_qposadr[j]), kind, 0))
        else:
            first = f"{name}_z" if kind == mujoco.mjtJoint.mjJNT_BALL else name
            found.append((int(model.jnt_qposadr[j]), kind, index[first]))
    return found


def velocity_map(
    character: Character, model: mujoco.MjModel, x: np.ndarray, h: float = 1e-4
) -> np.ndarray:
    """∂qvel/∂ẋ (nv, nx) at x, by central differences on the manifold of configurations, fourth
    order."""
    T = np.zeros((model.nv, character.nx))
    for address, kind, first in _addresses(character, model):
        dof = int(model.jnt_dofadr[np.flatnonzero(model.jnt_qposadr == address)[0]])
        if kind in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            T[dof, first] = 1.0
            continue
        for j in range(first, first + (6 if kind == mujoco.mjtJoint.mjJNT_FREE else 3)):
            step = np.eye(character.nx)[j] * h
            for factor, weight in ((1.0, 4.0 / 3.0), (2.0, -1.0 / 3.0)):
                ahead, behind = (
                    qpos_of(character, model, x + s * factor * step) for s in (1.0, -1.0)
                )
                difference = np.zeros(model.nv)
                mujoco.mj_differentiatePos(model, difference, 2.0 * factor * h, behind, ahead)
                T[:, j] += weight * difference
    return T


def mass_matrix_of(character: Character, model: mujoco.MjModel, x: np.ndarray) -> np.ndarray:
    """MuJoCo's mass matrix (nx, nx) in the coordinates x."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos_of(character, model, x)
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    T = velocity_map(character, model, x)
    return T.T @ full @ T


def pose_errors(character: Character, model: mujoco.MjModel, x: np.ndarray) -> float:
    """Largest difference of position (m) and rotation of the character's bodies from MuJoCo's at
    x."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos_of(character, model, x)
    mujoco.mj_kinematics(model, data)
    rotation, origin = body_poses(character, x)
    worst = 0.0
    for b, body in enumerate(character.bodies):
        k = (
            model.body(body.name).id
            if not body.name.startswith("body")
            else _body_id(model, body.name)
        )
        worst = max(
            worst,
            np.abs(data.xpos[k] - origin[b]).max(),
            np.abs(data.xmat[k].reshape(3, 3) - rotation[b]).max(),
        )
    return worst


def _body_id(model: mujoco.MjModel, name: str) -> int:
    """Of a body by name, or of a nameless one by the number in the name octo gave it."""
    found = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name)
    return found if found >= 0 else int(name.removeprefix("body"))


def mass_matrix_by_differences(character: Character, x: np.ndarray, h: float = 1e-4) -> np.ndarray:
    """The character's mass matrix (nx, nx) from central differences of its poses, fourth order."""
    velocity, spin = [], []  # (nx, bodies, 3) of the centres of mass, (nx, bodies, 3) angular
    com = np.array([body.com for body in character.bodies])
    rotation, _ = body_poses(character, x)
    for j in range(character.nx):
        step = np.eye(character.nx)[j] * h
        center, turn = 0.0, 0.0
        for factor, weight in ((1.0, 4.0 / 3.0), (2.0, -1.0 / 3.0)):
            (R1, t1), (R0, t0) = (body_poses(character, x + s * factor * step) for s in (1.0, -1.0))
            moved = (t1 + np.einsum("bij,bj->bi", R1, com)) - (
                t0 + np.einsum("bij,bj->bi", R0, com)
            )
            center = center + weight * moved / (2.0 * factor * h)
            turn = turn + weight * (R1 - R0) / (2.0 * factor * h)
        cross = turn @ np.swapaxes(rotation, 1, 2)
        velocity.append(center)
        spin.append(np.stack([cross[:, 2, 1], cross[:, 0, 2], cross[:, 1, 0]], axis=1))
    v, w = np.array(velocity), np.array(spin)
    mass = np.array([body.mass for body in character.bodies])
    inertia = np.array(
        [R @ body.inertia @ R.T for R, body in zip(rotation, character.bodies, strict=True)]
    )
    M = np.einsum("b,ibk,jbk->ij", mass, v, v) + np.einsum("ibk,bkl,jbl->ij", w, inertia, w)
    return M + np.diag([joint.armature for joint in character.joints])


def relative_difference(M: np.ndarray, expected: np.ndarray) -> float:
    """Largest difference of two mass matrices, every entry scaled by the diagonal."""
    scale = np.sqrt(np.diag(expected))
    return float(np.abs((M - expected) / np.outer(scale, scale)).max())
