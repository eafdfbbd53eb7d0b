"""Sequences of launches: a replay is the launches themselves, and what a graph cannot hold is
refused while it is captured."""

from __future__ import annotations

import gc
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import strict
from test_front_door import Counting
from test_solve import SETTINGS, batch_of

from octo.errors import DeviceError
from octo.gpu.backend import DeviceBackend
from octo.gpu.cuda import CudaDevice, CudaGraph
from octo.gpu.device import Device
from octo.gpu.factor import DeviceFactor
from octo.gpu.linear import Linear
from octo.gpu.problem import DeviceProblem
from octo.gpu.program import bytes_of
from octo.gpu.sequence import NoGraph, Sequence
from octo.solver import sqp
from octo.solver.options import SqpOptions
from tests.emulator import EmulatedDevice

TEXT = (
    'extern "C" __global__ void octo_add(double by, const double *x, double *y) { y[0] = '
    "x[0] + by; }"
)


def solve(problem, nodes, options, device):
    other, backend = DeviceProblem(problem, device), DeviceBackend(device)
    return sqp.run(other, other.unknowns(nodes), None, options, None, backend)


def same_bits(one, other):
    for name, value in vars(one.at).items():
        np.testing.assert_array_equal(value, getattr(other.at, name))
    np.testing.assert_array_equal(one.lam, other.lam)
    for a, b in zip(one.history, other.history, strict=True):
        for name in a.keys() - {"seconds"}:
            np.testing.assert_array_equal(a[name], b[name])


@pytest.mark.parametrize("setting", SETTINGS)
def test_a_replay_gives_the_bits_of_the_launches(setting):
    devices = [EmulatedDevice(xp=strict, graphs=graphs) for graphs in (True, False)]
    options = replace(SETTINGS[setting][0], max_iterations=12)
    replayed, launched = (
        solve(*batch_of("mammal", "nodes"), options, device) for device in devices
    )
    same_bits(replayed, launched)
    with_graphs, without = (device.counts for device in devices)
    assert without.graphs == without.replayed == 0
    assert with_graphs.launches + with_graphs.replayed == without.launches
    assert with_graphs.replayed > 4 * with_graphs.launches


def test_members_that_leave(swing_up_batch):
    """The batch gets smaller: other grids, other addresses, and graphs of its own."""
    devices = [EmulatedDevice(xp=strict, graphs=graphs) for graphs in (True, False)]
    replayed, launched = (
        solve(*swing_up_batch, SqpOptions(max_iterations=300), device) for device in devices
    )
    same_bits(replayed, launched)
    assert len(set(replayed.iterations.tolist())) > 1
    assert devices[0].counts.captures > 8


def test_two_threads_on_one_device(swing_up_batch):
    """Each has its own workspaces, and a capture of the one is none of the other's."""
    problem, nodes = swing_up_batch
    backend, options = DeviceBackend(EmulatedDevice()), SqpOptions(max_iterations=25)

    def run(seed: int):
        placed = backend.place(problem.take(np.array([seed])))
        return sqp.run(placed, placed.unknowns(nodes[[seed]]), None, options, None, backend)

    alone = [run(seed) for seed in range(3)]
    with ThreadPoolExecutor(3) as pool:
        for one, other in zip(alone, pool.map(run, range(3)), strict=True):
            same_bits(one, other)


def test_what_is_not_active_is_left_alone(random_system):
    """A member keeps its factor while the others are factored with other weights."""
    device = EmulatedDevice(3)
    system, linear = random_system(5, 3, 9, 6, 4, lowered=2.0), Linear(device, 6, 4)
    weight, active = device.array(np.full((3, 9), 30.0)), device.array(np.ones(3), np.int32)
    sequence = Sequence(device, lambda: DeviceFactor(linear, system.H, system.A, weight, active))
    first = [part.copy() for part in sequence().solve(-system.b, -system.C)]
    device.write(np.repeat([50.0, 30.0, 50.0], 9).reshape(3, 9), weight)
    device.write(np.array([1, 0, 1], dtype=np.int32), active)
    second = sequence().solve(-system.b, -system.C)
    whole = DeviceFactor(linear, system.H, system.A, weight).solve(-system.b, -system.C)
    for before, now, expected in zip(first, second, whole, strict=True):
        np.testing.assert_array_equal(now[1], before[1])
        np.testing.assert_array_equal(now[::2], expected[::2])
        assert (now[0] != before[0]).any()
    assert device.counts.captures == 1


def test_numbers_change_in_place_and_arguments_do_not(device):
    gpu = EmulatedDevice()
    add, x = gpu.module(TEXT).kernel("octo_add"), gpu.array([1.0])
    by = [0.5]

    def launches():
        y = gpu.empty((1,))
        add((1,), 1, by[0], x, y)
        return y

    sequence = Sequence(gpu, launches)
    assert sequence()[0] == 1.5
    gpu.write(np.array([2.0]), x)
    assert sequence()[0] == 2.5
    gpu.write(np.array([3.0]), x)
    by[0] = 7.0  # what was captured has 0.5
    assert sequence()[0] == 3.5
    assert (gpu.counts.captures, gpu.counts.graphs, gpu.counts.replayed, gpu.counts.launches) == (
        1,
        2,
        2,
        1,
    )


ILLEGAL = {
    "an allocation": lambda gpu, y: gpu.fresh((1,), float),
    "an array of the host": lambda gpu, y: gpu.array([1.0]),
    "a copy to the host": lambda gpu, y: gpu.host(y),
    "a copy from the host": lambda gpu, y: gpu.write(np.zeros(1), y),
    "a copy on the device": lambda gpu, y: gpu.copy(y, y),
    "waiting": lambda gpu, y: gpu.synchronize(),
    "a graph": lambda gpu, y: gpu.capture(lambda: None).launch(),
    "arithmetic": lambda gpu, y: y + y,
    "an assignment": lambda gpu, y: y.__setitem__(0, 1.0),
    "a decision": lambda gpu, y: bool(y),
    "one array more": lambda gpu, y: [
        gpu.empty((1,)) for _ in range(2 if gpu.here.capturing else 1)
    ],
    "another shape": lambda gpu, y: gpu.empty((2 if gpu.here.capturing else 1,)),
}


@pytest.mark.parametrize("what", ILLEGAL)
def test_what_a_graph_cannot_hold(what):
    gpu = EmulatedDevice(xp=strict)
    y = gpu.array([1.0])
    sequence = Sequence(gpu, lambda: (gpu.empty((1,)), ILLEGAL[what](gpu, y))[0])
    sequence()
    with pytest.raises((DeviceError, RuntimeError)):
        sequence()
    assert not gpu.here.capturing and not strict.capturing
    gpu.host(y + y)


def test_an_array_that_is_gone():
    gpu = EmulatedDevice()
    add, x = gpu.module(TEXT).kernel("octo_add"), gpu.array([1.0])
    y = {"y": gpu.array([0.0])}
    sequence = Sequence(gpu, lambda: add((1,), 1, 1.0, x, y["y"]) or True)
    for _ in range(3):
        sequence()
    y["y"] = gpu.array([0.0])
    gc.collect()
    with pytest.raises(DeviceError, match="octo_add on an array that is gone"):
        sequence()


class Refusing(EmulatedDevice):
    """A driver that cannot capture."""

    def capture(self, launches):
        raise NoGraph("cudaErrorNotSupported: operation not supported")


def test_without_graphs_it_says_so_once_and_goes_on(caplog):
    options = replace(SETTINGS["default"][0], max_iterations=6)
    refusing = Refusing(xp=strict)
    found = solve(*batch_of("mammal", "nodes"), options, refusing)
    same_bits(found, solve(*batch_of("mammal", "nodes"), options, EmulatedDevice(xp=strict)))
    lines = [line for line in caplog.messages if line.startswith("no CUDA graphs")]
    assert len(lines) == 1 and "cudaErrorNotSupported" in lines[0]
    assert refusing.counts.graphs == 0


class Stream:
    """CuPy's, as far as a capture needs it."""

    def __init__(self, log, refuses=None):
        self.log, self.refuses = log, refuses

    def __call__(self, non_blocking):
        assert non_blocking  # the legacy default stream must not meet one that is captured
        return self

    def __enter__(self):
        self.log.append("enter")
        return self

    def __exit__(self, *_):
        self.log.append("leave")

    def begin_capture(self, mode):
        self.log.append(f"begin {mode}")

    def end_capture(self):
        self.log.append("end")
        if self.refuses is not None:
            raise RuntimeError(self.refuses)
        return self

    def launch(self):
        self.log.append("launch")


def cuda_device(stream) -> CudaDevice:
    gpu: CudaDevice = object.__new__(CudaDevice)
    Device.__init__(gpu, graphs=True)
    gpu.xp = type("cupy", (), {"cuda": type("cuda", (), {"Stream": stream})})
    return gpu


def test_how_cupy_is_asked():
    log: list[str] = []
    gpu = cuda_device(Stream(log))

    def launches():
        assert gpu.here.capturing
        gpu.launched()
        gpu.launched()
        with pytest.raises(DeviceError, match="an allocation"):
            gpu.fresh((1,), float)

    graph = gpu.capture(launches)
    graph.launch()
    assert log == ["enter", "begin 1", "end", "leave", "launch"]
    assert (
        isinstance(graph, CudaGraph)
        and gpu.counts.replayed == 2
        and gpu.counts.launches == 0
        and not gpu.here.capturing
    )


def test_a_refused_capture_leaves_the_stream(caplog):
    log: list[str] = []
    gpu = cuda_device(Stream(log, "cudaErrorStreamCaptureInvalidated: operation failed"))
    runs = []
    sequence = Sequence(gpu, lambda: runs.append(gpu.here.capturing) or True)
    for _ in range(3):
        sequence()
    assert log == ["enter", "begin 1", "end", "leave"]
    assert runs == [False, True, False, False] and not gpu.here.capturing
    assert caplog.text.count("cudaErrorStreamCaptureInvalidated") == 1


@pytest.mark.parametrize("setting", SETTINGS)
def test_memory_stays_within_the_estimate(compiled, wiggle, setting):
    """Everything that a solve keeps on the device, and all of it is given back for the next
    pass."""
    problem, device = compiled("nodes"), Counting()
    backend = DeviceBackend(device)
    placed = backend.place(problem)
    before = device.used
    sqp.run(
        placed,
        device.array(wiggle(problem)),
        None,
        replace(SETTINGS[setting][0], max_iterations=4),
        None,
        backend,
    )
    assert device.used - before <= problem.batch * bytes_of(problem)
    again = backend.place(problem)
    assert device.used <= 2 * before and again is not placed
