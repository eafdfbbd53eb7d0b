"""Every kernel compiles for GPUs without one; registers, spills and shared memory beside a
committed table (nvrtc.json).

``PYTHONPATH=. python tests/gpu/test_nvrtc.py`` prints the report, and how long compiling takes, and
writes the table anew.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import json
import re
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from extending.code_stage import OverGrid

import octo
from octo import native
from octo.dynamics.evaluate import CustomDynamics, RobotDynamics
from octo.dynamics.laws import Compliant
from octo.errors import DeviceError, MissingExtraError
from octo.gpu import linear, nvrtc
from octo.gpu.between import Between
from octo.gpu.linear import Linear, pivot_room
from octo.gpu.program import Program
from octo.gpu.step_pairs import StepPairs
from octo.problem.compiled import CompiledProblem
from tests import emulator
from tests.gpu.ptxas import kernels_of

TABLE = Path(__file__).parent / "nvrtc.json"
# 14, 18 and 35 degrees of freedom
ROBOTS = {"chain": "paper", "mammal": "robot", "humanoid": "robot"}
ARCHITECTURES = ("sm_80", "sm_90")
MORE_REGISTERS = 1.1  # CasADi's text differs a little from version to version
WORK = "\nint octo_work_bytes(void) { return 8 * WORK; }\n"


class Dry:
    """A device that compiles nothing and runs nothing: for the texts."""

    xp, shared_limit = np, emulator.SHARED_LIMIT

    def __init__(self, work: int = 0):
        self.work, self.texts = work, []

    def module(self, text: str) -> Any:
        self.texts.append(text)
        return self

    def compile(self, texts: Any) -> None:
        pass

    def kernel(self, name: str) -> Any:
        return lambda grid, threads, size, **_: size.fill(self.work // 8)

    def empty(self, shape: tuple[int, ...], dtype: Any = float) -> np.ndarray:
        return np.zeros(shape, dtype)

    def host(self, array: np.ndarray) -> np.ndarray:
        return array


@functools.cache
def program(dynamics_or_robot: Any, costs: str) -> Program:
    terms = octo.costs.robot() if costs == "robot" else octo.costs.paper()
    compiled = CompiledProblem([octo.Problem(dynamics_or_robot, steps=20, dt=0.025, costs=terms)])
    library = native.load(compiled.dynamics.text() + WORK, ("-DLANE=0", "-DLANES=1", "-DBARRIER="))
    assert library is not None
    return Program(compiled, Dry(library.octo_work_bytes()))


@functools.cache
def robot(name: str) -> octo.Character:
    return octo.gallery.CHARACTERS[name]()


@functools.cache
def compiled(name: str, architecture: str) -> list[nvrtc.Binary]:
    """All texts of a robot's walk in nodes, compiled side by side as for a GPU."""
    nx, mu = robot(name).nx, robot(name).nx - robot(name).nu
    texts = [*program(robot(name), ROBOTS[name]).texts, linear.text(nx, mu, emulator.SHARED_LIMIT)]
    with ThreadPoolExecutor() as pool:
        return list(pool.map(lambda text: nvrtc.compile_text(text, architecture), texts))


@functools.cache
def registers(name: str, architecture: str) -> dict[str, list[int]]:
    """Registers, stack and spilled bytes of every kernel."""
    kernels = {
        key: kernel
        for binary in compiled(name, architecture)
        for key, kernel in kernels_of(binary).items()
    }
    return {
        key: [k.registers, k.stack, k.spill_stores, k.spill_loads]
        for key, k in sorted(kernels.items())
    }


def shared_memory(name: str) -> dict[str, Any]:
    """What a block needs of dynamic shared memory."""
    made, block = program(robot(name), ROBOTS[name]), 2 * (2 * robot(name).nx - robot(name).nu)
    pivot = pivot_room(block, emulator.SHARED_LIMIT)
    return {"step": 8 * made.work, "rows": made.room, "pivot": pivot}


@pytest.fixture(scope="module", autouse=True)
def compiler():
    try:
        nvrtc.compile_text('extern "C" __global__ void nothing() {}')
    except MissingExtraError:
        pytest.skip("nvidia-cuda-nvrtc is not installed")
    if native.compiler() is None:
        pytest.skip("no C compiler")


MOST_ASKED = ("mammal", "sm_90")


@pytest.mark.parametrize(
    ("name", "architecture"),
    [
        pytest.param(*case, marks=[] if case == MOST_ASKED else pytest.mark.slow)
        for case in itertools.product(ROBOTS, ARCHITECTURES)
    ],
)
def test_registers_spills_and_shared_memory(name, architecture):
    expected = json.loads(TABLE.read_text())["report"][name]
    own, other = registers(name, architecture), expected["kernels"][architecture]
    assert set(own) == set(other)
    for kernel, (used, _, stores, loads) in own.items():
        allowed = other[kernel][0]
        assert used <= max(allowed * MORE_REGISTERS, allowed + 8), kernel
        assert (stores, loads) == (0, 0), f"{kernel} spills"
    assert shared_memory(name) == expected["shared"]


@pytest.mark.slow
def test_before_compute_capability_8():
    """Warps agree on a pivot by shuffles there: no instruction does it."""
    binary = nvrtc.compile_text(linear.text(4, 2, 48 * 1024), "sm_75")
    assert kernels_of(binary)["octo_kkt_pivots"].spill_stores == 0


def test_another_law_and_user_written_dynamics():
    law = nvrtc.compile_text(program(RobotDynamics(robot("chain"), Compliant()), "paper").texts[0])
    assert {name for name, kernel in kernels_of(law).items() if kernel.spill_stores} == {
        "octo_curvature"
    }, "see docs/gpu.md"
    dynamics = CustomDynamics(
        lambda x_next, x, x_prev, p: ca.sin(x_next) - 2.0 * x + x_prev, 2, [0], {}
    )
    problem = octo.Problem(dynamics, steps=9, dt=0.05, x0=np.zeros(2), costs=[octo.costs.Effort()])
    for text in Program(CompiledProblem([problem]), Dry(64)).texts:
        assert nvrtc.compile_text(text).cubin[:4] == b"\x7fELF"


@pytest.mark.slow
def test_elements_do_not_spill():
    """A spring between two bodies of a leg and one to the world."""
    mammal = robot("mammal")
    springs = (
        octo.SpringDamper("trunk", (0.1, 0, 0), "front_left_shank", (0, 0, -0.1), 200, 5, 0.3),
        octo.SpringDamper("trunk", (0, 0, 0), None, (0, 0, 1), 200, 5, 0.3),
    )
    made = program(dataclasses.replace(mammal, elements=springs), "robot")
    for name, kernel in kernels_of(nvrtc.compile_text(made.texts[0], "sm_90")).items():
        assert (kernel.spill_stores, kernel.spill_loads) == (0, 0), name


def test_a_stage_of_code():
    """A look-up in a table with a floor and a limit in it."""
    costs = [octo.Effort(), OverGrid(body="front_left_shank")]
    problem = octo.Problem(robot("mammal"), steps=20, dt=0.025, costs=costs)
    kernels = kernels_of(nvrtc.compile_text(Program(CompiledProblem([problem]), Dry(64)).texts[1]))
    for name in ("octo_terms", "octo_cost_derivatives"):
        assert kernels[name].spill_stores == kernels[name].spill_loads == 0, name


def test_terms_over_neighbouring_hermite_controls():
    rate = octo.costs.NeighbourCost(lambda control, following, p: ca.sin(following) - control)
    problem = octo.Problem(robot("humanoid"), steps=20, dt=0.05, basis="hermite", costs=[rate])
    device = Dry(64)
    code = CompiledProblem([problem]).program.between
    assert code is not None
    Between(code, device)
    kernels = kernels_of(nvrtc.compile_text(device.texts[-1]))
    assert len(kernels) == 4 and all(
        kernel.spill_stores == kernel.spill_loads == 0 for kernel in kernels.values()
    )


def test_terms_over_two_steps_in_a_row():
    problem = octo.Problem(robot("humanoid"), steps=20, dt=0.05, costs=[octo.TorqueRate()])
    made, device = CompiledProblem([problem]), Dry(64)
    assert made.functions.pairs is not None
    StepPairs(made, made.functions.pairs, device)
    kernels = kernels_of(nvrtc.compile_text(device.texts[-1]))
    assert len(kernels) == 6 and all(
        kernel.spill_stores == kernel.spill_loads == 0 for kernel in kernels.values()
    )
    assert all(kernels_of(nvrtc.compile_text(text)) for text in Program(made, Dry(64)).texts[1:])


@pytest.mark.parametrize(
    ("nc", "ma"), [(1, 0), pytest.param(2, 1, marks=pytest.mark.slow), (72, 10)]
)
def test_other_blocks(nc, ma):
    kernels = kernels_of(nvrtc.compile_text(Linear(Dry(), nc, ma).text))
    assert kernels["octo_kkt_pivots"].spill_stores == 0


def test_spills_of_a_called_function_are_counted():
    text = """static __device__ __noinline__ void called(const double *x, double *y) {
      double v[400]; for (int k = 0; k < 400; ++k) v[k] = x[k];
      #pragma unroll
      for (int k = 0; k < 400; ++k) y[k] = v[k] * v[399 - k] + v[(7 * k) % 400]; }
    extern "C" __global__ void calling(const double *x, double *y) { called(x, y); }"""
    assert kernels_of(nvrtc.compile_text(text))["calling"].spill_stores > 0


def test_wrong_text_is_refused_with_the_log():
    with pytest.raises(DeviceError, match="nonsense"):
        nvrtc.compile_text("nonsense")


def test_machine_code_is_cached(tmp_path, monkeypatch):
    from octo.gpu import cuda

    monkeypatch.setenv("OCTO_CACHE", str(tmp_path))
    text = 'extern "C" __global__ void nothing() {}'
    paths = {
        cuda.cubin(text, "sm_90", "14.2.0"),
        cuda.cubin(text, "sm_80", "14.2.0"),
        cuda.cubin(text, "sm_90", "14.3.0"),
    }
    assert len(paths) == 3 and all(path.read_bytes()[:4] == b"\x7fELF" for path in paths)
    monkeypatch.setattr(nvrtc, "compile_text", None)
    assert cuda.cubin(text, "sm_90", "14.2.0") in paths


if __name__ == "__main__":
    for name in ROBOTS:
        program(robot(name), ROBOTS[name])  # CasADi's part is not the compiler's
        began, worked = time.perf_counter(), time.process_time()
        compiled(name, ARCHITECTURES[-1])
        passed = time.perf_counter() - began
        print(
            f"{name}: NVRTC {passed:.1f} s, {time.process_time() - worked:.1f} s of processor "
            f"time, {ARCHITECTURES[-1]}"
        )
    made = {}
    for name in ROBOTS:
        kernels = {architecture: registers(name, architecture) for architecture in ARCHITECTURES}
        made[name] = {"kernels": kernels, "shared": shared_memory(name)}
    text = json.dumps({"nvrtc": nvrtc.version(), "report": made}, indent=1)
    TABLE.write_text(
        re.sub(r"\[\s+(\d+),\s+(\d+),\s+(\d+),\s+(\d+)\s+\]", r"[\1, \2, \3, \4]", text) + "\n"
    )
    for name, one in made.items():
        print(f"{name}: shared memory {one['shared']}")
        for architecture, kernels in one["kernels"].items():
            for kernel, (registers, stack, stores, loads) in kernels.items():
                spilled = f"{stack:4d} bytes of stack, {stores} + {loads} spilled"
                print(f"  {architecture} {kernel:32s}{registers:4d} registers, {spilled}")
