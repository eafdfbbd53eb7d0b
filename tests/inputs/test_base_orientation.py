"""BaseOrientation is a rotation vector: it pulls back from every orientation, upside down too."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import octo
from octo import native
from octo.model.character import Array, Body, Character, Joint
from octo.model.chart import rotation_of_angles, turned_by
from octo.problem.body_costs import BaseOrientation, _rpy, rotation_vector
from octo.problem.compiled import CompiledProblem

ANGLES = (
    0.0,
    1e-12,
    1e-8,
    1e-4,
    0.1,
    1.0,
    np.pi / 2,
    2.0,
    2 * np.pi / 3,
    2.5,
    3.0,
    3.14,
    np.pi - 1e-6,
)
UPSIDE_DOWN = np.array([0.0, 0.0, np.pi])  # rad: yaw, pitch, roll


@pytest.fixture(scope="module")
def vector() -> ca.Function:
    R = ca.SX.sym("R", 3, 3)
    return ca.Function("vector", [R], [rotation_vector(R)])


@pytest.fixture(scope="module")
def derivatives() -> ca.Function:
    """Of the vector and of its square, to roll, pitch and yaw."""
    angles = ca.SX.sym("angles", 3)
    r = rotation_vector(_rpy(angles))
    square = ca.sumsqr(r)
    outputs = [
        r,
        ca.jacobian(r, angles),
        ca.gradient(square, angles),
        ca.hessian(square, angles)[0],
    ]
    return ca.Function("derivatives", [angles], outputs)


def directions() -> Array:
    random = np.random.default_rng(0).normal(size=(20, 3))
    return np.concatenate(
        [np.eye(3), -np.eye(3), random / np.linalg.norm(random, axis=1, keepdims=True)]
    )


def satellite() -> Character:
    """A body that turns about its own centre, held by yaw, pitch and roll motors."""
    hinges = tuple(
        Joint(n, "hinge", axis)
        for n, axis in zip(("yaw", "pitch", "roll"), np.eye(3)[::-1], strict=True)
    )
    return Character(
        "satellite",
        (Body("body", -1, hinges, mass=1.0, inertia=np.diag([0.01, 0.02, 0.025])),),
        base="fixed",
    )


@pytest.mark.parametrize("angle", ANGLES)
def test_it_is_axis_times_angle(vector, angle):
    for axis in directions():
        found = np.asarray(vector(turned_by(angle * axis))).ravel()
        np.testing.assert_allclose(
            found, angle * axis, rtol=0.0, atol=2e-9 if angle > 3.14 else 1e-14
        )


def test_upside_down_it_is_half_a_turn(vector):
    for axis in directions():
        half = 2.0 * np.outer(axis, axis) - np.eye(3)  # exactly
        found = np.asarray(vector(half)).ravel()
        assert np.linalg.norm(found) == pytest.approx(np.pi, abs=1e-7)
        assert abs(found @ axis) == pytest.approx(np.pi, abs=1e-7)


def test_derivatives_at_the_reference(derivatives):
    r, jacobian, gradient, hessian = (np.asarray(value) for value in derivatives(np.zeros(3)))
    assert not r.any()
    assert not gradient.any()
    np.testing.assert_allclose(jacobian, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(hessian, 2.0 * np.eye(3), atol=1e-7)


@pytest.mark.parametrize("angle", [1e-9, 1e-6, 1e-3, 0.5, np.pi / 2, 2.0, 3.0, np.pi - 1e-8, np.pi])
@pytest.mark.parametrize("which", [0, 1, 2])
def test_it_pulls_back_from_everywhere(derivatives, which, angle):
    """The slope along the turn is twice the angle, which sin(angle) does not have at a quarter
    turn; nothing is NaN."""
    roll_pitch_yaw = np.zeros(3)
    roll_pitch_yaw[which] = angle
    values = [np.asarray(value) for value in derivatives(roll_pitch_yaw)]
    assert all(np.isfinite(value).all() for value in values)
    assert abs(values[2][which, 0]) == pytest.approx(2.0 * angle, abs=1e-7)
    assert values[3][which, which] == pytest.approx(2.0, abs=1e-6)


@pytest.mark.parametrize(
    "at", [(0.3, -0.2, 0.5), (2.0, 0.4, -1.0), (-1.0, 1.2, 2.5), (3.0, 0.1, 0.2), (0.1, 0.2, 3.0)]
)
def test_derivatives_are_slopes(derivatives, at):
    step, x = 1e-5, np.array(at)
    _, jacobian, gradient, hessian = (np.asarray(value) for value in derivatives(x))
    for k in range(3):
        ahead, behind = (derivatives(x + sign * step * np.eye(3)[k]) for sign in (1.0, -1.0))
        np.testing.assert_allclose(
            np.asarray(ahead[0] - behind[0]).ravel() / (2 * step), jacobian[:, k], atol=1e-8
        )
        np.testing.assert_allclose(
            np.asarray(ahead[2] - behind[2]).ravel() / (2 * step), hessian[:, k], atol=1e-7
        )
    assert gradient.any()


def test_small_angles_cost_what_they_did(vector):
    """The residual was sin(angle)·axis: the weights of all lists of terms stay."""
    for axis in directions():
        for angle in (1e-3, 0.02, 0.1):
            found = np.asarray(vector(turned_by(angle * axis)))
            assert np.linalg.norm(found) == pytest.approx(np.sin(angle), rel=angle**2 / 5.9)


@pytest.mark.parametrize(
    "start",
    [
        UPSIDE_DOWN,
        (0.0, 0.0, np.pi / 2),
        (np.pi, 0.0, 0.0),
        (0.0, np.pi / 3, 3.0),
        (2.2, 1.0, -2.8),
    ],
)
def test_a_body_comes_back(start):
    """From upside down, where the term was zero, and from a quarter turn, where its slope was."""
    robot = satellite()
    costs = [BaseOrientation(body="body"), octo.Effort(weight=1e-4, reference=1.0)]
    problem = octo.Problem(robot, steps=40, dt=0.025, costs=costs, x0=np.array(start))
    solution = octo.solve(problem, device="cpu", progress=False)
    assert solution.converged
    turn = rotation_of_angles(solution.x[-1], "zyx")
    assert np.arccos(min(1.0, (np.trace(turn) - 1.0) / 2.0)) < 0.05


@pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("exact", [False, True])
def test_compiled_is_interpreted(exact):
    """Whichever column of the quaternion a step takes, also where the steps of one vector take
    different ones."""
    costs = [
        BaseOrientation(body="body", roll_pitch_yaw=(0.2, -0.1, 0.3)),
        octo.Effort(reference=1.0),
    ]
    problem = CompiledProblem(
        [octo.Problem(satellite(), steps=40, dt=0.025, costs=costs, x0=np.zeros(3))]
    )
    random = np.random.default_rng(5)
    unknowns = random.uniform(-np.pi, np.pi, (problem.batch, problem.K, problem.nc))
    lam = random.standard_normal((problem.batch, problem.K, problem.ma)) if exact else None
    plain = problem.interpreted()
    at, plain_at = (p.evaluate(unknowns) for p in (problem, plain))
    model, plain_model = problem.linearize(at, lam), plain.linearize(plain_at, lam)
    np.testing.assert_allclose(at.terms, plain_at.terms, rtol=1e-12)
    for name in ("H", "A", "b", "C"):
        expected = getattr(plain_model, name)
        np.testing.assert_allclose(
            getattr(model, name), expected, rtol=0.0, atol=1e-11 * np.abs(expected).max(initial=1.0)
        )


def test_axes_weigh_the_references_axes(vector):
    """A body turned about the reference's z is a z error, wherever the reference points."""
    reference = rotation_of_angles(np.array([0.4, -0.3, 2.0]), "zyx")
    found = np.asarray(
        vector(reference.T @ (reference @ turned_by(np.array([0.0, 0.0, 2.8]))))
    ).ravel()
    np.testing.assert_allclose(found, (0.0, 0.0, 2.8), atol=1e-12)
