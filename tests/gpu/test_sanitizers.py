"""Every kernel of an iteration under AddressSanitizer, UBSan and ThreadSanitizer; planted faults
are found."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from extending.code_stage import GRID
from replay import Recorder, replay
from walker import START, walker

import octo
from octo.gpu.backend import DeviceBackend
from octo.gpu.problem import DeviceProblem
from octo.problem.compiled import CompiledProblem
from octo.solver import sqp
from octo.solver.options import SqpOptions
from tests import emulator
from tests.emulator import EmulatedDevice
from tests.gpu import conftest

RACE = "data race"
# what is planted: sanitizer, a kernel that has it, the right words, the wrong ones, what is said
FAULTS = {
    "race in a sum": (
        "thread",
        "octo_kkt_check",
        "_block_max(double *part) {\n  BARRIER;",
        "_block_max(double *part) {",
        RACE,
    ),
    "race in a pivot": (
        "thread",
        "octo_kkt_pivots",
        "/ WARP] = own;\n  }\n  BARRIER;",
        "/ WARP] = own;\n  }",
        RACE,
    ),
    "overrun of shared memory": (
        "address",
        "octo_kkt_fold",
        "*partial = w + 2 * B;",
        "*partial = w + 2 * B + 1;",
        "heap-buffer-overflow",
    ),
    "overrun of an array": (
        "address",
        "octo_hessian_times",
        "out[own_v + e] =",
        "out[own_v + e + 1] =",
        "heap-buffer-overflow",
    ),
}


@lru_cache
def recorded() -> Recorder:
    """What two iterations of each rule launch, of a cycle and in both bases, with terms between
    controls and with a number of coordinates that tiles do not divide. The cycle is first: all
    three share their texts. With five threads a block: with more, there are blocks enough too."""
    recorder = Recorder()
    device = EmulatedDevice(5, recorder=recorder)
    walkers = (
        conftest._cycle("odd"),
        conftest._compiled("nodes"),
        conftest._compiled("hermite"),
        conftest._between(),
    )
    four = conftest._no_multiple_of_a_tile()
    starts = [*map(conftest.wiggle_near_ground, walkers), np.zeros((1, four.K, four.nc))]
    for problem, start in zip((*walkers, four), starts, strict=True):
        other, backend = DeviceProblem(problem, device), DeviceBackend(device)
        unknowns = device.array(start)
        for options in (SqpOptions(), SqpOptions.paper()):
            sqp.run(other, unknowns, None, replace(options, max_iterations=2), None, backend)
    return recorder


@pytest.mark.slow
def test_every_kernel_is_recorded():
    found = recorded()
    assert {
        name for text in found.launches for name in emulator.KERNEL.findall(text)
    } == found.kernels


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sanitizer", "threads", "crews"), [("address", 5, 2), ("thread", 5, 2), ("thread", 32, 1)]
)
def test_no_sanitizer_finds_anything(tmp_path, sanitizer, threads, crews):
    for text, launches in recorded().launches.items():
        done = replay(text, launches, sanitizer, threads, crews, tmp_path)
        assert done.returncode == 0, done.stderr[:3000]
        assert f"replayed {len(launches)} launches" in done.stdout


def _nested(step: Any, p: Any) -> ca.SX:
    heights = [step.call(GRID, point) for point in (step.x[:2], step.x_next[:2])]
    return step.call(GRID, ca.vertcat(*heights)) - step.x[2]


@pytest.mark.parametrize("barrier", [True, False])
def test_calls_of_stages_wait_for_one_another(tmp_path, barrier):
    recorder = Recorder()
    problem = octo.Problem(walker(), steps=5, dt=0.05, costs=[octo.CustomCost(_nested)], x0=START)
    made = DeviceProblem(CompiledProblem([problem]), EmulatedDevice(5, recorder=recorder))
    made.linearize(made.evaluate(made.unknowns(np.tile(START, (1, 7, 1)))), None)
    text = next(text for text in recorder.launches if "octo_calls_of_steps" in text)
    wave = "octo_call(wave + k, arg, v, order);\n    }\n    BARRIER;"
    assert wave in text
    planted = text if barrier else text.replace(wave, wave.removesuffix("BARRIER;"))
    done = replay(planted, recorder.launches[text], "thread", 5, 1, tmp_path)
    assert (done.returncode == 0) == barrier and (RACE in done.stderr) != barrier


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
def test_planted_faults_are_found(tmp_path, fault):
    sanitizer, kernel, right, wrong, said = FAULTS[fault]
    text = next(text for text in recorded().launches if kernel in emulator.KERNEL.findall(text))
    broken = text.replace(right, wrong, 1)
    assert broken != text
    chosen = [
        launch for launch in recorded().launches[text] if launch[4:].startswith(kernel.encode())
    ]
    done = replay(broken, chosen, sanitizer, 5, 1, tmp_path)
    assert done.returncode != 0 and said in done.stderr, done.stderr[:2000]


def test_what_a_kernel_must_not_be_given():
    device = EmulatedDevice()
    module = device.module(
        'extern "C" __global__ void octo_half(int n, double by, double *x) { x[0] = n * by; }'
    )
    half, x = module.kernel("octo_half"), np.zeros(1)
    half((1,), 1, 3, 0.5, x)
    assert x[0] == 1.5
    for wrong in (
        (3, 1, x),
        (3.0, 0.5, x),
        (3, 0.5, x.astype(np.float32)),
        (3, 0.5, np.zeros((2, 2))[:, 0]),
        (3, 0.5),
    ):
        with pytest.raises(TypeError):
            half((1,), 1, *wrong)
    with pytest.raises(ValueError, match="shared memory"):
        half((1,), 1, 3, 0.5, x, shared=1 << 20)
