"""R Δ, how bounded rows change along a step of the unknowns, beside differences of the rows, and
Rᵀ w beside R Δ."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

import octo
from octo import native
from octo.dynamics import slots
from octo.gpu.problem import DeviceProblem
from octo.problem.basis import Hermite
from octo.problem.compiled import CompiledProblem
from octo.problem.cycle import Cycle
from tests import emulator
from tests.emulator import EmulatedDevice

pytestmark = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
DT = 0.05
MOTIONS: dict[str, dict[str, Any]] = {
    "nodes": {"steps": 13},
    "one step": {"steps": 1},
    "hermite with a fixed end": {"steps": 12, "basis": Hermite(3), "x_end": None},
    "cycle": {"steps": 9, "cycle": Cycle(speed=0.4, turn=0.3, period=0.45, mirror=False)},
    "pairs": {"steps": 13, "costs": [octo.TorqueRate()]},
}


class Torques(octo.CustomCost):
    kind = "bounded"

    def residual(self, step, p):
        return ca.vertcat(step.u[:4] / 30.0, step.u[1] * step.u[5] * step.x_next[7] / 900.0)


class Joints(octo.CustomCost):
    kind = "bounded"

    def residual(self, step, p):
        return ca.vertcat(step.x_next[8] * step.x[9], ca.sin(step.x_prev[10]) / step.dt)


class Base(octo.CustomCost):
    kind = "bounded"

    def residual(self, step, p):
        rotation, position = step.pose()
        return ca.vertcat(rotation[2, :].T, position - step.pose_before()[1])


KNOWN: dict[Any, CompiledProblem] = {}  # the code of a model and its terms, made once


def compiled(
    steps: int, costs: Any = (), bounded: tuple[type, ...] = (Torques, Joints, Base), **given: Any
) -> CompiledProblem:
    """A batch of two, of which the second is faster."""
    robot = octo.gallery.mammal()
    if "x_end" in given:  # the start
        given["x_end"] = octo.Problem(robot, steps=2, dt=DT, costs=[octo.Effort()]).start
    if "cycle" not in given:
        given["dt"] = DT
    terms = [octo.Posture(weight=0.1), bounded[0](), octo.Effort(), *costs]
    terms += [each() for each in bounded[1:]]
    made = octo.Problem(robot, steps=steps, costs=terms, **given)
    batch = [made, made.replace(parameters={"gravity_z": -12.0})]
    if "cycle" in given:  # which has terms of its own
        return CompiledProblem(batch)
    problem = CompiledProblem(batch, like=KNOWN.get((len(costs), bounded)))
    KNOWN.setdefault((len(costs), bounded), problem)
    return problem


def wiggle(problem: CompiledProblem) -> tuple[np.ndarray, np.ndarray]:
    """Unknowns (batch, K, nc) of a motion, and a step of them."""
    rng = np.random.default_rng(2)
    times = np.linspace(0.0, 1.0, problem.steps + 2)[:, None]
    waves = np.sin(times * rng.uniform(1.0, 4.0, (problem.batch, 1, problem.n)))
    unknowns = problem.unknowns(problem.start[:, None] + 0.05 * waves)
    delta = 0.2 * rng.standard_normal(unknowns.shape)
    delta[:, problem.fixed] = 0.0
    return unknowns, delta


def on_device(problem: CompiledProblem) -> Any:
    if emulator.compiler() is None:
        pytest.skip("no C++ compiler")
    return DeviceProblem(problem, EmulatedDevice(32, 1))


BACKENDS: dict[str, Callable[[CompiledProblem], Any]] = {
    "C": lambda problem: problem,
    "interpreted": CompiledProblem.interpreted,
    "CUDA": on_device,
}


@pytest.mark.parametrize("name", MOTIONS)
def test_it_is_the_slope_of_the_rows(name):
    """To second order by central differences, and the same whatever evaluates it."""
    problem = compiled(**MOTIONS[name])
    unknowns, delta = wiggle(problem)
    ones = np.ones((2, problem.steps, 13))
    products = {}
    for backend, make in BACKENDS.items():
        own = make(problem)
        own.set_row_weights(ones, ones)
        at = own.evaluate(unknowns)
        model = own.linearize(at, None)
        products[backend] = np.asarray(own.row_products(model, delta))
        curved = own.linearize(at, np.ones((2, problem.K, problem.ma)))
        again = np.asarray(own.row_products(curved, delta))
        np.testing.assert_allclose(again, products[backend], rtol=1e-12, atol=1e-12)
    found = products["C"]
    scale = np.abs(found).max(axis=(0, 1))
    assert (scale > 1e-3).all() or problem.steps == 1
    scale[scale == 0.0] = 1.0  # of the given x_{−1}
    for other in products.values():
        assert (np.abs(other - found) <= 1e-11 * scale).all()

    def left(h: float) -> np.ndarray:
        ahead, behind = (problem.evaluate(unknowns + s * h * delta).rows for s in (1.0, -1.0))
        return np.abs((ahead - behind) / (2.0 * h) - found).max(axis=(0, 1)) / scale

    coarse, fine = left(1e-2), left(1e-3)
    assert (fine < np.maximum(0.015 * coarse, 1e-9)).all()
    assert coarse.max() > 1e-6  # the rows bend: the differences say something


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", MOTIONS)
def test_forces_are_the_transposed_products(name, backend):
    """wᵀ (R Δ) = (Rᵀ w)ᵀ Δ for each unknown alone, and nothing where units are fixed."""
    problem = compiled(**MOTIONS[name])
    unknowns, delta = wiggle(problem)
    own, rng = BACKENDS[backend](problem), np.random.default_rng(3)
    weights = rng.standard_normal((2, problem.steps, 13))
    ones = np.ones_like(weights)
    own.set_row_weights(ones, ones)
    model = own.linearize(own.evaluate(unknowns), None)
    forces = np.asarray(own.row_forces(model, weights))
    assert forces.shape == delta.shape and (forces[:, problem.fixed] == 0.0).all()
    found = np.full_like(forces, np.nan)
    for unit in range(problem.K):
        for place in rng.choice(problem.nc, 3, replace=False):
            one = np.zeros_like(delta)
            one[:, unit, place] = 1.0
            products = np.asarray(own.row_products(model, one))
            found[:, unit, place] = (weights * products).sum(axis=(1, 2))
    asked, least = ~np.isnan(found), 1e-12 * np.abs(forces).max()
    np.testing.assert_allclose(forces[asked], found[asked], rtol=1e-9, atol=least)
    whole = (weights * np.asarray(own.row_products(model, delta))).sum(axis=(1, 2))
    np.testing.assert_allclose((forces * delta).sum(axis=(1, 2)), whole, rtol=1e-9)


@pytest.mark.parametrize("backend", BACKENDS)
def test_it_is_what_h_is_made_of(backend):
    """Δᵀ H Δ has Σ D (R Δ)², and rows that are left out have no slope."""
    problem = compiled(13)
    unknowns, delta = wiggle(problem)
    own, weights = BACKENDS[backend](problem), np.zeros((2, 13, 13))
    own.set_row_weights(weights, weights)
    at = own.evaluate(unknowns)
    plain = np.asarray(own.linearize(at, None).H)
    weights[:] = np.random.default_rng(0).uniform(0.0, 2.0, weights.shape)
    weights[:, ::3], weights[..., 6] = 0.0, 0.0
    own.set_row_weights(weights, weights)
    model = own.linearize(at, None)
    products = np.asarray(own.row_products(model, delta))
    assert (products[weights == 0.0] == 0.0).all() and products[weights != 0.0].all()
    added = np.asarray(model.H) - plain
    curvature = np.einsum("bka,bkac,bkc->b", delta, added[:, :, 0], delta)
    for lag in (1, 2):
        later, older = delta[:, lag:], delta[:, :-lag]
        curvature += 2.0 * np.einsum("bka,bkac,bkc->b", later, added[:, lag:, lag], older)
    np.testing.assert_allclose(curvature, (weights * products**2).sum(axis=(1, 2)), rtol=1e-10)


def test_what_is_kept():
    """Nothing without bounded rows, and of FD's Jacobian the rows that they look at."""
    robot = octo.gallery.mammal()
    terms = [octo.Posture(), octo.Effort()]
    plain = CompiledProblem([octo.Problem(robot, steps=4, dt=DT, costs=terms)])
    unknowns, delta = wiggle(plain)
    for own in (plain, plain.interpreted()):
        model = own.linearize(own.evaluate(unknowns), None)
        assert model.R is None
        assert own.row_products(model, delta).shape == (1, 4, 0)
        assert (own.row_forces(model, np.zeros((1, 4, 0))) == np.zeros_like(delta)).all()
    for bounded, slopes, motors in (((Joints,), 3, []), ((Joints, Torques), 10, [0, 1, 2, 3, 5])):
        kept = compiled(4, bounded=bounded).program.kept
        assert kept is not None and len(kept.entries) == slopes and kept.motors.tolist() == motors
        assert slopes <= kept.size < slopes + 1 + len(motors) * 3 * 18


def test_threads_and_members_change_nothing():
    problem = compiled(150)
    four = CompiledProblem(problem.problems, threads=4, like=problem)
    unknowns, delta = wiggle(problem)
    weights = np.ones((2, 150, 13))
    for each in (problem, four):
        each.set_row_weights(weights, weights)
    model = problem.linearize(problem.evaluate(unknowns), None)
    products = problem.row_products(model, delta)
    made = four.linearize(four.evaluate(unknowns), None)
    np.testing.assert_array_equal(made.R, model.R)
    np.testing.assert_array_equal(four.row_products(made, delta), products)
    forces = problem.row_forces(model, products)
    np.testing.assert_array_equal(four.row_forces(made, products), forces)
    one = four.take(np.array([1]))
    alone = one.linearize(one.evaluate(unknowns[1:]), None)
    np.testing.assert_array_equal(one.row_products(alone, delta[1:]), products[1:])
    np.testing.assert_array_equal(one.row_forces(alone, products[1:]), forces[1:])
    with pytest.raises(octo.errors.ShapeError, match="weights"):
        problem.row_forces(model, products[:, 1:])


def test_limbs_that_touch_couple_their_motors():
    """Of FD's Jacobian nothing is dropped that is not zero."""
    robot = octo.gallery.mammal()
    costs, start = [octo.Effort(), Torques()], robot.default_pose
    problem = CompiledProblem([octo.Problem(robot, steps=16, dt=DT, costs=costs, x0=start)])
    dynamics, rng = problem.dynamics, np.random.default_rng(1)
    pattern = dynamics.jacobian_pattern
    coupled = pattern & (
        slots.of_robot(dataclasses.replace(robot, pairs=()))[2].reshape(18, 54) == 0
    )
    poses = np.repeat(start[None, None], 2000, axis=1)
    poses[..., 6:] += rng.uniform(-1.5, 1.5, (2000, 12))
    jac = dynamics.evaluate(poses, problem.p, order=1)[1]
    assert jac is not None and (jac[..., ~pattern] == 0.0).all()
    touching = int(jac[0][:, coupled].any(axis=1).argmax())
    assert touching > 10 and jac[0, touching, coupled].any()
    unknowns = problem.unknowns(poses[:, touching - 10 : touching + 8])
    ones, delta = np.ones((1, 16, 5)), rng.standard_normal(unknowns.shape)
    products = []
    for own in (problem, problem.interpreted(), on_device(problem)):
        own.set_row_weights(ones, ones)
        at = own.evaluate(unknowns)
        products.append(np.asarray(own.row_products(own.linearize(at, None), delta)))
        np.testing.assert_allclose(products[-1], products[0], rtol=1e-9, atol=1e-6)
    jac = dynamics.evaluate(problem.evaluate(unknowns).nodes, problem.p, order=1)[1]
    assert jac is not None and jac[..., coupled].any()
    moved = np.pad(delta, ((0, 0), (2, 0), (0, 0)))
    window = np.concatenate([moved[:, k : k + 16] for k in (2, 1, 0)], axis=-1)
    torques = np.einsum("bijk,bik->bij", jac[:, :, dynamics.actuated[:4]], window) / 30.0
    np.testing.assert_allclose(products[0][..., :4], torques, rtol=1e-9, atol=1e-6)
