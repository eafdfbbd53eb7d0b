"""What benchmarks/gpu.json says: the figure, and a line for each thing that a GPU is meant to show.
Sections may be missing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from gpu_stages import NAMES

Found = dict[str, Any]
EMULATED = "emulated on the CPU"
BASES = {"hermite": "Hermite", "nodes": "nodes"}
ITERATION_MS = 1.0
AIM_MS = 0.25
CHAIN_SECONDS = 5.0
BATCH_RATIO = 10.0
BEST_RATIO = 30.0
IPOPT_RATIO = 30.0


class Missing(Exception):
    """A figure is not there, and why."""


def rows(found: Found, section: str) -> dict[str, Any]:
    """The rows of a section that were measured."""
    return {
        key: row
        for key, row in found.get(section, {}).items()
        if isinstance(row, dict) and "why_not" not in row
    }


def row(found: Found, section: str, key: str) -> dict[str, Any]:
    """One row; raises Missing."""
    made = rows(found, section).get(key)
    if made is None:
        raise Missing(why_not(found, section, key))
    return made


def why_not(found: Found, section: str, key: str = "") -> str:
    own = found.get(section, {})
    own = own.get(key, own)
    return str(own.get("why_not", "not measured"))


def in_short(made: dict[str, Any]) -> str:
    """A row in a few words."""
    if "why_not" in made:
        return str(made["why_not"])
    words = []
    if isinstance(made.get("ms"), float):
        words.append(f"{made['ms']:.3g} ms, of a solve's {made['mean_ms']:.3g} ms")
    if "cpu" in made:
        words += [
            f"CPU on {name}: {cpu['ms']:.3g} ms"
            for name, cpu in made["cpu"].items()
            if name.isdigit()
        ]
    if "plans" in made:
        words.append(f"{made['converged']} of {made['plans']} converged in {made['seconds']:.3g} s")
    if "ratio" in made and isinstance(made["ratio"], float):
        words.append(f"{made['ratio']:.3g} times")
    return "; ".join(words) or "done"


# -- must show -------------------------------------------------------------------------------------

Judged = tuple[str, bool]  # the figure in words, and whether it is within its limit


def _iteration(basis: str) -> Callable[[Found], Judged]:
    def of(found: Found) -> Judged:
        own = row(found, "iteration", basis)
        most = max(own["bound_ms"], key=own["bound_ms"].get)
        times = [
            f"{cpu['ms']:.3g} ms on {name}"
            for name, cpu in own.get("cpu", {}).items()
            if name.isdigit()
        ]
        beside = f"CPU {', '.join(times)} threads" if times else "no CPU beside it"
        size = f"N = {own['steps']}" + (f", Z = {own['Z']}" if own["Z"] else "")
        bound = f"bound {own['bound_ms'][most]:.3g} ms of a {own['bound_of']}, by {most}"
        more = f"{beside}; of a solve's, {_factorised(own)}"
        return f"{size}: {own['ms']:.3g} ms (aim {AIM_MS}; {bound}; {more})", own[
            "ms"
        ] <= ITERATION_MS

    return of


def _factorised(own: dict[str, Any]) -> str:
    return f"{own['mean_ms']:.3g} ms with {own['factorisations']:.3g} factorisations each"


def _stages(found: Found) -> Judged:
    words = []
    for basis in BASES:
        own = row(found, "stages", basis)
        parts = ", ".join(
            f"{name} {own['ms'][name]:.3g}" for name in NAMES if own["ms"][name] or name != "other"
        )
        words.append(f"{BASES[basis]}: {parts} ms of {own['sum_ms']:.3g}")
    return "; ".join(words), True


def _chain_iteration(found: Found) -> Judged:
    own = row(found, "chain", "iteration")
    return (
        f"N = {own['steps']}, Z = {own['Z']}: {own['ms']:.3g} ms (of a solve's, "
        f"{_factorised(own)})",
        own["ms"] <= ITERATION_MS,
    )


def _chain_solved(found: Found) -> Judged:
    solves = [own for key, own in rows(found, "chain").items() if key.startswith("solve")]
    if not solves:
        raise Missing(why_not(found, "chain"))
    seconds = [own["seconds"] for own in solves if own["converged"]]
    words = f"{len(seconds)} of {len(solves)} starts converge"
    if not seconds:
        return words, False
    return f"{words}, median {np.median(seconds):.3g} s", float(np.median(seconds)) <= CHAIN_SECONDS


def _batch(basis: str) -> Callable[[Found], Judged]:
    def of(found: Found) -> Judged:
        key = next((key for key in rows(found, "batch") if key.startswith(basis)), "")
        own = row(found, "batch", key)
        if not own.get("ratio"):
            raise Missing(str(own["cpu"].get("why_not", "no CPU beside it")))
        cores, value = max(own["ratio"].items(), key=lambda item: int(item[0]))
        mean = own["mean_ratio"][cores]
        words = (
            f"batch of {own['batch']}, {cores} threads: {value:.3g} times an iteration, "
            f"{mean:.3g} times a solve's mean one"
        )
        return words, min(value, mean) >= BATCH_RATIO

    return of


def _best(found: Found) -> Judged:
    best: list[tuple[float, str]] = []
    for key, own in [*rows(found, "batches").items(), *rows(found, "batch").items()]:
        best += [(value, f"{value:.3g} times, {key}") for value in own.get("ratio", {}).values()]
        if "ratio_to_64" in own:
            best.append(
                (
                    own["ratio_to_64"],
                    f"{own['ratio_to_64']:.3g} times, {key} (the CPU by its time for 64)",
                )
            )
    if not best:
        raise Missing(why_not(found, "batches"))
    return max(best)[1], max(best)[0] >= BEST_RATIO


def _ipopt(found: Found) -> Judged:
    own = next((own for own in rows(found, "ipopt").values() if own["both_converged"]), None)
    if own is None:
        tried = {key: end for key, end in found.get("ipopt", {}).items() if isinstance(end, dict)}
        ends = "; ".join(
            f"{key}: octo {end['octo']}, IPOPT {end.get('ipopt', 'not run')}"
            for key, end in tried.items()
        )
        raise Missing(ends or why_not(found, "ipopt"))
    words = (
        f"{own['ratio']:.3g} times ({own['ipopt_seconds']:.3g} s over "
        f"{own['octo_seconds']:.3g} s, in {BASES[own['basis']]}; "
    )
    return words + f"E {own['ipopt_energy']:.4g} of IPOPT, {own['octo_energy']:.4g} of octo)", own[
        "ratio"
    ] >= IPOPT_RATIO


def _plans(found: Found) -> Judged:
    made = rows(found, "plans")
    if not made:
        raise Missing(why_not(found, "plans", "hermite"))
    words = []
    for basis, own in made.items():
        size, how = (
            (own["peak_bytes"], "")
            if "peak_bytes" in own
            else (own["estimated_bytes"], " by estimate")
        )
        ended = f"{own['converged']} of {own['plans']} converged in {own['seconds']:.3g} s"
        ended += (
            "" if own["plans"] == own["wanted"] else f" (there is no memory for {own['wanted']})"
        )
        words.append(
            f"{BASES[basis]}: {ended}, {own['converged_a_second']:.3g} a second, {size / 1e9:.3g} "
            f"GB{how}"
        )
    words += [
        f"{BASES[basis]}: {why_not(found, 'plans', basis)}" for basis in BASES if basis not in made
    ]
    return "; ".join(words), True


MUST: tuple[tuple[str, str, Callable[[Found], Judged]], ...] = (
    ("mammal, one full iteration, Hermite", f"≤ {ITERATION_MS:g} ms", _iteration("hermite")),
    ("mammal, one full iteration, nodes", f"≤ {ITERATION_MS:g} ms", _iteration("nodes")),
    ("its split by stage", "shown", _stages),
    ("chain of 40 s, one full iteration", f"≤ {ITERATION_MS:g} ms", _chain_iteration),
    ("chain of 40 s, solved", f"≤ {CHAIN_SECONDS:g} s", _chain_solved),
    ("all cores over the GPU, Hermite", f"≥ {BATCH_RATIO:g} times", _batch("hermite")),
    ("all cores over the GPU, nodes", f"≥ {BATCH_RATIO:g} times", _batch("nodes")),
    ("all cores over the GPU, best batch", f"aim {BEST_RATIO:g} times", _best),
    ("IPOPT's time over octo's, walk of 10 s", f"≥ {IPOPT_RATIO:g} times", _ipopt),
    ("1,024 plans of 10 s in one batch", "shown", _plans),
)


def conclude(found: Found) -> None:
    """Adds iteration_ms, mean_iteration_ms and must_show. What is short or emulated is not
    judged."""
    measured = rows(found, "iteration")
    found["iteration_ms"] = {basis: own["ms"] for basis, own in measured.items()} or {
        "why_not": why_not(found, "iteration")
    }
    found["mean_iteration_ms"] = {
        basis: {"ms": own["mean_ms"], "factorisations": own["factorisations"]}
        for basis, own in measured.items()
    } or {"why_not": why_not(found, "iteration")}
    real = not found["short"] and found["hardware"]["device"] != EMULATED
    found["must_show"] = []
    for what, limit, judge in MUST:
        met: bool | None = None
        try:
            figure, good = judge(found)
            met = good if real else None
        except Missing as missing:
            figure = str(missing)
        # of a JSON of another version: no reason to lose a run
        except (KeyError, TypeError, ValueError) as error:
            figure = f"not judged: {type(error).__name__}: {error}"
        found["must_show"].append({"what": what, "limit": limit, "figure": figure, "met": met})


def table(found: Found) -> list[str]:
    """must_show in words, and what this script does not measure."""
    words = {True: "met", False: "NOT MET", None: "-"}
    lines = [f"{found['hardware']['device']}, {found['hardware']['cpu']}, {found['date']}"]
    lines += [
        f"{words[one['met']]:8s}{one['what']} ({one['limit']}): {one['figure']}"
        for one in found["must_show"]
    ]
    return [
        *lines,
        "elsewhere: pytest tests/gpu/test_on_gpu.py; compute-sanitizer python "
        "benchmarks/gpu.py --once",
    ]


# -- the figure ------------------------------------------------------------------------------------


def draw(found: Found, path: Path) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 7.4), layout="constrained")
    figure.suptitle(
        f"{found['hardware']['device']}, {found['date']}", x=0.01, ha="left", fontsize=9.5
    )
    stages, steps, dof, batch = figure.subplots(2, 2).ravel()
    _draw_stages(stages, found)
    for axes, name, key, word in (
        (steps, "steps", "steps", "steps N"),
        (dof, "dof", "degrees", "degrees of freedom"),
    ):
        made = list(rows(found, name).values())
        for column, label in (("ms", "one full iteration"), ("mean_ms", "mean of a solve's")):
            axes.plot(
                [own[key] for own in made], [own[column] for own in made], marker="o", label=label
            )
        axes.set_xlabel(word)
        axes.set_ylabel("ms an iteration")
        _legend(axes, found, name, bool(made))
    _draw_batches(batch, found)
    figure.savefig(path, dpi=110)


def _draw_stages(axes: Any, found: Found) -> None:
    made = rows(found, "stages")
    bottom = np.zeros(len(made))
    for name in NAMES:
        values = np.array([own["ms"][name] for own in made.values()])
        axes.bar(list(made), values, bottom=bottom, label=name)
        bottom += values
    axes.set_xlim(-0.6, 2.4)  # room for the names
    axes.set_ylabel("ms of one full iteration, kernel by kernel")
    _legend(axes, found, "stages", bool(made))


def _draw_batches(axes: Any, found: Found) -> None:
    made = {own["batch"]: own for own in rows(found, "batches").values()}
    made |= {
        own["batch"]: own for key, own in rows(found, "batch").items() if key.startswith("hermite")
    }
    sizes = sorted(made)
    axes.plot(sizes, [made[size]["ms"] / size for size in sizes], marker="o", label="GPU")
    beside = [size for size in sizes if made[size].get("ratio")]
    if beside:
        cores = max(made[beside[0]]["ratio"], key=int)
        axes.plot(
            beside,
            [made[size]["cpu"][cores]["ms"] / size for size in beside],
            marker="s",
            label=f"CPU, {cores} threads",
        )
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("problems in a batch, Hermite")
    axes.set_ylabel("ms an iteration and problem")
    _legend(axes, found, "batches", bool(made))


def _legend(axes: Any, found: Found, section: str, there: bool) -> None:
    """The lines' names, or why there are none."""
    if there:
        axes.legend(fontsize=7)
    else:
        axes.set_axis_off()
        axes.text(
            0.5,
            0.5,
            f"{section}: {why_not(found, section)}",
            ha="center",
            wrap=True,
            transform=axes.transAxes,
        )
