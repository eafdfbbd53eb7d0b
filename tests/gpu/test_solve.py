"""The whole solve on a device, the CPU in its place and arrays as strict as CuPy's: the same path
as on the CPU."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import strict

import octo
from octo import arrays
from octo.errors import DeviceError
from octo.gpu.backend import DeviceBackend
from octo.gpu.problem import DeviceProblem
from octo.gpu.work import DeviceFactors, Modelled
from octo.problem.compiled import CompiledProblem
from octo.solver import sqp
from octo.solver.options import SqpOptions
from octo.solver.status import Status
from octo.starts import first_nodes
from tests.emulator import EmulatedDevice

SETTINGS = {"paper": (SqpOptions.paper(), 1e-8), "default": (SqpOptions(), 1e-6)}


def batch_of(robot: str, basis: str, steps: int = 40, seeds: tuple[int, ...] = (0, 1)):
    problem = octo.Problem(
        octo.gallery.CHARACTERS[robot](),
        steps=steps,
        dt=0.025,
        costs=octo.costs.paper(),
        basis=basis,
    )
    return CompiledProblem([problem] * len(seeds)), np.stack(
        [first_nodes(problem, seed, None) for seed in seeds]
    )


def cycles_of(robot: str, cycle: octo.Cycle, steps: int, seeds: tuple[int, ...] = (0, 1)):
    problem = octo.Problem(
        octo.gallery.CHARACTERS[robot](), steps=steps, costs=octo.costs.natural(), cycle=cycle
    )
    return CompiledProblem([problem] * len(seeds)), np.stack(
        [first_nodes(problem, seed, None) for seed in seeds]
    )


def both(problem, nodes, options, device=None):
    """The CPU's result with cyclic reduction, and the device's."""
    device = device or EmulatedDevice(xp=strict)
    other, backend = DeviceProblem(problem, device), DeviceBackend(device)
    expected = sqp.run(
        problem, problem.unknowns(nodes), None, replace(options, linear_solver="cyclic_reduction")
    )
    return expected, sqp.run(other, other.unknowns(nodes), None, options, None, backend)


def same_path(expected, found, tolerance):
    for one, other in zip(expected.history, found.history, strict=True):
        assert len(one["energy"]) == len(other["energy"])
        np.testing.assert_array_equal(one["taken"] > 0.0, other["taken"] > 0.0)
        np.testing.assert_array_equal(one["factorizations"], other["factorizations"])
        np.testing.assert_allclose(other["energy"], one["energy"], rtol=tolerance)


@pytest.mark.parametrize(
    ("robot", "basis"),
    [
        ("mammal", "nodes"),
        ("mammal", "hermite"),
        pytest.param("chain", "nodes", marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("setting", SETTINGS)
def test_twenty_iterations_on_the_same_path(robot, basis, setting):
    options, tolerance = SETTINGS[setting]
    expected, found = both(*batch_of(robot, basis), replace(options, max_iterations=20))
    same_path(expected, found, tolerance)


CYCLES = {
    "mirrored": (octo.Cycle(speed=0.5, period=0.8), 15),
    "turning": (octo.Cycle(speed=0.5, period=0.4, mirror=False, turn=0.5), 12),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", CYCLES)
@pytest.mark.parametrize("setting", SETTINGS)
def test_a_cycle_on_the_same_path(kind, setting):
    """The paper's radius takes more iterations until a first step is accepted."""
    iterations = {"paper": 24, "default": 10}[setting]
    options = replace(SETTINGS[setting][0], max_iterations=iterations)
    expected, found = both(*cycles_of("mammal", *CYCLES[kind]), options)
    same_path(expected, found, 1e-6)
    assert all((record["taken"] > 0.0).any() for record in found.history)


def test_to_convergence(swing_up_batch):
    expected, found = both(*swing_up_batch, SqpOptions(max_iterations=300))
    assert found.status == expected.status and all(status.converged for status in found.status)
    for one, other in zip(expected.history, found.history, strict=True):
        assert abs(len(one["energy"]) - len(other["energy"])) <= 0.15 * len(one["energy"])
        assert other["energy"][-1] == pytest.approx(one["energy"][-1], rel=0.01)


def test_the_result_is_numpy(swing_up_batch):
    _, found = both(*swing_up_batch, SqpOptions(max_iterations=3))
    assert all(type(value) is np.ndarray for value in (*vars(found.at).values(), found.lam))


def test_a_nan_member_leaves_the_others_bit_identical(swing_up_batch):
    problem, nodes = swing_up_batch
    device = EmulatedDevice(xp=strict)
    other, backend = DeviceProblem(problem, device), DeviceBackend(device)
    options = SqpOptions(max_iterations=12)
    whole = sqp.run(other, other.unknowns(nodes), None, options, None, backend)
    nodes = nodes.copy()
    nodes[1, 7] = np.nan
    broken = sqp.run(other, other.unknowns(nodes), None, options, None, backend)
    assert broken.status[1] is Status.NOT_FINITE
    for k in (0, 2):
        assert broken.status[k] is whole.status[k]
        np.testing.assert_array_equal(broken.history[k]["energy"], whole.history[k]["energy"])
        np.testing.assert_array_equal(broken.at.unknowns[k], whole.at.unknowns[k])


@pytest.mark.parametrize("setting", SETTINGS)
def test_how_often_the_host_waits(setting):
    """A copy for each factorisation and each trial (a trial more where a solution is refined after
    it), eight of the result."""
    launched: dict[str, int] = {}

    def count(kernel, launch, arguments):
        launched[kernel.name] = launched.get(kernel.name, 0) + 1

    problem, nodes = batch_of("mammal", "nodes", seeds=(0,))
    device = EmulatedDevice(xp=strict, recorder=count)
    other, backend = DeviceProblem(problem, device), DeviceBackend(device)
    strict.copies, before = 0, arrays.copies
    # a progress line is not waited for
    monitor = sqp.Monitor(progress=lambda at, final=False: at.words)
    found = sqp.run(
        other,
        other.unknowns(nodes),
        None,
        replace(SETTINGS[setting][0], max_iterations=30),
        monitor,
        backend,
    )
    assert len(found.history[0]["energy"]) == 30
    assert launched["octo_kkt_blocks"] == found.factorizations[0]
    assert strict.copies == launched["octo_kkt_blocks"] + launched["octo_summary"] + 8
    assert strict.copies == arrays.copies - before
    assert device.counts.launches + device.counts.replayed == sum(launched.values())


def test_solutions_that_are_coarse(monkeypatch):
    """As on the CPU at most three refinements, the host asking for them: of the first step all, of
    a later one but the first."""
    launched: dict[str, int] = {}

    def count(kernel, launch, arguments):
        launched[kernel.name] = launched.get(kernel.name, 0) + 1

    options = replace(SETTINGS["default"][0], max_iterations=10)
    batch = batch_of("mammal", "nodes", seeds=(0,))
    _, usual = both(*batch, options)
    monkeypatch.setattr("octo.gpu.work.TOLERANCE", 1e-30)
    attempts = []
    monkeypatch.setattr(
        DeviceFactors, "attempt", lambda *a, _=DeviceFactors.attempt: (attempts.append(1), _(*a))[1]
    )
    expected, found = both(*batch, options, EmulatedDevice(xp=strict, recorder=count))
    same_path(expected, found, 1e-6)
    same_path(usual, found, 1e-6)
    assert launched["octo_kkt_residual"] == launched["octo_kkt_check"] == 4 * len(attempts)


@pytest.mark.slow
def test_trials_of_some_members(swing_up_batch, monkeypatch):
    """Where a batch fills a GPU, only the members that want a trial get one."""
    monkeypatch.setattr("octo.gpu.work.TOGETHER", 0)
    untried = []
    monkeypatch.setattr(
        Modelled, "untried", lambda *a, _=Modelled.untried: (untried.append(1), _(*a))[1]
    )
    for batch, iterations in ((swing_up_batch, 20), (batch_of("mammal", "nodes"), 20)):
        expected, found = both(*batch, SqpOptions(max_iterations=iterations))
        same_path(expected, found, 1e-6)
    assert untried


def test_units_with_extra_unknowns_are_refused(device):
    problem, _ = batch_of("mammal", "nodes", 4)
    wide = problem.with_data(replace(problem.plan, extra=2, extra_rows=1), problem.data)
    with pytest.raises(DeviceError, match="2 extra unknowns and 1 extra rows, must have"):
        DeviceBackend(device()).place(wide)
