"""Fig. 11: gaits with and without Markovian regularisation, its convergence, and how long an
unrolled network is stable (section 8.5), by benchmarks.markovian.

Cells that benchmarks/results/markovian.json holds are measured anew with ``--again`` only.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from benchmarks import markovian
from benchmarks.paper.curves import every
from benchmarks.paper.page import Row, number, seconds

TITLE = "Markovian regularisation (Fig. 11)"
PANELS = 3
BENCHMARK = markovian
LOSSES = {"one_step": "Eq. 14", "recurrent": "Eq. 16"}
WAYS = {"plain": "Algorithm 1", "markovian": "Algorithm 2"}


def measure(short: bool) -> dict[str, Any]:
    """A summary of the cells of benchmarks.markovian; a short run has one of each, of two rounds
    and two seconds."""
    if not short:
        return summary(json.loads(markovian.RESULTS.read_text()))
    own, stride = markovian.repeating()
    found = {
        "gaits": {"walk-0": markovian.measure_gaits("walk", 0, steps=80, rounds=2)},
        "cycles": {"walk-0": markovian.measure_cycle("walk", 0)},
        "seconds": {"default": markovian.measure_seconds(steps=80, rounds=2)},
        "stability": {
            f"small-{loss}": markovian.measure_stability(own, stride, "small", loss, 20)
            for loss in LOSSES
        },
    }
    return summary(json.loads(json.dumps(found, default=markovian.plain_numbers)))


def summary(found: dict[str, Any]) -> dict[str, Any]:
    """What the figure and the page show."""
    tasks = dict.fromkeys(name.rpartition("-")[0] for name in found["gaits"])
    own = found["seconds"]["default"]
    return {
        "gaits": {task: _gaits(found, task) for task in tasks},
        "curve": _curve(found["gaits"]["walk-0"]),
        "seconds": {
            "rounds": len(own["rounds"]),
            "motion": own["motion"],
            "network": own["network"],
            "training": own["training"],
        },
        "stability": {name: _stability(one) for name, one in found["stability"].items()},
    }


def _gaits(found: dict[str, Any], task: str) -> dict[str, Any]:
    """Medians over the starts of a task, and each start's unevenness and velocity error."""
    cells = [own for name, own in found["gaits"].items() if name.startswith(f"{task}-")]
    cycles = [found["cycles"][name] for name in found["gaits"] if name.startswith(f"{task}-")]
    ways = {way: [cell[way] for cell in cells] for way in WAYS}
    best = [_most_even(cell["more"]) for cell in cells]
    return {
        "starts": len(cells),
        **{way: _medians(ones) for way, ones in ways.items()},
        "more": _median(best),
        "more_starts": float(np.median([len(cell["more"]) for cell in cells])),
        "cycles": _median([one["unevenness"] for one in cycles]),
        "points": {
            way: [[one["velocity_error"], one["unevenness"]] for one in ones]
            for way, ones in ways.items()
        },
    }


def _medians(ones: Sequence[dict[str, Any]]) -> dict[str, Any]:
    names = ("unevenness", "velocity_error", "energy", "seconds")
    own = {name: _median([one[name] for one in ones]) for name in names}
    stepping = sum(one["unevenness"] is not None for one in ones)
    return {**own, "converged": sum(one["converged"] for one in ones), "stepping": stepping}


def _median(values: Iterable[float | None]) -> float | None:
    """Of those that are known."""
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None


def _most_even(starts: Sequence[dict[str, Any]]) -> float | None:
    """The least unevenness of starts that converged."""
    known = [one["unevenness"] for one in starts if one["converged"]]
    return min((value for value in known if value is not None), default=None)


def _curve(cell: dict[str, Any]) -> dict[str, Any]:
    """E + λ E_RNN by iteration of the motion, and after each round."""
    energy: list[float] = []
    ends, after = [], []
    for curve, own in zip(cell["curves"], cell["markovian"]["rounds"], strict=True):
        energy += curve.get("energy", [])
        ends.append(len(energy))
        after.append(own["after"])
    values = np.array(energy)
    return {
        "iteration": every(np.arange(1, len(values) + 1), 300),
        "energy": every(values, 300),
        "ends": ends,
        "after": after,
    }


def _stability(one: dict[str, Any]) -> dict[str, Any]:
    """Errors of each horizon, None where the network exploded."""
    kept = ("loss", "iterations", "seconds", "horizon", "training_error", "phase_free")
    layers: Any = markovian.NETWORKS[one["network"]]["hidden"]
    return {"layers": " × ".join(map(str, layers)), **{name: one[name] for name in kept}}


def draw(records: dict[str, Any], axes: Any) -> None:
    """Unevenness, convergence, stability."""
    left, middle, right = axes
    for marker, (task, own) in zip("os", records["gaits"].items(), strict=False):
        for colour, (way, name) in zip(("C1", "C0"), WAYS.items(), strict=True):
            known = [point for point in own["points"][way] if point[1] is not None]
            x, y = np.array(known).reshape(-1, 2).T
            left.plot(x, y, marker, color=colour, label=f"{task}, {name}", ms=5)
    left.set(xlabel="velocity error, rms (m/s)", ylabel="unevenness", ylim=(0.0, None))
    curve = records["curve"]
    middle.semilogy(curve["iteration"], curve["energy"], label="E + λ E_RNN")
    middle.semilogy(curve["ends"], curve["after"], "ko", ms=4, label="network trained")
    middle.set(xlabel="iteration of the motion", ylabel="E + λ E_RNN")
    for one in records["stability"].values():
        errors = [np.nan if value is None else value for value in one["phase_free"]]
        line = "-" if one["loss"] == "recurrent" else "--"
        label = f"{one['layers']}, {LOSSES[one['loss']]}"
        right.semilogy(np.arange(1, len(errors) + 1), errors, line, label=label)
    right.set(xlabel="horizons unrolled", ylabel="distance from the stride (rad, ℓ)")


def _even(value: float | None) -> str:
    """A coefficient of variation; that of a cycle is rounding."""
    return "no steps" if value is None else number(value if value > 1e-6 else 0.0)


def _stable(one: dict[str, Any]) -> str:
    """How far the network is from its stride in its last horizon."""
    last = one["phase_free"][-1]
    if last is None:
        return f"{one['layers']} explodes"
    factor = max(value for value in one["phase_free"] if value is not None) / one["training_error"]
    return f"{one['layers']} gets to {number(factor)} × its training error"


def rows(records: dict[str, Any]) -> list[Row]:
    """Fig. 11a to d, and the times of section 8.5."""
    found = [row for task, own in records["gaits"].items() for row in _of_gaits(task, own)]
    own = records["seconds"]
    whole = own["motion"] + own["network"]
    stable = {
        loss: "; ".join(
            _stable(one) for one in records["stability"].values() if one["loss"] == loss
        )
        for loss in LOSSES
    }
    first, last = records["curve"]["after"][0], records["curve"]["after"][-1]
    trained = own["training"]
    return [
        *found,
        Row(
            "Fig. 11c, Eq. 15 after the first and the last round",
            "in the plot alone; “it always converges in our experiments”",
            f"{number(first, 3)} and {number(last, 3)}",
            "the walk's start 0; λ grows over the first half of the rounds",
        ),
        Row(
            "seconds of Algorithm 2",
            "510 s, of which 42 % (214 s) for the motion and 58 % (295 s) for the network",
            f"{seconds(whole)}, {100.0 * own['motion'] / whole:.0f} % "
            f"({seconds(own['motion'])}) and {100.0 * own['network'] / whole:.0f} % "
            f"({seconds(own['network'])})",
            f"{own['rounds']} rounds of the walk, `octo.learn.solve` as it is by default",
        ),
        Row(
            "1000 iterations of training",
            "–",
            f"{trained['iterations']:,} in {seconds(trained['seconds'])}",
            "three layers of 128",
        ),
        Row(
            "Fig. 11d, trained with Eq. 14",
            "“quickly becomes unstable”",
            stable["one_step"],
            "ten horizons of a stride that repeats, to the nearest point of it",
        ),
        Row("the same with Eq. 16", "“long-term stability”", stable["recurrent"], ""),
    ]


def _of_gaits(task: str, own: dict[str, Any]) -> list[Row]:
    plain, learned = own["plain"], own["markovian"]

    def ended(one: dict[str, Any]) -> str:
        return (
            f"unevenness {_even(one['unevenness'])} ({one['stepping']} of {own['starts']} starts "
            "take steps enough), velocity error "
            f"{number(one['velocity_error'])} m/s, E {number(one['energy'], 3)}, "
            f"{seconds(one['seconds'])}, {one['converged']} of {own['starts']} converged"
        )

    return [
        Row(
            f"Fig. 11b, {task} without",
            "“the bipedal takes uneven step sizes”",
            ended(plain),
            f"the most even of {own['more_starts']:g} starts, in the time of Algorithm 2: "
            f"{_even(own['more'])}",
        ),
        Row(
            f"Fig. 11a, {task} with",
            "“generates realistic walking gaits”",
            ended(learned),
            f"a cycle, carried on: {_even(own['cycles'])}",
        ),
    ]
