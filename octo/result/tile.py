"""A solved cycle carried on for some strides: ``Solution.tile``."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo.checks import whole
from octo.errors import ProblemError
from octo.result.trajectory import VECTORS, AnyTrajectory

Array = NDArray[np.float64]


def tiled(motion: AnyTrajectory, strides: int) -> AnyTrajectory:
    """``strides`` whole strides of a solved cycle, one after the other, without ``unknowns``.

    Of a mirrored one ``violation`` and ``pointwise_residual`` are those of the image too, which is
    larger where the robot is not exactly its own mirror image.

    Raises
    ------
    ProblemError: the motion is no cycle. ValueRangeError: fewer than one stride.
    """
    stride = motion.cycle
    if stride is None:
        raise ProblemError(
            "this motion is no cycle, it cannot be tiled: solve a Problem with cycle=octo.Cycle(…)"
        )
    pieces = whole("strides", strides) * (2 if stride.mirrored else 1)
    names = ("u", "contact_depth", *VECTORS)
    made: dict[str, list[Array]] = {name: [getattr(motion, name)] for name in names}
    made["x"] = [motion.x[2:]]
    for _ in range(pieces - 1):
        last = {name: blocks[-1] for name, blocks in made.items()}
        made["x"].append(stride.on(last["x"]))
        made["u"].append(last["u"] @ stride.torque.T)
        made["contact_depth"].append(last["contact_depth"][:, stride.contacts])
        for name in VECTORS:
            turned = last[name][:, stride.contacts] @ stride.rotation.T
            made[name].append(turned + stride.shift if name == "contact_point" else turned)
    joined: dict[str, Any] = {name: np.concatenate(blocks) for name, blocks in made.items()}
    joined["x"] = np.concatenate([motion.x[:2], joined["x"]])
    for name in ("violation", "pointwise_residual"):
        joined[name] = max(getattr(motion, name), stride.asymmetry)
    return replace(
        motion,
        **joined,
        ground=_plane_around(motion.ground, joined["contact_point"]),
        cycle=stride.times(pieces),
        unknowns=motion.unknowns[:0],
    )


def _plane_around(ground: dict[str, Array], points: Array) -> dict[str, Array]:
    """The sampled plane of a cycle under all of ``points`` (N, c, 3) m."""
    if not ground:
        return ground
    (x, y, z), margin = (ground[name] for name in "xyz"), 1.0
    slope_x, slope_y = (z[-1, 0] - z[0, 0]) / (x[-1] - x[0]), (z[0, -1] - z[0, 0]) / (y[-1] - y[0])
    (low, high) = (extreme(points.reshape(-1, 3), axis=0)[:2] for extreme in (np.min, np.max))
    wide = [
        np.linspace(min(a[0], lo - margin), max(a[-1], hi + margin), 2)
        for a, lo, hi in zip((x, y), low, high, strict=True)
    ]
    height = z[0, 0] + slope_x * (wide[0] - x[0])[:, None] + slope_y * (wide[1] - y[0])[None]
    return {"x": wide[0], "y": wide[1], "z": height}
