"""Feedback gains along a motion: against the dense KKT matrix, and of a pole off its way."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np
import pytest
from walker import START, walker

import octo
from octo.errors import OctoError
from octo.gains import SIGMA, gains_of
from octo.problem.compiled import CompiledProblem
from octo.solver.receding_interpreted import InterpretedHorizon
from octo.solver.riccati import feedback


def test_the_recursion_against_the_dense_matrix(random_system) -> None:
    """The answer of every node to the two before it is that of the whole KKT matrix of what is left
    of the motion."""
    K, n, m = 7, 4, 2
    blocks = random_system(3, 2, K, n, m)
    found = feedback(blocks.H, blocks.A, 1e-3)
    assert found.shape == (2, K - 2, n, 2 * n)
    for first in range(K - 2):  # the nodes first, first + 1 are given, those behind them answer
        units = K - first
        H, A = (part[:, first:].copy() for part in (blocks.H, blocks.A))
        dense = np.zeros((2, units * n, units * n))
        rows = np.zeros((2, units * m, units * n))
        for k in range(units):
            for o in range(min(k, 2) + 1):
                at, to = slice(k * n, (k + 1) * n), slice((k - o) * n, (k - o + 1) * n)
                if k >= 2:
                    dense[:, at, to] = H[:, k, o]
                    dense[:, to, at] = np.swapaxes(H[:, k, o], 1, 2)
                rows[:, k * m : (k + 1) * m, to] = A[:, k, o]
        own, given = slice(2 * n, None), slice(0, 2 * n)
        free = dense[:, own, own] + 1e-3 * np.eye((units - 2) * n)
        C = rows[:, 2 * m :]
        zero = np.zeros((2, C.shape[1], C.shape[1]))
        matrix = np.block([[free, np.swapaxes(C[:, :, own], 1, 2)], [C[:, :, own], zero]])
        right = np.concatenate([dense[:, own, given], C[:, :, given]], axis=1)
        expected = -np.linalg.solve(matrix, right)[:, :n]
        expected = np.concatenate([expected[..., n:], expected[..., :n]], axis=-1)  # nearer first
        np.testing.assert_allclose(found[:, first], expected, rtol=1e-8, atol=1e-9)


def motion_of(basis: str = "nodes", **fields: object) -> tuple[octo.Problem, octo.Solution]:
    costs = [
        octo.CenterOfMassVelocity((0.2, 0.0, 0.0)),
        octo.Effort(reference=5.0),
        octo.Posture(reference=START),
    ]
    soft = {"contact.w_perp": 2e3, "contact.w_par": 2e4}
    usual = {"costs": costs, "x0": START, "basis": basis, "parameters": soft}
    own = octo.Problem(walker(), steps=10, dt=0.05, **{**usual, **fields})
    return own, octo.solve(own, max_iterations=30)


@pytest.mark.parametrize("basis", ["nodes", "hermite"])
def test_the_rest_of_a_motion_has_the_rest_of_its_gains(basis: str) -> None:
    """Bellman's principle, and what a receding horizon says of its first step."""
    own, motion = motion_of(basis)
    K, n, i = octo.gains(own, motion), own.dynamics.nx, 4
    assert K.shape == (10, own.dynamics.nu, 2 * n) and abs(K).max() > 1.0
    rest = own.replace(basis="nodes", steps=10 - i, x0=motion.x[i + 1], v0=motion.v[i])
    compiled = CompiledProblem([rest])
    horizon = InterpretedHorizon(compiled, SIGMA * 10 / (10 - i))  # E is a mean over the steps
    horizon.nodes[:] = motion.x[i:]
    assert horizon.feedback()
    answer = horizon.gain()
    jac = own.dynamics.evaluate(motion.x[None, i : i + 3], compiled.p, order=1)[1][0, 0]
    rows = jac[own.dynamics.actuated]
    both = rows[:, n:] + rows[:, :n] @ answer
    expected = np.concatenate([both[:, :n] + both[:, n:], -0.05 * both[:, n:]], axis=1)
    np.testing.assert_allclose(K[i], expected, rtol=0, atol=1e-7 * abs(expected).max())


def test_many_motions_at_once() -> None:
    pairs = [motion_of(), motion_of(v0=0.1 * np.eye(walker().nx)[0])]
    problems, motions = zip(*pairs, strict=True)
    for own, motion, K in zip(problems, motions, gains_of(problems, motions), strict=True):
        np.testing.assert_allclose(octo.gains(own, motion), K, rtol=0, atol=1e-9 * abs(K).max())


def cart_pole(x_next, x, x_prev, p):
    """N and N m: a cart and a pole of 1 kg and 1 m that stands on it, one motor."""
    a, v = (x_next - 2.0 * x + x_prev) / p["dt"] ** 2, (x_next - x) / p["dt"]
    angle, turn = x_next[1], v[1]
    cart = 2.0 * a[0] + ca.cos(angle) * a[1] - ca.sin(angle) * turn**2
    return ca.vertcat(cart, ca.cos(angle) * a[0] + a[1] - 9.81 * ca.sin(angle))


@lru_cache
def balanced(**fields: object) -> tuple[octo.Problem, octo.Solution]:
    """A pole that falls is caught, and ends upright."""
    dynamics = octo.CustomDynamics(cart_pole, nx=2, actuated=[0], parameters={})
    costs = [
        octo.CustomCost(lambda step, p: step.x_next, {}, name="Upright"),
        octo.Effort(weight=0.001, reference=1.0),
    ]
    x0 = np.array([0.0, 0.3])
    own = octo.Problem(dynamics, steps=80, dt=0.03, costs=costs, x0=x0, **fields)
    return own, octo.solve(own)


def rolled_out(own: octo.Problem, motion: octo.Solution, K: np.ndarray, off: np.ndarray):
    """The nodes x_0 … that follow from another start, with the torques corrected by K."""
    p, x = own.p[None], [motion.x[0] + off, motion.x[1] + off]
    for i in range(own.steps):
        state = np.concatenate([x[-1], (x[-1] - x[-2]) / own.dt])
        planned = np.concatenate([motion.x[i + 1], motion.v[i]])
        u = np.array([*(motion.u[i] + K[i] @ (state - planned)), 0.0])
        new = 2.0 * x[-1] - x[-2]
        for _ in range(20):
            fd, jac, _ = own.dynamics.evaluate(np.stack([x[-2], x[-1], new])[None], p, order=1)
            new = new - np.linalg.solve(jac[0, 0][:, :2], fd[0, 0] - u)
        x.append(new)
    return np.stack(x[1:])


def test_a_pole_that_begins_elsewhere_is_brought_back() -> None:
    own, motion = balanced()
    K, off = octo.gains(own, motion), np.array([0.02, 0.05])
    with_gains = rolled_out(own, motion, K, off)
    without = rolled_out(own, motion, np.zeros_like(K), off)
    end = motion.x[-1]
    assert abs(with_gains[-1] - end).max() < 0.05 and abs(with_gains[-1, 1]) < 0.02
    assert abs(without[-1] - end).max() > 1.0
    # near the motion they are what the solver itself would do
    again = octo.solve(own.replace(x0=own.x0 + 1e-3 * off), start=motion)
    change = np.concatenate([1e-3 * off, [0.0, 0.0]])
    np.testing.assert_allclose(again.u[0] - motion.u[0], K[0] @ change, rtol=0.1)


def test_a_row_at_its_bound_is_not_left() -> None:
    """A motor at its limit answers nothing, one that has room does."""
    hard = octo.CustomConstraint(lambda step, p: step.u, lower=-10.0, upper=20.0, name="Motor")
    own, motion = balanced(constraints=(hard,))
    at = np.minimum(20.0 - motion.u[:, 0], motion.u[:, 0] + 10.0) < 1e-3
    K = octo.gains(own, motion)
    assert motion.converged and 3 <= at.sum() < 40
    assert abs(K[at]).max() < 1e-2 * abs(K[~at]).max()


REFUSED = [
    (lambda: octo.gains(3, motion_of()[1]), "problem is 3, must be an octo.Problem"),
    (lambda: octo.gains(motion_of()[0], 3), "solution is 3, must be an octo.Solution"),
    (lambda: octo.gains(motion_of()[0].replace(steps=20), motion_of()[1]), "solution.x has shape"),
    (
        lambda: octo.gains(
            motion_of()[0].replace(costs=[octo.Effort(), octo.TorqueRate()]), motion_of()[1]
        ),
        "TorqueRate looks at two steps",
    ),
    (lambda: octo.gains(motion_of()[0].replace(duration=(0.4, 0.6)), motion_of()[1]), "a free dur"),
]


@pytest.mark.parametrize(("call", "words"), REFUSED, ids=[words for _, words in REFUSED])
def test_refused_in_one_line(call, words: str) -> None:
    with pytest.raises(OctoError) as error:
        call()
    assert words in str(error.value) and "\n" not in str(error.value)
