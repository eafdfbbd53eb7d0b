"""The weight sigma is raised until the inertia is right, remembered, and no larger than eight times
what is needed."""

from __future__ import annotations

import numpy as np
import pytest

from octo import native
from octo.arrays import choose
from octo.errors import UnknownNameError, ValueRangeError
from octo.solver.factors import HostFactors
from octo.solver.options import SqpOptions
from octo.solver.regularisation import GROW, SHRINK, Regularisation
from tests.dense import kkt_matrix

METHODS = [
    "cyclic_reduction",
    pytest.param(
        "elimination", marks=pytest.mark.skipif(native.compiler() is None, reason="no gcc")
    ),
]


def negatives(system, sigma: np.ndarray) -> np.ndarray:
    return (np.linalg.eigvalsh(kkt_matrix(system, sigma)) < 0).sum(
        axis=1
    ) - system.units * system.ma


def made(batch: int, method: str) -> Regularisation:
    return Regularisation(batch, 6, SqpOptions(linear_solver=method, first_sigma=1e-3))


def factorize(weight: Regularisation, system) -> tuple[HostFactors, np.ndarray, np.ndarray]:
    factors = HostFactors(system, np.zeros_like(system.C), weight.options, threads=1)
    return factors, *weight.factorize(factors)


@pytest.mark.parametrize("method", METHODS)
def test_raised_until_the_inertia_is_right(random_system, method):
    system = random_system(0, 4, 6, 5, 2, lowered=4.0)
    system.H[1] = random_system(1, 4, 6, 5, 2).H[1]  # one is positive definite from the start
    weight = made(4, method)
    factors, sigma, has = factorize(weight, system)
    assert has.all()
    assert sigma[1] == 0.0 and (np.delete(sigma, 1) > 0.0).all()
    np.testing.assert_array_equal(negatives(system, sigma), 0)
    assert (negatives(system, sigma / GROW * 0.999)[[0, 2, 3]] > 0).all()
    dv, lam = factors.solve(-system.b, -system.C)
    stationarity, feasibility = system.residual(dv, lam, sigma)
    assert max(np.abs(stationarity).max(), np.abs(feasibility).max()) < 1e-8
    tries = 2 + np.round(np.log(np.delete(sigma, 1) / 1e-3) / np.log(GROW))
    np.testing.assert_array_equal(np.delete(weight.factorizations, 1), tries)
    assert weight.factorizations[1] == 1


@pytest.mark.parametrize("method", METHODS)
def test_remembered_and_lowered(random_system, method):
    """The next iteration starts from a third of the last weight, so that it may fall again."""
    system = random_system(0, 1, 6, 5, 2, lowered=4.0)
    weight = made(1, method)
    _, first, _ = factorize(weight, system)
    _, second, _ = factorize(weight, system)
    ratio = second / (SHRINK * first)
    assert np.isclose(ratio, GROW ** np.round(np.log(ratio) / np.log(GROW))).all()
    assert (second <= GROW * SHRINK * first).all()
    definite = random_system(0, 1, 6, 5, 2)
    _, none, _ = factorize(weight, definite)
    assert none[0] == 0.0 and weight.last[0] == second[0]


@pytest.mark.parametrize("method", METHODS)
def test_a_member_that_is_not_finite_gives_up_alone(random_system, method):
    system = random_system(0, 3, 6, 5, 2, lowered=4.0)
    alone = made(3, method)
    expected, sigma, _ = factorize(alone, system)
    expected = expected.solve(-system.b, -system.C)
    broken = random_system(0, 3, 6, 5, 2, lowered=4.0)
    broken.H[1, 2, 0, 0, 0] = np.nan
    factors, same, has = factorize(made(3, method), broken)
    np.testing.assert_array_equal(has, [True, False, True])
    np.testing.assert_array_equal(same[::2], sigma[::2])
    for found, before in zip(factors.solve(-broken.b, -broken.C), expected, strict=True):
        np.testing.assert_array_equal(found[::2], before[::2])
        assert np.isnan(found[1]).all()


@pytest.mark.parametrize("method", METHODS)
def test_a_member_factored_again_leaves_the_others(random_system, method):
    """Their weights and their steps to the last bit: a member of a batch goes the way that it goes
    alone."""
    system = random_system(0, 3, 6, 5, 2, lowered=4.0)
    weight = made(3, method)
    factors, before, _ = factorize(weight, system)
    held = weight.last.copy()
    count = weight.factorizations.copy()
    step = factors.solve(-system.b, -system.C)
    weight.local[1, 2] = 1e3
    again = np.array([False, True, False])
    sigma, has = weight.factorize(factors, again)
    assert has.all() and before.all() and not sigma[::2].any()
    np.testing.assert_array_equal(weight.last[::2], held[::2])
    np.testing.assert_array_equal(weight.factorizations[::2], count[::2])
    dv, lam = factors.solve(-system.b, -system.C)
    np.testing.assert_array_equal(dv[::2], step[0][::2])
    np.testing.assert_array_equal(lam[::2], step[1][::2])
    stationarity, feasibility = system.residual(
        dv, lam, choose(again, sigma, before)[:, None] + weight.local
    )
    assert max(np.abs(stationarity).max(), np.abs(feasibility).max()) < 1e-8


def test_weights_of_single_units_are_added(random_system):
    system = random_system(0, 2, 6, 5, 2)
    weight = made(2, "cyclic_reduction")
    weight.local = np.random.default_rng(0).uniform(0.0, 3.0, (2, 6))
    factors, _, _ = factorize(weight, system)
    dv, lam = factors.solve(-system.b, -system.C)
    stationarity, _ = system.residual(dv, lam, weight.local)
    assert np.abs(stationarity).max() < 1e-9
    weight.take(np.array([1]))
    assert weight.local.shape == (1, 6) and weight.last.shape == weight.factorizations.shape == (1,)


REFUSED = {
    "hessian": ("exakt", "did you mean exact"),
    "step": ("dogleg", "line_search"),
    "linear_solver": ("lu", "elimination"),
    "tolerance": (0.0, "must be positive"),
    "step_tolerance": (-1.0, "must be positive"),
    "cap": (np.nan, "must be positive"),
    "time_limit": (0.0, "must be positive"),
    "max_iterations": (0, "whole number of at least 1"),
    "plateau": (1.5, "whole number"),
    "gauss_newton_first": (-1, "at least 0"),
    "first_sigma": ("much", "must be positive"),
    "c_max": (None, "must be positive"),
    "dual_tolerance": (np.inf * 0, "must be positive"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_options_name_what_is_wrong(name):
    value, words = REFUSED[name]
    with pytest.raises((ValueRangeError, UnknownNameError), match=f"{name}.*{words}"):
        SqpOptions(**{name: value})
    with pytest.raises((ValueRangeError, UnknownNameError)):
        SqpOptions.paper(**{name: value})


@pytest.mark.parametrize("value", [np.nan, np.inf, "ten", None, 2.5])
def test_whole_numbers_of_options(value):
    with pytest.raises(
        ValueRangeError, match="max_iterations is .*, must be a whole number of at least 1"
    ):
        SqpOptions(max_iterations=value)


def test_the_papers_constants():
    paper = SqpOptions.paper(max_iterations=7)
    assert (paper.hessian, paper.step, paper.max_iterations) == ("gauss_newton", "trust_region", 7)
    assert (paper.tolerance, paper.step_tolerance, paper.c_max) == (1e-5, 1e-3, 0.1)
