"""Where the bodies of a motion are at the moments of its frames, and between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from octo.model.kinematics import body_poses
from octo.model.quantities import Array
from octo.model.quaternions import quaternions
from octo.result.trajectory import Trajectory

NEAR_END = 1e-6  # of a frame: how far behind the last one the end of the motion may be
OFF = 5e-5  # m, that a body may be off between two keys: half of what is promised
HALVINGS = 12  # of the time between two nodes
BLOCK = 256  # frames that are refined at a time


def frame_times(motion: Trajectory, fps: float) -> Array:
    """(frames,) s, 0, 1/fps … up to the end of the motion."""
    return np.arange(int(motion.times[-1] * fps + NEAR_END) + 1) / fps


def configurations(motion: Trajectory, times: Array) -> Array:
    """(k, nx) at times (k,) s, linear between two nodes."""
    return np.stack([np.interp(times, motion.times, column) for column in motion.x[1:].T], axis=1)


def poses_of(motion: Trajectory, x: Array) -> tuple[Array, Array]:
    """Rotations (k, bodies, 3, 3) and origins (k, bodies, 3) m in the world at x (k, nx); of a soft
    body those of its frame."""
    if motion.soft is not None:
        return motion.soft.rotation(x)[:, None], x[:, None, :3]
    assert motion.character is not None
    return body_poses(motion.character, x)


def parents_of(motion: Trajectory) -> NDArray[np.intp]:
    """(bodies,) the body that each one is on, -1 of those in the world."""
    robot = motion.character
    bodies = () if robot is None else robot.bodies
    return np.array([body.parent for body in bodies] or [-1], dtype=np.intp)


def on_parents(motion: Trajectory, x: Array) -> tuple[Array, Array]:
    """Quaternions (k, bodies, 4), real part first, and origins (k, bodies, 3) m of every body in
    the frame of its parent at x (k, nx)."""
    R, t = poses_of(motion, x)
    parent = parents_of(motion)
    inner = np.flatnonzero(parent >= 0)
    back = R[:, parent[inner]].swapaxes(-1, -2)
    place = t.copy()
    apart = t[:, inner] - t[:, parent[inner]]
    place[:, inner] = (back @ apart[..., None])[..., 0]
    turn = R.copy()
    turn[:, inner] = back @ R[:, inner]
    return np.stack([quaternions(turn[:, b]) for b in range(len(parent))], axis=1), place


def key_times(motion: Trajectory, fps: float, reach: Array) -> Array:
    """(k,) s, exact in single precision: the frames and the end, and between them what it takes for
    bodies of ``reach`` (bodies,) m to be where the motion has them, with rotations and translations
    on parents interpolated as glTF does it."""
    nodes = _single(motion.times)
    frames = np.union1d(_single(frame_times(motion, fps)), nodes[-1:])
    blocks = []
    for start in range(0, max(len(frames) - 1, 1), BLOCK):
        own = frames[start : start + BLOCK + 1]
        inside = nodes[(nodes >= own[0]) & (nodes <= own[-1])]
        blocks.append(_refined(motion, own, inside, reach))
    return np.unique(np.concatenate(blocks))


def _single(times: Array) -> Array:
    return np.asarray(times, dtype=np.float32).astype(float)


def _refined(motion: Trajectory, keys: Array, nodes: Array, reach: Array) -> Array:
    for _ in range(HALVINGS):
        known = np.union1d(keys, nodes)
        halves = _single(0.5 * (known[1:] + known[:-1]))
        checked = np.setdiff1d(np.union1d(known, halves), keys)
        if not len(checked):
            break
        wrong = checked[_off(motion, keys, checked, reach) > OFF]
        at_nodes = np.intersect1d(wrong, nodes)  # where a motion has its corners
        keys = np.union1d(keys, at_nodes if len(at_nodes) else wrong)
        if not len(wrong):
            break
    return keys


def _off(motion: Trajectory, keys: Array, times: Array, reach: Array) -> Array:
    """(k,) m, how far any body is off at times (k,) when it is interpolated between keys."""
    known, wanted = configurations(motion, keys), configurations(motion, times)
    turn, place = on_parents(motion, known)
    index = np.clip(np.searchsorted(keys, times, side="right") - 1, 0, len(keys) - 2)
    share = ((times - keys[index]) / (keys[index + 1] - keys[index]))[:, None]
    found: list[tuple[Array, Array]] = []
    for b, parent in enumerate(parents_of(motion)):
        R = _between(turn[index, b], turn[index + 1, b], share)
        t = (1.0 - share) * place[index, b] + share * place[index + 1, b]
        if parent >= 0:
            outer, origin = found[parent]
            R, t = outer @ R, origin + (outer @ t[..., None])[..., 0]
        found.append((R, t))
    R, t = poses_of(motion, wanted)
    off = [
        np.linalg.norm(own_t - t[:, b], axis=1)
        + reach[b] * np.linalg.norm(own_R - R[:, b], axis=(1, 2)) / np.sqrt(2.0)
        for b, (own_R, own_t) in enumerate(found)
    ]
    if motion.soft is not None:  # and the points on it
        bent = (1.0 - share) * known[index, 6:] + share * known[index + 1, 6:] - wanted[:, 6:]
        off[0] = off[0] + np.abs(bent) @ np.linalg.norm(motion.soft.body.modes, axis=2).max(axis=0)
    return np.max(off, axis=0, initial=0.0)


def _between(first: Array, second: Array, share: Array) -> NDArray[np.float64]:
    """Rotations (k, 3, 3) on the shortest way (slerp) from quaternions (k, 4) to others."""
    start, end = (Rotation.from_quat(q[:, [1, 2, 3, 0]]) for q in (first, second))
    way = (start.inv() * end).as_rotvec()
    return np.asarray((start * Rotation.from_rotvec(share * way)).as_matrix())
