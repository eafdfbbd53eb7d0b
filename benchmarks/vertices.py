"""What it costs that a body has thousands of contacts, of which as many touch as before.

    python -m benchmarks.vertices [--counts 50 500 5000] [--repeats 30] [--json FILE] [--png FILE]

Two robots: a stone of 2 kg that lies on eight points, with all others on an ellipsoid 2 cm above
the ground; and the mammal, each of whose four feet touches with two points and has a quarter of the
others on a ball of its own size, 2 cm higher. Three grounds: a plane, hills (an expression), a
world of boxes. What is measured is FD with its Jacobian, of 400 steps in lanes: processor time of
one thread, robots taking turns, the least of all repeats. The share of detection is what all
contacts cost beyond those that touch alone. With ``--all`` also every contact one by one.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import casadi as ca
import numpy as np

import octo
from benchmarks.world import least
from octo.checks import Array
from octo.dynamics import crowd
from octo.dynamics.evaluate import RobotDynamics
from octo.model.body import Body, ContactSphere, floating_base
from octo.model.kinematics import body_poses

STEPS = 400
TOUCHING = 8
FEET = ("front_left", "front_right", "hind_left", "hind_right")
COLUMNS = [(x, y) for x in (-0.3, 0.1, 0.5) for y in (-0.2, 0.25)]


def ellipsoid(count: int, half: Array) -> Array:
    """(count, 3) m, evenly over an ellipsoid of these half axes."""
    k = np.arange(count) + 0.5
    polar, around = np.arccos(1.0 - 2.0 * k / max(count, 1)), np.pi * (1.0 + 5.0**0.5) * k
    across = np.sin(polar)
    return half * np.stack([np.cos(around) * across, np.sin(around) * across, np.cos(polar)], 1)


def spheres(body: int, points: Array) -> list[ContactSphere]:
    return [ContactSphere(f"b{body}v{k}", body, point, 0.0) for k, point in enumerate(points)]


def stone(count: int) -> octo.Character:
    """Lies on eight points of a ring."""
    turns = np.arange(TOUCHING) * 2.0 * np.pi / TOUCHING
    ring = np.stack([0.1 * np.cos(turns), 0.1 * np.sin(turns), 0.0 * turns - 0.14], 1)
    points = np.concatenate([ring, ellipsoid(count - TOUCHING, np.array([0.2, 0.16, 0.12]))])
    body = Body("stone", -1, floating_base(), mass=2.0, inertia=np.diag([0.02, 0.03, 0.04]))
    return octo.Character("stone", (body,), tuple(spheres(0, points)))


def mammal(count: int) -> octo.Character:
    """Stands on two points of each foot."""
    robot = octo.gallery.CHARACTERS["mammal"]()
    feet = [robot.contact_index(name) for name in FEET]
    rotation, _ = body_poses(robot, robot.start_pose)
    made = []
    for k in feet:
        foot, each = robot.contacts[k], count // len(feet)
        lowest = [[side, 0.0, -foot.radius - 0.02] for side in (0.01, -0.01)]
        down = np.array(lowest) @ rotation[foot.body]  # in the body's axes
        ball = ellipsoid(each - len(down), np.full(3, foot.radius))
        made += spheres(foot.body, foot.position + np.concatenate([down, ball]))
    return replace(robot, contacts=tuple(made), pairs=(), default_pose=robot.start_pose)


def hilly(point: ca.SX, p: Any) -> ca.SX:
    return point[2] - 0.001 * ca.sin(10.0 * point[0]) * ca.cos(10.0 * point[1])


def grounds() -> dict[str, octo.Plane | octo.Terrain | octo.World]:
    boxes = [octo.shapes.Box((0.3, 0.3, 0.1), position=(x, y, -0.05)) for x, y in COLUMNS]
    return {
        "plane": octo.Plane(),
        "hills": octo.Terrain(hilly, steepest=1.1),
        "boxes": octo.World([octo.shapes.Ground(), *boxes]),
    }


def motion(robot: octo.Character) -> Array:
    """(1, STEPS + 2, n): near its start, with what touches 3 mm deep."""
    rng = np.random.default_rng(1)
    nodes = np.repeat(robot.start_pose[None, None], STEPS + 2, axis=1)
    low = octo.kinematics.sphere_centers(robot, nodes[0, 0])[:, 2]
    nodes[..., 2] -= np.sort(low)[TOUCHING - 1] + 0.003
    nodes[..., :3] += rng.normal(0.0, 5e-4, (STEPS + 2, 3))
    nodes[..., 3:] += rng.normal(0.0, 1e-3, (STEPS + 2, robot.nx - 3))
    return nodes


def task_of(robot: octo.Character, terrain: Any, few: int) -> Callable[[], Any]:
    """FD and its Jacobian of the motion, where more than ``few`` contacts are a crowd."""
    usual, crowd.FEW = crowd.FEW, few
    try:
        dynamics = RobotDynamics(robot, terrain=terrain)
        nodes, p = motion(robot), dynamics.bound(dynamics.layout.pack()[None])
        dynamics.evaluate(nodes, p, order=1)
    finally:
        crowd.FEW = usual
    return lambda: dynamics.evaluate(nodes, p, order=1)


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--counts", type=int, nargs="+", default=[50, 100, 200, 500, 1000, 5000])
    parser.add_argument("--repeats", type=int, default=30)
    parser.add_argument("--all", action="store_true")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--png", type=Path)
    chosen = parser.parse_args(words)
    records = []
    print(f"{'robot':8s}{'ground':8s}{'contacts':>9s}{'us a step':>11s}{'of 50':>7s}{'share':>7s}")
    for name, robot in (("stone", stone), ("mammal", mammal)):
        for ground, terrain in grounds().items():
            counts = [TOUCHING, *chosen.counts]
            kinds = [(n, crowd.FEW if n > TOUCHING else 10**9) for n in counts]
            kinds += [(n, 10**9) for n in chosen.counts if chosen.all]
            tasks = [task_of(robot(n), terrain, few) for n, few in kinds]
            seconds = least(chosen.repeats, *tasks)
            for (n, few), own in zip(kinds, seconds, strict=True):
                each = few == 10**9 and n > TOUCHING
                record = {"robot": name, "ground": ground, "contacts": n, "one by one": each}
                record |= {"us": 1e6 * own / STEPS, "of the fewest": own / seconds[1]}
                record["share"] = 1.0 - seconds[0] / own
                records.append(record)
                print(
                    f"{name:8s}{ground:8s}{n:9d}{record['us']:11.2f}"
                    f"{record['of the fewest']:7.2f}{100.0 * record['share']:6.0f} %"
                    + ("  one by one" if each else "")
                )
    if chosen.json is not None:
        chosen.json.write_text(json.dumps(records, indent=1) + "\n", encoding="utf-8")
    if chosen.png is not None:
        draw(records, chosen.png)
    return 0


def draw(records: list[dict[str, Any]], path: Path) -> None:
    """The share of detection, and the time of a step, by the number of contacts."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    colors = dict(zip(grounds(), ("tab:blue", "tab:green", "tab:orange"), strict=True))
    for robot, style in (("stone", "--"), ("mammal", "-")):
        for ground, color in colors.items():
            own = [r for r in records if (r["robot"], r["ground"]) == (robot, ground)]
            for each, mark in ((False, "o"), (True, "x")):
                some = [r for r in own if r["one by one"] == each and r["contacts"] > TOUCHING]
                x = [r["contacts"] for r in some]
                if not each:
                    share = [100.0 * r["share"] for r in some]
                    left.semilogx(x, share, style, marker=mark, color=color)
                line = style if not each else ":"
                label = f"{robot}, {ground}" if not each else None
                us = [r["us"] for r in some]
                right.loglog(x, us, line, marker=mark, color=color, label=label, alpha=0.8)
    left.set(xlabel="contacts", ylabel="share of detection, %", ylim=(0.0, 100.0))
    right.set(xlabel="contacts", ylabel="FD and Jacobian, µs a step")
    right.set_title("dotted: each contact, one by one", fontsize=8)
    right.legend(fontsize=7)
    figure.savefig(path, dpi=130)


if __name__ == "__main__":
    sys.exit(main())
