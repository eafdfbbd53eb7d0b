"""E, C, H, A and b by the kernels, executed on the CPU, against the native code and against
CasADi's virtual machine."""

from __future__ import annotations

import re

import casadi as ca
import numpy as np
import pytest
from soft.clouds import cloud

import octo
from octo.gpu.problem import PARTS, DeviceProblem
from octo.gpu.program import DEFINED as BOUNDS
from octo.problem.compiled import CompiledProblem
from octo.problem.interpreted import Interpreted
from tests.emulator import KERNEL, EmulatedDevice, EmulatedKernel

THREADS = (1, 5, 32, 96)


def close(found, expected, scale=None):
    largest = np.abs(expected if scale is None else scale).max()
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-11 * max(1e-300, largest))


def check_model(device, problem, unknowns):
    """The model of a kernel of one thread and of five is that of the native code."""
    lam = np.random.default_rng(0).standard_normal((1, problem.K, problem.ma))
    expected = problem.linearize(problem.evaluate(unknowns), lam)
    for threads in (1, 5):
        gpu = device(threads)
        other = DeviceProblem(problem, gpu)
        found = other.linearize(other.evaluate(gpu.array(unknowns)), gpu.array(lam))
        for name in "HAbC":
            close(getattr(found, name), getattr(expected, name))


@pytest.mark.parametrize("threads", THREADS)
@pytest.mark.parametrize("basis", ["nodes", "hermite"])
def test_values(compiled, wiggle, device, basis, threads):
    problem = compiled(basis)
    unknowns, gpu = wiggle(problem), device(threads)
    expected = problem.evaluate(unknowns)
    found = DeviceProblem(problem, gpu).evaluate(gpu.array(unknowns))
    for name in ("nodes", "fd", "terms", "energy", "C"):
        close(getattr(found, name), getattr(expected, name))


@pytest.mark.parametrize("threads", THREADS)
@pytest.mark.parametrize("basis", ["nodes", "hermite"])
@pytest.mark.parametrize("end", [False, True])
def test_the_model_against_casadi(compiled, wiggle, device, basis, threads, end):
    problem, gpu = compiled(basis, end), device(threads)
    unknowns = wiggle(problem)
    lam = np.random.default_rng(0).standard_normal((2, problem.K, problem.ma))
    at, other = problem.evaluate(unknowns), DeviceProblem(problem, gpu)
    own = other.evaluate(gpu.array(unknowns))
    oracle, models = Interpreted(problem.program, problem.plan, problem.data), []
    for multipliers in (None, lam):
        nc, ma = problem.nc, problem.ma
        out = tuple(
            np.empty((2, problem.K, *shape)) for shape in ((3, nc, nc), (3, ma, nc), (nc,), (ma,))
        )
        oracle.linearize(at, multipliers, None, out)
        out[0][:, problem.fixed, 0] = np.eye(nc)
        found = other.linearize(own, multipliers)
        for name, expected in zip("HAbC", out, strict=True):
            close(getattr(found, name), expected)
        models.append((out[0], found.H))
    curvature = models[1][0] - models[0][0]
    assert np.abs(curvature).max() > 0.0
    close(models[1][1] - models[0][1], curvature, models[1][0])


def test_a_nan_member_leaves_the_other_bit_identical(compiled, wiggle, device):
    problem, gpu = compiled("nodes"), device(5)
    other, unknowns = DeviceProblem(problem, gpu), wiggle(problem)
    expected = other.evaluate(gpu.array(unknowns))
    model = other.linearize(expected, None)
    unknowns[1, 4, 2] = np.nan
    found = other.evaluate(gpu.array(unknowns))
    broken = other.linearize(found, None)
    np.testing.assert_array_equal(found.finite, [True, False])
    for name in ("fd", "terms", "energy", "C"):
        np.testing.assert_array_equal(getattr(found, name)[0], getattr(expected, name)[0])
    for name in "HAb":
        np.testing.assert_array_equal(getattr(broken, name)[0], getattr(model, name)[0])


def test_members_taken_out_of_a_batch(compiled, wiggle, device):
    problem, gpu = compiled("hermite"), device(1)
    other, unknowns = DeviceProblem(problem, gpu), wiggle(problem)
    expected = other.evaluate(gpu.array(unknowns))
    found = other.take(np.array([1])).evaluate(gpu.array(unknowns[1:]))
    np.testing.assert_array_equal(found.energy, expected.energy[1:])
    np.testing.assert_array_equal(found.C, expected.C[1:])


def test_user_written_dynamics(device):
    """A pendulum on a cart, written by the user: its curvature has the block of x and x_prev."""

    def pendulum(x_next, x, x_prev, p):
        acceleration = (x_next - 2.0 * x + x_prev) / p["dt"] ** 2
        return acceleration + ca.vertcat(
            ca.sin(x_next[1]) * x_prev[0] * x[1], 9.81 * ca.sin(x_next[1]) + x[0] * x_prev[1]
        )

    dynamics = octo.CustomDynamics(pendulum, nx=2, actuated=[0], parameters={})
    near = octo.costs.CustomCost(lambda step, p: step.x_next, name="near")
    costs = [near, octo.costs.Effort(weight=1e-2)]
    problem = CompiledProblem(
        [octo.Problem(dynamics, steps=9, dt=0.05, x0=np.array([0.1, 0.3]), costs=costs)]
    )
    unknowns = 0.1 * np.random.default_rng(1).standard_normal((1, problem.K, problem.nc))
    check_model(device, problem, unknowns)


@pytest.mark.parametrize("threads", THREADS)
@pytest.mark.parametrize("end", [False, True])
def test_neighbouring_hermite_controls(between_controls, wiggle, device, threads, end):
    problem, gpu = between_controls(end), device(threads)
    unknowns = wiggle(problem)
    lam = np.random.default_rng(0).standard_normal((2, problem.K, problem.ma))
    at, other = problem.evaluate(unknowns), DeviceProblem(problem, gpu)
    own = other.evaluate(gpu.array(unknowns))
    assert (problem.term_values(at)[:, [0, 2]] > 0.0).all()
    close(other.term_values(own), problem.term_values(at))
    close(own.energy, at.energy)
    for multipliers in (None, lam):
        expected, found = problem.linearize(at, multipliers), other.linearize(own, multipliers)
        for name in "HAbC":
            assert np.isfinite(getattr(expected, name)).all()
            close(getattr(found, name), getattr(expected, name))
    single = other.take(np.array([1])).evaluate(gpu.array(unknowns[1:]))
    np.testing.assert_array_equal(single.energy, own.energy[1:])


@pytest.mark.parametrize("threads", THREADS)
@pytest.mark.parametrize("kind", ["even", "odd", "turning"])
def test_cycles(cycle, wiggle, device, kind, threads):
    """The first two nodes are the last two carried back: so are the slopes of the first two
    steps."""
    problem, gpu = cycle(kind), device(threads)
    unknowns = wiggle(problem)
    lam = np.random.default_rng(0).standard_normal((problem.batch, problem.K, problem.ma))
    at, other = problem.evaluate(unknowns), DeviceProblem(problem, gpu)
    own = other.evaluate(gpu.array(unknowns))
    for name in ("nodes", "fd", "terms", "energy", "C"):
        close(getattr(own, name), getattr(at, name))
    for multipliers in (None, lam):
        expected, found = problem.linearize(at, multipliers), other.linearize(own, multipliers)
        for name in "HAbC":
            close(getattr(found, name), getattr(expected, name))
    for slope, wanted in zip(other.gradient(own), problem.gradient(at), strict=True):
        close(slope, wanted)
    members = np.arange(problem.batch)[::-1]
    turned = other.take(members)
    again = turned.evaluate(gpu.array(unknowns[members]))
    np.testing.assert_array_equal(again.nodes, own.nodes[members])
    np.testing.assert_array_equal(turned.linearize(again, lam[members]).H, found.H[members])


def test_what_a_problem_shares_with_the_one_before_it_has_no_cycle_of_it(cycle, wiggle, device):
    even, odd, gpu = cycle("even"), cycle("odd"), device(1)
    before = DeviceProblem(odd, gpu)
    for problem in (even, even.take(np.array([1, 0]))):
        after, unknowns = DeviceProblem(problem, gpu, before), wiggle(problem)
        found, expected = after.evaluate(gpu.array(unknowns)), problem.evaluate(unknowns)
        close(found.nodes, expected.nodes)
        for name in "HAb":
            close(
                getattr(after.linearize(found, None), name),
                getattr(problem.linearize(expected, None), name),
            )
        before = after


def test_no_launch_has_more_threads_than_its_kernel_is_compiled_for(
    compiled, cycle, wiggle, monkeypatch
):
    """CUDA refuses such a launch; the CPU, whose blocks have another number of threads, would not
    notice."""
    most, run, seen = {**BOUNDS, "PARTS": PARTS}, EmulatedKernel.__call__, set()

    def launch(kernel, grid, threads, *arguments, shared=0):
        bound = re.search(rf"__launch_bounds__\((\w+), \d+\)\s*{kernel.name}\(", kernel.text)
        if bound is not None:
            assert threads <= most[bound[1]], kernel.name
            seen.add(kernel.name)
        run(kernel, grid, 1, *arguments, shared=shared)

    monkeypatch.setattr(EmulatedKernel, "__call__", launch)
    gpu = EmulatedDevice()
    gpu.threads = lambda wanted: wanted
    for problem in (compiled("nodes"), compiled("hermite"), cycle("even")):
        other = DeviceProblem(problem, gpu)
        at = other.evaluate(gpu.array(wiggle(problem)))
        for multipliers in (None, gpu.array(np.zeros((2, problem.K, problem.ma)))):
            other.linearize(at, multipliers)
    unbound = {"octo_work_size", "octo_jacobian", "octo_curvature"}
    assert seen == {name for text in other.program.texts for name in KERNEL.findall(text)} - unbound


@pytest.mark.parametrize("terrain", [None, octo.World([octo.shapes.Box((0.4, 0.4, 0.02), 0.01)])])
def test_a_soft_body(device, terrain):
    """Bends, and touches the ground with some of its vertices."""
    dynamics = octo.soft.SoftDynamics(cloud(3, 40), octo.laws.Smooth(onset=0.02), terrain)
    start = np.array([0.0, 0.0, 0.14, 0.2, 0.3, -0.1, 0.01, 0.02, -0.01])
    near = octo.costs.CustomCost(lambda step, p: step.x_next[:3], name="near")
    costs = [near, octo.costs.Effort(weight=1e-2)]
    problem = CompiledProblem([octo.Problem(dynamics, steps=6, dt=0.05, x0=start, costs=costs)])
    unknowns = problem.unknowns(np.repeat(start[None, None], 8, axis=1))
    unknowns += 0.01 * np.random.default_rng(1).standard_normal(unknowns.shape)
    check_model(device, problem, unknowns)
