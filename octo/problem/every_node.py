"""A problem in nodes with x_{-1} and x_0 as units too: what they would change is in its model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from octo.problem.basis import Stencil
from octo.problem.compiled import CompiledProblem
from octo.problem.plan import Plan

PAST = 2  # units that are measured


def every_node_a_unit(compiled: CompiledProblem) -> CompiledProblem:
    """The same problems (their p and q are shared) with x_{-1} and x_0 as units too.

    Parameters
    ----------
    compiled: in the basis Nodes, with free ends.
    """
    N, K = compiled.steps, compiled.steps + PAST
    unit, none = np.arange(K, dtype=np.int32)[:, None], np.zeros((K, 1), dtype=np.int32)
    stencil = Stencil(
        K, 1, unit, none, np.ones((K, 1)), unit[PAST:].copy(), none[PAST:].copy(), np.ones((N, 1))
    )
    plan = Plan(compiled.basis, N, compiled.n, compiled.m, stencil, compiled.fixed)
    constant = np.zeros((compiled.batch, K, compiled.n))
    return compiled.with_data(plan, replace(compiled.data, constant=constant))
