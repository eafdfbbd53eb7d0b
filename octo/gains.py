"""Feedback gains along a motion: the linear-quadratic regulator of its linearised problem."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from octo.checks import Array, asked, instance
from octo.errors import ProblemError, ShapeError
from octo.problem.array_costs import ArrayCost
from octo.problem.compiled import CompiledProblem
from octo.problem.costs import NeighbourCost
from octo.problem.every_node import every_node_a_unit
from octo.problem.problem import Problem
from octo.problem.step_pairs import refuse_step_pairs
from octo.result.solution import Solution
from octo.solver.riccati import feedback

SIGMA = 1e-6  # added to the diagonal of H, as a controller begins with
EQUAL = 1e7  # weight of a row whose bounds are equal, as in the interior point
NEAREST = 1e-9  # a slack to its bound
CONTACT = "contact."  # how the names of a contact law's parameters begin


@asked
def gains(problem: Problem, solution: Solution) -> Array:
    """The gains of the linear-quadratic regulator along a motion.

    Where a robot is off the motion by (δx, δv) at step i, ``u[i] + K[i] @ [δx, δv]`` brings it
    back: the least of E of what is left of the motion, with E's Gauss–Newton model and the laws of
    physics linearised at each step. K is found by a Riccati recursion over the blocks of Eq. 12 of
    the nodes, whatever the basis; a fixed end is left free. A row that is at its bound is held
    there as hard as the interior point holds it. What Crocoddyl returns as its K is −K here.

    Parameters
    ----------
    problem: that was solved, of one robot without a cycle.
    solution: what came of it.

    Returns
    -------
    K (N, nu, 2 nx), N m or N over rad and m and their rates: of the coordinates as in
    ``solution.x`` and of ``solution.v``.

    Raises
    ------
    OctoError: the solution is not of this problem, or the problem is a cycle, has phases, a free
        duration, or a term over two steps in a row or over neighbouring controls.
    """
    instance("problem", problem, Problem, "an octo.Problem without phases")
    instance("solution", solution, Solution, "an octo.Solution")
    return gains_of([problem], [solution])[0]


def gains_of(problems: Sequence[Problem], solutions: Sequence[Solution]) -> Array:
    """The same of a batch: (batch, N, nu, 2 nx)."""
    own = [_freed(*pair) for pair in zip(problems, solutions, strict=True)]
    compiled = every_node_a_unit(CompiledProblem(own))
    nodes = np.stack([solution.x for solution in solutions])
    _weigh(compiled, solutions)
    model = compiled.linearize(compiled.evaluate(nodes), None)
    answers = feedback(model.H, model.A, SIGMA)
    n, dynamics = compiled.n, compiled.dynamics
    jac = dynamics.evaluate(nodes, dynamics.unbound(compiled.p), order=1)[1]
    assert jac is not None
    rows = jac[:, :, dynamics.actuated]
    both = rows[..., n:] + rows[..., :n] @ answers  # of (x_i, x_{i−1})
    dt = np.array([problem.dt for problem in own])[:, None, None, None]
    place, past = both[..., :n], both[..., n:]
    return np.concatenate([place + past, -dt * past], axis=-1)


def at_stiffness(problem: Problem, motion: Solution) -> Problem:
    """The problem with the contact law that a motion was solved with."""
    own = {k: v for k, v in motion.parameters.items() if k.startswith(CONTACT)}
    return problem.replace(parameters=own) if own else problem


def check_gains(problem: Problem) -> None:
    """Refuse what has no such gains.

    Raises
    ------
    ProblemError: says why.
    """
    instance("problem", problem, Problem, "an octo.Problem without phases")
    what = "a problem whose gains are asked for"
    refuse_step_pairs(problem.terms, what)
    own = {"a cycle": problem.cycle, "a free duration": problem.duration}
    for words, given in own.items():
        if given is not None:
            raise ProblemError(f"the problem has {words}, which {what} cannot have")
    for term in problem.terms:
        if isinstance(term, (NeighbourCost, ArrayCost)):
            raise ProblemError(
                f"{term.label} is over neighbouring controls, which {what} cannot have: leave it "
                "out"
            )


def _freed(problem: Problem, solution: Solution) -> Problem:
    """The problem as it was solved, in nodes, with a free end."""
    check_gains(problem)
    expected = (problem.steps + 2, problem.dynamics.nx)
    if solution.x.shape != expected:
        raise ShapeError("solution.x", solution.x.shape, f"{expected}, as the problem has")
    own = at_stiffness(problem, solution)
    return own.replace(basis="nodes", x_end=None, v_end=None, displacement=None)


def _weigh(compiled: CompiledProblem, solutions: Sequence[Solution]) -> None:
    """Give the rows between bounds the weights that they were last solved with (Nocedal and Wright,
    §19.3)."""
    rows = len(compiled.functions.bounded)
    if not rows:
        return
    weights = np.zeros((compiled.batch, compiled.steps, rows))
    for k, solution in enumerate(solutions):
        own = solution.slacks
        if not own or own["s"].shape != weights.shape[1:]:
            continue
        low, high = (bound[k] for bound in compiled.row_bounds)
        below, above = (np.maximum(gap, NEAREST) for gap in (own["s"] - low, high - own["s"]))
        found = own["lower"] / below + own["upper"] / above
        weights[k] = np.where(low == high, EQUAL, found)
    compiled.set_row_weights(weights, np.zeros_like(weights))
