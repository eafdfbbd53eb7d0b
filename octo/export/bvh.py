"""A motion as BVH: the robot's skeleton, and the angles of its joints frame by frame.

A joint of BVH turns about one point and cannot slide, and at rest its axes are those of its parent.
So the skeleton is the robot's at zero displacements of all joints, and a joint's rotation is what
its hinges turn by, in the axes of the world at rest. The file's axes are glTF's: y up, z to the
right.
"""

from __future__ import annotations

import itertools
import logging
import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from octo.errors import ModelError
from octo.export.moments import configurations, frame_times
from octo.files import replacing
from octo.model.body import Joint
from octo.model.character import Character
from octo.model.chart import angles_of
from octo.model.kinematics import axis_rotation, body_poses
from octo.model.quantities import Array
from octo.result.trajectory import Trajectory

LOG = logging.getLogger("octo")
AXES = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # octo's to the file's
SAME = 1e-9  # m, between the points of two hinges that are one joint
STEEP = 0.98  # sine of the middle angle from which on other axes are looked for
SHORTEST = 0.01  # m, of the last bone of a limb, which has no other end
Order = tuple[int, int, int]  # axes x, y, z as 0, 1, 2, outermost first


@dataclass(eq=False)
class Bone:
    """A joint of the file.

    Attributes
    ----------
    parent: its number; -1 of the root. place: (3,) m, in the world at rest.
    rest: (3, 3) the axes of ``body``, whose hinges it has, in the world at rest.
    """

    name: str
    parent: int
    body: int
    place: Array
    rest: Array
    joints: list[int] = field(default_factory=list)
    tip: Array | None = None  # (3,) m, in the world at rest, where it has no child
    order: Order = (0, 1, 2)


def write_bvh(motion: Trajectory, target: Path, fps: float) -> None:
    """Write ``target`` (.bvh); raises as :func:`octo.export` does."""
    character = motion.character
    assert character is not None
    bones = skeleton(character)
    with replacing(target) as beside:
        x = configurations(motion, frame_times(motion, fps))
        columns = []
        for bone in bones:
            place, turn = _moved(character, bone, x)
            bone.order = _order(turn, _native(character, bone))
            columns += [place] if bone.parent < 0 else []
            columns.append(np.degrees(_angles(turn, bone.order)))
        with beside.open("w", encoding="utf-8") as file:
            file.writelines(f"{line}\n" for line in _hierarchy(bones, 0))
            file.write(f"MOTION\nFrames: {len(x)}\nFrame Time: {1.0 / fps:.9g}\n")
            np.savetxt(file, np.concatenate(columns, axis=1), fmt="%.6f")
    if character.objects:
        LOG.warning(
            "%s has the robot's skeleton, not the objects (%s): a .glb has both",
            target.name,
            ", ".join(character.objects),
        )


def skeleton(character: Character) -> list[Bone]:
    """The robot's joints, each before those that it carries, limb by limb: as the file has them.

    Raises
    ------
    ModelError: a joint slides that is not the root's.
    """
    rest, origin = body_poses(character, np.array([j.reference for j in character.joints]))
    own = np.flatnonzero(character.own & ~character.of_objects).tolist()
    roots = [b for b in own if character.bodies[b].parent < 0]
    bones, carrier = list[Bone](), dict[int, int]()
    if len(roots) > 1:  # each is a limb of what stands still
        bones.append(Bone(_word(character.name), -1, -1, np.zeros(3), np.eye(3)))
    for b in own:
        body, first = character.bodies[b], int(character.first_joint[b])
        joints = list(range(first, first + len(body.joints)))
        if b in roots and len(roots) == 1:
            bones.append(Bone(_word(body.name), -1, b, origin[b], rest[b], joints))
            carrier[b] = 0
            continue
        carrier[b] = carrier.get(body.parent, 0)
        for number, group in enumerate(_groups(character, joints)):
            name = _word(body.name) + (f"_{number + 1}" if number else "")
            place = origin[b] + rest[b] @ character.joints[group[0]].anchor
            bones.append(Bone(name, carrier[b], b, place, rest[b], group))
            carrier[b] = len(bones) - 1
    _add_tips(character, bones, carrier, rest, origin)
    return _by_limb(bones)


def _by_limb(bones: list[Bone]) -> list[Bone]:
    """Depth first, with the parents' new numbers."""
    order, left = list[int](), [0]
    while left:
        order.append(left.pop())
        left += [k for k in reversed(range(len(bones))) if bones[k].parent == order[-1]]
    number = {old: new for new, old in enumerate(order)} | {-1: -1}
    return [replace(bones[old], parent=number[bones[old].parent]) for old in order]


def _groups(character: Character, joints: list[int]) -> list[list[int]]:
    """Hinges that turn about one point, outermost first."""
    groups: list[list[int]] = []
    for j in joints:
        joint = character.joints[j]
        if joint.kind == "slide":
            raise ModelError(
                f"joint {joint.name!r} of {character.name!r} slides, which BVH cannot say; "
                "a .glb can"
            )
        last = character.joints[groups[-1][0]].anchor if groups else None
        if last is not None and np.abs(joint.anchor - last).max() < SAME:
            groups[-1].append(j)
        else:
            groups.append([j])
    return groups


def _add_tips(
    character: Character, bones: list[Bone], carrier: dict[int, int], rest: Array, origin: Array
) -> None:
    """Where bones without a child end: at what they carry that is farthest."""
    ends: dict[int, list[Array]] = {}
    for b, k in carrier.items():
        spheres = [contact.position for contact in character.contacts if contact.body == b]
        for point in (np.zeros(3), character.bodies[b].com, *spheres):
            ends.setdefault(k, []).append(origin[b] + rest[b] @ point)
    for k in {*range(len(bones))} - {bone.parent for bone in bones}:
        bone = bones[k]
        bone.tip = max(ends[k], key=lambda end: float(np.linalg.norm(end - bone.place)))
        if np.linalg.norm(bone.tip - bone.place) < SHORTEST:
            bone.tip = bone.place - [0.0, 0.0, SHORTEST]


def _moved(character: Character, bone: Bone, x: Array) -> tuple[Array, Array]:
    """Places (k, 3) m and rotations (k, 3, 3) of a joint on its parent at x (k, nx), in the file's
    axes; the root's are in the world."""
    turn = np.broadcast_to(np.eye(3), (len(x), 3, 3))
    place = np.broadcast_to(bone.place, (len(x), 3))
    if bone.parent < 0 and bone.body >= 0:
        R, t = body_poses(character, x)
        turn, place = R[:, bone.body] @ bone.rest.T, t[:, bone.body]
    else:
        for j in bone.joints:
            joint = character.joints[j]
            turn = turn @ axis_rotation(joint.axis, x[:, j] - joint.reference)
        turn = bone.rest @ turn @ bone.rest.T
    return place @ AXES.T, AXES @ turn @ AXES.T


def _native(character: Character, bone: Bone) -> Order:
    """The axes that the joint's hinges turn about, as far as these are the file's; where there are
    two, the third is between them, and nothing turns about it."""
    hinges: list[Joint] = [character.joints[j] for j in bone.joints]
    turned = [AXES @ bone.rest @ hinge.axis for hinge in hinges if hinge.kind == "hinge"]
    found = list(dict.fromkeys(int(np.argmax(np.abs(axis))) for axis in turned))[:3]
    left = [axis for axis in range(3) if axis not in found]
    first, second, third = [*found[:1], *left, *found[1:]] if len(left) else found
    return first, second, third


def _order(turn: Array, native: Order) -> Order:
    """The joint's own order, unless its middle angle comes near a right angle, where the other two
    cannot be told apart, and leap if these are not the hinges': then the one that stays farthest
    from there, if any does."""
    sine = np.abs(turn).max(axis=0)  # of the middle angle, by the outer and the inner axis
    a, b, c = min(itertools.permutations(range(3)), key=lambda axes: sine[axes[0], axes[2]])
    steep = sine[native[0], native[2]] >= STEEP
    return (a, b, c) if steep and sine[a, c] < STEEP else native


def _angles(turn: Array, order: Order) -> NDArray[np.float64]:
    """(k, 3) rad about the axes of ``order``, each near the one before: no leap of a whole turn."""
    a, b, c = order
    names = [c, b, a]  # the rotation with its axes called z, y and x, outermost first
    renamed = turn[:, names][:, :, names]
    sign = np.linalg.det(np.eye(3)[names])  # turning the other way in axes that are left-handed
    angles, near = np.empty((len(turn), 3)), (0.0, 0.0, 0.0)
    for k, rotation in enumerate(renamed):
        near = angles_of(rotation, "zyx", near)
        angles[k] = near
    return sign * angles


def _hierarchy(bones: list[Bone], k: int) -> Iterator[str]:
    """The lines of joint ``k`` and of what it carries."""
    bone = bones[k]
    turns = " ".join(f"{'XYZ'[axis]}rotation" for axis in bone.order)
    if bone.parent < 0:
        yield from ("HIERARCHY", f"ROOT {bone.name}", "{", "\tOFFSET 0 0 0")
        yield f"\tCHANNELS 6 Xposition Yposition Zposition {turns}"
    else:
        yield from (f"JOINT {bone.name}", "{", _offset(bone.place - bones[bone.parent].place))
        yield f"\tCHANNELS 3 {turns}"
    for child in (c for c, other in enumerate(bones) if other.parent == k):
        yield from (f"\t{line}" for line in _hierarchy(bones, child))
    if bone.tip is not None:
        yield from ("\tEnd Site", "\t{", f"\t{_offset(bone.tip - bone.place)}", "\t}")
    yield "}"


def _offset(way: Array) -> str:
    return "\tOFFSET " + " ".join(f"{value:.9g}" for value in AXES @ way)


def _word(name: str) -> str:
    """A name without spaces, which would end it."""
    return re.sub(r"\s+", "_", name.strip()) or "_"
