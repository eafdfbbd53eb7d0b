"""benchmarks/gpu.py works on a machine without a GPU, where it measures nothing."""

from __future__ import annotations

import importlib
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from octo.errors import MissingExtraError
from octo.gpu import cuda, nvrtc

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "gpu.py"


def run(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, str(SCRIPT), *words], capture_output=True, text=True, check=False)


def test_every_part_of_it(tmp_path):
    done = run("--emulate", "--short", "--out", str(tmp_path / "gpu.json"))
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "gpu.json").read_text())
    assert {"hardware", "date", "iteration_ms", "stages", "batch", "steps", "dof", "plans", "ipopt", "kkt"} <= set(found)
    assert set(found["iteration_ms"]) == {"hermite", "nodes"}
    for rows in found["launching"].values():
        graphs, alone = rows["graphs"], rows["kernel_by_kernel"]
        assert graphs["captured"] and graphs["kernels_in_graphs"] > 0.0 and graphs["captures"] > 0
        assert not alone["captured"] and alone["kernels_in_graphs"] == alone["graphs"] == 0.0
        assert graphs["kernels"] + graphs["kernels_in_graphs"] == pytest.approx(alone["kernels"])
    for kkt in found["kkt"].values():
        for times in kkt["milliseconds"].values():
            assert set(times) >= {"octo", "octo_float32", "inverses", "inverses_float32", "eigenvalues"}
            assert all(way["factor_ms"] > 0.0 and way["solve_ms"] > 0.0 for way in times.values())
        for row in kkt["accuracy"]:
            assert not row["octo"]["wrong_inertia"] and row["octo"]["refinements"] <= 1 and row["eigenvalues"]["refinements"] <= 1
            assert row["octo"]["residuals"][0] < 1e-9 < row["octo_float32"]["residuals"][0]
            assert max(row[way]["backward_error"] for way in ("octo", "inverses", "eigenvalues")) < 1e-11
    assert all(value > 0.0 for stages in found["stages"].values() for value in stages.values())


def test_what_is_no_measurement_is_not_written():
    done = run("--emulate", "--short")
    assert done.returncode == 2 and "no measurement" in done.stderr


@pytest.mark.skipif(cuda.reason() is None, reason="there is a GPU")
def test_without_a_gpu_it_says_why():
    done = run()
    assert done.returncode == 2 and "--emulate" in done.stderr


def test_float32_text_has_no_double(monkeypatch):
    monkeypatch.syspath_prepend(SCRIPT.parent)
    gpu_kkt = importlib.import_module("gpu_kkt")
    text = gpu_kkt.reduction_text(48, "float32")
    assert not re.search(r"\bdouble\b", text) and re.search(r"\b1\.0f", text)
    try:
        kernels = nvrtc.compile_text(text).kernels
    except MissingExtraError:
        pytest.skip("nvidia-cuda-nvrtc is not installed")
    assert all(kernel.spill_stores == kernel.spill_loads == 0 for kernel in kernels.values())
