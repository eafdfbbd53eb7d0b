"""A motion graph of the paper's size (§8.6), how well it is steered, and what a transition costs:
docs/motion_graph.md.

    python -m benchmarks.motion_graph [--robots mammal spider] [--every 1] [--folder build/graphs]
        [--again] [--json FILE] [--plots DIR]

Four motions of 10 s, N = 400, and transitions of 1 s between all moments of different ones that are
0.25 s apart: 12 × 40 × 40 pairs. A graph that is in the folder is gone on with, one that FILE has
is not measured again. Ten commands of 5 to 7 s are followed from five seeds; 20 s of such a way are
replayed in MuJoCo. Seconds of a transition are processor time of one thread, of the same pairs,
alone, in batches, and each from the nearest one that was found.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import octo
from octo.checks import steps_in
from octo.motion_graph import MotionGraph, build
from octo.motion_graph.route import Route, waits

RESULTS = Path(__file__).parent / "results" / "motion_graph.json"
MOTIONS = ("walk", "left", "right", "jump")
SEEDS, COMMANDS, LONG = 5, 10, 60.0  # of ways, of each, s
STARTS = 5
SIZES, TIMED = (1, 4, 16, 64), 12  # transitions of a call; the batch of pairs that is timed
FEW = 100  # iterations, as of a first try of a graph
DOTS = 110  # an inch


def built(robot: octo.Character, path: Path, every: int) -> tuple[MotionGraph, dict[str, Any]]:
    """The graph, and how long it took: s of a build that began here, and of processor time."""
    began, new = time.perf_counter(), not path.exists()
    graph = build(robot, MOTIONS, path=path, every=every, progress=True, device="cpu")
    spent = {"build_seconds": time.perf_counter() - began} if new else {}
    return graph, {**spent, **graph.report()}


def routes(graph: MotionGraph) -> list[Route]:
    """Ways of ten commands, no two the same one after the other."""
    made = []
    for seed in range(SEEDS):
        rng, names = np.random.default_rng(seed), ["walk"]
        while len(names) < COMMANDS:
            names.append(str(rng.choice([name for name in MOTIONS if name != names[-1]])))
        lengths = LONG / COMMANDS + rng.uniform(-1.0, 1.0, COMMANDS)
        made.append(graph.route(list(zip(names, lengths.tolist(), strict=True))))
    return made


def followed(found: Sequence[Route]) -> dict[str, Any]:
    """How soon commands are followed, and how well the laws hold on the whole way."""
    motions, late = [route.motion for route in found], waits(found)
    return {
        "seconds": [route.seconds for route in found],
        "pointwise_residual": max(motion.pointwise_residual for motion in motions),
        "torque": max(motion.torque_excess for motion in motions),
        "largest_step": max(motion.largest_step["change"] for motion in motions),
        "wait_mean": float(late.mean()),
        "wait_quartiles": np.quantile(late, (0.0, 0.25, 0.5, 0.75, 1.0)).tolist(),
        "waits": late.tolist(),
    }


def replayed(graph: MotionGraph) -> dict[str, Any]:
    """20 s in MuJoCo, with base feedback and without: starts that stand to the end."""
    motion = graph.play([("walk", 5.0), ("left", 4.0), ("walk", 4.0), ("right", 4.0)])
    stood = {}
    for feedback in ("base", "none"):
        done = octo.replay(motion, friction=0.8, starts=STARTS, feedback=feedback)
        stood[feedback] = STARTS - sum(start.fell for start in done.starts)
    return {"seconds": motion.steps * motion.dt, "starts": STARTS, "stood": stood}


def timed(graph: MotionGraph) -> list[dict[str, Any]]:
    """Pairs that are alike: from a blend in batches of several sizes, and each from the nearest one
    that was found; in this process."""
    from octo.motion_graph.build import crossing_of, pairs_of
    from octo.motion_graph.settings import Settings
    from octo.motion_graph.work import batches_of, broken, work

    settings = Settings(how={"device": "cpu"})
    one, other = (graph.motions[name] for name in MOTIONS[:2])
    crossing = crossing_of(one, other, graph.crossing, settings)
    apart = steps_in(settings.moments, one.dt)
    pairs = pairs_of(crossing, *MOTIONS[:2], apart, settings.share)
    batch = batches_of(crossing, pairs, settings.batch, settings.options)[TIMED]
    problems = [crossing.problem(p.at, p.to, crossing.placed(p.at, p.to)[1]) for p in batch.pairs]
    count, made = len(problems), []
    how = {**settings.options, "max_iterations": FEW}
    octo.solve(problems[0][0], start=problems[0][1], **how)  # what is compiled
    for size in SIZES:
        began, motions = time.process_time(), []
        for k in range(0, count, size):
            asked, starts = zip(*problems[k : k + size], strict=True)
            motions += octo.solve(list(asked), start=list(starts), **how)
        spent = time.process_time() - began
        told = [(not broken(motion), motion.iterations) for motion in motions]
        made.append(row(f"from a blend, {size} at once", told, spent))
    began = time.process_time()
    outcomes = work(batch)
    assert isinstance(outcomes, list), outcomes
    told = [(own.found, own.iterations) for own in outcomes]
    made.append(row("from the nearest", told, time.process_time() - began))
    return made


def row(name: str, told: Sequence[tuple[bool, int]], spent: float) -> dict[str, Any]:
    """Of transitions, found or not and with how many iterations."""
    made = {
        "how": name,
        "seconds": spent / len(told),
        "found": sum(found for found, _ in told) / len(told),
        "iterations": float(np.median([iterations for _, iterations in told])),
    }
    print(made, flush=True)
    return made


def draw(graph: MotionGraph, path: Path) -> None:
    """Which pairs of moments were found: rows are left, columns reached."""
    from matplotlib.figure import Figure

    names = list(graph.motions)
    figure = Figure(figsize=(7.0, 7.0), layout="constrained")
    grid = figure.subplots(len(names), len(names), sharex=True, sharey=True)
    for a, one in enumerate(names):
        for b, other in enumerate(names):
            axes = grid[a, b]
            rows = [r for r in graph.table if (r["one"], r["other"]) == (one, other)]
            place = np.array([[r["to"], r["at"]] for r in rows]).reshape(-1, 2) * graph.dt
            good = np.array([bool(r["found"]) for r in rows], dtype=bool)
            size = 40.0 / max(np.sqrt(len(rows)), 1.0)
            axes.scatter(*place[good].T, s=size, marker="s", color="tab:blue")
            axes.scatter(*place[~good].T, s=size, marker="s", color="tab:red")
            share = f"{good.mean():.0%}" if len(rows) else ""
            axes.set_title(f"{one} → {other} {share}", fontsize=8)
    figure.supxlabel("reached (s)")
    figure.supylabel("left (s)")
    figure.savefig(path, dpi=DOTS)


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", nargs="+", default=["mammal", "spider"])
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--folder", type=Path, default=Path("build/graphs"))
    parser.add_argument("--again", action="store_true", help="also what the file has already")
    parser.add_argument("--json", type=Path, default=RESULTS)
    parser.add_argument("--plots", type=Path, default=Path("docs"))
    arguments = parser.parse_args(words)
    arguments.folder.mkdir(parents=True, exist_ok=True)
    known = json.loads(arguments.json.read_text()) if arguments.json.exists() else {}
    for name in arguments.robots:
        label = f"{name}, every {arguments.every}"
        if label in known and not arguments.again:
            continue
        path = arguments.folder / f"{name}-{arguments.every}.graph"
        graph, numbers = built(octo.load(name), path, arguments.every)
        print(graph, flush=True)
        numbers |= {"way": followed(routes(graph)), "every": arguments.every}
        if name == "mammal":
            numbers["replay"] = replayed(graph)
        numbers["batches"] = timed(graph)
        draw(graph, arguments.plots / f"motion_graph_{name}.png")
        known[label] = {**known.get(label, {}), **numbers}
        arguments.json.write_text(json.dumps(known, indent=1) + "\n", encoding="utf-8")
        print(json.dumps(numbers["way"] | numbers.get("replay", {}), indent=1), flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
