"""A long motion by short horizons, of each of which the first steps are kept."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from octo.checks import instance, positive, whole
from octo.errors import ProblemError
from octo.problem.compiled import CompiledProblem
from octo.problem.problem import Array, Problem
from octo.problem.step_pairs import refuse_step_pairs
from octo.result.measure import measured
from octo.result.solution import Solution
from octo.solver import sqp
from octo.solver.bounds import Slacks
from octo.solver.options import SqpOptions
from octo.solver.status import HISTORY, Status
from octo.starts import first_nodes

FIRST = 300  # iterations of the first horizon, which starts from a pose held still
LEFT = 1e-2  # relative to mg and to a constraint, what a plan may leave in the steps that are kept
TOLERANCE = 1e-5  # relative to mg, ‖C‖∞ of a horizon


def animate(
    problem: Problem,
    seconds: float,
    *,
    advance: int = 4,
    iterations: int = 40,
    seed: int = 0,
    options: SqpOptions | None = None,
) -> Solution:
    """A motion of ``seconds`` in which each step was planned over the problem's horizon from where
    the one before led.

    Parameters
    ----------
    problem: its N steps are the horizon, in the basis "nodes"; its start is the motion's.
    advance: steps of each plan that are kept. iterations: of each plan (the first has more). seed:
        of the first start's noise.
    options: of the solver; by default exact curvature, ‖C‖∞ ≤ 1e-5 mg.

    Returns
    -------
    The whole motion with its own E, ‖C‖∞ and contacts; ``iterations`` and ``seconds`` are those of
    all plans together, ``history`` has one row a plan. Converged if no plan left more than 1e-2 mg
    and no constraint is broken by more than 1e-2 of its size.

    Raises
    ------
    ProblemError: the basis is not nodes, the problem is a cycle, or a term or the start has
        separate values for each step.
    """
    _check(instance("problem", problem, Problem, "an octo.Problem"))
    advance = min(whole("advance", advance), int(problem.steps))
    total = round(positive("seconds", seconds, "s") / float(problem.dt))
    settings = options or SqpOptions(tolerance=TOLERANCE)
    began = time.perf_counter()
    compiled = CompiledProblem([problem])
    compiled.check_squares("animate", bounds=True)
    compiled.prepare()
    setup = time.perf_counter() - began
    nodes = first_nodes(problem, seed, None)
    kept = [nodes[0].copy(), nodes[1].copy()]
    rows: list[tuple[float, ...]] = []
    lam, slacks, worst, counted = None, None, 0.0, 0
    began, processor = time.perf_counter(), time.process_time()
    for place in range(0, total, advance):
        compiled.constant[0, :2] = nodes[:2]
        limited = replace(settings, max_iterations=iterations if place else FIRST)
        result = sqp.run(compiled, compiled.unknowns(nodes[None]), lam, limited, slacks=slacks)
        plan = result.at.nodes[0]
        violation = float(np.abs(result.at.C[0, :advance]).max(initial=0.0)) * problem.weight
        worst, counted = max(worst, violation), counted + int(result.iterations[0])
        row = dict.fromkeys(HISTORY, 0.0)
        row.update(iteration=len(rows), energy=float(result.at.energy[0]), violation=violation)
        row["seconds"] = time.perf_counter() - began
        rows.append(tuple(row.values()))
        kept += list(plan[2 : 2 + advance])
        nodes = np.concatenate([plan[advance:], np.repeat(plan[-1:], advance, axis=0)])
        lam, slacks = _later(result, advance)
    spent = (setup, time.perf_counter() - began, time.process_time() - processor)
    return _whole(problem, compiled, np.array(kept)[: total + 2], rows, (worst, counted), spent)


def _later(result: sqp.Result, steps: int) -> tuple[Array, Slacks | None]:
    """Multipliers, and slacks if any, as many steps later."""
    lam = np.zeros_like(result.lam)
    lam[:, : lam.shape[1] - steps] = result.lam[:, steps:]
    return lam, None if result.slacks is None else result.slacks.later(steps)


def _check(problem: Problem) -> None:
    if problem.cycle is not None:
        raise ProblemError("cycle is given: animate goes on from where it is, it needs a free end")
    if problem.basis_object.name != "nodes" or problem.end is not None:
        raise ProblemError("animate needs the basis 'nodes' and a free end")
    refuse_step_pairs(problem.costs, "animate")


def _whole(
    problem: Problem,
    like: CompiledProblem,
    nodes: Array,
    rows: list[tuple[float, ...]],
    done: tuple[float, int],
    spent: tuple[float, float, float],
) -> Solution:
    """The motion as one problem of all its steps, which nobody solved as a whole."""
    worst, counted = done
    setup, seconds, processor = spent
    long = problem.replace(steps=len(nodes) - 2)
    compiled = CompiledProblem([long], like=like)
    at = compiled.evaluate(compiled.unknowns(nodes[None]))
    table, motion = np.array(rows, dtype=float), measured(compiled, at, 0)
    kept = all(bound.violation <= LEFT for bound in motion["bounds"])
    good = kept and worst <= LEFT * problem.weight
    return Solution(
        **motion,
        multipliers=np.zeros((compiled.K, compiled.ma)),
        status=Status.ACCEPTABLE if good else Status.ITERATION_LIMIT,
        iterations=counted,
        factorizations=counted,
        history=dict(zip(HISTORY, table.T, strict=True)),
        seconds=seconds,
        setup_seconds=setup,
        processor_seconds=processor,
    )
