"""The C text of the query: C99, C++ and CUDA, without allocation, recursion or state."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scenes import mixed, worst

from octo import World, native, shapes
from octo.errors import MissingExtraError
from octo.gpu import nvrtc
from octo.world import query
from octo.world.jet import SIZES
from tests import emulator
from tests.world.maps import maps

KERNEL = """
extern "C" __global__ void octo_world_kernel(
    int count, int order, const double *world, const double *points, double *jets) {
  const int k = blockIdx.x * blockDim.x + threadIdx.x;
  if (k < count) octo_world(world, points + 3 * k, order, jets + octo_world_size(order) * k);
}
"""
FUNCTION = r"^static \w+ (octo_world\w*)\(([^{;]*)\) \{\n?(.*?)\n?\}$"
STRICT = ("-pedantic", "-Wall", "-Wextra", "-Werror", "-Wno-unused", "-c")


@pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("standard", ["c99", "c++17"])
def test_the_text_is_c_and_c_plus_plus(standard: str, tmp_path: Path) -> None:
    words = [*native.compiler()] if standard == "c99" else [emulator.compiler()]
    if words == [None]:
        pytest.skip("no C++ compiler")
    source = tmp_path / ("world.c" if standard == "c99" else "world.cpp")
    source.write_text(query.text())
    command = [*words, f"-std={standard}", *STRICT, "-o", str(tmp_path / "world.o"), str(source)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[:2000]


@pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
def test_it_has_no_state_and_asks_for_no_memory(tmp_path: Path) -> None:
    """What it needs from outside are functions of numbers; what it keeps are constants."""
    if not shutil.which("nm"):
        pytest.skip("no nm")
    source = tmp_path / "world.c"
    source.write_text(query.text() + query.ALL)
    made = tmp_path / "world.o"
    subprocess.run([*native.compiler(), "-O1", "-w", "-c", "-o", made, source], check=True)
    listed = subprocess.run(["nm", made], capture_output=True, text=True, check=True).stdout
    symbols = [line.split()[-2:] for line in listed.splitlines()]
    asked = {name for kind, name in symbols if kind == "U"}
    numbers = {"sqrt", "cbrt", "fmin", "fmax", "fabs", "floor", "memset", "memcpy"}
    assert all(name in numbers or name.startswith("_") for name in asked), asked
    assert not {name for kind, name in symbols if kind in "dDbBC"}


def test_functions_call_only_those_before_them() -> None:
    """No recursion, and no prototype that would hide it."""
    text = query.text()
    defined: list[str] = []
    for match in re.finditer(FUNCTION, text, re.MULTILINE | re.DOTALL):
        called = set(re.findall(r"\b(octo_world\w*)\(", match[3]))
        assert called <= set(defined), match[1]
        defined.append(match[1])
    assert "octo_world" in defined and not re.search(r"^static [^{=]*;$", text, re.MULTILINE)


def test_it_is_the_same_for_every_world() -> None:
    before = query.text()
    World([shapes.Sphere(1.0)]).jets([[0.0, 0.0, 2.0]])
    assert query.text() == before


@pytest.mark.parametrize("order", range(4))
def test_a_gpus_threads_compute_the_same_numbers(order: int) -> None:
    if emulator.compiler() is None:
        pytest.skip("no C++ compiler")
    rng = np.random.default_rng(order)
    world, points = World([*mixed(rng), *maps()], blend=0.2), 0.7 * rng.normal(size=(70, 3))
    device = emulator.EmulatedDevice()
    jets = device.fresh((len(points), SIZES[order]), float)
    kernel = device.load(query.text() + KERNEL).kernel("octo_world_kernel")
    arrays = device.array(world.data), device.array(points), jets
    kernel((len(points),), 1, len(points), order, *arrays)
    assert worst(device.host(jets), world.jets(points, order)) < 1e-12


def test_nvrtc_takes_the_text() -> None:
    try:
        nvrtc.version()
    except MissingExtraError:
        pytest.skip("nvidia-cuda-nvrtc is not installed")
    made = nvrtc.compile_text(query.text() + KERNEL)
    stacks = re.findall(r"(\d+) bytes stack frame", made.log)  # of all that is not inlined
    assert 0 < sum(map(int, stacks)) < 4096
