"""Terms that are zero where a contact carries nothing are not evaluated there: the numbers are
those of evaluating them everywhere."""

from __future__ import annotations

import numpy as np
import pytest
from walker import START, walker

from octo import costs, native
from octo.problem.compiled import CompiledProblem
from octo.problem.problem import Problem

STEPS = 90


def bouncing(threads: int) -> CompiledProblem:
    terms = [
        costs.LoadSharing(),
        costs.ForceRate(),
        costs.FrictionCone(mu=0.1),
        costs.FootLift(height=0.0, contacts=("foot",)),
    ]
    return CompiledProblem(
        [Problem(walker(), steps=STEPS, dt=0.05, costs=terms, x0=START)], threads
    )


@pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("threads", [1, 3])
def test_contacts_that_come_and_go(threads, exact):
    """Contacts land and leave at every place of a vector of steps and of a chunk."""
    problem = bouncing(threads)
    nodes = np.repeat(START[None, None], STEPS + 2, axis=1)
    nodes[0, :, 2] += 0.2 * np.sin(np.arange(STEPS + 2) / 5.0)
    nodes += 0.001 * np.random.default_rng(4).standard_normal(nodes.shape)
    unknowns = problem.unknowns(nodes)
    lam = np.random.default_rng(5).standard_normal((1, problem.K, problem.ma)) if exact else None
    plain = problem.interpreted()
    at, expected = problem.evaluate(unknowns), plain.evaluate(unknowns)
    load, rate = expected.terms[0, :, 0], expected.terms[0, :, 1]
    assert (load > 0.0).sum() > 30 and (rate == 0.0).sum() > 30
    assert ((load == 0.0) & (rate > 0.0)).sum() > 2  # it carried something in the step before
    np.testing.assert_allclose(at.terms, expected.terms, rtol=1e-10, atol=1e-14)
    found, model = problem.linearize(at, lam), plain.linearize(expected, lam)
    for name in ("H", "A", "b"):
        whole = getattr(model, name)
        np.testing.assert_allclose(
            getattr(found, name), whole, rtol=0.0, atol=1e-11 * np.abs(whole).max()
        )
