"""A solution in one figure: centre of mass, contact forces, torques, convergence."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from octo.checks import STILLS, Array, ending
from octo.result.even import even
from octo.result.solution import Solution
from octo.saved import Motion, motion_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from octo.figure import Figure

COLORS = ("#2f6db2", "#d0703c", "#4f9a57", "#8c6aaa", "#b0892f", "#6b7785")
STYLE = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e6e8eb",
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "axes.edgecolor": "#8a9099",
    "xtick.color": "#4a4f57",
    "ytick.color": "#4a4f57",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
}
HISTORIES = (
    ("energy", "E (objective)"),
    ("violation", "‖C‖∞ (N), largest violation of a constraint"),
)
MOST_ROWS = 32  # contacts or joints in one panel; those that carry least are left out
MOST_LINES = 6  # with more joints than these the torques are an image
Panel = Callable[[Solution, "Axes"], None]


def plot(solution: Motion, path: str | os.PathLike[str] | None = None) -> Figure:
    """Draw the solution; write it to ``path`` (.png, .pdf, .svg) where one is given. A notebook
    shows what is returned.

    The solution may also be a Log, or the path of what octo wrote.

    Centre of mass and its velocity (coordinates, for user-written dynamics), normal force of every
    contact that ever carries load, torques in parts of their limits, E and ‖C‖∞ over the
    iterations.

    Raises
    ------
    MissingExtraError: matplotlib is not installed. OutputError: the file's ending is none of these.
    """
    if path is not None:
        path = ending("path", path, STILLS)
    from octo.figure import Figure, matplotlib

    solution = motion_of(solution)
    rows: list[tuple[float, list[Panel]]] = [(2.2, [_position, _velocity])]
    if solution.loaded.any():
        count = 1 if solution.soft is not None else int(solution.loaded.any(axis=0).sum())
        rows.append((_height(count), [_contacts]))
    if solution.u.size:
        nu = solution.u.shape[1]
        rows.append((_height(nu) if nu > MOST_LINES else 2.4, [_torques]))
    if len(solution.history.get("energy", ())):
        rows.append((2.2, [partial(_convergence, shown=k) for k in (0, 1)]))
    with matplotlib.rc_context(STYLE):
        heights = [height for height, _ in rows]
        figure = Figure(figsize=(11.0, sum(heights) + 0.65 * len(rows) + 0.7), layout="constrained")
        figure.suptitle(_headline(solution), x=0.01, ha="left", fontsize=9.5)
        grid = figure.add_gridspec(len(rows), 2, height_ratios=heights)
        for r, (_, panels) in enumerate(rows):
            for k, panel in enumerate(panels):
                axes = figure.add_subplot(grid[r, k] if len(panels) == 2 else grid[r, :])
                panel(solution, axes)
                for when in _joints(solution) if axes.get_xlabel() == "time (s)" else ():
                    axes.axvline(when, color="#8a9099", lw=0.8, ls=":")
        if path is not None:
            figure.savefig(path, dpi=120)
    return figure


def _height(count: int) -> float:
    """inches, of a panel with one row for each of ``count`` things."""
    return 0.5 + 0.22 * min(max(count, 3), MOST_ROWS)


def _headline(solution: Solution) -> str:
    sentence = solution.status.value
    if solution.converged:
        sentence = sentence.partition(":")[0]
    steps = f"{solution.sampling} ({solution.basis})"
    lines = [
        f"{solution.name}, {steps}: {sentence}",
        f"E = {solution.energy:.4g}, ‖C‖∞ = {solution.violation:.1e} N, pointwise "
        f"{solution.pointwise_residual:.1e} N of {solution.weight:.0f} N weight; "
        f"{solution.iterations} iterations, {solution.seconds:.2g} s",
    ]
    if solution.loaded.any():
        what = "feet sink" if solution.soft is None else "it sinks"
        lines[1] += f"; {what} {1e3 * solution.penetration:.1f} mm, slip {solution.slip:.3f} m/s"
    return "\n".join(lines)


def _joints(solution: Solution) -> Array:
    """s, when a phase begins but the first."""
    return np.cumsum([phase.steps * phase.dt for phase in solution.phases[:-1]])


def _position(solution: Solution, axes: Axes) -> None:
    names, values = _followed(solution)
    _lines(axes, solution.times, values, names)
    custom = solution.extent is None
    axes.set(title="coordinates (rad, m)" if custom else "centre of mass (m)", xlabel="time (s)")


def _velocity(solution: Solution, axes: Axes) -> None:
    names, values = _followed(solution)
    if solution.extent is None:
        rate, times, title = solution.v, solution.times, "their rates (rad/s, m/s)"
    else:
        rate = np.diff(values, axis=0) / solution.intervals[:, None]
        times = solution.times[1:]
        title = "its velocity (m/s)"
    _lines(axes, times, rate[:, : len(names)], names)
    axes.set(title=title, xlabel="time (s)")


def _followed(solution: Solution) -> tuple[tuple[str, ...], Array]:
    """Names and values (N+1, k) of the first row of panels."""
    if solution.extent is not None:
        return ("x", "y", "z"), solution.com
    return solution.joint_names[:MOST_LINES], solution.x[1:, :MOST_LINES]


def _lines(axes: Axes, times: Array, values: Array, names: tuple[str, ...]) -> None:
    look = {"lw": 1.5, "ms": 4, "marker": "o" if len(times) < 3 else ""}
    for k, name in enumerate(names):
        axes.plot(times, values[:, k], color=COLORS[k % len(COLORS)], label=name, **look)
    if names:
        axes.legend(ncols=min(len(names), 3), loc="best", handlelength=1.2)
    axes.margins(x=0.01)


def _contacts(solution: Solution, axes: Axes) -> None:
    """One strip per contact, filled up to the normal force, in the same scale for all; one for
    all of a soft body's surface."""
    every, called = solution.normal_force, solution.contact_names
    ever = np.asarray(solution.loaded.any(axis=0))
    if solution.soft is not None:
        every, called, ever = every.sum(axis=1, keepdims=True), ("surface",), np.ones(1, dtype=bool)
    force, names, left_out = _chosen_rows(every, called, ever)
    edges = solution.times
    top = max(float(force.max()), 1e-12)
    for row, name in enumerate(names):
        base = len(names) - 1 - row
        color = COLORS[row % len(COLORS)]
        share = 0.9 * np.maximum(force[:, row], 0.0) / top
        axes.stairs(base + share, edges, baseline=base, fill=True, color=color, alpha=0.8, lw=0)
        axes.axhline(base, color="#c4c9d0", lw=0.6, zorder=0)
        place = {"transform": axes.get_yaxis_transform(), "ha": "right", "va": "center"}
        axes.text(-0.005, base + 0.3, name, fontsize=8.5, **place)
    axes.set(ylim=(-0.1, len(names)), yticks=[], xlim=(0.0, edges[-1]), xlabel="time (s)")
    scale = f"a full strip is {top:.3g} N; the weight is {solution.weight:.3g} N"
    axes.set_title(f"normal force ({scale}){left_out}")
    axes.grid(False, axis="y")


def _torques(solution: Solution, axes: Axes) -> None:
    limit = solution.torque_limit
    limited = np.isfinite(limit) & (limit > 0.0)
    scale = np.where(limited, limit, np.maximum(np.abs(solution.u).max(axis=0, initial=0.0), 1e-12))
    pairs = zip(solution.actuated_names, limited, strict=True)
    names = tuple(name + ("" if has else " *") for name, has in pairs)
    mixed = limited.any() and not limited.all()
    what = "torque" if solution.soft is None else "force"
    title = f"{what} / limit" + (" (* no limit: / its largest)" if mixed else "")
    if len(names) <= MOST_LINES:
        shown = solution.u / scale if limited.any() else solution.u
        for k, name in enumerate(names if limited.any() else solution.actuated_names):
            look = {"color": COLORS[k], "lw": 1.4, "label": name}
            axes.stairs(shown[:, k], solution.times, baseline=None, **look)
        if limited.any() and np.abs(shown).max() > 0.5:
            for side in (-1.0, 1.0):
                axes.axhline(side, color="#b3261e", lw=0.8, ls="--")
        axes.legend(ncols=len(names), loc="best", handlelength=1.2)
        units = "N m, N" if solution.soft is None else "N kg^-½"
        axes.set(title=title if limited.any() else f"{what} ({units})")
        axes.set(xlabel="time (s)", xlim=(0.0, solution.times[-1]))
        return
    solution = even(solution)  # an image has columns of one width
    title = title if limited.any() else f"{what} / its largest"
    used = np.ones(len(names), dtype=bool)
    share, names, left_out = _chosen_rows(solution.u / scale, names, used)
    reach = float(np.clip(np.quantile(np.abs(share), 0.995), 0.1, 1.0))
    extent = (0.0, float(solution.times[-1]), len(names) - 0.5, -0.5)
    colors = {"cmap": "RdBu_r", "vmin": -reach, "vmax": reach}
    image = axes.imshow(share.T, aspect="auto", interpolation="nearest", extent=extent, **colors)
    axes.set_yticks(range(len(names)), names, fontsize=8.5)
    axes.tick_params(axis="y", length=0)
    axes.grid(False)
    axes.set_title(f"{title}; the largest is {np.abs(solution.u / scale).max():.2f}{left_out}")
    axes.set_xlabel("time (s)")
    bar = axes.figure.colorbar(image, ax=axes, pad=0.01, fraction=0.025, extend="both")
    bar.outline.set_visible(False)


def _chosen_rows(
    values: Array, names: tuple[str, ...], used: NDArray[np.bool_]
) -> tuple[Array, tuple[str, ...], str]:
    """Columns that are ``used``, the largest MOST_ROWS in their order; a note on the rest."""
    columns = np.flatnonzero(used)
    left_out = len(columns) - MOST_ROWS
    if left_out > 0:
        columns = np.sort(columns[np.argsort(-np.abs(values[:, columns]).max(axis=0))[:MOST_ROWS]])
    note = f"; {left_out} smaller ones are not shown" if left_out > 0 else ""
    return values[:, columns], tuple(names[k] for k in columns), note


def _convergence(solution: Solution, axes: Axes, shown: int) -> None:
    """One column of the history over all iterations, passes as bands."""
    (name, title), color = HISTORIES[shown], COLORS[shown]
    values = np.asarray(solution.history[name], dtype=float)
    number = np.asarray(solution.history["pass"])
    count = np.arange(len(values))
    starts = np.flatnonzero(np.diff(number, prepend=number[:1] - 1))
    ends = np.append(starts[1:], len(values))
    for start, end in zip(starts, ends, strict=True):
        if len(starts) > 1 and number[start] % 2 == 0:
            axes.axvspan(start - 0.5, end - 0.5, color="#f1f3f6", lw=0, zorder=0)
        if len(starts) > 1 and end - start > 0.04 * len(values):
            where, look = 0.5 * (start + end - 1), {"fontsize": 8, "color": "#7a808a"}
            place = {"transform": axes.get_xaxis_transform(), "ha": "center", "va": "top"}
            axes.text(where, 0.98, f"{number[start]:g}", **place, **look)
        marker = "o" if len(values) < 3 else ""
        axes.plot(count[start:end], values[start:end], color=color, lw=1.2, marker=marker, ms=4)
    if (values > 0.0).any():
        axes.set_yscale("log", nonpositive="mask")
    passes = ", passes in bands" if len(starts) > 1 else ""
    axes.set(title=title, xlabel=f"iteration{passes}")
    axes.margins(x=0.01)
