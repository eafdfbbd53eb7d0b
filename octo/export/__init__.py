"""A motion in the formats of animators: animated glTF, BVH, video."""

from __future__ import annotations

import os

from octo.checks import ANIMATED, MOST_STEPS, asked, ending, flag, numbers, positive, whole
from octo.errors import ModelError, OutputError, ProblemError, ValueRangeError
from octo.export.bvh import write_bvh
from octo.export.film import write_film
from octo.export.gltf import write_gltf
from octo.result.solution import Solution
from octo.saved import Motion, motion_of

FASTEST = {".gif": 50.0}  # frames a second; browsers slow a faster one down to 10
FASTEST_OTHER = 1000.0


@asked
def export(
    solution: Motion,
    path: str | os.PathLike[str],
    fps: float = 30.0,
    repeat: int = 1,
    *,
    visuals: bool = True,
) -> None:
    """Write a motion as animated glTF (.glb), BVH (.bvh) or video (.mp4, .gif).

    Between two nodes the coordinates x change linearly, as on the page of :func:`octo.view`.

    A .glb has the bodies as nodes, with their meshes and materials, key frames of translation and
    rotation, the ground and the shapes of a world; metres, y up. A soft body has a morph target for
    each mode. Beside the frames it has as many
    key frames as it takes for every body to be within 0.1 mm of the motion at all times. A .bvh is
    the robot's skeleton alone, in metres and degrees, y up: a root with six channels, joints with
    three. Objects are left out, which is warned of. A video shows the character in front of a
    camera that travels with it.

    Parameters
    ----------
    solution: a Solution, a Log, or the path of what octo wrote.
    path: the file, written beside and then renamed.
    fps: frames a second, the first at t = 0; of a .gif at most 50.
    repeat: so many whole strides of a cycle, one after the other.
    visuals: the robot looks as its file says; False: as the shapes that octo computes with.

    Raises
    ------
    MissingExtraError: the library of that format is not installed. ModelError: user-written
        dynamics have no bodies; BVH has no joints that slide, and no soft bodies.
    ProblemError: ``repeat`` of a motion that is no cycle. ValueRangeError: ``fps``, ``repeat``, a
        motion that is not finite.
    OutputError: the file cannot be written, or its ending is none of these.
    """
    target = ending("path", path, ANIMATED)
    kind = target.suffix.lower()
    if target.is_dir():
        raise OutputError(f"path is {str(target)!r}, which is a folder, must be a file's")
    rate, most = positive("fps", fps, "a second"), FASTEST.get(kind, FASTEST_OTHER)
    if rate > most:
        raise ValueRangeError(f"fps is {rate:g}, must be at most {most:g} of a {kind} file")
    count, looks = whole("repeat", repeat), flag("visuals", visuals)
    motion = repeated(motion_of(solution), count)
    if motion.extent is None:
        raise ModelError(
            "export needs a character: a motion of user-written dynamics has no bodies"
        )
    if motion.soft is not None and kind == ".bvh":
        raise ModelError("a soft body has no joints, a .bvh is of joints: write a .glb or a video")
    numbers("x of the motion", motion.x)
    if kind == ".glb":
        write_gltf(motion, target, rate, looks)
    elif kind == ".bvh":
        write_bvh(motion, target, rate)
    else:
        write_film(motion, target, rate, looks)


def repeated(motion: Solution, count: int) -> Solution:
    """``count`` whole strides of a cycle; a motion that is none as it is."""
    if motion.cycle is None:
        if count > 1:
            raise ProblemError(f"repeat is {count}, must be 1: this motion is no cycle")
        return motion
    pieces = count * (2 if motion.cycle.mirrored else 1)
    if pieces * motion.steps > MOST_STEPS:
        most = MOST_STEPS * count // (pieces * motion.steps)
        raise ValueRangeError(f"repeat is {count}, must be at most {most} of this cycle")
    return motion if pieces == 1 else motion.tile(count)
