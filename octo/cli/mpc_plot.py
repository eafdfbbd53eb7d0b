"""A closed loop in one figure: command and motion, feet, torques, what the controller took."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import uniform_filter1d

from octo.checks import STILLS, ending
from octo.mpc.log import Log
from octo.plot import COLORS, STYLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from octo.figure import Figure


def plot_log(log: Log, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw the log; write it to ``path``, if given.

    Raises
    ------
    MissingExtraError: matplotlib is not installed. OutputError: the file's ending is not .png, .pdf
        or .svg.
    """
    if path is not None:
        path = ending("path", path, STILLS)
    from octo.figure import Figure, matplotlib

    panels = (_velocity, _base, _feet, _torque, _seconds, _plan)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9.0, 1.9 * len(panels)), layout="constrained")
        axes = figure.subplots(len(panels), 1, sharex=True)
        for draw, place in zip(panels, axes, strict=True):
            draw(log, place)
            for fall in log.falls:
                place.axvline(fall, color="#b3261e", lw=1.0, ls="--")
        axes[-1].set(xlabel="time (s)", xlim=(0.0, float(log.t[-1])))
        figure.suptitle(
            f"{log.robot.name}: {len(log.falls)} falls (dashed)", x=0.01, ha="left", fontsize=11
        )
        if path is not None:
            figure.savefig(path, dpi=110)
    return figure


def _velocity(log: Log, axes: Axes) -> None:
    for k, name in enumerate(("ahead (m/s)", "left (m/s)", "yaw rate (rad/s)")):
        axes.plot(log.t, _smooth(log.velocity[:, k], log.tick), color=COLORS[k], lw=1.2, label=name)
        axes.plot(log.t, log.wanted[:, k], color=COLORS[k], lw=0.8, ls=":")
    # being put back after a fall is no motion
    reach = 0.3 + 1.5 * float(np.abs(log.wanted).max(initial=0.0))
    axes.set_ylim(-reach, reach)
    axes.set_title("velocity of the centre of mass, mean over 0.2 s; command dotted")
    axes.legend(ncols=3, loc="lower right")


def _smooth(values: np.ndarray, tick: float) -> np.ndarray:
    width = max(1, round(0.2 / tick))
    return np.asarray(uniform_filter1d(values, width, mode="nearest"))


def _base(log: Log, axes: Axes) -> None:
    first = log.robot.base_coordinate
    for k, name in ((4, "middle angle (rad)"), (5, "inner angle (rad)"), (2, "height (m)")):
        color = COLORS[(k + 1) % len(COLORS)]
        axes.plot(log.t, log.x[:, first + k], lw=1.1, color=color, label=name)
    axes.set_title("base")
    axes.legend(ncols=3, loc="lower right")


def _feet(log: Log, axes: Axes) -> None:
    names = [log.robot.contacts[log.robot.terrain_contacts[c]].name for c in log.feet]
    for c, name in enumerate(names):
        height, color = 100.0 * log.foot_height[:, c], COLORS[c % len(COLORS)]
        axes.plot(log.t, height, lw=1.0, color=color, label=name)
    axes.set_title(f"feet over the ground (cm); they slip {log.slip:.3f} m/s rms")
    if names:
        axes.legend(ncols=min(len(names), 6), loc="upper right")


def _torque(log: Log, axes: Axes) -> None:
    limit = log.robot.torque_limit
    has = np.isfinite(limit) & (limit > 0.0)
    if has.any():
        given, planned = np.abs(log.u[:, has] / limit[has]).max(axis=1), np.minimum(log.excess, 3.0)
        axes.plot(log.t, given, lw=0.9, color=COLORS[0], label="given")
        axes.plot(log.t, planned, lw=0.9, color=COLORS[1], label="planned (cut at 3)")
        axes.legend(ncols=2, loc="upper right")
    axes.set_title("largest torque / limit")


def _seconds(log: Log, axes: Axes) -> None:
    axes.plot(log.t, 1e3 * log.seconds, lw=0.7, color=COLORS[0])
    latency = log.latency()
    title = f"step (ms): p50 {1e3 * latency['p50']:.2f}, p99 {1e3 * latency['p99']:.2f}"
    axes.set(title=title, yscale="log")


def _plan(log: Log, axes: Axes) -> None:
    axes.plot(log.t, log.violation, lw=0.8, color=COLORS[1])
    axes.set(title="‖C‖∞ of the plan (weights)", yscale="log")
