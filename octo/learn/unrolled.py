"""What a network makes of a first control: its error against a motion, and itself as a motion."""

from __future__ import annotations

import numpy as np

from octo.checks import Array
from octo.gains import at_stiffness
from octo.learn.controls import controls, count_of, nodes_of
from octo.learn.losses import one_step, recurrent, with_decay
from octo.learn.transition import Transition
from octo.problem.problem import Problem
from octo.result.solution import Solution
from octo.solve import evaluated
from octo.solver.status import Status


def losses_of(transition: Transition, given: Array, decay: float) -> tuple[float, float]:
    """Eq. 14 as a mean over the transitions of one motion's controls (Z + 1, 2n), and the same with
    the decay."""
    network, frame, weights = transition.network, transition.frame, transition.weights
    assert weights is not None
    loss = one_step(network, frame, given[None])
    error, _ = loss(weights)
    return error, with_decay(lambda w: (error, np.zeros_like(w)), network, decay)(weights)[0]


def unrolled_error(transition: Transition, given: Array) -> float | None:
    """Eq. 16 as a mean over the controls of one motion (Z + 1, 2n); None where it is not finite."""
    assert transition.weights is not None
    with np.errstate(over="ignore", invalid="ignore"):
        error, _ = recurrent(transition.network, transition.frame, given[None])(transition.weights)
    return error if np.isfinite(error) else None


def unrolled(problem: Problem, transition: Transition, motion: Solution) -> Solution | None:
    """The motion that a network makes from the first control of another, as long as the problem's;
    None where it explodes.

    Parameters
    ----------
    problem: whose terms and laws of physics it is measured by; a fixed end is left out.
    transition: with weights. motion: whose first control and contact law it has.
    """
    own = at_stiffness(problem.replace(x_end=None, v_end=None, displacement=None), motion)
    made = transition.at(problem).unroll(controls(motion)[0], count_of(problem))
    if not np.isfinite(made).all():
        return None
    return evaluated(own, nodes_of(problem, made), Status.UNROLLED)
