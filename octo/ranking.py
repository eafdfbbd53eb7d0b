"""Which of several solutions is the best one."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

from octo.problem.phases import Described
from octo.result.explanation import LIMITED
from octo.result.gait import flaws
from octo.result.solution import Solution

LOG = logging.getLogger("octo")


def best_of(members: Sequence[Solution]) -> Solution:
    """The best of the starts of one problem, with a record of each."""
    best = min(members, key=rank)
    say_kept(best)
    return replace(best, starts=tuple(member.report() for member in members))


def rank(member: Solution) -> tuple[bool, int, bool, int, float]:
    """Converged first, then those that got through more passes, of cycles those whose gait has
    fewer flaws, then by E."""
    feasible = member.violation <= 1e-3 * member.weight
    done = sum(bool(own["converged"]) for own in member.passes if LIMITED not in own)
    flawed = 0 if member.cycle is None else flaws(member.gait, member.length)
    last = member.energy if feasible else member.violation
    return not member.converged, -done, not feasible, flawed, last


def rank_of_period(problem: Described, member: Solution) -> tuple[bool, int, bool, int, float]:
    """As ``rank``, with the work of the joints in place of E.

    The terms of E are means over time, but they do not mean the same for every period: feet that
    share the load stand longer the longer the stride is, so that E of the natural terms only falls
    (mammal at 0.5 m/s: .25, .17, .14 at 0.3, 0.5, 0.8 s; biped .24, .15, .13 at 0.5, 1.0, 1.5 s).
    Work over weight and way has its least in between (.54, .37, .53; 1.1, .72, .81), near the
    strides of animals of that size (docs/notes/cycles.md).
    """
    failed, passes, infeasible, flawed, last = rank(member)
    cycle = problem.cycle
    if cycle is None or member.cycle is None or infeasible:
        return failed, passes, infeasible, flawed, last
    # the way of a stride is what is given
    a_stride = cycle.shift is not None or (cycle.velocity == cycle.sideways == 0.0)
    work = member.power * (member.cycle.period if a_stride else 1.0)
    return failed, passes, infeasible, flawed, work


def say_kept(solution: Solution) -> None:
    """Say so where the last pass failed and the motion is that of the one before."""
    last = solution.passes[-1]
    if solution.converged and not last["converged"]:
        what = f"pass {last['pass']} did not converge ({last['status']})"
        LOG.warning("%s: the motion of the pass before it is returned", what)
