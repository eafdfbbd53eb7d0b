"""Terms that are zero where a contact carries nothing are not evaluated there: the numbers are
those of evaluating them everywhere."""

from __future__ import annotations

import ctypes

import numpy as np
import pytest
from walker import START, walker

from octo import costs, native
from octo.problem.compiled import CompiledProblem
from octo.problem.problem import Problem

STEPS = 90
pytestmark = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")


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


def test_what_rests_is_not_evaluated():
    """In the air the one contact that has a term there, under the ground all three."""
    problem = bouncing(1)
    source = problem.program.c_text()
    for name in ("cost", "exact", "model"):
        call = f"octo_contact_{name}(arg, res);"
        assert source.count(call) == 1
        source = source.replace(call, f"(++octo_evaluated, octo_contact_{name}(arg, res));")
    library = native.load(f"int octo_evaluated;\n{source}")
    assert library is not None
    problem.__dict__["library"] = library
    evaluated = ctypes.c_int.in_dll(library, "octo_evaluated")
    counts = []
    for height in (2.0, -2.0):
        nodes = np.repeat(START[None, None], STEPS + 2, axis=1)
        nodes[..., 2] += height
        for lam in (None, np.ones((1, problem.K, problem.ma))):
            evaluated.value = 0
            problem.linearize(problem.evaluate_nodes(problem.unknowns(nodes), nodes), lam)
            counts.append(evaluated.value)
    air, *others = counts
    assert air > 0 and others == [air, 3 * air, 3 * air]
