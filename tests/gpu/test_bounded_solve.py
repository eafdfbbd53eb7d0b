"""Solves of problems with constraints on a device, the CPU in its place: the same path as on the
CPU."""

from __future__ import annotations

import importlib
from dataclasses import replace

import numpy as np
import pytest
import strict

import octo
from octo.gpu import cuda
from octo.gpu.backend import DeviceBackend
from octo.gpu.problem import DeviceProblem
from octo.problem.compiled import CompiledProblem
from octo.solver import sqp
from octo.solver.options import SqpOptions
from octo.starts import first_nodes
from tests.emulator import EmulatedDevice

DT, WAY = 0.05, 0.8


def push(limit: float, steps: int = 40, **changes) -> octo.Problem:
    """A mass of 1 kg from rest to rest, pushed with ``limit`` at most: 0.8 N is just enough."""
    dynamics = octo.CustomDynamics(
        lambda x_next, x, x_prev, view: (x_next - 2 * x + x_prev) / view["dt"] ** 2,
        1,
        [0],
        {"dt": DT},
    )
    given = {
        "costs": [octo.Effort(weight=1.0, reference=1.0)],
        "constraints": [octo.TorqueLimits(limit=limit)],
        "x0": np.zeros(1),
        "x_end": np.array([WAY]),
        "v_end": np.zeros(1),
    }
    return octo.Problem(dynamics, steps=steps, dt=DT, **{**given, **changes})


def walk(cycle: bool = False) -> octo.Problem:
    """Of which torques and speeds meet their limits on the way."""
    torque, speed = (40.0, 8.0) if cycle else (15.0, 3.0)
    constraints = [octo.TorqueLimits(limit=torque), octo.JointSpeedLimits(limit=speed)]
    own = {"steps": 20, "dt": 0.025, "costs": octo.costs.paper()}
    if cycle:
        stride = octo.Cycle(speed=0.5, period=0.8)
        own = {"steps": 15, "costs": octo.costs.natural(), "cycle": stride}
    return octo.Problem(octo.gallery.mammal(), constraints=constraints, **own)


def both(problems, options, slacks=None, device=None, nodes=None):
    """The CPU's result with cyclic reduction, and the device's."""
    compiled = CompiledProblem(problems)
    if nodes is None:
        nodes = np.stack([first_nodes(one, k, None) for k, one in enumerate(problems)])
    cpu = replace(options, linear_solver="cyclic_reduction")
    expected = sqp.run(compiled, compiled.unknowns(nodes), None, cpu, slacks=slacks)
    device = device or EmulatedDevice(xp=strict)
    other, backend = DeviceProblem(compiled, device), DeviceBackend(device)
    start = other.unknowns(nodes)
    return expected, sqp.run(other, start, None, options, None, backend, slacks)


def same_path(expected, found, rtol):
    for one, other in zip(expected.history, found.history, strict=True):
        assert len(one["energy"]) == len(other["energy"])
        for name in ("step", "ratio", "sigma"):
            np.testing.assert_allclose(other[name], one[name], rtol=1e3 * rtol, atol=1e-12)
        for name in ("energy", "violation"):
            np.testing.assert_allclose(other[name], one[name], rtol=rtol, atol=1e-9)
    for name in ("s", "lower", "upper", "equal", "mu"):
        one, other = (getattr(result.slacks, name) for result in (expected, found))
        assert type(other) is np.ndarray
        np.testing.assert_allclose(other, one, rtol=1e3 * rtol, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("cycle", [False, True])
def test_a_robot_on_the_same_path(cycle):
    """Iterate by iterate, while limits shorten steps and hold."""
    problem = walk(cycle)
    expected, found = both([problem], SqpOptions(max_iterations=8))
    same_path(expected, found, 1e-7)
    ratio = expected.history[0]["ratio"]
    assert (ratio < 1.0).any()


@pytest.mark.slow
def test_to_the_end_and_from_there():
    """Members with bounds of their own that end at iterations of their own; from the slacks of the
    end a solve takes few iterations."""
    problems, options = [push(1.0), push(0.85)], SqpOptions()
    expected, found = both(problems, options)
    assert all(status.converged for status in found.status)
    assert found.iterations[0] != found.iterations[1]
    np.testing.assert_array_equal(found.iterations, expected.iterations)
    np.testing.assert_allclose(found.at.objective, expected.at.objective, rtol=1e-9)
    np.testing.assert_allclose(found.at.unknowns, expected.at.unknowns, atol=1e-7)
    most = np.abs(found.at.rows).max(axis=(1, 2))  # in parts of the limit
    assert (most > 0.9999).all() and (most <= 1.0).all()
    again, warm = both(problems, options, found.slacks, nodes=found.at.nodes)
    same_path(again, warm, 1e-6)
    assert (warm.iterations < found.iterations).all()


@pytest.mark.parametrize("together", [4096, 0])
def test_trials_of_some_members(monkeypatch, together):
    """Also where only the members that want a trial get one."""
    monkeypatch.setattr("octo.gpu.work.TOGETHER", together)
    problems = [push(1.0), push(0.85), push(2.0)]
    expected, found = both(problems, SqpOptions())
    np.testing.assert_array_equal(found.iterations, expected.iterations)
    np.testing.assert_allclose(found.at.objective, expected.at.objective, rtol=1e-9)


def test_how_often_the_host_waits():
    """Beside what a solve without bounds waits for: once for the errors of the problem at hand,
    for the length of a step, for its trial and for what is known after it; and for a new start."""
    launched: dict[str, int] = {}

    def count(kernel, launch, arguments):
        launched[kernel.name] = launched.get(kernel.name, 0) + 1

    device = EmulatedDevice(xp=strict, recorder=count)
    strict.copies = 0
    _, found = both([walk()], SqpOptions(max_iterations=12), device=device)
    usual = launched["octo_kkt_blocks"] + launched["octo_summary"]
    assert strict.copies <= usual + 5 * len(found.history[0]["energy"]) + 16


def test_the_front_door(monkeypatch):
    device = EmulatedDevice(xp=strict)
    backend = DeviceBackend(device)
    front = importlib.import_module("octo.devices")
    monkeypatch.setattr(cuda, "reason", lambda: None)
    monkeypatch.setattr(front, "_cuda_backend", lambda: backend)
    problem = push(0.9)
    found, expected = octo.solve(problem, device="cuda"), octo.solve(problem, device="cpu")
    assert found.device == "cuda" and found.status is expected.status and found.status.converged
    np.testing.assert_allclose(found.energy, expected.energy, rtol=1e-6)
    assert [own.violation for own in found.bounds] == [0.0]
    assert np.abs(found.u).max() <= 0.9
