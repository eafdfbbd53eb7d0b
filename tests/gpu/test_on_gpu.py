"""On a GPU: what the tests of this folder see on the CPU. Skipped where there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_sequence import same_bits
from test_solve import CYCLES, SETTINGS, batch_of, both, cycles_of, same_path

import octo
from octo.arrays import host
from octo.dynamics.laws import Compliant, Coulomb, Smooth
from octo.gpu import cuda
from octo.gpu.factor import DeviceFactor
from octo.gpu.linear import Linear
from octo.gpu.normal import DeviceNormal
from octo.gpu.problem import DeviceProblem
from octo.problem.compiled import CompiledProblem
from octo.solver.normal import NormalFactor
from octo.solver.options import SqpOptions
from octo.solver.status import Status
from tests.dense import kkt_matrix

pytestmark = pytest.mark.skipif(cuda.reason() is not None, reason=str(cuda.reason()))


def close(found, expected):
    np.testing.assert_allclose(
        host(found), expected, rtol=0.0, atol=1e-11 * max(1e-300, np.abs(expected).max(initial=0.0))
    )


@pytest.mark.parametrize("basis", ["nodes", "hermite", "neighbouring hermite controls"])
@pytest.mark.parametrize("end", [False, True])
def test_values_and_models(compiled, between_controls, wiggle, basis, end):
    problem = compiled(basis, end) if basis in ("nodes", "hermite") else between_controls(end)
    gpu = cuda.device()
    unknowns, other = wiggle(problem), DeviceProblem(problem, gpu)
    lam = np.random.default_rng(0).standard_normal((2, problem.K, problem.ma))
    at, own = problem.evaluate(unknowns), other.evaluate(gpu.array(unknowns))
    for name in ("nodes", "fd", "terms", "energy", "C"):
        close(getattr(own, name), getattr(at, name))
    for multipliers in (None, lam):
        found = other.linearize(own, None if multipliers is None else gpu.array(multipliers))
        expected = problem.linearize(at, multipliers)
        for name in "HAbC":
            close(getattr(found, name), getattr(expected, name))


LAWS = {
    "viscous": Smooth(),
    "coulomb": Smooth(onset=0.02, friction=Coulomb(mu=0.6)),
    "compliant": Compliant(),
}


PAIRS = [(robot, "viscous") for robot in octo.gallery.CHARACTERS]


@pytest.mark.parametrize(
    ("robot", "law"), [*PAIRS, ("humanoid", "coulomb"), ("humanoid", "compliant")]
)
def test_models_of_every_robot_and_law(wiggle, robot, law):
    """Up to 35 degrees of freedom: a step that asks for more shared memory than a kernel has by
    itself."""
    character = octo.gallery.CHARACTERS[robot]()
    costs = [
        octo.CenterOfMassVelocity((0.5, 0.0, 0.0)),
        octo.Effort(),
        octo.costs.Slip(length=0.03),
    ]
    one = octo.Problem(character, steps=6, dt=0.025, costs=costs, law=LAWS[law])
    problem, gpu = CompiledProblem([one]), cuda.device()
    unknowns, other = wiggle(problem), DeviceProblem(problem, gpu)
    lam = np.random.default_rng(0).standard_normal((1, problem.K, problem.ma))
    at, own = problem.evaluate(unknowns), other.evaluate(gpu.array(unknowns))
    found, expected = other.linearize(own, gpu.array(lam)), problem.linearize(at, lam)
    for name in ("fd", "terms", "C"):
        close(getattr(own, name), getattr(at, name))
    for name in "HAb":
        close(getattr(found, name), getattr(expected, name))


@pytest.mark.parametrize("robot", ["spider", "humanoid"])
@pytest.mark.parametrize("basis", ["nodes", "hermite"])
def test_blocks_larger_than_shared_memory(robot, basis):
    """Of 48 to 164 and more numbers, in shared or in global memory."""
    same_path(
        *both(
            *batch_of(robot, basis, steps=20, seeds=(0,)),
            SqpOptions(max_iterations=4),
            cuda.device(),
        ),
        1e-6,
    )


@pytest.mark.parametrize(("nc", "ma"), [(18, 6), (36, 12), (72, 10), (5, 1), (6, 0)])
def test_solutions_inertia_and_projections(random_system, nc, ma):
    gpu = cuda.device()
    linear = Linear(gpu, nc, ma)
    for K, lowered in ((1, 0.0), (8, 4.0), (13, 20.0)):
        system = random_system(K, 2, K, nc, ma, lowered=lowered)
        H, A, b, C = (gpu.array(part) for part in (system.H, system.A, system.b, system.C))
        factor = DeviceFactor(linear, H, A, None)
        np.testing.assert_array_equal(
            host(factor.negative), (np.linalg.eigvalsh(kkt_matrix(system)) < 0).sum(axis=1) - K * ma
        )
        factor.solve(-b, -C, tolerance=1e-14, check=True)
        assert host(factor.residual).max() < 1e-10
        normal, other = DeviceNormal(linear, A), NormalFactor(system.A)
        np.testing.assert_allclose(
            host(normal.least_norm(C)), other.least_norm(system.C), atol=1e-9
        )
        np.testing.assert_allclose(host(normal.project(b)), other.project(system.b), atol=1e-9)


@pytest.mark.parametrize(
    ("robot", "basis", "seeds"),
    [("mammal", "nodes", (0, 1)), ("chain", "nodes", (0, 1)), ("mammal", "hermite", (1,))],
)
@pytest.mark.parametrize("setting", SETTINGS)
def test_twenty_iterations_on_the_same_path(robot, basis, seeds, setting):
    options, tolerance = SETTINGS[setting]
    expected, found = both(
        *batch_of(robot, basis, seeds=seeds), replace(options, max_iterations=20), cuda.device()
    )
    same_path(expected, found, tolerance)


@pytest.mark.parametrize("kind", ["even", "odd", "turning"])
def test_models_of_cycles(cycle, wiggle, kind):
    problem, gpu = cycle(kind), cuda.device()
    unknowns, other = wiggle(problem), DeviceProblem(problem, gpu)
    lam = np.random.default_rng(0).standard_normal((problem.batch, problem.K, problem.ma))
    at, own = problem.evaluate(unknowns), other.evaluate(gpu.array(unknowns))
    found, expected = other.linearize(own, gpu.array(lam)), problem.linearize(at, lam)
    for name in ("nodes", "fd", "terms", "C"):
        close(getattr(own, name), getattr(at, name))
    for name in "HAb":
        close(getattr(found, name), getattr(expected, name))


@pytest.mark.parametrize("kind", CYCLES)
def test_a_cycle_on_the_same_path(kind):
    same_path(
        *both(*cycles_of("mammal", *CYCLES[kind]), SqpOptions(max_iterations=10), cuda.device()),
        1e-6,
    )


def test_to_convergence(swing_up_batch):
    expected, found = both(*swing_up_batch, SqpOptions(max_iterations=300), cuda.device())
    assert found.status == expected.status and all(status.converged for status in found.status)
    for one, other in zip(expected.history, found.history, strict=True):
        assert abs(len(one["energy"]) - len(other["energy"])) <= 0.15 * len(one["energy"])
        assert other["energy"][-1] == pytest.approx(one["energy"][-1], rel=0.01)


def test_a_nan_member_leaves_the_others_bit_identical(swing_up_batch):
    problem, nodes = swing_up_batch
    broken = nodes.copy()
    broken[1, 7] = np.nan
    whole, found = (
        both(problem, start, SqpOptions(max_iterations=12), cuda.device())[1]
        for start in (nodes, broken)
    )
    assert found.status[1] is Status.NOT_FINITE
    for k in (0, 2):
        np.testing.assert_array_equal(found.history[k]["energy"], whole.history[k]["energy"])
        np.testing.assert_array_equal(found.at.unknowns[k], whole.at.unknowns[k])


def test_a_batch_of_64_on_the_same_path():
    expected, found = both(
        *batch_of("mammal", "nodes", seeds=tuple(range(64))),
        SqpOptions(max_iterations=8),
        cuda.device(),
    )
    same_path(expected, found, 1e-6)


def test_the_same_result_twice():
    problem, nodes = batch_of("mammal", "nodes")
    first, second = (
        both(problem, nodes, replace(SETTINGS["default"][0], max_iterations=10), cuda.device())[1]
        for _ in range(2)
    )
    np.testing.assert_array_equal(first.at.unknowns, second.at.unknowns)


@pytest.mark.parametrize("setting", SETTINGS)
def test_graphs_give_the_bits_of_the_launches(monkeypatch, setting):
    gpu, problem = cuda.device(), batch_of("mammal", "nodes")
    options, found = replace(SETTINGS[setting][0], max_iterations=12), []
    for graphs in (True, False):
        monkeypatch.setattr(gpu, "graphs", graphs)
        before = replace(gpu.counts)
        found.append(both(*problem, options, gpu)[1])
        assert (gpu.counts.replayed > before.replayed) == graphs
    same_bits(*found)


def test_a_walk():
    problem = octo.Problem(octo.gallery.mammal(), steps=40, dt=0.025, costs=octo.costs.paper())
    solution = octo.solve(problem, seeds=4, device="cuda")
    assert solution.device == "cuda" and solution.converged
