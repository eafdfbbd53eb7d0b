"""The figures of benchmarks.markovian, from its records: Fig. 11a–d."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from benchmarks.markovian import DT, HORIZONS, LOSSES, NETWORKS, SPEEDS, STARTS, STEPS
from octo.plot import COLORS, STYLE

Record = dict[str, Any]
NAMES = {"plain": "Algorithm 1", "markovian": "Algorithm 2"}


def panels(count: int, height: float) -> tuple[Any, Any]:
    figure = Figure(figsize=(9.0, height), layout="constrained")
    return figure, figure.subplots(1, count)


def draw_gaits(gaits: Record, path: Path) -> None:
    """Fig. 11a and b: when each foot stands, start 0 of each task, without and with E_RNN."""
    with matplotlib.rc_context(STYLE):
        figure, places = panels(len(SPEEDS), 2.6)
        for axes, task in zip(places, SPEEDS, strict=True):
            drawn = gaits[f"{task}-0"]["drawn"]
            labels = []
            for row, (way, color) in enumerate(zip(("markovian", "plain"), COLORS, strict=False)):
                for k, (foot, own) in enumerate(sorted(drawn[way].items())):
                    spans = [(a, b - a) for a, b in zip(own["begins"], own["ends"], strict=True)]
                    height = 2.4 * row + k
                    axes.broken_barh(spans, (height - 0.4, 0.8), color=color)
                    labels.append((height, f"{foot.replace('_', ' ')}, {NAMES[way]}"))
            axes.set_yticks([h for h, _ in labels], [text for _, text in labels])
            axes.set(xlabel="s", title=f"{task}: whole stances", xlim=(0.0, STEPS * DT))
        figure.savefig(path, dpi=100)


def draw_unevenness(gaits: Record, path: Path) -> None:
    """Unevenness of all starts against their velocity error."""
    with matplotlib.rc_context(STYLE):
        figure, places = panels(len(SPEEDS), 3.2)
        for axes, task in zip(places, SPEEDS, strict=True):
            own = [gaits[f"{task}-{seed}"] for seed in range(STARTS)]
            told = {
                "more starts of Algorithm 1": [one for cell in own for one in cell["more"][1:]],
                "Algorithm 1": [cell["plain"] for cell in own],
                "Algorithm 2": [cell["markovian"] for cell in own],
            }
            for (name, ones), color in zip(told.items(), ("#b9bfc7", *COLORS[1::-1]), strict=True):
                points = [(o["velocity_error"], o["unevenness"]) for o in ones if o["unevenness"]]
                axes.scatter(*np.array(points).reshape(-1, 2).T, color=color, label=name, s=22)
            axes.set(xlabel="velocity error, rms (m/s)", title=task, xlim=(0, None), ylim=(0, None))
        places[0].set_ylabel("unevenness")
        places[0].legend()
        figure.savefig(path, dpi=100)


def draw_convergence(cell: Record, path: Path) -> None:
    """Fig. 11c: E + λ E_RNN over the iterations of all motions, with a dot at each training."""
    with matplotlib.rc_context(STYLE):
        figure, axes = panels(1, 2.8)
        at = 0
        for curve, own in zip(cell["curves"], cell["markovian"]["rounds"], strict=True):
            energy = curve.get("energy", [])
            axes.semilogy(at + np.arange(len(energy)), energy, color=COLORS[0], lw=1.0)
            at += len(energy)
            axes.plot(at, own["after"], "o", color="black", ms=4)
        axes.set(xlabel="iteration of the motion", ylabel="E + λ E_RNN")
        axes.set_title("Algorithm 2: a dot where the network was trained")
        figure.savefig(path, dpi=100)


def draw_stability(cells: Record, path: Path) -> None:
    """Fig. 11d: how far the unrolled networks are from the stride, at each control."""
    with matplotlib.rc_context(STYLE):
        figure, places = panels(2, 3.2)
        for axes, which in zip(places, ("phase_free", "equal_time"), strict=True):
            for k, own in enumerate(cells.values()):
                errors = np.array([np.nan if e is None else e for e in own["each"][which]])
                times = np.arange(1, len(errors) + 1) * HORIZONS * own["horizon"] / len(errors)
                equation = {"one_step": "Eq. 14", "recurrent": "Eq. 16"}[own["loss"]]
                layers = "×".join(str(size) for size in NETWORKS[own["network"]]["hidden"])
                label = f"{layers}, {equation}"
                axes.semilogy(times, errors, color=COLORS[k % len(COLORS)], lw=1.1, label=label)
            axes.axvline(own["horizon"], color="#888888", lw=0.8, ls="--")
            axes.set(xlabel="s", title=f"{which.replace('_', ' ')} error", ylim=(1e-3, 1e2))
        places[0].set_ylabel("rad, ℓ")
        places[0].legend()
        figure.savefig(path, dpi=100)


def draw_all(found: Record, folder: Path) -> None:
    """Each figure whose cells are all there."""
    folder.mkdir(parents=True, exist_ok=True)
    gaits, stable = found.get("gaits", {}), found.get("stability", {})
    if len(gaits) == STARTS * len(SPEEDS):
        draw_gaits(gaits, folder / "learn_gaits.png")
        draw_unevenness(gaits, folder / "learn_unevenness.png")
    if "walk-0" in gaits:
        draw_convergence(gaits["walk-0"], folder / "learn_rounds.png")
    if len(stable) == len(NETWORKS) * len(LOSSES):
        draw_stability(stable, folder / "learn_stability.png")
