"""What soft bodies do in the air and on the ground: momentum, energy, springs."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np
import pytest
from soft.clouds import cloud

import octo
from octo import laws, soft
from octo.dynamics.simulate import Motion
from octo.soft.moments import Moments
from octo.soft.stages import turn

G = 9.81  # m/s²


@lru_cache
def ball() -> soft.SoftDynamics:
    return soft.SoftDynamics(cloud(4, 60), laws.Smooth(w_perp=2e5, onset=0.003))


def embedded(x: np.ndarray) -> np.ndarray:
    """T (N, 3, 3r+4)."""
    R = np.asarray(turn("zyx")(x[:, 3:6].T)).T[:, :9].reshape(-1, 3, 3)
    weights = np.concatenate([np.ones((len(x), 1)), x[:, 6:]], axis=1)
    made = np.einsum("nk,nij->nikj", weights, R).reshape(len(x), 3, -1)
    return np.concatenate([made, x[:, :3, None]], axis=2)


def momenta(dynamics: soft.SoftDynamics, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """Linear (N+1, 3) kg m/s, and angular (N+1, 3) kg m²/s about the centre of mass: ∫ρ Ṗ and
    ∫ρ P × Ṗ of all points, that of the centre taken off."""
    T = embedded(motion.x)
    rate, M = np.diff(T, axis=0) / motion.dt, dynamics.body.inertia
    linear = rate @ M[:, -1]
    outer = rate @ M @ T[1:].swapaxes(1, 2)  # ∫ρ Ṗ Pᵀ
    angular = np.stack([outer[:, k, i] - outer[:, i, k] for i, k in ((1, 2), (2, 0), (0, 1))], -1)
    center = T[1:] @ M[:, -1] / dynamics.body.mass
    return linear, angular - np.cross(center, linear)


def energy(dynamics: soft.SoftDynamics, motion: Motion) -> np.ndarray:
    """Kinetic, elastic, and weight times height (N+1,) J."""
    T = embedded(motion.x)
    rate, M = np.diff(T, axis=0) / motion.dt, dynamics.body.inertia
    z = motion.x[1:, 6:]
    kinetic = 0.5 * np.einsum("nia,ab,nib->n", rate, M, rate)
    elastic = 0.5 * np.einsum("nk,kl,nl->n", z, dynamics.body.stiffness, z)
    return kinetic + elastic + G * (T[1:] @ M[:, -1])[:, 2]


def thrown(dt: float, seconds: float = 0.4, **parameters: float) -> Motion:
    """Turning and bending, 5 m above the ground."""
    x0, v0, rng = np.zeros(10), np.zeros(10), np.random.default_rng(0)
    x0[2], x0[6:] = 5.0, 0.02 * rng.normal(size=4)
    v0[:3], v0[3:6] = (0.4, -0.2, 2.0), 2.0 * rng.normal(size=3)
    names = {f"elastic.{name}": value for name, value in parameters.items()}
    motion = octo.simulate(ball(), x0, v0, seconds=seconds, dt=dt, parameters=names)
    assert motion.converged.all()
    return motion


def test_in_free_flight_linear_momentum_grows_by_the_weight_alone() -> None:
    motion = thrown(0.02)
    linear, _ = momenta(ball(), motion)
    step = np.tile([0.0, 0.0, -ball().body.mass * G * motion.dt], (len(linear) - 1, 1))
    np.testing.assert_allclose(np.diff(linear, axis=0), step, atol=1e-10)
    assert np.abs(np.diff(motion.x[:, 6:], axis=0)).max() > 1e-3  # it does swing


def test_in_free_flight_angular_momentum_is_kept_to_first_order() -> None:
    """Its drift falls with dt; damping, which acts on the modes alone, does not matter."""
    steps = 5e-4 * 0.5 ** np.arange(4)
    for damped in (0.0, 1.0):
        drift = []
        for dt in steps:
            _, angular = momenta(ball(), thrown(dt, 0.1, alpha=3.0 * damped, beta=0.004 * damped))
            drift.append(np.linalg.norm(angular[-1] - angular[0]) / np.linalg.norm(angular[0]))
        order = np.polyfit(np.log(steps), np.log(drift), 1)[0]
        assert drift[0] < 0.1 and 0.85 < order < 1.3, (drift, order)


def test_a_falling_body_has_the_energy_of_the_discrete_parabola() -> None:
    """It loses m g² dt t/2: v is the backward difference. Nothing bends and nothing turns."""
    x0 = np.zeros(10)
    x0[2] = 5.0
    motion = octo.simulate(ball(), x0, seconds=0.4, dt=0.02)
    np.testing.assert_allclose(np.delete(motion.x, 2, axis=1), 0.0, atol=1e-12)
    lost = 0.5 * ball().body.mass * G**2 * motion.dt * motion.time
    own = energy(ball(), motion)
    np.testing.assert_allclose(own, own[0] - lost, rtol=1e-10)


def test_a_drop_changes_momentum_by_the_impulse_and_loses_energy() -> None:
    """The forces are those of the law at all vertices, one by one."""
    dynamics = ball()
    x0 = np.zeros(10)
    x0[2], x0[3:6] = 0.3, (0.2, 0.4, -0.3)
    motion = octo.simulate(dynamics, x0, seconds=0.6, dt=0.005)
    assert motion.converged.all()
    T, body = embedded(motion.x), dynamics.body
    modes = body.modes.reshape(len(body.points), -1)
    Y = np.column_stack([body.points, modes, np.ones(len(modes))])
    at = np.einsum("nia,pa->npi", T, Y)
    forces = np.zeros((len(motion.u), 3))
    at_next, before = ca.SX.sym("place", 3), ca.SX.sym("before", 3)
    p = {name: ca.SX(v) for name, v in dynamics.law.parameters.items()}
    law = dynamics.law.force(-at_next[2], ca.SX([0, 0, 1]), (at_next - before) / motion.dt, p)
    inside = ca.if_else(at_next[2] < dynamics.law.reach(p), law, ca.SX(3, 1))
    force = ca.Function("force", [at_next, before], [inside])
    for i in range(len(forces)):
        forces[i] = np.asarray(force(at[i + 2].T, at[i + 1].T)).sum(axis=1)
    own = dynamics.layout.pack(dt=motion.dt)
    names, (found, place, speed, _), depth = dynamics.contact_numbers(own, motion.x)
    chosen = [int(name.removeprefix("vertex_")) for name in names]
    np.testing.assert_allclose(found.sum(axis=1), forces, atol=1e-9)
    np.testing.assert_allclose(place, at[2:, chosen], atol=1e-12)
    np.testing.assert_allclose(speed, np.diff(at[1:, chosen], axis=0) / motion.dt, atol=1e-9)
    np.testing.assert_allclose(depth, -place[..., 2], atol=1e-12)
    linear, _ = momenta(dynamics, motion)
    weight = np.array([0.0, 0.0, -body.mass * G])
    np.testing.assert_allclose(np.diff(linear, axis=0), motion.dt * (forces + weight), atol=1e-7)
    assert forces[:, 2].max() > 3.0 * body.mass * G and np.abs(motion.x[:, 6:]).max() > 1e-3
    energies = energy(dynamics, motion)  # without what the contacts hold, which is not negative
    assert (energies <= energies[0] + 1e-9).all() and energies[-1] < 0.9 * energies[0]
    assert linear[:, 2].max() > 0.2  # it leaves the ground


def test_modes_swing_at_their_own_frequencies() -> None:
    """In the air, small, without damping: cos(ωt), to the discretisation's order."""
    rates, errors = np.sqrt(np.diag(ball().body.stiffness)), []
    for dt in (4e-4, 2e-4):
        x0 = np.zeros(10)
        x0[2], x0[6:] = 5.0, 1e-5
        off = {"elastic.alpha": 0.0, "elastic.beta": 0.0, "gravity_z": 0.0}
        motion = octo.simulate(ball(), x0, seconds=0.1, dt=dt, parameters=off)
        wanted = 1e-5 * np.cos(np.outer(motion.time, rates))
        errors.append(np.abs(motion.x[1:, 6:] - wanted).max() / 1e-5)
    assert errors[0] < 0.2 and errors[0] / errors[1] == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("bent", [False, True])
def test_a_mode_sags_under_a_force_by_its_stiffness(bent: bool) -> None:
    """u is the body's elastic force at rest, Λz of a linear one."""
    dynamics = soft.SoftDynamics(cloud(4, 60, bent=bent)) if bent else ball()
    z = np.array([0.01, -0.02, 0.005, 0.01])
    x = np.zeros((1, 3, 10))
    x[..., 2], x[..., 6:] = 5.0, z
    p = dynamics.layout.pack(gravity_z=0.0)[None]
    fd = dynamics.evaluate(x, p)[0][0, 0]
    np.testing.assert_allclose(fd[6:], dynamics.body.elastic_force(z), rtol=1e-12)
    linear = dynamics.body.stiffness @ z
    assert bent != bool(np.allclose(fd[6:], linear, rtol=1e-6))
    np.testing.assert_allclose(fd[:6], 0.0, atol=1e-10)
    assert np.allclose(Moments.of(dynamics.body).modal, np.eye(4))
