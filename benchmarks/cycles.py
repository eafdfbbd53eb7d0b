"""Strides, walks from rest to rest, jumps: every figure beside its limit, and whether it is met.

    python -m benchmarks.cycles [SECTION …] [--only TEXT] [--json FILE] [--table] [--folder
    build/cycles] [--crocoddyl PYTHON]

Sections:

    cycles     the best stride of five starts, of eight robots at two speeds walks      walks and
    turns of ten seconds from rest to rest, five starts each replay     these walks of mammal and
    go2 and a fast stride of go2 in MuJoCo, from perturbed starts jumps      jumps of mammal and
    go2, five starts each crocoddyl  a walk of anymal_b beside Crocoddyl's own trotting problem;
    PYTHON has crocoddyl, this one need not

A row is one line, printed when it is done and written to FILE, where it takes the place of the row
of that name. Times are those of the processor, one core, code generation apart. ``replay`` takes
the walks that ``walks`` left in the folder, and solves those that are not there.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import sysconfig
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

import octo
from octo.continuation.schedule import DEPTHS
from octo.dynamics import codegen as dynamics_codegen
from octo.goals import Goal
from octo.jump import first_guesses, jump_problem
from octo.model.character import Character
from octo.model.feet import CARRYING, LOADED
from octo.problem import codegen as problem_codegen
from octo.problem import structure
from octo.problem.cycle import usual_period
from octo.result.gait import measure_gait
from octo.result.solution import Solution

ROBOTS = Path(sysconfig.get_path("purelib")) / "cmeel.prefix/share/example-robot-data/robots"
FILES = {
    "go2": "go2_description/urdf/go2.urdf",
    "go1": "go1_description/urdf/go1.urdf",
    "anymal_c": "anymal_c_simple_description/urdf/anymal.urdf",
    "anymal_b": "anymal_b_simple_description/robots/anymal.urdf",
    "hyq": "hyq_description/robots/hyq_no_sensors.urdf",
}  # the others are octo's own
STRIDES = [
    (name, speed)
    for name in ("mammal", "biped", "spider", "bird", "go2", "go1", "anymal_c", "hyq")
    for speed in ((0.2, 0.3) if name == "spider" else (0.3, 0.5))  # a spider stands 16 cm high
]
WALKS = (
    ("mammal", "walk", 0.5),
    ("go2", "walk", 0.5),
    ("go2", "walk", 0.4),
    ("mammal", "turn", 0.3),
    ("go2", "turn", 0.3),
    ("biped", "walk", 0.5),
    ("spider", "walk", 0.3),
)
REPLAYED = (("mammal", "walk", 0.5), ("go2", "walk", 0.5), ("go2", "walk", 0.4))
FAST = ("go2", 1.0, 0.48)  # m/s, s
TROTS = (0.15, 0.375)  # m, a step: that of Crocoddyl's example, and that of 0.5 m/s
JUMPERS = ("mammal", "go2")
STARTS = 5
SECONDS = 10.0
TIME_LIMIT = 300.0  # s, of one walk
SLOWER = 1.25  # of the usual period: the middle of what walks try
GRAIN = 0.05  # s, of a period: half a stride is a whole number of steps of 25 ms
FASTEST = 12.0  # rad/s, of joints whose file says no limit
FRICTION = 0.8
ROUNDING = 1e-9
GENERATION = (
    (dynamics_codegen, "function_text"),
    (structure, "derived"),
    (problem_codegen, "cost_text"),
)


@dataclass(frozen=True)
class Check:
    """A figure and its limit; without a limit it is only told."""

    name: str
    value: float | None
    most: float | None = None
    least: float | None = None

    @property
    def met(self) -> bool:
        if self.most is None and self.least is None:
            return True
        if self.value is None:
            return False
        over = self.most is not None and not self.value <= self.most + ROUNDING
        return not (over or (self.least is not None and not self.value >= self.least - ROUNDING))

    @property
    def limit(self) -> str:
        bounds = (("≥", self.least), ("≤", self.most))
        return " ".join(f"{sign} {bound:.3g}" for sign, bound in bounds if bound is not None)

    def __str__(self) -> str:
        value = "none" if self.value is None else f"{self.value:.3g}"
        return (
            f"{self.name} "
            f"{value}{f' ({self.limit})' if self.limit else ''}{'' if self.met else ' SHORT'}"
        )


@dataclass(frozen=True)
class Row:
    """A line of a section. needed: whether a limit that is missed counts; rows of single starts are
    counted in a row of all."""

    section: str
    name: str
    checks: tuple[Check, ...]
    needed: bool = True

    @property
    def missed(self) -> list[str]:
        return [check.name for check in self.checks if not check.met]

    def __str__(self) -> str:
        outcome = f"SHORT: {', '.join(self.missed)}" if self.missed else "met"
        return f"{self.section} | {self.name} | {', '.join(map(str, self.checks))} | {outcome}"

    def record(self) -> dict[str, Any]:
        values = {
            check.name: None if check.value is None else float(f"{check.value:.4g}")
            for check in self.checks
        }
        limits = {check.name: check.limit for check in self.checks if check.limit}
        return {"name": self.name, "missed": self.missed, "figures": values, "limits": limits}


def table(records: dict[str, Any]) -> str:
    """The records as tables for docs/cycles.md: figures that have a limit, which the head says
    where it is one for all."""
    lines = []
    for section, rows in records.items():
        told = [row for row in rows if ", start " not in row["name"]]
        limits = {
            name: {row["limits"].get(name) for row in told}
            for row in told
            for name in row["limits"]
        }
        names = [
            name
            for name in dict.fromkeys(name for row in told for name in row["figures"])
            if name in limits
        ]
        heads = [
            f"{name} {limits[name].copy().pop()}" if len(limits[name]) == 1 else name
            for name in names
        ]
        lines += [
            "",
            f"| {section} | {' | '.join(heads)} | short |",
            "| --- " * (len(names) + 2) + "|",
        ]
        for row in told:
            found = [row["figures"].get(name) for name in names]
            words = " | ".join("" if value is None else f"{value:.3g}" for value in found)
            lines.append(f"| {row['name']} | {words} | {', '.join(row['missed'])} |")
    return "\n".join(lines[1:])


def load(name: str) -> Character:
    return octo.load(ROBOTS / FILES[name]) if name in FILES else getattr(octo.gallery, name)()


class Clock:
    """Processor time of this process, code generation apart; the C compiler is a process of its
    own."""

    def __init__(self) -> None:
        self.began, self.generation = time.process_time(), 0.0

    @property
    def seconds(self) -> float:
        return time.process_time() - self.began - self.generation


@contextmanager
def clock() -> Iterator[Clock]:
    """Counts what the functions that write C text take."""
    running = Clock()
    before = [(module, name, getattr(module, name)) for module, name in GENERATION]

    def counted(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **named: Any) -> Any:
            began = time.process_time()
            try:
                return function(*arguments, **named)
            finally:
                running.generation += time.process_time() - began

        return call

    for module, name, function in before:
        setattr(module, name, counted(function))
    try:
        yield running
    finally:
        for module, name, function in before:
            setattr(module, name, function)


# -- what a motion must be ------------------------------------------------------------------------


def gait_checks(motion: Solution, use: float) -> list[Check]:
    """Of feet, joints and torques; ``use`` is the most that friction and torque may be used."""
    robot, gait, length = motion.character, motion.gait, motion.length
    assert robot is not None and gait is not None
    speed = np.abs(np.diff(motion.x, axis=0)).max(axis=0)[robot.actuated] / motion.dt
    limit = robot.velocity_limit[robot.actuated]
    return [
        Check("touchdowns", gait.touchdowns, most=2.5),
        Check("shortest stance", gait.shortest_stance, least=0.1),
        Check("shortest swing", gait.shortest_swing, least=0.1),
        Check(
            "clearance mm",
            None if gait.clearance is None else 1e3 * gait.clearance,
            least=min(15.0, 60.0 * length),
        ),
        Check("torque > 5 Hz", gait.torque_high, most=0.3),
        Check(
            "joint speed use",
            float(np.max(speed / np.where(np.isfinite(limit), limit, FASTEST))),
            most=1.0,
        ),
        Check("slip", motion.slip, most=0.05),
        Check("sink mm", 1e3 * motion.penetration, most=max(4.0, 12.0 * length)),
        Check("torque use", motion.torque_excess, most=use),
        Check("friction use", motion.friction_use, most=use),
    ]


def journey_checks(motion: Solution, goal: Goal) -> list[Check]:
    """What a motion from rest to rest must have beside: rhythm, soft ends, all feet on the ground
    at last."""
    steady = measure_gait(motion, 1.0, motion.steps * motion.dt - 1.0)
    ends, weight = round(0.25 / motion.dt), motion.weight
    push = np.linalg.norm(motion.contact_force[..., :2].sum(axis=1), axis=1) / weight
    loads = motion.normal_force
    feet = loads.mean(axis=0) >= CARRYING * weight
    return [
        Check("goal error", goal.error(motion), most=0.1),
        Check("rhythm", None if steady is None else steady.rhythm, least=0.6),
        Check(
            "horizontal force at the ends",
            float(max(push[:ends].max(), push[-ends:].max())),
            most=0.6,
        ),
        Check(
            "feet in the air at the end", float((loads[-1, feet] < LOADED * weight).sum()), most=0.0
        ),
        *gait_checks(motion, use=1.01),
        Check("limit excess", None if motion.gait is None else motion.gait.limit_excess, most=0.01),
    ]


# -- the sections ---------------------------------------------------------------------------------


def cycle_of(robot: Character, speed: float, period: float | None = None) -> octo.Problem:
    """A mirrored stride; of the usual period × 1.25 where none is given."""
    plain = octo.Problem(robot, steps=3, dt=0.025, costs=[octo.Effort()])
    wanted = (
        GRAIN * round(SLOWER * usual_period(plain.length, speed) / GRAIN)
        if period is None
        else period
    )
    terms = octo.costs.natural(length=plain.length)
    problem = octo.Problem(
        robot, costs=[octo.Effort()], cycle=octo.Cycle(speed=speed, period=wanted)
    )
    return problem.replace(costs=terms)


def passed(record: dict[str, Any]) -> bool:
    """Whether a start converged through the last pass."""
    last = record["passes"][-1]
    return bool(last["converged"]) and last["pass"] == len(DEPTHS)


def cycles(only: str, folder: Path) -> Iterator[Row]:
    for name, speed in STRIDES:
        if only not in f"{name} {speed:g}":
            continue
        robot = load(name)
        problem = cycle_of(robot, speed)
        with clock() as spent:
            best = octo.solve(problem, seeds=STARTS, device="cpu")
        assert best.cycle is not None and best.gait is not None
        best.save(folder / f"cycle-{name}-{speed:g}.npz")
        yield Row(
            "cycles",
            f"{name} {speed:g} m/s, {best.cycle.period:.2f} s",
            (
                Check("converged of 5", sum(passed(record) for record in best.starts), least=4),
                Check("processor s", spent.seconds, most=10.0),
                *gait_checks(best, use=1.0),
                Check("limit excess", best.gait.limit_excess),
                Check("joint speed", best.gait.joint_speed),
                Check("E", best.energy),
                Check("start", best.seed),
            ),
        )


def plan(
    name: str, kind: str, speed: float, start: int, folder: Path, again: bool
) -> tuple[Solution, float | None]:
    """One motion from rest to rest and the processor time that it took, None of one that the folder
    has."""
    path = folder / f"{kind}-{name}-{speed:g}-{start}.npz"
    if path.exists() and not again:
        return Solution.load(path), None
    with clock() as spent:
        motion = getattr(octo, kind)(
            load(name), speed, SECONDS, seed=10 * start, device="cpu", time_limit=TIME_LIMIT
        )
    motion.save(path)
    return motion, spent.seconds


def walks(only: str, folder: Path) -> Iterator[Row]:
    for name, kind, speed in WALKS:
        case = f"{name} {kind} {speed:g}"
        if only not in case:
            continue
        converged, good, missed = 0, 0, set()
        times = []
        for start in range(STARTS):
            motion, seconds = plan(name, kind, speed, start, folder, again=True)
            assert seconds is not None
            times.append(seconds)
            told = (
                Check("converged", float(motion.converged)),
                Check("processor s", seconds),
                *journey_checks(motion, Goal(kind, speed)),  # type: ignore[arg-type]
                Check("joint speed", motion.gait.joint_speed if motion.gait else None),
                Check("E", motion.energy),
                Check("iterations", motion.iterations),
                Check("stride's start", motion.seed),
                Check("|C| N", motion.violation),
            )
            row = Row("walks", f"{case}, start {start}", told, needed=False)
            converged += motion.converged
            good += motion.converged and not row.missed
            missed |= set(row.missed) if motion.converged else set()
            yield row
        limit = 8.0 if name == "mammal" and kind == "walk" else None
        yield Row(
            "walks",
            f"{case}, all",
            (
                Check("converged of 5", converged, least=4),
                Check("of these with all limits met", good, least=converged),
                Check("processor s", float(np.median(times)), most=limit),
            ),
        )


def stood(motion: Solution, feedback: str) -> tuple[int, float]:
    """How many of five perturbed starts stand in MuJoCo, and for how long (s, mean) they do."""
    starts = octo.replay(motion, friction=FRICTION, starts=STARTS, feedback=feedback).starts
    return sum(not start.fell for start in starts), float(
        np.mean([start.seconds_upright for start in starts])
    )


def replayed(
    name: str, motion: Solution, least: float | None = None
) -> tuple[Row, NDArray[np.intp]]:
    """The row of a plan, and how many starts stand with base feedback and without."""
    base, upright = stood(motion, "base")
    alone, upright_alone = stood(motion, "none")
    checks = (
        Check("stand of 5", base, least=least),
        Check("upright s", upright),
        Check("stand of 5 without base feedback", alone),
        Check("upright s without", upright_alone),
        Check("converged", float(motion.converged)),
    )
    return Row("replay", name, checks, needed=least is not None), np.array([base, alone])


def replay(only: str, folder: Path) -> Iterator[Row]:
    for name, kind, speed in REPLAYED:
        case = f"{name} {kind} {speed:g}"
        if only not in case:
            continue
        standing = np.zeros(2, dtype=np.intp)
        for start in range(STARTS):
            motion, _ = plan(name, kind, speed, start, folder, again=False)
            row, counts = replayed(f"{case}, start {start}", motion)
            standing += counts
            yield row
        checks = (
            Check("stand of 25", standing[0], least=24),
            Check("stand of 25 without base feedback", standing[1]),
        )
        yield Row("replay", f"{case}, all", checks)
    name, speed, period = FAST
    case = f"{name} cycle {speed:g} m/s, {period:g} s"
    if only in case:
        stride = octo.solve(cycle_of(load(name), speed, period), seeds=STARTS, device="cpu")
        row, _ = replayed(case, stride.tile(round(SECONDS / period)), least=5)
        yield row


def jumps(only: str, folder: Path) -> Iterator[Row]:
    for name in JUMPERS:
        case, goal = f"{name} jump", Goal("jump")
        if only not in case:
            continue
        problem = jump_problem(load(name), goal.height, goal.distance)
        with clock() as spent:
            members = octo.solve(
                [problem] * STARTS, start=list(first_guesses(problem, STARTS)), device="cpu"
            )
        good = 0
        for start, motion in enumerate(members):
            motion.save(folder / f"jump-{name}-{start}.npz")
            row = Row(
                "jumps", f"{case}, start {start}", tuple(jump_checks(motion, goal)), needed=False
            )
            good += not row.missed
            yield row
        checks = (
            Check("land and stand of 5", good, least=3),
            Check("processor s of all", spent.seconds),
        )
        yield Row("jumps", f"{case}, all", checks)


def jump_checks(motion: Solution, goal: Goal) -> list[Check]:
    """One flight, nearly as long as a stone's, then feet that stay on the ground, and rest."""
    weight, loads = motion.weight, motion.normal_force
    feet = loads.mean(axis=0) >= CARRYING * weight
    air = np.r_[False, ~(loads >= LOADED * weight).any(axis=1), False]
    edges = np.flatnonzero(np.diff(air.astype(int))).reshape(-1, 2)
    flight = motion.dt * max((b - a for a, b in edges), default=0)
    ballistic = 2.0 * np.sqrt(2.0 * goal.height / gravity_of(motion))
    gait = motion.gait
    return [
        Check("converged", float(motion.converged), least=1.0),
        Check("goal error", goal.error(motion), most=0.1),
        Check("flights", float(len(edges)), most=1.0, least=1.0),
        Check("flight s", flight, least=0.6 * ballistic),
        Check(
            "feet in the air at the end", float((loads[-1, feet] < LOADED * weight).sum()), most=0.0
        ),
        Check(
            "joint speed at the end",
            float(np.abs(motion.x[-1] - motion.x[-2]).max() / motion.dt),
            most=0.1,
        ),
        Check("torque use", motion.torque_excess, most=1.01),
        Check("friction use", motion.friction_use),
        Check("joint speed", gait.joint_speed if gait else None),
        Check("sink mm", 1e3 * motion.penetration),
        Check("slip", motion.slip),
        Check("E", motion.energy),
    ]


def gravity_of(motion: Solution) -> float:
    return float(np.linalg.norm([motion.parameters[f"gravity_{axis}"] for axis in "xyz"]))


def beside_crocoddyl(only: str, folder: Path, python: str | None) -> Iterator[Row]:
    """Each for itself, one core: contacts are given there and found here. With the step of its
    example, and with octo's speed."""
    if python is None:
        print("crocoddyl | skipped: --crocoddyl names no Python that has it")
        return
    motion = None
    for step in TROTS:
        command = [python, str(Path(__file__).with_name("crocoddyl_trot.py")), f"{step:g}"]
        environment = {"OMP_NUM_THREADS": "1", "PATH": os.environ.get("PATH", "")}
        done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
        theirs = json.loads(done.stdout.splitlines()[-1])
        if motion is None:
            with clock() as spent:
                motion = octo.walk(load("anymal_b"), seconds=theirs["seconds"], device="cpu")
            seconds = spent.seconds
        yield Row(
            "crocoddyl",
            f"anymal_b, {theirs['seconds']:g} s, its steps of {step:g} m",
            (
                Check("time over Crocoddyl's", seconds / theirs["processor"], most=3.0),
                Check("octo processor s", seconds),
                Check("Crocoddyl processor s", theirs["processor"]),
                Check("octo converged", float(motion.converged), least=1.0),
                Check("Crocoddyl converged", float(theirs["converged"])),
                Check("octo iterations", motion.iterations),
                Check("Crocoddyl iterations", theirs["iterations"]),
                Check("octo steps", motion.steps),
                Check("Crocoddyl nodes", theirs["nodes"]),
                Check("octo way m", float(motion.com[-1, 0] - motion.com[0, 0])),
                Check("Crocoddyl way m", theirs["way"]),
                Check("goal error", Goal("walk", 0.5).error(motion), most=0.1),
            ),
        )


SECTIONS: dict[str, Callable[..., Iterator[Row]]] = {
    "cycles": cycles,
    "walks": walks,
    "replay": replay,
    "jumps": jumps,
    "crocoddyl": beside_crocoddyl,
}


def keep(row: Row, path: Path) -> None:
    """Writes a row in the place of the one of that name, or behind the others."""
    records = json.loads(path.read_text()) if path.exists() else {}
    rows, made = records.setdefault(row.section, []), row.record()
    names = [other["name"] for other in rows]
    place = names.index(row.name) if row.name in names else len(rows)
    rows[place : place + 1] = [made]
    path.write_text(json.dumps(records, indent=1, ensure_ascii=False) + "\n")


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "sections", nargs="*", metavar="SECTION", help=f"{', '.join(SECTIONS)}; all by default"
    )
    parser.add_argument(
        "--only", default="", help="rows whose name has this text: 'go2 walk', 'spider'"
    )
    parser.add_argument("--json", type=Path, help="where the records are kept")
    parser.add_argument(
        "--folder", type=Path, default=Path("build/cycles"), help="where the motions go"
    )
    parser.add_argument(
        "--table", action="store_true", help="run nothing: print the records of --json as tables"
    )
    parser.add_argument("--crocoddyl", metavar="PYTHON", help="a Python that has crocoddyl 3.2.1")
    arguments = parser.parse_args(words)
    if arguments.table:
        print(table(json.loads(arguments.json.read_text())))
        return 0
    unknown = set(arguments.sections) - set(SECTIONS)
    if unknown:
        parser.error(
            f"no section is named {', '.join(sorted(unknown))}; there are {', '.join(SECTIONS)}"
        )
    arguments.folder.mkdir(parents=True, exist_ok=True)
    short = 0
    for name in arguments.sections or SECTIONS:
        more = (arguments.crocoddyl,) if name == "crocoddyl" else ()
        for row in SECTIONS[name](arguments.only, arguments.folder, *more):
            print(row, flush=True)
            short += row.needed and bool(row.missed)
            if arguments.json:
                keep(row, arguments.json)
    print(f"{short} rows fall short" if short else "all limits are met")
    return 1 if short else 0


if __name__ == "__main__":
    sys.exit(main())
