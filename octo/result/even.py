"""A motion of phases at equal steps, for whoever counts time in steps: pictures, gaits, replays."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from octo.result.trajectory import ROWS, Trajectory

T = TypeVar("T", bound=Trajectory)


def even(motion: T) -> T:
    """The same motion as one of steps that are all equally long, about as long as the shortest of
    its own; itself where it has no phases.

    Configurations are interpolated linearly; torques and contacts are those of the step in whose
    time a new one's middle is.
    """
    if not motion.phases:
        return motion
    own = motion.intervals
    if np.ptp(own) == 0.0:
        return replace(motion, phases=())
    duration = float(motion.times[-1])
    count = round(duration / float(own.min()))
    return resampled(motion, duration / count, count)


def resampled(motion: T, dt: float, count: int) -> T:
    """The same motion as ``count`` steps of ``dt`` s, in the same way; what of it is later is left
    out."""
    times, wanted = motion.times, dt * np.arange(count + 1)
    nodes = [np.interp(wanted, times, column) for column in motion.x[1:].T]
    x = np.stack(nodes, axis=1)
    first = x[:1] - dt * motion.v[:1]  # x_{-1}
    step = np.searchsorted(times, wanted[:-1] + 0.5 * dt, side="right") - 1
    made: dict[str, Any] = {name: getattr(motion, name)[step] for name in ROWS}
    made |= {"x": np.concatenate([first, x]), "dt": dt, "unknowns": motion.unknowns[:0]}
    return replace(motion, **made, phases=())
