"""``octo compare``: the same problem, start and tolerances, in octo and in other solvers."""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from octo.checks import whole
from octo.cli.arguments import (
    LIMITS,
    add_options,
    check_limits,
    limits_of,
    number,
    positive,
    robot_of,
)
from octo.cli.output import OutputFolder, Writer, records_of, say_left_out
from octo.cli.soft import is_soft
from octo.cli.soft_solve import check_soft, course_of
from octo.cli.solve import add_goal_arguments, asked_steps, described, goal_of, report, surroundings
from octo.cli.written import write_json
from octo.errors import ProblemError, UnknownNameError, UsageError
from octo.model.character import Character
from octo.problem import presets
from octo.problem.cycle import TIME_STEP, Cycle
from octo.problem.hard import beside
from octo.problem.joint_costs import Effort
from octo.problem.problem import Problem
from octo.result.solution import Solution
from octo.solver.options import SqpOptions
from octo.solver.status import Status

HEAD = (
    f"{'solver':8s}{'pass':>5s}{'seed':>5s}  "
    f"{'status':16s}{'its':>5s}{'cpu s':>9s}{'ms/it':>8s}{'E':>12s}{'‖C‖∞ N':>10s}{'point N':>10s}"
)
SOLVERS = ("ipopt", "fatrop")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_goal_arguments(parser, device="cpu")  # one core each
    parser.add_argument(
        "--with",
        dest="others",
        metavar="SOLVERS",
        help="ipopt, fatrop or both with a comma (default: all that can solve the problem)",
    )
    records = "a list with one record per solver, seed and pass; a plot is written beside it"
    add_options(
        parser,
        ("--cycle", bool, False, "a stride that repeats, at --speed, in place of a goal"),
        ("--period", positive, None, "s, of a cycle's stride (default 0.8)"),
        ("--no-mirror", bool, False, "solve for a whole stride of a cycle, not for half of it"),
        ("--turn", number, None, "rad, change of heading in a cycle's stride (default 0)"),
        ("--json", None, None, records, "FILE"),
    )
    parser.set_defaults(run=run, dt=None)


def run(arguments: argparse.Namespace) -> int:
    """Everything that can be refused is refused before anything is compiled."""
    check_limits(arguments)
    cycle = cycle_of(arguments)
    if cycle is None:
        arguments.dt = arguments.dt or TIME_STEP
    soft = is_soft(arguments.robot)
    others = solvers_of(arguments.others, arguments.basis, cycle is not None, soft)
    path = records_of(arguments.json)
    start = None if arguments.start is None else Solution.load(arguments.start)
    asked = asked_of(arguments, cycle)
    # after the checks: it takes longer to import than they take
    from octo.bench.contest import Contest, Entry
    from octo.devices import resolve_device
    from octo.reference.run import OPTIONS
    from octo.solve import LARGEST_SEED, MOST_STARTS, settings_of

    whole("seeds", arguments.seeds, most=MOST_STARTS)
    whole("seed", arguments.seed, 0, LARGEST_SEED)
    device = resolve_device(arguments.device)
    problem = asked.describe()
    options = settings_of(OPTIONS, *(getattr(arguments, name) for name in LIMITS))
    how = (arguments.passes or 1, arguments.threads, device, start, asked.guess)
    contest = Contest(problem, others, options, *how)
    entries: list[Entry] = []
    interrupted = False
    kind = f"goal {asked.goal}" if asked.goal else "cycle"
    steps_of_dt = f"{problem.steps} steps of {problem.dt:g} s"
    head = f"{HEAD}{'bounds':>10s}" if problem.constraints else HEAD
    name = (problem.character or problem.dynamics).name
    print(f"{name}, {steps_of_dt}, {problem.basis_object.name}, {kind}\n{head}", flush=True)
    try:
        for entry in contest.run(range(arguments.seed, arguments.seed + arguments.seeds)):
            entries.append(entry)
            print(row(entry), flush=True)
            if entry.solution.status is Status.INTERRUPTED:
                raise KeyboardInterrupt
    except KeyboardInterrupt:
        interrupted = True
    for line in summary(entries, others, len(contest.plan)):
        print(line)
    finished = any(entry.solution.status is not Status.INTERRUPTED for entry in entries)
    # an earlier file stays
    if path is not None and not finished and (path.exists() or not entries):
        print("octo: interrupted before a solver was done, nothing was written", file=sys.stderr)
    elif path is not None:
        write(path, entries, [record(entry, asked, options) for entry in entries])
    return 130 if interrupted else 0


@dataclass(frozen=True)
class Asked:
    """A goal in a word, "" of a cycle; what describes the problem; what says of a solution how near
    it came; and the first guess of a seed, where it has one of its own."""

    goal: str
    describe: Callable[[], Problem]
    said: Callable[[Solution], Solution] = lambda solution: solution
    guess: Callable[[int], Any] | None = None


def asked_of(arguments: argparse.Namespace, cycle: Cycle | None) -> Asked:
    """What is asked for; what can be refused is."""
    if is_soft(arguments.robot):
        check_soft(arguments)
        course = course_of(arguments)
        return Asked(course.task, lambda: course.problem, course.said, course.guess)
    if cycle is not None:
        robot = robot_of(arguments)
        return Asked("", lambda: repeated(robot, cycle, arguments))
    goal = goal_of(arguments)
    steps, robot = asked_steps(goal, arguments), robot_of(arguments)
    goal.check(robot)
    return Asked(goal.kind, lambda: described(robot, goal, steps, arguments), goal.said)


def cycle_of(arguments: argparse.Namespace) -> Cycle | None:
    """The cycle that was asked for; None where a goal was.

    Raises
    ------
    UsageError: what only a cycle has was given without it.
    """
    if arguments.cycle:
        period = 0.8 if arguments.period is None else arguments.period
        mirror, turn = not arguments.no_mirror, arguments.turn or 0.0
        return Cycle(speed=arguments.speed, period=period, mirror=mirror, turn=turn)
    for name in ("--period", "--no-mirror", "--turn"):
        given = getattr(arguments, name[2:].replace("-", "_"))
        if given is not None and given is not False:
            raise UsageError(f"{name} is given without --cycle: only a cycle has it")
    return None


def repeated(robot: Character, cycle: Cycle | None, arguments: argparse.Namespace) -> Problem:
    """The problem of a cycle, of natural terms."""
    own = {"dt": arguments.dt or 0.0, "basis": arguments.basis, "cycle": cycle}
    problem = Problem(robot, costs=[Effort()], **own, **surroundings(robot, arguments))
    held = limits_of(robot, arguments)
    costs = beside(held, presets.natural(length=problem.length))
    return problem.replace(costs=costs, constraints=held)


def solvers_of(words: str | None, basis: str, cycle: bool, soft: bool = False) -> tuple[str, ...]:
    """The solvers beside octo.

    Raises
    ------
    UnknownNameError: no such solver. ProblemError: fatrop was asked for a cycle, a soft body, or in
        another basis than nodes.
    """
    if words is None:
        return SOLVERS if basis == "nodes" and not (cycle or soft) else ("ipopt",)
    names = tuple(dict.fromkeys(word.strip() for word in words.split(",") if word.strip()))
    for name in names:
        if name not in SOLVERS:
            raise UnknownNameError("solver", name, SOLVERS)
    sees = "a stage may see its own state and control only"
    if "fatrop" in names and cycle:
        raise ProblemError(f"fatrop cannot solve a cycle: {sees}; leave it out of --with")
    if "fatrop" in names and soft:
        raise ProblemError(
            "fatrop needs the dynamics as one expression, a soft body's are loops over its "
            "surface; leave it out of --with"
        )
    if "fatrop" in names and basis != "nodes":
        raise ProblemError(
            f"fatrop cannot solve in the {basis} basis: {sees}, and a row of C sums the steps of "
            "two segments; leave it out of --with, or use --basis nodes"
        )
    return names


def row(entry: Any) -> str:
    """One line of the table."""
    s = entry.solution
    line = f"{entry.solver:8s}{entry.number:5d}{entry.seed:5d}  {s.status.label:16s}"
    line += f"{s.iterations:5d}{s.processor_seconds:9.2f}"
    line += f"{1e3 * s.processor_seconds / max(s.iterations, 1):8.1f}"
    line += f"{s.energy:12.6g}{s.violation:10.1e}{s.pointwise_residual:10.1e}"
    if s.bounds:  # of all constraints, in parts of their size
        line += f"{max(bound.violation for bound in s.bounds):10.1e}"
    return line if entry.compiled else f"{line}  interpreted"


def summary(entries: Sequence[Any], others: Sequence[str], passes: int) -> list[str]:
    """How many starts each solver converged on, and octo's medians over another's where both
    converged."""
    from octo.bench.contest import both_converged, ratios

    lines = []
    for stage in range(1, passes + 1):
        own = [entry for entry in entries if entry.number == stage]
        if not own:
            continue
        done = Counter(entry.solver for entry in own if entry.solution.converged)
        told = ", ".join(f"{name} {done[name]}" for name in ("octo", *others))
        starts = len({entry.seed for entry in own})
        lines.append(f"pass {stage}: converged of {starts} starts: {told}")
        for name in others:
            both = both_converged(own, name)
            if both:
                words = ", ".join(f"{what} {value:.3g}" for what, value in ratios(both).items())
                lines.append(f"  octo/{name}, medians over {len(both)}: {words}")
    return lines


def record(entry: Any, asked: Asked, options: SqpOptions) -> dict[str, Any]:
    """The fields of report.json, those of a goal if any, who made it, and to which
    tolerances."""
    own = ("solver", "said", "compiled", "settings")
    limits = {"violation": options.tolerance, "dual": options.dual_tolerance}
    limits |= {"step": options.step_tolerance}
    limits |= {name: getattr(options, name) for name in ("plateau", "plateau_change")}
    found = entry.solution
    return {
        **(report(asked.said(found), asked.goal) if asked.goal else found.report()),
        **{name: getattr(entry, name) for name in own},
        "pass": entry.number,
        "iteration_limit": options.max_iterations,
        "tolerances": limits,
    }


def write(path: Path, entries: Sequence[Any], records: Sequence[dict[str, Any]]) -> None:
    """The list, and the plot beside it where matplotlib is."""
    s = entries[0].solution
    title = f"{s.name}, {s.steps} steps of {s.dt:g} s, {s.basis}"

    def draw_runs(scratch: Path) -> None:
        from octo.cli.convergence import draw  # here: it is loaded when the numbers are written

        draw(entries, title, scratch)

    writers: dict[str, Writer] = {
        path.name: lambda scratch: write_json(scratch, records),
        f"{path.stem}.png": draw_runs,
    }
    say_left_out(OutputFolder(path.parent).write(writers))
    print(f"written to {path}")
