"""The real-time iteration against the general one: the same step, multipliers and gains from the
same trajectory."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import octo
from octo.dynamics.laws import Compliant
from octo.errors import DeviceError
from octo.problem.compiled import CompiledProblem
from octo.solver.elimination import factorize
from octo.solver.receding import RecedingHorizon
from octo.solver.receding_interpreted import InterpretedHorizon

SIGMA = 1e-4


@pytest.fixture(scope="module")
def case():
    robot = octo.load("mammal")
    problem = octo.Problem(
        robot, steps=9, dt=0.04, costs=octo.costs.locomotion((0.3, 0.0, 0.0)), law=Compliant()
    )
    compiled = CompiledProblem([problem])
    compiled.prepare()
    rng = np.random.default_rng(0)
    nodes = problem.start + 0.02 * rng.standard_normal((11, robot.nx))
    return problem, compiled, nodes


def general(problem, nodes, lam=None, sigma=SIGMA):
    """Step and multipliers of the ordinary solver's parts, with nodes[0] and nodes[1] as x_{-1} and
    x_0."""
    own = CompiledProblem([problem])
    own.constant[0, :2] = nodes[:2]
    at = own.evaluate(own.unknowns(nodes[None]))
    model = own.linearize(at, None if lam is None else lam[None])
    factor = factorize(model.H, model.A, np.full((1, own.K), sigma))
    step, multipliers = factor.solve(-model.b, -model.C)
    return at, step[0], multipliers[0]


def test_one_step_is_that_of_the_general_solver(case):
    problem, compiled, nodes = case
    horizon = RecedingHorizon(compiled, SIGMA)
    horizon.nodes[:] = nodes
    assert horizon.feedback(usable=horizon.prepare())
    at, step, multipliers = general(problem, nodes, sigma=SIGMA)
    np.testing.assert_allclose(horizon.step, step, atol=1e-9)
    np.testing.assert_allclose(horizon.lam, multipliers, atol=1e-9)
    np.testing.assert_allclose(horizon.fd, at.fd[0], atol=1e-8)


def test_what_is_prepared_does_not_depend_on_the_measurement(case):
    problem, compiled, nodes = case
    horizon = RecedingHorizon(compiled, SIGMA)
    horizon.nodes[:] = nodes
    horizon.nodes[:2] += 0.3  # what was expected before the measurement came
    usable = horizon.prepare()
    horizon.nodes[:2] = nodes[:2]
    assert horizon.feedback(usable=usable)
    np.testing.assert_allclose(horizon.step, general(problem, nodes)[1], atol=1e-9)


def test_many_measurements_after_one_preparation(case):
    problem, compiled, nodes = case
    horizon = RecedingHorizon(compiled, SIGMA)
    horizon.nodes[:] = nodes
    usable = horizon.prepare()
    for k in range(40):  # more than the factor has room for, one after the other
        horizon.nodes[:2] = nodes[:2] + 0.01 * (k % 3)
        assert horizon.feedback(usable=usable)
    np.testing.assert_allclose(horizon.step, general(problem, nodes)[1], atol=1e-9)


def test_exact_curvature_is_the_general_solver_s(case):
    problem, compiled, nodes = case
    horizon = RecedingHorizon(compiled, 10.0)
    lam = 1e-3 * np.random.default_rng(1).standard_normal((9, 6))
    horizon.nodes[:], horizon.guess[2:] = nodes, lam
    assert horizon.feedback(True, horizon.prepare(True))
    np.testing.assert_allclose(
        horizon.step, general(problem, nodes, lam, horizon.sigma[0])[1], atol=1e-9
    )


def test_evaluate_gives_e_and_c(case):
    problem, compiled, nodes = case
    horizon = RecedingHorizon(compiled, SIGMA)
    horizon.nodes[:] = nodes
    horizon.evaluate()
    at = general(problem, nodes)[0]
    assert horizon.energy == pytest.approx(float(at.energy[0]), rel=1e-9)
    np.testing.assert_allclose(horizon.C, at.C[0], atol=1e-10)


def test_gain_of_linear_dynamics_is_exact():
    """A cart with a weight on a spring: one iteration solves it from anywhere, so differences of
    its answers are the gain."""

    def fd(x_next, x, x_prev, p):
        accelerated = (x_next - 2 * x + x_prev) / p["dt"] ** 2
        stretch = x_next[1] - x_next[0]
        return ca.vertcat(2.0 * accelerated[0] - 30.0 * stretch, accelerated[1] + 30.0 * stretch)

    aim = octo.CustomCost(function=lambda step, p: step.x_next, weight=3.0)
    problem = octo.Problem(
        octo.CustomDynamics(fd, 2, [0], {"dt": 0.05}),
        steps=12,
        dt=0.05,
        costs=[aim, octo.Effort(weight=0.01)],
        x0=np.ones(2),
    )
    horizon = RecedingHorizon(CompiledProblem([problem]), 1e-9)

    def answer(start):
        horizon.nodes[:] = 0.0
        horizon.nodes[:2] = start
        assert horizon.feedback(usable=horizon.prepare())
        return horizon.nodes[2] + horizon.step[0]

    rng = np.random.default_rng(2)
    start, change = rng.normal(size=(2, 2)), rng.normal(size=(2, 2))
    moved = answer(start + change) - answer(start)
    np.testing.assert_allclose(
        horizon.gain() @ np.concatenate([change[1], change[0]]), moved, atol=1e-8
    )


def test_refuses_what_it_cannot_do(case):
    problem = case[0]
    hermite = problem.replace(steps=20, basis="hermite")
    with pytest.raises(DeviceError, match="basis 'nodes'"):
        RecedingHorizon(CompiledProblem([hermite]))
    with pytest.raises(DeviceError, match="steps is 2"):
        RecedingHorizon(CompiledProblem([problem.replace(steps=2)]))


def test_without_a_compiler(case):
    """The general parts give the same step, multipliers, gain and values; exact curvature raises
    sigma until it can be used."""
    problem, compiled, nodes = case
    plain = CompiledProblem([problem]).interpreted()
    slow, fast = InterpretedHorizon(plain, SIGMA), RecedingHorizon(compiled, SIGMA)
    for horizon in (slow, fast):
        horizon.nodes[:] = nodes
        assert horizon.feedback(usable=horizon.prepare())
        horizon.evaluate()
    for name in ("step", "lam", "fd", "terms", "C"):
        np.testing.assert_allclose(
            getattr(slow, name), getattr(fast, name), rtol=1e-7, atol=1e-8, err_msg=name
        )
    np.testing.assert_allclose(slow.gain(), fast.gain(), atol=1e-7)
    assert slow.energy == pytest.approx(fast.energy)
    lam = 1e-3 * np.random.default_rng(1).standard_normal((9, 6))
    for horizon in (slow, fast):
        horizon.sigma[0], horizon.guess[2:] = SIGMA, lam
        horizon.nodes[:] = nodes
        assert horizon.feedback(True, horizon.prepare(True))
    assert slow.sigma[0] == fast.sigma[0] > SIGMA
    np.testing.assert_allclose(slow.step, fast.step, atol=1e-7)
