"""Walks that a plan was made for, replayed in MuJoCo: how many perturbed starts stand, with and
without base feedback.

    python -m benchmarks.replay [--seeds 0 1 2 3 4] [--seconds 5] [--workers 2] [--folder
    build/replay] [--json FILE]

Every plan and every replay goes through the command line. What is in the folder already is not done
again: an interrupted campaign goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

GO2 = "cmeel.prefix/share/example-robot-data/robots/go2_description/urdf/go2.urdf"
# robot, m/s
WALKS = {"mammal": ("mammal", 0.5), "go2": (str(Path(sysconfig.get_path("purelib")) / GO2), 0.4)}
STARTS = 5
FRICTION = 0.8
NEEDED = 0.8  # of the starts
DOTS = 110  # an inch, of the picture
Record = dict[str, Any]


def octo(*words: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "octo", *words], capture_output=True, text=True, check=False
    )
    if done.returncode not in (0, 1):  # 1: did not converge or missed its goal, as its report says
        raise RuntimeError(f"octo {' '.join(words)}: {done.stderr.strip()}")


def plan(walk: str, seed: int, seconds: float, folder: Path) -> Path:
    """The folder of one plan."""
    robot, speed = WALKS[walk]
    out = folder / f"{walk}-{seconds:g}s-{seed}"
    if not (out / "report.json").exists():
        words = (
            "--costs",
            "robot",
            "--speed",
            f"{speed:g}",
            "--seconds",
            f"{seconds:g}",
            "--seed",
            str(seed),
        )
        octo("solve", robot, *words, "--out", str(out))
    return out


def record(walk: str, seed: int, seconds: float, folder: Path) -> Record:
    """One plan and its replays."""
    out = plan(walk, seed, seconds, folder)
    solved = json.loads((out / "report.json").read_text())
    kept = (
        "status",
        "goal_error",
        "iterations",
        "penetration",
        "slip",
        "friction_use_95",
        "torque_excess",
    )
    found: Record = {
        "walk": walk,
        "seed": seed,
        "seconds": seconds,
        **{name: solved[name] for name in kept},
    }
    for feedback in ("base", "none"):
        replayed = out / feedback
        if not (replayed / "report.json").exists():
            words = (
                "--friction",
                f"{FRICTION:g}",
                "--starts",
                str(STARTS),
                "--feedback",
                feedback,
                "--out",
                str(replayed),
            )
            octo("replay", str(out), *words)
        report = json.loads((replayed / "report.json").read_text())
        found[feedback] = {
            "stood": len(report["starts"]) - report["falls"],
            "starts": len(report["starts"]),
            "seconds_upright": [start["seconds_upright"] for start in report["starts"]],
            "drift": report["drift"],
            "tracking_error": report["tracking_error"],
        }
    return found


def picture(walk: str, seed: int, seconds: float, folder: Path, path: Path) -> None:
    """The plan above what MuJoCo made of its first perturbed start."""
    import matplotlib.image as image
    import numpy as np
    from matplotlib.figure import Figure

    from octo import Solution, filmstrip, replay

    solved = Solution.load(plan(walk, seed, seconds, folder) / "solution.npz")
    motion = replay(solved, friction=FRICTION, starts=1).motion
    with tempfile.TemporaryDirectory() as scratch:
        strips = []
        for name, shown in (("plan", solved), ("MuJoCo", motion)):
            filmstrip(shown, Path(scratch) / f"{name}.png")
            strips.append((name, image.imread(Path(scratch) / f"{name}.png")))
    height, width = (max(strip.shape[k] for _, strip in strips) for k in (0, 1))
    figure = Figure(figsize=(width / DOTS, 2 * height / DOTS))
    for k, (name, strip) in enumerate(strips):
        axes = figure.add_axes((0.0, 0.5 - 0.5 * k, 1.0, 0.5))
        axes.imshow(np.asarray(strip))
        axes.set_title(name, loc="left", x=0.01, y=0.86, fontsize=11)
        axes.axis("off")
    figure.savefig(path, dpi=DOTS)


def table(records: Sequence[Record]) -> str:
    lines = [
        "walk    seed  status       goal error  base          none          upright with "
        "base feedback, s"
    ]
    for r in records:
        base, none = (f"{r[name]['stood']} of {r[name]['starts']}" for name in ("base", "none"))
        upright = " ".join(f"{t:.2f}" for t in r["base"]["seconds_upright"])
        lines.append(
            f"{r['walk']:8}{r['seed']:4}  {r['status']:12} {r['goal_error']:9.3f}  {base:13} "
            f"{none:13} {upright}"
        )
    for name in ("base", "none"):
        stood, starts = (sum(r[name][key] for r in records) for key in ("stood", "starts"))
        lines.append(
            f"feedback {name}: {stood} of {starts} stand ({100.0 * stood / max(starts, 1):.0f} %)"
        )
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--walks", nargs="+", default=list(WALKS), choices=list(WALKS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2, 3, 4])
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--folder", type=Path, default=Path("build/replay"))
    parser.add_argument("--picture", type=Path, help="of the first walk's first seed")
    parser.add_argument("--json", type=Path, help="where the records go")
    arguments = parser.parse_args()
    began = time.perf_counter()
    jobs = [(walk, seed) for walk in arguments.walks for seed in arguments.seeds]
    arguments.folder.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(arguments.workers) as pool:
        records = list(
            pool.map(lambda job: record(*job, arguments.seconds, arguments.folder), jobs)
        )
    print(table(records))
    print(f"{time.perf_counter() - began:.0f} s")
    if arguments.picture:
        picture(
            arguments.walks[0],
            arguments.seeds[0],
            arguments.seconds,
            arguments.folder,
            arguments.picture,
        )
    if arguments.json:
        arguments.json.write_text(json.dumps(records, indent=1) + "\n")
    stood, starts = (sum(r["base"][key] for r in records) for key in ("stood", "starts"))
    return 0 if stood >= NEEDED * starts else 1


if __name__ == "__main__":
    sys.exit(main())
