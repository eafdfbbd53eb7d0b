"""A solve that ends once all constraints hold."""

import pytest

import octo
from octo.errors import UnknownNameError, ValueRangeError
from octo.solve import settings_of
from tests.solver.test_barrier import swing_up


@pytest.fixture(scope="module")
def bounded():
    """A cart-pole's swing-up with a bounded motor."""
    return swing_up(12.0)


def test_it_ends_with_every_constraint_met(bounded):
    best = octo.solve(bounded, device="cpu")
    found = octo.solve(bounded, device="cpu", goal="feasible")
    assert found.converged
    assert found.violation <= 2e-7 * found.weight
    assert (abs(found.u) <= 12.0 * (1.0 + 1e-6)).all()
    assert found.energy >= best.energy * (1.0 - 1e-6)


def test_it_ends_sooner_than_at_the_best_motion():
    terms = [octo.CenterOfMassVelocity((0.3, 0.0, 0.0)), octo.Effort()]
    problem = octo.Problem(octo.load("mammal"), steps=12, dt=0.025, costs=terms)
    best = octo.solve(problem, passes=1, device="cpu")
    found = octo.solve(problem, passes=1, device="cpu", goal="feasible")
    assert best.converged
    assert found.converged
    assert found.violation <= 2e-7 * found.weight
    assert found.iterations < 0.7 * best.iterations


def test_what_the_goal_changes_of_the_options():
    given = octo.SqpOptions(max_iterations=7)
    assert settings_of(given, None, None, None, "feasible") == octo.SqpOptions.feasible(
        max_iterations=7
    )
    assert settings_of(given, None, None, None) == given
    assert octo.SqpOptions.feasible(plateau=5).plateau == 5


def test_another_goal_is_refused(bounded):
    with pytest.raises(UnknownNameError, match=r"goal .*'near'.*optimal"):
        octo.solve(bounded, goal="near")
    with pytest.raises(ValueRangeError, match=r"goal is 'feasible', must be 'optimal'"):
        octo.SqpOptions.feasible(step="lbfgs")
