"""Eq. 10 within two directions against scipy and against a brute-force search over the ball."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import LinearConstraint, NonlinearConstraint
from scipy.optimize import minimize as scipy_minimize

from octo.solver.normal import NormalFactor
from octo.solver.subproblem import Directions, Step, inner, minimize, two_by_two
from tests.dense import kkt_matrix


def directions(system) -> tuple[Directions, NormalFactor]:
    """The three solves that one linearisation gives, by dense algebra."""
    matrix = kkt_matrix(system)
    size = system.units * system.nc

    def solve(C: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rhs = -np.concatenate(
            [system.b.reshape(system.batch, -1), C.reshape(system.batch, -1)], axis=1
        )
        x = np.linalg.solve(matrix, rhs[..., None])[..., 0]
        return x[:, :size].reshape(system.b.shape), x[:, size:].reshape(C.shape)

    full, lam = solve(system.C)
    tangential, _ = solve(np.zeros_like(system.C))
    normal = NormalFactor(system.A)
    return Directions(full, tangential, normal.least_norm(-system.C), lam), normal


def subproblem(system, radius) -> tuple[Step, Directions, NormalFactor]:
    at, normal = directions(system)
    return (
        minimize(
            system,
            at,
            normal.project,
            np.broadcast_to(np.asarray(radius, dtype=float), (system.batch,)),
        ),
        at,
        normal,
    )


def test_a_large_radius_gives_the_kkt_step(random_system):
    system = random_system(0, 3, 5, 4, 2)
    for radius in (1e3, 1e150):
        step, at, _ = subproblem(system, radius)
        np.testing.assert_allclose(step.delta, at.full, atol=1e-9 * np.abs(at.full).max())
        np.testing.assert_allclose(step.residual, 0.0, atol=1e-10)


@pytest.mark.parametrize("part", [0.05, 0.3, 0.7, 1.5])
def test_the_step_is_the_best_of_its_plane_in_the_ball(random_system, part):
    """Members of one batch have radii of their own; a million points of the plane's disc are no
    better."""
    system = random_system(1, 3, 4, 4, 2)
    at, _ = directions(system)
    radius = part * np.sqrt(inner(at.full, at.full)) * [1.0, 0.5, 2.0]
    step, _, normal = subproblem(system, radius)
    assert (np.sqrt(inner(step.delta, step.delta)) <= radius * (1 + 1e-9)).all()
    angle, size = (
        g.ravel() for g in np.meshgrid(np.linspace(0.0, 2 * np.pi, 721), np.linspace(0.0, 1.0, 201))
    )
    theta = np.minimum(1.0, 0.8 * radius / np.sqrt(inner(at.normal, at.normal)))
    hessian, _ = dense_parts(system)
    for k in range(system.batch):
        v = (theta[k] * at.normal[k]).ravel()
        target = (theta[k] * at.full[k] + (1.0 - theta[k]) * at.tangential[k]).ravel()
        gradient = system.b[k].ravel() + hessian[k] @ v
        padded = np.zeros_like(system.b)
        padded[k] = gradient.reshape(system.b[k].shape)
        plane, _ = np.linalg.qr(np.stack([target - v, normal.project(padded)[k].ravel()], axis=1))
        room = np.sqrt(radius[k] ** 2 - v @ v)
        z = room * size * np.stack([np.cos(angle), np.sin(angle)])
        b2, H2 = plane.T @ gradient, plane.T @ hessian[k] @ plane
        values = (
            b2 @ z
            + 0.5 * np.einsum("ip,ij,jp->p", z, H2, z)
            + system.b[k].ravel() @ v
            + 0.5 * v @ hessian[k] @ v
        )
        assert step.energy[k] <= values.min() + 1e-9 * np.abs(values).max()
        assert step.energy[k] >= values.min() - 1e-3 * np.ptp(values)
        delta = step.delta[k].ravel()
        assert step.energy[k] == pytest.approx(
            system.b[k].ravel() @ delta + 0.5 * delta @ hessian[k] @ delta
        )
        np.testing.assert_allclose(delta - v, plane @ (plane.T @ (delta - v)), atol=1e-10)


def dense_parts(system) -> tuple[np.ndarray, np.ndarray]:
    matrix, size = kkt_matrix(system), system.units * system.nc
    return matrix[:, :size, :size], matrix[:, size:, :size]


@pytest.mark.parametrize("part", [0.5, 0.9])
def test_near_the_minimum_of_the_whole_space(random_system, part):
    """Against scipy's trust-constr over all variables: never better than it, and not much worse."""
    for seed in (4, 5):
        system = random_system(seed, 1, 3, 3, 1)
        at, _ = directions(system)
        radius = part * float(np.sqrt(inner(at.full, at.full))[0])
        step, _, _ = subproblem(system, radius)
        (H,), (A,) = dense_parts(system)
        b, C = system.b.ravel(), system.C.ravel()
        theta = min(1.0, 0.8 * radius / float(np.linalg.norm(at.normal)))
        best = scipy_minimize(
            lambda d, H=H, b=b: 0.5 * d @ H @ d + b @ d,
            theta * at.normal.ravel(),
            jac=lambda d, H=H, b=b: H @ d + b,
            hess=lambda d, H=H: H,
            method="trust-constr",
            options={"gtol": 1e-9, "xtol": 1e-12},
            constraints=[
                LinearConstraint(A, -theta * C, -theta * C),
                NonlinearConstraint(
                    lambda d: d @ d,
                    -np.inf,
                    radius**2,
                    jac=lambda d: 2 * d[None],
                    hess=lambda d, v: 2 * v[0] * np.eye(len(d)),
                ),
            ],
        )
        start = theta * at.normal.ravel()
        at_start = 0.5 * start @ H @ start + b @ start
        assert step.energy[0] >= best.fun - 1e-5 * abs(best.fun)
        assert at_start - step.energy[0] >= 0.9 * (at_start - best.fun)


@pytest.mark.parametrize("part", [0.1, 0.5, 2.0])
def test_constraints_are_relaxed_by_theta(random_system, part):
    """‖A Δ + C‖ = (1 − θ)‖C‖ with θ = min(1, 0.8 radius/‖v_N‖)."""
    system = random_system(2, 2, 5, 4, 2)
    at, _ = directions(system)
    length = np.sqrt(inner(at.normal, at.normal))
    step, _, _ = subproblem(system, part * length)
    theta = min(1.0, 0.8 * part)
    np.testing.assert_allclose(
        step.residual, (1.0 - theta) * np.sqrt(inner(system.C, system.C)), atol=1e-10
    )


def test_without_constraints_and_without_a_gradient(random_system):
    system = random_system(3, 2, 4, 3, 0)
    step, at, _ = subproblem(system, 1e150)
    np.testing.assert_allclose(step.delta, at.full, atol=1e-10)
    system.b[:] = 0.0
    step, _, _ = subproblem(system, 1.0)
    np.testing.assert_array_equal(step.delta, 0.0)


@pytest.mark.parametrize(
    "hessian",
    [(2.0, 0.3, 1.0), (1.0, 0.0, 0.0), (1.0, 2.0, 1.0), (-1.0, 0.2, -3.0), (0.0, 0.0, 0.0)],
)
def test_two_by_two(hessian):
    """Definite, singular and indefinite, against a search over the disc."""
    random = np.random.default_rng(0)
    angle, size = (
        g.ravel()
        for g in np.meshgrid(np.linspace(0.0, 2 * np.pi, 1441), np.linspace(0.0, 1.0, 301))
    )
    for radius in (0.1, 1.0, 5.0):
        g = random.standard_normal(2)
        (a, b, c), arrays = hessian, [np.array([v]) for v in (*hessian, *g, radius)]
        z1, z2 = two_by_two((arrays[0], arrays[1], arrays[2]), (arrays[3], arrays[4]), arrays[5])
        assert z1[0] ** 2 + z2[0] ** 2 <= radius**2 * (1 + 1e-9)
        x, y = radius * size * np.cos(angle), radius * size * np.sin(angle)
        values = g[0] * x + g[1] * y + 0.5 * (a * x * x + 2 * b * x * y + c * y * y)
        found = (
            g[0] * z1[0]
            + g[1] * z2[0]
            + 0.5 * (a * z1[0] ** 2 + 2 * b * z1[0] * z2[0] + c * z2[0] ** 2)
        )
        assert values.min() - 1e-3 * np.ptp(values) <= found <= values.min() + 1e-9 * np.ptp(values)
