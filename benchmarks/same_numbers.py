"""Whether two commits compute the same E, C, H, A and b.

    python -m benchmarks.same_numbers write now.npz          # in each of two checkouts
    python -m benchmarks.same_numbers compare before.npz now.npz

All gallery robots and three imported ones, both bases and a cycle, all terms of natural motions and
of the paper's, at random states near the ground with contacts and pairs at work, with multipliers
and without. Exit code 1 where a number differs by more than 1e-11 of the largest of its array.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import octo
from octo.errors import OctoError
from octo.problem.compiled import CompiledProblem

SAME = 1e-11
IMPORTED = ("go2", "anymal_b", "cassie")  # of example-robot-data
GALLERY = ("bird", "biped", "chain", "humanoid", "mammal", "spider")
STEPS, DT = 20, 0.025


def robots() -> Iterator[tuple[str, octo.Character]]:
    for name in GALLERY:
        yield name, getattr(octo.gallery, name)()
    try:
        import example_robot_data
    except ImportError:
        print("example-robot-data is not installed: the gallery alone", file=sys.stderr)
        return
    root = Path(example_robot_data.__file__).parent
    found = {path.stem: path for path in sorted(root.rglob("*.urdf"), reverse=True)}
    for name in IMPORTED:
        path = next((p for stem, p in found.items() if stem.startswith(name)), None)
        if path is not None:
            yield name, octo.load(path, base="floating")


def problems(robot: octo.Character) -> Iterator[tuple[str, octo.Problem]]:
    """With spheres so large that contacts and pairs touch."""
    spheres = [replace(s, radius=1.2 * s.radius + 0.01) for s in robot.contacts]
    robot = replace(robot, contacts=tuple(spheres))
    x0 = robot.default_pose.copy()
    radii = np.array([sphere.radius for sphere in robot.contacts])
    touching = list(robot.terrain_contacts)
    lowest = (octo.kinematics.sphere_centers(robot, x0)[:, 2] - radii)[touching].min()
    x0[2] -= lowest + 0.01
    paper = [octo.CenterOfMassVelocity((0.5, 0.0, 0.0)), octo.Effort()]
    natural = [t for t in octo.costs.natural((0.5, 0.0, 0.0)) if t.label != "Anchor"]
    for basis in ("nodes", "hermite"):
        for name, costs in (("paper", paper), ("natural", natural)):
            made = octo.Problem(robot, steps=STEPS, dt=DT, costs=costs, basis=basis, x0=x0)
            yield f"{basis} {name}", made
    cycle = octo.Cycle(speed=0.4, mirror=False)
    yield "cycle", octo.Problem(robot, steps=STEPS, costs=natural, cycle=cycle, pose=x0)


def numbers() -> Iterator[tuple[str, np.ndarray]]:
    for robot_name, robot in robots():
        for name, problem in problems(robot):
            random = np.random.default_rng(7)
            try:
                problem.start  # noqa: B018  (a cycle of this robot may have none)
                compiled = CompiledProblem([problem] * 2)
            except OctoError as error:
                print(f"{robot_name} {name}: {error}", file=sys.stderr)
                continue
            nodes = np.repeat(problem.start[None, None], problem.steps + 2, axis=1)
            nodes = nodes + 0.05 * random.standard_normal((2, problem.steps + 2, compiled.n))
            at = compiled.evaluate(compiled.unknowns(nodes))
            lam = random.standard_normal((2, compiled.K, compiled.ma))
            label = f"{robot_name}/{name}"
            yield f"{label}/terms", at.terms
            yield f"{label}/C", at.C
            for what, multipliers in (("plain", None), ("exact", lam)):
                model = compiled.linearize(at, multipliers)
                for field in ("H", "A", "b"):
                    yield f"{label}/{what}/{field}", getattr(model, field)


def compare(before: Path, now: Path) -> int:
    one, other = np.load(before), np.load(now)
    worst, bad = 0.0, sorted(set(one.files) ^ set(other.files))
    for name in sorted(set(one.files) & set(other.files)):
        size = max(float(np.abs(one[name]).max(initial=0.0)), 1e-300)
        off = float(np.abs(one[name] - other[name]).max(initial=0.0)) / size
        worst = max(worst, off)
        if not off <= SAME:
            bad.append(name)
            print(f"{name}: {off:.1e}")
    print(f"{len(one.files)} arrays, largest difference {worst:.1e}, {len(bad)} that differ")
    return 1 if bad else 0


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    actions = parser.add_subparsers(dest="action", required=True)
    actions.add_parser("write").add_argument("file", type=Path)
    two = actions.add_parser("compare")
    two.add_argument("before", type=Path)
    two.add_argument("now", type=Path)
    given = parser.parse_args(words)
    if given.action == "write":
        np.savez(given.file, **dict(numbers()))
        return 0
    return compare(given.before, given.now)


if __name__ == "__main__":
    sys.exit(main())
