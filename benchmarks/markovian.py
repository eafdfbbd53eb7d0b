"""Fig. 11: gaits with and without Markovian regularisation, Algorithm 2's convergence and time, and
how long the network stays with its motion when it is unrolled.

    python -m benchmarks.markovian [gaits] [seconds] [stability] [--only CELL …] [--again]
        [--json FILE] [--plots DIR]

gaits      the biped walks and strides sideways for 10 s, five starts of each, as Algorithm 1 and as
           Algorithm 2 find it; as many more starts of Algorithm 1 as end in the time of Algorithm
           2; and a cycle of octo.costs.natural, of the walk of octo.costs.paper too
seconds    ten rounds of octo.learn.solve as it is by default, and 1,000 iterations of training
stability  networks of Eq. 14 and of Eq. 16 on a stride that repeats, unrolled for ten horizons

A cell that FILE holds is not measured again without ``--again``. Times are processor time of one
thread.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

import octo
from octo import learn
from octo.result.solution import Solution

Array = NDArray[np.float64]
Record = dict[str, Any]
RESULTS = Path(__file__).parent / "results" / "markovian.json"
SECTIONS = ("gaits", "seconds", "stability")
STEPS, DT, ROUNDS = 400, 0.025, 10
SPEEDS = {"walk": (0.5, 0.0, 0.0), "stride": (0.0, 0.5, 0.0)}  # m/s
STARTS = 5
OTHERS = 100  # the seed of the first of the starts that Algorithm 2's time is worth
# of Algorithm 2, tuned on start 0 of the walk alone
REGULARISED: dict[str, Any] = {
    "hidden": (4,),
    "activation": "softplus",
    "weight": 1.0,
    "decay": 1e-2,
    "training": 1000,
}
STRIDES, HORIZONS = 5, 10  # of a stride, in what is trained on; and as many of that unrolled
NETWORKS = {
    "paper": {"hidden": (128, 128, 128), "activation": "softplus"},
    "small": {"hidden": (32, 32), "activation": "tanh"},
}
LOSSES = {"one_step": 1000, "recurrent": 600}  # and the iterations of training
GENTLE = 1e-4  # decay, where a motion is to be known by heart


def problem(task: str, steps: int = STEPS) -> octo.Problem:
    """E of Eq. 17 and the effort, nothing else, as section 8.5 has it."""
    costs = octo.costs.paper(SPEEDS[task])
    return octo.Problem(octo.gallery.biped(), steps=steps, dt=DT, basis="hermite", costs=costs)


# -- gaits -----------------------------------------------------------------------------------------


def figures(motion: Solution, velocity: Sequence[float]) -> Record:
    """What is told of a motion: of each foot the coefficients of variation of its steps' lengths
    and periods, and the mean over the feet of both."""
    feet = {own.foot: own.unevenness for own in motion.footfalls}
    known = [both for both in feet.values() if both is not None]
    off = np.diff(motion.com[1:], axis=0) / motion.dt - np.array(velocity)
    return {
        "status": motion.status.name,
        "converged": motion.converged,
        "energy": motion.energy,
        "iterations": motion.iterations,
        "seconds": motion.processor_seconds,
        "velocity_error": float(np.sqrt((off**2).sum(axis=1).mean())),  # m/s, rms
        "feet": feet,
        "steps": {own.foot: len(own.periods) for own in motion.footfalls},
        "unevenness": float(np.mean(known)) if len(known) > 1 else None,
    }


def regularised(
    task: str, seed: int, steps: int, rounds: int, settings: Record
) -> tuple[learn.Learned, list[Record]]:
    """Algorithm 2, and of each round its motion's convergence (Fig. 11c)."""
    own = dict(settings)
    network = learn.Transition(hidden=own.pop("hidden"), activation=own.pop("activation"))
    curves: list[Record] = []

    def keep(found: learn.Learned) -> None:
        last, history = found.rounds[-1], found.motion.history
        taken = {name: history[name].tolist() for name in ("energy", "violation")}
        curves.append({"taken": last.accepted, **(taken if last.accepted else {})})

    found = learn.solve(
        problem(task, steps), network, seed=seed, rounds=rounds, callback=keep, device="cpu", **own
    )
    return found, curves


def measure_gaits(
    task: str, seed: int, steps: int = STEPS, rounds: int = ROUNDS, settings: Record | None = None
) -> Record:
    """One start of a task: without E_RNN, with it, and more starts in the same time."""
    asked, velocity = problem(task, steps), SPEEDS[task]
    plain = octo.solve(asked, seed=seed, device="cpu")
    used = REGULARISED if settings is None else settings
    found, curves = regularised(task, seed, steps, rounds, used)
    seconds = sum(found.seconds)
    own = figures(found.motion, velocity)
    own["energy"] -= found.motion.terms["Markovian"]
    others, spent = [figures(plain, velocity)], plain.processor_seconds
    while spent < seconds:
        more = octo.solve(asked, seed=OTHERS + STARTS * seed + len(others), device="cpu")
        others.append(figures(more, velocity))
        spent += more.processor_seconds
    rounds_of = found.report()["rounds"]
    return {
        "plain": others[0],
        "markovian": {**own, "seconds": seconds, "rounds": rounds_of, "unrolled": found.error},
        "more": others,
        "curves": curves if seed == 0 else [],
        "drawn": {"plain": placed(plain), "markovian": placed(found.motion)},
    }


def placed(motion: Solution) -> Record:
    """Stances of each foot for the figure: s and m."""
    return {
        own.foot: {"begins": own.begins, "ends": own.ends, "places": own.places[:, :2]}
        for own in motion.footfalls
    }


def measure_cycle(task: str, seed: int, terms: str = "natural") -> Record:
    """A stride that repeats, carried on for ten seconds: as even as a motion can be; of the
    ``terms`` of E of that preset."""
    ahead, left, _ = SPEEDS[task]
    cycle = octo.Cycle(speed=ahead, sideways=left, mirror=not left)
    costs = octo.costs.natural() if terms == "natural" else octo.costs.paper(SPEEDS[task])
    asked = octo.Problem(octo.gallery.biped(), cycle=cycle, costs=costs)
    stride = octo.solve(asked, seed=seed, device="cpu")
    strides = round(STEPS * DT / stride.cycle.period) if stride.cycle is not None else 1
    return figures(stride.tile(strides), SPEEDS[task])


# -- seconds ---------------------------------------------------------------------------------------


def measure_seconds(steps: int = STEPS, rounds: int = ROUNDS) -> Record:
    """Processor time of each round of Algorithm 2 as it is by default, and of 1,000 iterations of a
    training that nothing ends before."""
    asked = problem("walk", steps)
    found = learn.solve(asked, rounds=rounds, device="cpu")
    new = learn.train(learn.Transition().started(asked), found.motion, iterations=1000, decay=0.0)
    kept = ("number", "iterations", "training", "motion_seconds", "network_seconds", "accepted")
    return {
        "rounds": [{name: own[name] for name in kept} for own in found.report()["rounds"]],
        "motion": found.seconds[0],
        "network": found.seconds[1],
        "training": {"iterations": new.iterations, "seconds": new.processor_seconds},
    }


# -- stability -------------------------------------------------------------------------------------


def repeating() -> tuple[octo.Problem, Solution]:
    """A stride of the biped that repeats, of 16 transitions of 50 ms, and its problem."""
    own = octo.Problem(
        octo.gallery.biped(),
        steps=8,
        dt=2 * DT,
        cycle=octo.Cycle(speed=SPEEDS["walk"][0]),
        costs=octo.costs.natural(),
    )
    return own, octo.solve(own, seeds=3, device="cpu")


def measure_stability(
    own: octo.Problem, stride: Solution, network: str, loss: str, iterations: int | None = None
) -> Record:
    """Train on STRIDES of a stride, one horizon, and unroll for HORIZONS: root mean square errors
    of each horizon, rad and ℓ.

    ``equal_time``: against the control that the stride carried on has at that time.
    ``phase_free``: to the nearest point of the stride's orbit, without the place and the heading.
    """
    given = learn.controls(stride.tile(STRIDES))
    true = learn.controls(stride.tile(STRIDES * HORIZONS))
    begun = learn.Transition(**NETWORKS[network]).started(own)
    many = LOSSES[loss] if iterations is None else iterations
    trained = learn.train(begun, given, loss=loss, iterations=many, decay=GENTLE)
    made = trained.transition.unroll(given[0], len(true) - 1)
    frame = trained.transition.frame
    with np.errstate(over="ignore", invalid="ignore"):
        off = np.sqrt((((made - true) / frame.sizes) ** 2).sum(axis=1))[1:]
        period = (len(given) - 1) // STRIDES
        near = from_orbit(trained.transition, true[: period + 1], made[1:])
        horizons = [
            np.sqrt((errors.reshape(HORIZONS, -1) ** 2).mean(axis=1)) for errors in (off, near)
        ]
    return {
        "network": network,
        "loss": loss,
        "iterations": trained.iterations,
        "seconds": trained.processor_seconds,
        "horizon": (len(given) - 1) * own.dt,
        "training_error": float(np.sqrt(trained.error)),
        "equal_time": finite(horizons[0]),
        "phase_free": finite(horizons[1]),
        "each": {"equal_time": finite(off), "phase_free": finite(near)},
    }


def from_orbit(transition: learn.Transition, orbit: Array, made: Array) -> Array:
    """(m,) of controls (m, 2n): distance to the nearest point of a closed polygon of controls
    (k + 1, 2n), in what a network sees of them, rad and ℓ."""
    frame = transition.frame
    unit = learn.frame.USUAL
    corners, own = unit * frame.inputs(orbit), unit * frame.inputs(made)
    way = np.diff(corners, axis=0)
    along = ((own[:, None] - corners[:-1]) * way).sum(axis=-1) / (way**2).sum(axis=-1)
    nearest = corners[:-1] + np.clip(along, 0.0, 1.0)[..., None] * way
    return np.asarray(np.sqrt(((own[:, None] - nearest) ** 2).sum(axis=-1).min(axis=1)))


def finite(values: Array) -> list[float | None]:
    """For JSON: None where something exploded."""
    return [float(v) if np.isfinite(v) and v < 1e6 else None for v in values]


# -- all -------------------------------------------------------------------------------------------


def cells_of(sections: Sequence[str]) -> dict[str, Callable[[], Record]]:
    """What there is to measure, by name."""
    made: dict[str, Callable[[], Record]] = {}
    if "seconds" in sections:
        made["seconds default"] = measure_seconds
    if "stability" in sections:
        strides: list[tuple[octo.Problem, Solution]] = []

        def stable(network: str, loss: str) -> Record:
            strides.extend([] if strides else [repeating()])
            return measure_stability(*strides[0], network, loss)

        for network in NETWORKS:
            for loss in LOSSES:
                made[f"stability {network}-{loss}"] = lambda n=network, o=loss: stable(n, o)
    if "gaits" in sections:
        made["cycles walk-paper"] = lambda: measure_cycle("walk", 0, "paper")
        for seed in range(STARTS):
            for task in SPEEDS:
                made[f"gaits {task}-{seed}"] = lambda t=task, s=seed: measure_gaits(t, s)
                made[f"cycles {task}-{seed}"] = lambda t=task, s=seed: measure_cycle(t, s)
    return made


def plain_numbers(value: Any) -> Any:
    """For JSON: of arrays lists, with four digits."""
    if isinstance(value, np.ndarray):
        return np.round(value, 4).tolist()
    raise TypeError(f"{value!r} is no number")


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sections", nargs="*", default=SECTIONS, metavar="SECTION")
    parser.add_argument("--only", nargs="+", help="cells, such as walk-0")
    parser.add_argument("--again", action="store_true")
    parser.add_argument("--json", type=Path, default=RESULTS)
    parser.add_argument("--plots", type=Path)
    asked = parser.parse_args(words)
    if unknown := set(asked.sections) - set(SECTIONS):
        parser.error(f"section {sorted(unknown)[0]!r} is none of {', '.join(SECTIONS)}")
    found: Record = json.loads(asked.json.read_text()) if asked.json.exists() else {}
    for label, measure in cells_of(asked.sections).items():
        section, name = label.split()
        known = found.setdefault(section, {})
        if (name in known and not asked.again) or (asked.only and name not in asked.only):
            continue
        began = time.process_time()
        known[name] = {"date": datetime.date.today().isoformat(), **measure()}
        asked.json.write_text(json.dumps(found, default=plain_numbers) + "\n")
        print(f"{label}: {time.process_time() - began:.0f} s", flush=True)
    if asked.plots is not None:
        from benchmarks.markovian_figures import draw_all  # which needs Matplotlib

        draw_all(found, asked.plots)
    return 0


if __name__ == "__main__":
    sys.exit(main())
