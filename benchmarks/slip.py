"""When feet slip: speed of the point that touches at every time step of MuJoCo, against the time in
stance and the load."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from octo.model.feet import CARRYING
from octo.mpc import run
from octo.mpc.log import Log
from octo.plant import MujocoPlant

Array = NDArray[np.float64]
Part = dict[str, Any]
FRICTION = 0.8
# of the friction: a contact whose force is less is inside its cone, and gives where rigid friction
# would hold
STICKS = 0.95
AFTER, BEFORE = 0.02, 0.01  # s, of touchdown and of lift-off
EDGES_TIME = np.arange(0.0, 0.102, 0.004)  # s
EDGES_LOAD = np.array([0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0, 2.0])  # of the weight


class WatchedPlant(MujocoPlant):
    """Keeps force and velocity of each contact's lowest material point, (c, 3) N and m/s, at every
    time step."""

    def __init__(self, *arguments: Any, **described: Any):
        self.forces: list[Array] = []
        self.velocities: list[Array] = []
        super().__init__(*arguments, **described)

    def step(self, u: Array, seconds: float | None = None) -> None:
        super().step(u, seconds)
        force = self.contacts()[0]
        jacobian = self.feet(np.arange(len(force)))[1]
        self.forces.append(force)
        self.velocities.append(jacobian @ self.v)


def stances(loaded: NDArray[np.bool_], timestep: float) -> tuple[Array, Array]:
    """(k, feet) s since each foot was loaded, and until it no longer is; infinite where it is
    not."""
    since, until = np.full(loaded.shape, np.inf), np.full(loaded.shape, np.inf)
    for foot in range(loaded.shape[1]):
        edges = np.flatnonzero(np.diff(np.r_[0, loaded[:, foot].astype(int), 0]))
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            count = np.arange(end - begin)
            since[begin:end, foot] = timestep * count
            until[begin:end, foot] = timestep * (count[::-1] + 1)
    return since, until


def measure(log: Log, plant: WatchedPlant) -> tuple[Part, Part]:
    """What the record keeps, and what the figure draws: root mean squares and shares of the sum of
    squares."""
    force, velocity = np.array(plant.forces)[:, log.feet], np.array(plant.velocities)[:, log.feet]
    load = force[..., 2] / (9.81 * log.robot.mass)
    square = np.sum(velocity[..., :2] ** 2, axis=-1)
    loaded = load > CARRYING
    since, until = stances(loaded, plant.timestep)
    whole = float(square[loaded].sum())

    def part(chosen: NDArray[np.bool_]) -> Part:
        chosen = chosen & loaded
        rms = float(np.sqrt(square[chosen].mean())) if chosen.any() else 0.0
        return {
            "steps": float(chosen.sum() / loaded.sum()),
            "share": float(square[chosen].sum() / whole),
            "rms": rms,
        }

    landing = since < AFTER - 1e-9
    leaving = (until < BEFORE + 1e-9) & ~landing
    inside = np.linalg.norm(force[..., :2], axis=-1) < STICKS * FRICTION * force[..., 2]
    kept = {
        "every_tick": log.slip,
        "every_tick_mean": float(log.slip_speeds.mean()),
        "falls": len(log.falls),
        "every_step": part(loaded)["rms"],
        "every_step_mean": float(np.sqrt(square[loaded]).mean()),
        "first_20_ms": part(landing),
        "last_10_ms": part(leaving),
        "between": part(~landing & ~leaving),
        "under_a_tenth_of_the_weight": part(load < 0.1),
        "inside_the_friction_cone": part(inside),
        "landing_speed": float(np.sqrt(np.median(square[since == 0.0]))),
    }
    drawn = {
        name: [
            part((value >= a - 1e-9) & (value < b - 1e-9))
            for a, b in zip(edges[:-1], edges[1:], strict=True)
        ]
        for name, value, edges in (
            ("since", since, EDGES_TIME),
            ("until", until, EDGES_TIME),
            ("load", load, EDGES_LOAD),
        )
    }
    return kept, drawn


def draw(cases: dict[str, Part], path: Path) -> None:
    """Root mean square of slip by time and by load, of each case."""
    import matplotlib
    from matplotlib.figure import Figure

    from octo.plot import COLORS, STYLE

    titles = {
        "since": ("ms since the foot is loaded", 1e3 * EDGES_TIME),
        "until": ("ms until it is not", 1e3 * EDGES_TIME),
        "load": ("its load, of the weight", EDGES_LOAD),
    }
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9.0, 3.4), layout="constrained")
        for place, (what, (label, edges)) in zip(
            figure.subplots(1, 3, sharey=True), titles.items(), strict=True
        ):
            for k, (name, drawn) in enumerate(cases.items()):
                color = COLORS[k % len(COLORS)]
                rms = [p["rms"] for p in drawn[what]]
                place.stairs(rms, edges, color=color, lw=1.1, label=name)
            place.set(xlabel=label, yscale="log")
            place.axhline(0.05, color="#888888", lw=0.8, ls="--")
            if what == "load":
                place.set_xscale("log")
        figure.axes[0].set_ylabel("slip, rms (m/s)")
        figure.axes[0].legend(fontsize=7)
        figure.suptitle(
            "go2 in MuJoCo, 30 s: loaded feet slip while they land", x=0.01, ha="left", fontsize=11
        )
        figure.savefig(path, dpi=80)


def measure_all(
    set_out: Callable[..., Any], commands: dict[str, tuple[float, float, float]], path: Path
) -> dict[str, Any]:
    """All ``commands`` for 30 s on seed 0."""
    kept, drawn = {}, {}
    for name, command in commands.items():
        controller, plant = set_out("go2", command, 0, WatchedPlant)
        kept[name], drawn[name] = measure(run(controller, plant, 30.0, seed=0), plant)
    draw(drawn, path)
    return kept
