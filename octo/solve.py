"""The front door: device, passes, starts as one batch, callbacks."""

from __future__ import annotations

import logging
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import islice
from typing import Any, overload

import numpy as np
from scipy.interpolate import CubicSpline

from octo.checks import asked, flag, instance, numbers, one_of, room, whole
from octo.dynamics.evaluate import Dynamics, RobotDynamics
from octo.errors import DeviceError, ProblemError, ShapeError, ValueRangeError, said
from octo.gpu import cuda
from octo.gpu.backend import DeviceBackend
from octo.model.character import Character
from octo.model.kinematics import body_poses, sphere_centers
from octo.model.mass_matrix import joint_twists
from octo.passes import RAMP_ITERATIONS, Pass, between, early, moved, record, schedule
from octo.problem.codegen import touching
from octo.problem.compiled import CompiledProblem
from octo.problem.cycle import Closure
from octo.problem.problem import Array, Problem
from octo.problem.structure import check_alike
from octo.result import measure
from octo.result.gait import flaws
from octo.result.solution import Solution, solution_of
from octo.solver import sqp
from octo.solver.backend import CPU, Backend
from octo.solver.options import SqpOptions
from octo.solver.sqp import Iterate, Monitor
from octo.solver.status import HISTORY, Status

# rad and m, of the actuated coordinates: a perfectly symmetric start keeps the solution planar
NOISE = 0.02
NOISE_PERIOD = 0.5  # s, between the knots of the noise
SWINGS = 0.02  # m/rad, by which a joint must move its foot forward to be one that swings it
CYCLE_NOISE = 0.1  # rad and m, of a cycle's first harmonic
DEVICES = ("auto", "cpu", "cuda")
BLOCKS = 20  # (n, n) of a step, about: derivatives of FD, E and C, and the factors
MOST_STARTS, MOST_THREADS, LARGEST_SEED = 100_000, 1024, 2**64 - 1
LOG = logging.getLogger("octo")
Guess = Solution | Array | str | os.PathLike[str] | None
Start = Guess | Sequence[Guess]


@overload
def solve(
    problem: Problem,
    *,
    start: Guess = None,
    passes: int | None = None,
    seeds: int = 1,
    seed: int = 0,
    options: SqpOptions | None = None,
    max_iterations: int | None = None,
    time_limit: float | None = None,
    tolerance: float | None = None,
    device: str = "auto",
    threads: int = 1,
    progress: bool | str = False,
    callback: Callable[[Iterate], bool | None] | None = None,
) -> Solution: ...
@overload
def solve(
    problem: Sequence[Problem],
    *,
    start: Start = None,
    passes: int | None = None,
    seeds: int = 1,
    seed: int = 0,
    options: SqpOptions | None = None,
    max_iterations: int | None = None,
    time_limit: float | None = None,
    tolerance: float | None = None,
    device: str = "auto",
    threads: int = 1,
    progress: bool | str = False,
    callback: Callable[[Iterate], bool | None] | None = None,
) -> list[Solution]: ...
@asked
def solve(
    problem: Problem | Sequence[Problem],
    *,
    start: Start = None,
    passes: int | None = None,
    seeds: int = 1,
    seed: int = 0,
    options: SqpOptions | None = None,
    max_iterations: int | None = None,
    time_limit: float | None = None,
    tolerance: float | None = None,
    device: str = "auto",
    threads: int = 1,
    progress: bool | str = False,
    callback: Callable[[Iterate], bool | None] | None = None,
) -> Solution | list[Solution]:
    """Find the motion.

    Parameters
    ----------
    problem: one problem, or several of one structure (same robot, terms, basis, steps) that are
        solved as one batch.
    start: a Solution (or the path of its file or folder), or nodes x_0 … x_N (N+1, nx), to start
        from instead of the static pose with noise; of several problems one for all, or a list of
        one for each. With another number of steps than the problem's it is resampled: the whole of
        it over the whole of the problem.
    passes: how many passes of growing contact stiffness; four by default, one where the caller set
        the stiffness.
    seeds: starts, solved as one batch; ``seed`` is the first one's number. The converged one of
        least E is returned. Of a cycle with a range of periods each period has its own starts, all
        in one batch; of the best of each period the one is returned whose joints do least work on
        the same way (``Solution.power``).
    options: how; ``max_iterations`` (of a pass), ``time_limit`` (s, of all passes) and
        ``tolerance`` (‖C‖∞ over the weight) may also be given on their own.
    device: "cpu", "cuda", or "auto": the GPU where there is one, else the CPU. The solution's
        ``device`` says which it was, the log of the package ``logging`` (named "octo", level INFO)
        why.
    threads: of the CPU's native code.
    progress: print a line now and then, behind this text where it is one. callback: called with an
        :class:`~octo.solver.sqp.Iterate` after every iteration; returning True stops, with the best
        iterate so far.

    Returns
    -------
    A Solution for one problem, a list of them for several. Ctrl-C returns the best iterate so far.

    Raises
    ------
    OctoError: the problem, an option or the device is refused; nothing was computed.
    """
    problems = [problem] if isinstance(problem, Problem) else _problems(problem)
    periods = [_of_each_period(one) for one in problems]
    given = zip(_each(start, problems, 1), periods, strict=True)
    starts = [start for start, group in given for _ in group]
    members, best = _solve(
        [one for group in periods for one in group],
        start=starts,
        passes=passes,
        seeds=seeds,
        seed=seed,
        options=options,
        max_iterations=max_iterations,
        time_limit=time_limit,
        tolerance=tolerance,
        device=device,
        threads=threads,
        progress=progress,
        callback=callback,
    )
    left = iter(best)
    chosen = []
    for described, group in zip(problems, periods, strict=True):
        rivals = [members[k] for k in islice(left, len(group))]
        chosen.append(min(rivals, key=partial(_rank_of_period, described)))
    if not isinstance(problem, Problem):
        return chosen
    _say_kept(chosen[0])
    return replace(chosen[0], starts=tuple(m.report() for m in members))


def _problems(given: Any) -> list[Problem]:
    """A batch, or a sentence that says what is missing of one."""
    if isinstance(given, (Character, Dynamics)):
        raise ProblemError(
            f"octo.solve was given {said(given)}, must be an octo.Problem: what the robot is to "
            "do is missing. "
            "Say it with octo.Problem(robot, steps=160, dt=0.025, costs=[octo.Effort()]), or "
            "call octo.walk(robot)"
        )
    if not isinstance(given, (list, tuple)) or not all(isinstance(one, Problem) for one in given):
        raise ProblemError(
            f"octo.solve was given {said(given)}, must be an octo.Problem or a list of them"
        )
    if not given:
        raise ValueRangeError("the list of problems is empty")
    return list(given)


def _of_each_period(problem: Problem) -> list[Problem]:
    """The problem itself, or one for each period of its cycle's range."""
    cycle = problem.cycle
    if cycle is None or not isinstance(cycle.period, tuple):
        return [problem]
    return [problem.replace(cycle=replace(cycle, period=period)) for period in cycle.periods]


def best_of(members: Sequence[Solution]) -> Solution:
    """The best of the starts of one problem, with a record of each."""
    best = min(members, key=_rank)
    _say_kept(best)
    return replace(best, starts=tuple(member.report() for member in members))


def solve_all(problem: Problem | Sequence[Problem], **options: Any) -> list[Solution]:
    """As :func:`solve`, but the solutions of all starts of all problems, not the best of each."""
    return _solve([problem] if isinstance(problem, Problem) else list(problem), **options)[0]


def evaluated(problem: Problem, nodes: Array, status: Status) -> Solution:
    """A given trajectory x_0 … x_N (N+1, nx) as a Solution, without a solve."""
    compiled = CompiledProblem([problem])
    at = compiled.evaluate(compiled.unknowns(first_nodes(problem, 0, nodes)[None]))
    multipliers = np.zeros((compiled.K, compiled.ma))
    made = Solution(
        **measure.measured(compiled, at, 0),
        multipliers=multipliers,
        status=status,
        iterations=0,
        factorizations=0,
        history={name: np.zeros(0) for name in HISTORY},
        seconds=0.0,
        setup_seconds=0.0,
    )
    return replace(made, passes=(record(1, made),))


@dataclass
class _Run:
    """What one call of solve carries from pass to pass."""

    options: SqpOptions
    threads: int
    backend: Backend
    setup_seconds: float = 0.0
    seconds: float = 0.0


def _solve(
    problems: list[Problem],
    *,
    options: SqpOptions | None = None,
    passes: int | None = None,
    seeds: int = 1,
    seed: int = 0,
    start: Start = None,
    device: str = "auto",
    threads: int = 1,
    max_iterations: int | None = None,
    time_limit: float | None = None,
    tolerance: float | None = None,
    progress: bool | str = False,
    callback: Callable[[Iterate], bool | None] | None = None,
) -> tuple[list[Solution], list[int]]:
    """All members' solutions, and the index of the best one of each problem."""
    settings = settings_of(options, max_iterations, time_limit, tolerance)
    for name, count, most in (("seeds", seeds, MOST_STARTS), ("threads", threads, MOST_THREADS)):
        whole(name, count, most=most)
    whole("seed", seed, 0, LARGEST_SEED)
    check_progress(progress, callback)
    steps, n = max(problem.steps for problem in problems), problems[0].dynamics.nx
    room(
        f"{steps} steps of {len(problems) * seeds} starts",
        BLOCKS * n**2 * float(steps) * len(problems) * seeds,
    )
    run = _Run(settings, int(threads), backend_of(device))
    batch = [problem for problem in problems for _ in range(seeds)]
    numbers = [seed + k for _ in problems for k in range(seeds)]
    check_alike(problems)  # before the seeds, so that a message counts what the caller gave
    own = [schedule(problem, passes) for problem in problems]
    if any(
        [stage is None for stage in plan] != [stage is None for stage in own[0]] for plan in own[1:]
    ):
        told = "one has passes in which it grows, one is fixed"
        raise ProblemError(
            f"the contact laws of the problems differ in stiffness or friction: {told}, solve "
            "them one by one"
        )
    plans = [plan for plan in own for _ in range(seeds)]
    began = time.perf_counter()
    current = _for_pass(batch, [plan[0] for plan in plans])
    compiled = CompiledProblem(current, run.threads)
    starts = _each(start, problems, seeds)
    nodes = np.stack([first_nodes(*one) for one in zip(current, numbers, starts, strict=True)])
    _prepare(run, compiled, device)
    run.setup_seconds = time.perf_counter() - began
    monitor = Monitor(
        callback, _Progress(progress if isinstance(progress, str) else "") if progress else None
    )
    try:
        members = _passes(run, compiled, nodes, plans, monitor, numbers, starts)
    finally:
        run.backend.release()
    groups = [range(k * seeds, (k + 1) * seeds) for k in range(len(problems))]
    return members, [min(group, key=lambda k: _rank(members[k])) for group in groups]


def settings_of(options: Any, max_iterations: Any, time_limit: Any, tolerance: Any) -> SqpOptions:
    """The options, with those in place that were given on their own."""
    chosen = (
        SqpOptions()
        if options is None
        else instance("options", options, SqpOptions, "an octo.SqpOptions")
    )
    given: dict[str, Any] = {
        "max_iterations": max_iterations,
        "time_limit": time_limit,
        "tolerance": tolerance,
    }
    return replace(chosen, **{name: value for name, value in given.items() if value is not None})


def _prepare(run: _Run, compiled: CompiledProblem, device: str) -> None:
    """Everything compiled; with "auto", a problem that the GPU cannot take goes to the CPU."""
    try:
        run.backend.prepare(compiled, run.options)
    except DeviceError as error:
        if device != "auto" or run.backend is CPU:
            raise
        _say_cpu(str(error))
        run.backend = CPU
        CPU.prepare(compiled, run.options)


def _rank(member: Solution) -> tuple[bool, int, bool, int, float]:
    """Converged first, then those that got through more passes, of cycles those whose gait has
    fewer flaws, then by E."""
    feasible = member.violation <= 1e-3 * member.weight
    done = sum(bool(record["converged"]) for record in member.passes)
    flawed = 0 if member.cycle is None else flaws(member.gait, member.length)
    return (
        not member.converged,
        -done,
        not feasible,
        flawed,
        member.energy if feasible else member.violation,
    )


def _rank_of_period(problem: Problem, member: Solution) -> tuple[bool, int, bool, int, float]:
    """As ``_rank``, with the work of the joints in place of E.

    The terms of E are means over time, but they do not mean the same for every period: feet that
    share the load stand longer the longer the stride is, so that E of the natural terms only falls
    (mammal at 0.5 m/s: .25, .17, .14 at 0.3, 0.5, 0.8 s; biped .24, .15, .13 at 0.5, 1.0, 1.5 s).
    Work over weight and way has its least in between (.54, .37, .53; 1.1, .72, .81), near the
    strides of animals of that size (docs/notes/cycles.md).
    """
    failed, passes, infeasible, flawed, last = _rank(member)
    cycle = problem.cycle
    if cycle is None or member.cycle is None or infeasible:
        return failed, passes, infeasible, flawed, last
    # the way of a stride is what is given
    a_stride = cycle.shift is not None or (cycle.velocity == cycle.sideways == 0.0)
    return (
        failed,
        passes,
        infeasible,
        flawed,
        member.power * (member.cycle.period if a_stride else 1.0),
    )


def _for_pass(problems: Sequence[Problem], stages: Sequence[Pass | None]) -> list[Problem]:
    """Problems with the contact laws of their passes: what is the same problem and pass is one
    object."""
    made: dict[tuple[int, Pass | None], Problem] = {}
    for problem, stage in zip(problems, stages, strict=True):
        if (id(problem), stage) not in made:
            parameters = None if stage is None else stage.parameters(problem.weight)
            made[id(problem), stage] = (
                problem if parameters is None else problem.replace(parameters=parameters)
            )
    return [made[id(problem), stage] for problem, stage in zip(problems, stages, strict=True)]


def _passes(
    run: _Run,
    compiled: CompiledProblem,
    nodes: Array,
    plans: list[list[Pass | None]],
    monitor: Monitor,
    numbers: list[int],
    starts: Sequence[Solution | Array | None],
) -> list[Solution]:
    """Pass after pass, each member by its own plan; it goes on from a converged pass only, and
    keeps the last one it was in."""
    done: dict[int, Solution] = {}
    alive, count = list(range(compiled.batch)), len(plans[0])
    lam = _first_multipliers(starts, compiled)
    number = 0
    try:
        for number in range(1, count + 1):
            monitor.begin(number, count)
            if number > 1:
                ends = [(plans[k][number - 2], plans[k][number - 1]) for k in alive]
                compiled, nodes, result = _climb(run, compiled, nodes, lam, monitor, ends)
            else:
                result = _pass(run, compiled, nodes, lam, monitor, run.options.max_iterations)
            made = [
                _solution(run, compiled, result, place, numbers[k], number, done.get(k))
                for place, k in enumerate(alive)
            ]
            for k, member in zip(alive, made, strict=True):
                done[k] = member if member.converged or k not in done else _kept(done[k], member)
            keep = np.flatnonzero([member.converged for member in made])
            alive = [alive[place] for place in keep]
            if not alive or monitor.stopped:
                break
            compiled = compiled.take(keep)
            nodes = result.at.nodes[keep]
            lam = np.ascontiguousarray(result.lam[keep])
    except KeyboardInterrupt:  # between two passes
        if not done:
            raise
        monitor.stopped, number = True, min(number, count - 1)
    if monitor.stopped and number < count:
        done.update({k: replace(done[k], status=Status.INTERRUPTED) for k in alive})
    monitor.end()
    return [done[k] for k in sorted(done)]


def _climb(
    run: _Run,
    compiled: CompiledProblem,
    nodes: Array,
    lam: Array | None,
    monitor: Monitor,
    ends: Sequence[tuple[Pass | None, Pass | None]],
) -> tuple[CompiledProblem, Array, sqp.Result]:
    """From one converged pass to the end of the next, over the stiffnesses between each member's
    two."""
    ways = [
        (*between(before, after), after)
        for before, after in ends
        if before is not None and after is not None
    ]
    way: list[sqp.Result] = []
    for stages in zip(*ways, strict=True):
        last = len(way) + 1 == len(ways[0])
        compiled, nodes = _stiffer(run, compiled, nodes, stages)
        way.append(
            _pass(
                run,
                compiled,
                nodes,
                lam,
                monitor,
                run.options.max_iterations if last else RAMP_ITERATIONS,
            )
        )
        nodes, lam = way[-1].at.nodes, way[-1].lam
        if monitor.stopped and not last:
            way[-1].status = [Status.INTERRUPTED] * compiled.batch
            break
    result = way.pop()
    for earlier in reversed(way):
        result = result.after(earlier)
    return compiled, nodes, result


def _kept(converged: Solution, failed: Solution) -> Solution:
    """The motion of the last converged pass, left near its optimum, with the record of the pass
    that failed after it."""
    status = failed.status if failed.status is Status.INTERRUPTED else Status.ACCEPTABLE
    return replace(
        converged,
        status=status,
        passes=failed.passes,
        history=failed.history,
        stages=failed.stages,
        seconds=failed.seconds,
        processor_seconds=failed.processor_seconds,
        iterations=failed.iterations,
        factorizations=failed.factorizations,
    )


def _pass(
    run: _Run,
    compiled: CompiledProblem,
    nodes: Array,
    lam: Array | None,
    monitor: Monitor,
    iterations: int,
) -> sqp.Result:
    """One solve with what is left of the time."""
    wanted = run.options if monitor.number == monitor.passes else early(run.options)
    options = replace(
        wanted,
        time_limit=max(run.options.time_limit - run.seconds, 1e-9),
        max_iterations=iterations,
    )
    problem = run.backend.place(compiled)
    result = sqp.run(
        problem, problem.unknowns(nodes), run.backend.array(lam), options, monitor, run.backend
    )
    run.seconds += result.seconds
    return result


def _stiffer(
    run: _Run, compiled: CompiledProblem, nodes: Array, stages: Sequence[Pass]
) -> tuple[CompiledProblem, Array]:
    """The same problems with stiffer contact laws, and the nodes shifted to their new starts."""
    began = time.perf_counter()
    problems = _for_pass(compiled.problems, stages)
    shifted = np.stack(
        [moved(x, old, new) for x, old, new in zip(nodes, compiled.problems, problems, strict=True)]
    )
    stiffer = CompiledProblem(problems, run.threads, like=compiled)
    run.setup_seconds += time.perf_counter() - began
    return stiffer, shifted


def _solution(
    run: _Run,
    compiled: CompiledProblem,
    result: sqp.Result,
    place: int,
    seed: int,
    number: int,
    before: Solution | None,
) -> Solution:
    """One member after a pass, with the record of the passes before."""
    history = result.history[place]
    history["pass"] = np.full(len(history["iteration"]), float(number))
    if before is not None:
        history = {
            name: np.concatenate([before.history[name], values]) for name, values in history.items()
        }
    own = {
        "multipliers": result.lam[place].copy(),
        "status": result.status[place],
        "iterations": int(result.iterations[place]),
        "factorizations": int(result.factorizations[place]),
        "history": history,
        "seconds": float(result.seconds),
        "processor_seconds": float(result.processor_seconds),
        "setup_seconds": run.setup_seconds,
        "seed": seed,
        "device": run.backend.name,
        "stages": dict(result.stages),
    }
    made = Solution(**measure.measured(compiled, result.at, place), **own)
    records = (*(before.passes if before else ()), record(number, made))
    if before is None:
        return replace(made, passes=records)
    stages = {name: before.stages.get(name, 0.0) + value for name, value in made.stages.items()}
    return replace(
        made,
        passes=records,
        stages=stages,
        iterations=before.iterations + made.iterations,
        factorizations=before.factorizations + made.factorizations,
        seconds=before.seconds + made.seconds,
        processor_seconds=before.processor_seconds + made.processor_seconds,
    )


def first_nodes(problem: Problem, seed: int, start: Solution | Array | None) -> Array:
    """x_{-1} … x_N (N+2, nx): the start held still with smooth noise on the actuated coordinates,
    or what the user gave."""
    if problem.closure is not None:
        return _first_cycle(problem, problem.closure, seed, start)
    before = problem.start - problem.dt * problem.start_velocity
    if start is None:
        nodes = np.repeat(problem.start[None], problem.steps + 2, axis=0)
        nodes[2:, problem.dynamics.actuated] += smooth_noise(problem, seed)
    else:
        nodes = _given_nodes(problem, start)
        nodes[1] = problem.start
    nodes[0] = before
    return nodes


def _first_cycle(
    problem: Problem, closure: Closure, seed: int, start: Solution | Array | None
) -> Array:
    """x_{-1} … x_N (N+2, nx) of a cycle: the start carried along, with noise in the joints' first
    harmonic."""
    if start is None:
        part = np.arange(-1, problem.steps + 1)[:, None] / problem.steps
        nodes = closure.along(problem.start, problem.steps)
        angle = 2.0 * np.pi * part / (2.0 if closure.mirrored else 1.0)
        a, b = CYCLE_NOISE * np.random.default_rng(seed).standard_normal((2, problem.dynamics.nx))
        swing = fore_and_aft(problem)
        a = np.where(swing != 0.0, np.abs(a) * swing, a)
        if closure.mirror is not None:  # left and right do the same, half a period apart
            a, b = (0.5 * (wave - closure.mirror.matrix @ wave) for wave in (a, b))
        joints = problem.dynamics.actuated
        nodes[:, joints] = (
            problem.start[joints] + (np.cos(angle) * a + np.sin(angle) * b)[:, joints]
        )
    else:
        nodes = _given_nodes(problem, start)
    nodes[:2] = nodes[-2:] @ closure.matrix.T + closure.constant
    return nodes


def fore_and_aft(problem: Problem) -> Array:
    """(nx,) the sign with which a joint swings its foot forward while the neighbours of that foot
    swing back; 0 of other joints.

    Neighbours are the foot beside it and the one before it: of four legs those across swing
    together, as in a trot. Starts without this rule pace as often as they trot, at the same E, and
    a pace at speed falls over sideways.
    """
    signs = np.zeros(problem.dynamics.nx)
    if not isinstance(problem.dynamics, RobotDynamics):
        return signs
    robot = problem.dynamics.character
    x = problem.start
    feet = touching(problem.dynamics, problem.setting)
    centers, twists = sphere_centers(robot, x), joint_twists(robot, x)
    heading = body_poses(robot, x)[0][robot.base_body]
    place = (centers[feet] - centers[feet].mean(axis=0)) @ heading  # fore, left, up
    for side in (1.0, -1.0):
        row = sorted(
            (k for k in range(len(feet)) if side * place[k, 1] > 0.0), key=lambda k: place[k, 0]
        )
        # heel and toe are one foot
        bodies = list(dict.fromkeys(robot.contacts[feet[k]].body for k in row))
        for k in row:
            body = robot.contacts[feet[k]].body
            step = side * (-1.0) ** bodies.index(body)
            for j in set(robot.path[body]).intersection(robot.actuated.tolist()):
                forward = (twists[j, 3:] + np.cross(twists[j, :3], centers[feet[k]])) @ heading[
                    :, 0
                ]
                signs[j] = step * np.sign(forward) if abs(forward) > SWINGS else signs[j]
    return signs


def _given_nodes(problem: Problem, start: Solution | Array) -> Array:
    """x_0 (twice) … x_N (N+2, nx) that the user gave."""
    given = numbers("start", start.x[1:] if isinstance(start, Solution) else start)
    if given.ndim != 2 or given.shape[1] != problem.dynamics.nx or len(given) < 2:
        raise ShapeError(
            "start",
            given.shape,
            f"(N+1, {problem.dynamics.nx}), one row for each of two moments or more",
        )
    given = resampled(given, problem.steps)
    return np.concatenate([given[:1], given])


def resampled(nodes: Array, steps: int) -> Array:
    """Nodes (M+1, nx) as (steps+1, nx): the same motion from its first to its last, on a natural
    cubic spline."""
    if len(nodes) == steps + 1:
        return nodes
    spline = CubicSpline(np.linspace(0.0, 1.0, len(nodes)), nodes, axis=0, bc_type="natural")
    return np.asarray(spline(np.linspace(0.0, 1.0, steps + 1)))


def smooth_noise(problem: Problem, seed: int) -> Array:
    """(N, nu) rad and m: a cubic spline through random knots, zero at the start; the same for the
    same seed."""
    duration = problem.steps * problem.dt
    knots = max(3, int(np.ceil(duration / NOISE_PERIOD)) + 1)
    values = NOISE * np.random.default_rng(seed).standard_normal((knots, problem.dynamics.nu))
    values[0] = 0.0
    times = problem.dt * np.arange(1, problem.steps + 1)
    return np.asarray(CubicSpline(np.linspace(0.0, duration, knots), values, axis=0)(times))


def _first_multipliers(
    starts: Sequence[Solution | Array | None], compiled: CompiledProblem
) -> Array | None:
    """Those of warm starts of the same shape, zero for other members."""
    shape = (compiled.K, compiled.ma)
    found = [
        start.multipliers
        if isinstance(start, Solution) and start.multipliers.shape == shape
        else None
        for start in starts
    ]
    return (
        None
        if all(lam is None for lam in found)
        else np.stack([np.zeros(shape) if lam is None else lam for lam in found])
    )


def _each(start: Any, problems: Sequence[Problem], seeds: int) -> list[Solution | Array | None]:
    """The start of each member: a list has one for each problem."""
    if not isinstance(start, (list, tuple)):
        return [_opened(start)] * (len(problems) * seeds)
    if len(start) != len(problems):
        raise ShapeError("start", (len(start),), f"({len(problems)},): one for each problem")
    return [one for one in map(_opened, start) for _ in range(seeds)]


def _opened(start: Any) -> Any:
    """What the user gave, or the solution at a path."""
    return solution_of(start) if isinstance(start, (str, os.PathLike)) else start


def _say_kept(solution: Solution) -> None:
    last = solution.passes[-1]
    if solution.converged and not last["converged"]:
        print(
            f"octo: pass {last['pass']} did not converge ({last['status']}): the motion of the "
            "pass before it is returned",
            file=sys.stderr,
        )


@cache
def _say_cpu(reason: str) -> None:
    LOG.info("using the CPU: %s", reason)


def check_progress(progress: object, callback: object) -> None:
    """Refuse what cannot say how a solve goes."""
    if not isinstance(progress, str):
        flag("progress", progress)
    if not (callback is None or callable(callback)):
        raise ProblemError(f"callback is {said(callback)}, must be a function of an Iterate")


def check_device_name(device: object) -> None:
    """Refuse what is no device. The nearest name would be a bad guess: that of "gpu" is "cpu".

    Raises
    ------
    UnknownNameError: says which there are.
    """
    one_of(
        "device", device, DEVICES, "valid: cpu, cuda (an NVIDIA GPU), auto (a GPU if there is one)"
    )


def resolve_device(device: str) -> str:
    """ "cuda", or "cpu"; for "auto" the log says why.

    Raises
    ------
    DeviceError: "cuda" was asked for and cannot be used. UnknownNameError: no such device.
    """
    check_device_name(device)
    if device == "cpu":
        return "cpu"
    reason = cuda.reason()
    if reason is None:
        return "cuda"
    if device == "cuda":
        raise DeviceError(f"device 'cuda' cannot be used: {reason}; try device 'cpu'")
    _say_cpu(reason)
    return "cpu"


def backend_of(device: str) -> Backend:
    """Where the arrays of a solve live.

    Raises
    ------
    DeviceError, UnknownNameError: as ``resolve_device``.
    """
    return CPU if resolve_device(device) == "cpu" else _cuda_backend()


@cache
def _cuda_backend() -> DeviceBackend:
    """Once per process: it keeps what was compiled."""
    return DeviceBackend(cuda.device())


class _Progress:
    """A line on stderr: rewritten in place on a terminal, once every few seconds elsewhere."""

    def __init__(self, doing: str) -> None:
        self.terminal = sys.stderr.isatty()
        self.doing = f"{doing}: " if doing else ""
        self.last = time.perf_counter()

    def __call__(self, at: Iterate, final: bool = False) -> None:
        now = time.perf_counter()
        if not final and now - self.last < (0.1 if self.terminal else 5.0):
            return
        self.last = now
        line = (
            f"octo: {self.doing}pass {at.number}/{at.passes}, iteration {at.iteration}: {at.words}"
        )
        end = "\n" if final or not self.terminal else ""
        print(f"\r\033[K{line}" if self.terminal else line, end=end, file=sys.stderr, flush=True)


__all__ = ["Solution", "Status", "solve"]
