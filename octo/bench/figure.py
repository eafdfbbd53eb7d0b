"""The records as a figure: an iteration against steps and degrees, dynamics, other solvers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from octo.bench.plan import Plan
from octo.bench.timing import Records
from octo.solver.rule import STAGES

COLORS = {"linearize": "#2f6db2", "factor": "#d0703c", "solve": "#e3b04b", "evaluate": "#4f9a57"}
SOLVERS = {"octo": "#2f6db2", "ipopt": "#d0703c", "fatrop": "#4f9a57"}
SHADES = {"fd": "#b9cfe8", "fd_jacobian": "#6f9ed1", "curvature": "#2f6db2"}
WORDS = {"fd": "FD", "fd_jacobian": "and its Jacobian", "curvature": "and its curvature"}
Panel = Callable[[Any, Records, Plan], None]


def draw(records: Records, plan: Plan, title: str, path: Path) -> None:
    """The panels of the groups that were measured.

    Raises
    ------
    MissingExtraError: matplotlib is not there.
    """
    from octo.figure import Figure

    groups = {record.name.partition(".")[0] for record in records.made}
    panels = [panel for group, panel in PANELS.items() if group in groups]
    columns = max(1, min(2, len(panels)))
    rows = max(1, -(-len(panels) // columns))
    figure = Figure(figsize=(5.5 * columns, 3.6 * rows + 0.4), layout="constrained")
    figure.suptitle(title, x=0.01, ha="left", fontsize=9.5)
    for k, panel in enumerate(panels):
        axes = figure.add_subplot(rows, columns, k + 1)
        axes.grid(True, axis="y", color="#e6e8eb", linewidth=0.7)
        axes.set_axisbelow(True)
        panel(axes, records, plan)
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=130, format="png")


def _against_steps(axes: Any, records: Records, plan: Plan) -> None:
    names = [f"iteration.nodes.{steps}" for steps in plan.nodes]
    stages = np.array([[records[f"{name}.{stage}"] for name in names] for stage in STAGES])
    labels = [f"nodes: {stage}" for stage in STAGES]
    axes.stackplot(plan.nodes, stages, colors=COLORS.values(), labels=labels, alpha=0.85)
    sizes = np.array([0, max(*plan.nodes, *plan.hermite)])
    for basis, steps, mark in (("nodes", plan.nodes, "ko"), ("hermite", plan.hermite, "k^")):
        slope, constant = (records[f"iteration.{basis}.{name}"] for name in ("slope", "constant"))
        whole = [records[f"iteration.{basis}.{count}"] for count in steps]
        axes.plot(steps, whole, mark, ms=4, label=f"{basis}, whole")
        line = "k-" if basis == "nodes" else "k:"
        axes.plot(sizes, (slope * sizes + constant) / 1e3, line, lw=0.9)
    axes.set(title="one iteration of the mammal, one core", xlabel="steps N", ylabel="ms")
    axes.set(ylim=(0, None), xlim=(0, None))


def _against_degrees(axes: Any, records: Records, plan: Plan) -> None:
    names = [f"degrees.chain{links}" for links in plan.links]
    degrees = np.array([records[f"{name}.dof"] for name in names])
    base = np.zeros(len(names))
    for stage in STAGES:
        values = np.array([records[f"{name}.{stage}"] for name in names])
        axes.bar(degrees, values, 1.5, bottom=base, color=COLORS[stage], alpha=0.85, label=stage)
        base += values
    for name in plan.staged:
        if f"degrees.{name}" in records:
            at = (records[f"degrees.{name}.dof"], records[f"degrees.{name}"])
            axes.plot(*at, "kD", ms=4)
            axes.annotate(name, at, (-6, 5), textcoords="offset points", ha="right", fontsize=8)
    axes.margins(y=0.12)
    ends = f"{plan.links[0]} to {plan.links[-1]} links"
    axes.set(title=f"one iteration, chains of {ends}, N = {plan.steps}")
    axes.set(xlabel="degrees of freedom", ylabel="µs a step")


def _dynamics(axes: Any, records: Records, plan: Plan) -> None:
    labels = [f"{name}\n{records[f'dynamics.{name}.dof']:.0f} DOF" for name in plan.robots]
    places = np.arange(len(labels))
    before = np.zeros(len(labels))
    for order, color in SHADES.items():
        values = np.array([records[f"dynamics.{name}.{order}"] for name in plan.robots])
        axes.bar(places, values - before, 0.7, bottom=before, color=color, label=WORDS[order])
        before = values
    axes.set_xticks(places, labels, fontsize=8)
    axes.set(title="the dynamics of one step, one core", ylabel="µs a step")


def _solvers(axes: Any, records: Records, plan: Plan) -> None:
    ticks: list[tuple[float, str]] = []
    place = 0.0
    for basis in ("nodes", "hermite"):
        shown = [name for name in SOLVERS if f"solvers.{basis}.{name}.time" in records]
        for name in shown:
            seconds = records[f"solvers.{basis}.{name}.time"]
            axes.bar(place, seconds, 0.8, color=SOLVERS[name])
            text = f"{seconds:.2g} s\n{records[f'solvers.{basis}.{name}.iterations']:.0f} its"
            look = {"textcoords": "offset points", "ha": "center", "fontsize": 7.5}
            axes.annotate(text, (place, seconds), (0, 2), **look)
            ticks.append((place, f"{name}\n{basis}"))
            place += 1.0
        place += 0.5
    axes.set_xticks([at for at, _ in ticks], [words for _, words in ticks], fontsize=8)
    axes.margins(y=0.2)
    starts = f"medians over {plan.seeds} starts" if plan.seeds > 1 else "one start"
    axes.plot([], [], " ", label=starts)
    axes.set(title=f"a walk of {plan.motion_steps} steps of the mammal, solved")
    axes.set_ylabel("s of one core")


PANELS: dict[str, Panel] = {
    "iteration": _against_steps,
    "degrees": _against_degrees,
    "dynamics": _dynamics,
    "solvers": _solvers,
}
