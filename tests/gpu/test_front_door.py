"""device="cuda" and "auto" through octo.solve and the command line."""

from __future__ import annotations

import importlib
import re
import sys
import weakref

import numpy as np
import pytest
import strict

import octo
from octo.cli.main import main
from octo.errors import DeviceError, MissingExtraError
from octo.gpu import cuda
from octo.gpu.backend import DeviceBackend
from octo.gpu.program import bytes_of
from tests.emulator import EmulatedDevice

front = importlib.import_module("octo.devices")


@pytest.fixture
def no_gpu(monkeypatch):
    """As on a machine without CuPy."""
    monkeypatch.setitem(sys.modules, "cupy", None)
    cuda.reason.cache_clear()
    front.say_cpu.cache_clear()
    yield
    cuda.reason.cache_clear()


@pytest.fixture
def emulated(monkeypatch) -> EmulatedDevice:
    """The CPU behind device="cuda"."""
    device = EmulatedDevice(xp=strict)
    backend = DeviceBackend(device)
    monkeypatch.setattr(cuda, "reason", lambda: None)
    monkeypatch.setattr(front, "_cuda_backend", lambda: backend)
    front.say_cpu.cache_clear()
    return device


def walk(**changes) -> octo.Problem:
    return octo.Problem(
        octo.gallery.mammal(), **{"steps": 10, "dt": 0.025, "costs": octo.costs.paper(), **changes}
    )


def test_auto_says_why_it_uses_the_cpu(no_gpu, capsys, tmp_path):
    words = [
        "solve",
        "mammal",
        "--costs",
        "paper",
        "--seconds",
        "0.4",
        "--passes",
        "1",
        "--max-iterations",
        "2",
    ]
    words += ["--out", str(tmp_path / "out")]
    assert main([*words, "--device", "auto"]) in (0, 1)
    lines = [
        line
        for line in capsys.readouterr().err.splitlines()
        if line.startswith("octo: using the CPU: ")
    ]
    assert len(lines) == 1 and "CuPy" in lines[0]
    assert main([*words, "--device", "cuda"]) == 2
    assert "device 'cuda' cannot be used: CuPy" in capsys.readouterr().err


def test_devices_are_listed(no_gpu, capsys):
    assert main(["info", "--devices"]) == 0
    printed = capsys.readouterr().out
    assert "cores" in printed and "cuda  cannot be used: CuPy" in printed


@pytest.mark.slow
def test_two_passes_and_two_starts(emulated):
    settings = {"passes": 2, "seeds": 2, "max_iterations": 100, "tolerance": 1e-3}
    found, expected = (octo.solve(walk(), device=device, **settings) for device in ("cuda", "cpu"))
    assert found.device == "cuda" and emulated.counts.replayed > 0
    assert found.status == expected.status
    assert [record["pass"] for record in found.passes] == [
        record["pass"] for record in expected.passes
    ]
    assert found.energy == pytest.approx(expected.energy, rel=0.05)
    assert all(type(value) is np.ndarray for value in (found.x, found.u, found.multipliers))
    found.report()


def test_too_little_memory(emulated, caplog):
    emulated.memory = 10_000_000
    with pytest.raises(
        DeviceError, match="need .* GB, the GPU has 0.01 GB free: solve .* at a time"
    ):
        octo.solve(walk(), seeds=8, device="cuda")
    with caplog.at_level("INFO", logger="octo"):
        solution = octo.solve(walk(), seeds=8, device="auto", max_iterations=1)
    assert solution.device == "cpu"
    assert "using the CPU: 8 problems" in caplog.text


class Counting(EmulatedDevice):
    """A device of ``memory`` bytes that knows which of its arrays are still there."""

    def __init__(self):
        super().__init__()
        self.used = 0

    def array(self, values, dtype=np.float64):
        return self._counted(super().array(values, dtype))

    def fresh(self, shape, dtype):
        return self._counted(super().fresh(shape, dtype))

    def _counted(self, made):
        self.used += made.nbytes
        weakref.finalize(made, self._give_back, made.nbytes)
        return made

    def _give_back(self, count):
        self.used -= count

    def free_bytes(self):
        return self.memory - self.used


def test_what_fits_in_the_first_pass_fits_in_the_second(compiled, wiggle):
    problem, device = compiled("nodes"), Counting()
    backend = DeviceBackend(device)
    placed = backend.place(problem)
    device.memory = device.used + problem.batch * bytes_of(problem)
    placed.linearize(placed.evaluate(device.array(wiggle(problem))), None)
    assert device.free_bytes() < problem.batch * bytes_of(problem)  # the scratch is still there
    again = backend.place(problem)
    found = [
        p.linearize(p.evaluate(device.array(wiggle(problem))), None).H for p in (placed, again)
    ]
    np.testing.assert_array_equal(*found)


def test_terms_over_neighbouring_hermite_controls(emulated):
    between = octo.costs.NeighbourCost(lambda control, following, p: following - control)
    problem = walk(steps=20, basis="hermite", costs=[between, octo.costs.Effort()])
    found = octo.solve(problem, device="cuda", max_iterations=3)
    assert found.device == "cuda"
    assert found.energy == pytest.approx(
        octo.solve(problem, device="cpu", max_iterations=3).energy, rel=1e-6
    )


class Cupy:
    """What ``cuda.reason`` asks of CuPy."""

    class cuda:
        class runtime:
            CUDARuntimeError = RuntimeError
            count, driver = 1, 13000

            @classmethod
            def getDeviceCount(cls):
                if cls.count is None:
                    raise RuntimeError("cudaErrorNoDevice: no CUDA-capable device is detected")
                return cls.count

            @classmethod
            def driverGetVersion(cls):
                return cls.driver


@pytest.mark.parametrize(
    ("count", "driver", "nvrtc", "said"),
    [
        (None, 13000, "13.0", "no CUDA GPU or its driver is too old \\(cudaErrorNoDevice"),
        (0, 13000, "13.0", "there is no CUDA GPU"),
        (1, 13000, None, "NVRTC is missing: pip install"),
        (1, 12080, "13.0", "driver is for CUDA 12 and NVRTC is 13.0"),
        (1, 13000, "12.8", None),
    ],
)
def test_the_reasons(monkeypatch, count, driver, nvrtc, said):
    monkeypatch.setitem(sys.modules, "cupy", Cupy)
    monkeypatch.setattr(Cupy.cuda.runtime, "count", count)
    monkeypatch.setattr(Cupy.cuda.runtime, "driver", driver)

    def version():
        if nvrtc is None:
            raise MissingExtraError("compiling for the GPU", "cuda13")
        return nvrtc

    monkeypatch.setattr(cuda.nvrtc, "version", version)
    found = cuda.reason.__wrapped__()
    assert found is None if said is None else re.search(said, found)
