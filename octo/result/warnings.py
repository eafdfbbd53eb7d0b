"""What a result says beside its status: steps that are too long to be seen through.

A residual looks at three neighbouring configurations and at nothing between them. A coordinate that
changes by more than a radian or a metre from one to the next may have gone round the other way, or
through the ground, at no cost.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from octo.result.trajectory import Trajectory

LEAP = 1.0  # rad or m, that a coordinate may change in a step
GRAVITY = 9.81  # m/s²


def largest_step(motion: Trajectory) -> dict[str, Any] | None:
    """The largest change of a coordinate from one node to the next.

    None of a motion without steps, or of one that is not finite.
    """
    change = np.abs(np.diff(motion.x[1:], axis=0))  # (N, nx) rad and m
    if not change.size or not np.isfinite(change).all():
        return None
    step, coordinate = np.unravel_index(int(np.argmax(change)), change.shape)
    leaps = int((change > LEAP).any(axis=1).sum())
    return {
        "change": float(change[step, coordinate]),
        "unit": _unit(motion, int(coordinate)),
        "coordinate": motion.joint_names[int(coordinate)],
        "step": int(step),
        "time": float(motion.dt * step),  # s, at its beginning
        "leaps": leaps,  # steps in which a coordinate changes by more than LEAP
    }


def _unit(motion: Trajectory, coordinate: int) -> str:
    if motion.character is None:
        return "rad or m"
    return "rad" if motion.character.joints[coordinate].kind == "hinge" else "m"


def warnings(motion: Trajectory) -> tuple[str, ...]:
    """A sentence for each of what a reader should know before using the motion."""
    said = []
    largest = largest_step(motion)
    if largest is not None and largest["change"] > LEAP:
        leaps = largest["leaps"]
        many = f"{leaps} steps change" if leaps > 1 else "one step changes"
        said.append(
            f"{many} a coordinate by more than {LEAP:g} rad or m ({largest['coordinate']} by "
            f"{largest['change']:.3g} {largest['unit']} at {largest['time']:.3g} s): between two "
            "nodes no law of physics is looked at, take a smaller dt"
        )
    fall = float(np.sqrt(motion.length / GRAVITY))
    if motion.character is not None and motion.dt > fall:
        said.append(
            f"dt is {motion.dt:g} s, and in {fall:.2g} s this robot falls by half its height: "
            "take a smaller dt"
        )
    return tuple(said)
