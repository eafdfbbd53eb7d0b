"""On a GPU: what the tests of this folder see on the CPU. Skipped where there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_sequence import same_bits
from test_solve import SETTINGS, batch_of, both, same_path

import octo
from octo.arrays import host
from octo.gpu import cuda
from octo.gpu.factor import DeviceFactor
from octo.gpu.linear import Linear
from octo.gpu.normal import DeviceNormal
from octo.gpu.problem import DeviceProblem
from octo.solver.normal import NormalFactor

pytestmark = pytest.mark.skipif(cuda.reason() is not None, reason=str(cuda.reason()))


def close(found, expected):
    np.testing.assert_allclose(host(found), expected, rtol=0.0, atol=1e-11 * max(1e-300, np.abs(expected).max(initial=0.0)))


@pytest.mark.parametrize("basis", ["nodes", "hermite", "neighbouring hermite controls"])
@pytest.mark.parametrize("end", [False, True])
def test_values_and_models(compiled, between_controls, wiggle, basis, end):
    problem, gpu = compiled(basis, end) if basis in ("nodes", "hermite") else between_controls(end), cuda.device()
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


@pytest.mark.parametrize(("nc", "ma"), [(18, 6), (36, 12), (72, 10), (5, 1), (6, 0)])
def test_solutions_inertia_and_projections(random_system, nc, ma):
    gpu = cuda.device()
    linear = Linear(gpu, nc, ma)
    for K, lowered in ((1, 0.0), (8, 4.0), (13, 20.0)):
        system = random_system(K, 2, K, nc, ma, lowered=lowered)
        H, A, b, C = (gpu.array(part) for part in (system.H, system.A, system.b, system.C))
        factor = DeviceFactor(linear, H, A, None)
        np.testing.assert_array_equal(host(factor.negative), (np.linalg.eigvalsh(system.dense()) < 0).sum(axis=1) - K * ma)
        factor.solve(-b, -C, tolerance=1e-14, check=True)
        assert host(factor.residual).max() < 1e-10
        normal, other = DeviceNormal(linear, A), NormalFactor(system.A)
        np.testing.assert_allclose(host(normal.least_norm(C)), other.least_norm(system.C), atol=1e-9)
        np.testing.assert_allclose(host(normal.project(b)), other.project(system.b), atol=1e-9)


@pytest.mark.parametrize(
    ("robot", "basis", "seeds"), [("mammal", "nodes", (0, 1)), ("chain", "nodes", (0, 1)), ("mammal", "hermite", (1,))]
)
@pytest.mark.parametrize("setting", SETTINGS)
def test_twenty_iterations_on_the_same_path(robot, basis, seeds, setting):
    options, tolerance = SETTINGS[setting]
    expected, found = both(*batch_of(robot, basis, seeds=seeds), replace(options, max_iterations=20), cuda.device())
    same_path(expected, found, tolerance)


def test_the_same_result_twice():
    problem, nodes = batch_of("mammal", "nodes")
    first, second = (both(problem, nodes, replace(SETTINGS["default"][0], max_iterations=10), cuda.device())[1] for _ in range(2))
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
