"""assemble.c equals CasADi's virtual machine with NumPy; threads and the members of a batch do not
disturb each other."""

from __future__ import annotations

import numpy as np
import pytest

from octo import native
from octo.problem.compiled import CompiledProblem, Evaluation, Model

pytestmark = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
FIELDS = ("H", "A", "b", "C")


def interpreted(problem: CompiledProblem) -> CompiledProblem:
    """The same numbers on CasADi's virtual machine, dynamics included."""
    return problem.interpreted()


def close(found: np.ndarray, expected: np.ndarray, relative: float = 1e-11) -> None:
    np.testing.assert_allclose(
        found, expected, rtol=0.0, atol=relative * max(1e-300, np.abs(expected).max(initial=0.0))
    )


def both(
    problem: CompiledProblem, unknowns: np.ndarray, lam: np.ndarray | None
) -> tuple[Evaluation, Model]:
    at = problem.evaluate(unknowns)
    return at, problem.linearize(at, lam)


def random_lam(problem: CompiledProblem) -> np.ndarray:
    return np.random.default_rng(2).standard_normal((problem.batch, problem.K, problem.ma))


@pytest.mark.parametrize("basis", ["nodes", "hermite"])
@pytest.mark.parametrize("exact", [False, True])
def test_native_equals_interpreted(compiled, wiggle, basis, exact):
    problem = compiled(basis)
    lam = random_lam(problem) if exact else None
    (at, model), (plain_at, plain) = (
        both(p, wiggle(problem), lam) for p in (problem, interpreted(problem))
    )
    for name in ("fd", "terms", "energy", "C"):
        close(getattr(at, name), getattr(plain_at, name))
    for name in FIELDS:
        close(getattr(model, name), getattr(plain, name))


@pytest.mark.parametrize("basis", ["nodes", "hermite"])
@pytest.mark.parametrize("threads", [1, 3])
def test_a_gradient_is_that_of_the_model(compiled, wiggle, basis, threads):
    """To rounding: it is the same code without the squares, but compilers contract sums anew."""
    problem = compiled(basis, threads)
    for one in (problem, interpreted(problem)):
        at = one.evaluate(wiggle(one))
        model = one.linearize(at, None)
        b, A = one.gradient(at)
        for found, whole in ((b, model.b), (A, model.A)):
            np.testing.assert_allclose(found, whole, rtol=0.0, atol=1e-14 * np.abs(whole).max())


def test_curvature_of_contacts_for_some_members(compiled, wiggle):
    """Of each member, with lam, as if it were alone: Gauss and Newton's or all of it."""
    problem = compiled("nodes")
    lam, at = random_lam(problem), problem.evaluate(wiggle(problem))
    both_ways = [
        problem.linearize(at, lam, np.full(problem.batch, value)).H for value in (False, True)
    ]
    np.testing.assert_array_equal(both_ways[1], problem.linearize(at, lam).H)
    assert np.abs(both_ways[1] - both_ways[0]).max() > 1e-3 * np.abs(both_ways[0]).max()
    curved = np.arange(problem.batch) % 2 == 1
    assert curved.any() and not curved.all()
    expected = np.where(curved[:, None, None, None, None], both_ways[1], both_ways[0])
    plain = interpreted(problem)
    for own, other in ((problem, at), (plain, plain.evaluate(wiggle(plain)))):
        close(own.linearize(other, lam, curved).H, expected)


@pytest.mark.parametrize("steps", [3, 7, 9, 25])
@pytest.mark.parametrize("threads", [1, 3])
def test_any_number_of_steps(compiled, wiggle, steps, threads):
    """More and less than fill a vector, cut in chunks of whole vectors but for the last."""
    problem = compiled("nodes", threads, steps)
    lam = random_lam(problem)
    (at, model), (plain_at, plain) = (
        both(p, wiggle(problem), lam) for p in (problem, interpreted(problem))
    )
    for name in ("fd", "terms", "energy", "C"):
        close(getattr(at, name), getattr(plain_at, name))
    for name in FIELDS:
        close(getattr(model, name), getattr(plain, name))


@pytest.mark.parametrize("basis", ["nodes", "hermite"])
def test_threads_give_the_same_numbers(compiled, wiggle, basis):
    one, three = compiled(basis), compiled(basis, 3)
    assert three.plan.chunks(3)[1].size > 1
    lam = random_lam(one)
    (at, model), (same_at, same) = (both(p, wiggle(one), lam) for p in (one, three))
    np.testing.assert_array_equal(at.energy, same_at.energy)
    for name in FIELDS:
        close(getattr(same, name), getattr(model, name), 1e-14)
    again = three.linearize(same_at, lam)
    for name in FIELDS:  # the order of the sums does not depend on which thread comes first
        np.testing.assert_array_equal(getattr(again, name), getattr(same, name))


@pytest.mark.parametrize("basis", ["nodes", "hermite"])
@pytest.mark.parametrize("threads", [1, 3])
def test_members_are_independent(compiled, wiggle, basis, threads):
    problem = compiled(basis, threads)
    unknowns, lam = wiggle(problem), random_lam(problem)
    at, model = both(problem, unknowns, lam)
    alone = problem.take(np.array([1]))
    own_at, own = both(alone, unknowns[1:], lam[1:])
    broken = unknowns.copy()
    broken[0, problem.K // 2] = np.nan
    beside_at, beside = both(problem, broken, lam)
    np.testing.assert_array_equal(beside_at.finite, [False, True])
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(own, name)[0], getattr(model, name)[1])
        np.testing.assert_array_equal(getattr(beside, name)[1], getattr(model, name)[1])
    for name in ("fd", "terms", "energy", "C", "nodes"):
        np.testing.assert_array_equal(getattr(own_at, name)[0], getattr(at, name)[1])
        np.testing.assert_array_equal(getattr(beside_at, name)[1], getattr(at, name)[1])


def test_taking_and_putting_members(compiled, wiggle):
    problem = compiled("nodes")
    at = problem.evaluate(wiggle(problem))
    turned = at.take([1, 0])
    np.testing.assert_array_equal(turned.energy, at.energy[::-1])
    turned.put(np.array([0]), at.take([0]))
    np.testing.assert_array_equal(turned.unknowns[0], at.unknowns[0])
    np.testing.assert_array_equal(at.energy, problem.evaluate(at.unknowns).energy)
