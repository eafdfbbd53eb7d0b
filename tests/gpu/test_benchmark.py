"""benchmarks/gpu.py works on a machine without a GPU, where it measures nothing."""

from __future__ import annotations

import importlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import strict

import octo
from benchmarks import quote
from octo.errors import MissingExtraError
from octo.gpu import cuda, nvrtc
from octo.gpu.program import bytes_of
from octo.solver.backend import CPU
from tests.emulator import EmulatedDevice
from tests.gpu.ptxas import kernels_of

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "gpu.py"


def run(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(SCRIPT), *words], capture_output=True, text=True, check=False
    )


@pytest.fixture
def module(monkeypatch):
    """A file of benchmarks, as the script imports it."""
    monkeypatch.syspath_prepend(SCRIPT.parent)
    return importlib.import_module


class Pool:
    """In the place of CuPy's memory."""

    freed = 0

    def free_all_blocks(self) -> None:
        self.freed += 1

    def total_bytes(self) -> int:
        assert self.freed
        return 12345


@pytest.fixture
def script(module, tmp_path, monkeypatch):
    """Runs some sections on the emulated device, with arrays as strict as CuPy's: exit code and
    what the JSON has afterwards."""
    path, gpu, pool = tmp_path / "gpu.json", module("gpu"), Pool()
    monkeypatch.setattr(strict, "get_default_memory_pool", lambda: pool, raising=False)
    monkeypatch.setattr(gpu, "emulated", lambda: EmulatedDevice(xp=strict))

    def call(*words: str) -> tuple[int, dict]:
        code = gpu.main(["--emulate", "--short", "--out", str(path), *words])
        return code, json.loads(path.read_text())

    call.path = path
    return call


@pytest.fixture
def plant(module, monkeypatch):
    """Puts another section in the place of one."""
    sections = module("gpu_sections").SECTIONS

    def put(name: str, generator) -> None:
        monkeypatch.setitem(sections, name, replace(sections[name], run=generator))

    return put


@pytest.mark.slow
def test_every_part_of_it(script):
    names = [
        "iteration",
        "stages",
        "launching",
        "chain",
        "batch",
        "plans",
        "batches",
        "ipopt",
        "dof",
        "steps",
    ]
    code, found = script("--only", ",".join(names))
    assert code == 0 and script.path.with_suffix(".png").exists()
    assert list(found["seconds"]) == names and not any("why_not" in found[name] for name in names)
    for basis in ("hermite", "nodes"):
        row, rows = found["iteration"][basis], found["launching"][basis]
        assert (
            found["iteration_ms"][basis]
            == row["ms"]
            < row["mean_ms"]
            == found["mean_iteration_ms"][basis]["ms"]
        )
        assert (
            row["factorisations"] > 1.0 and row["ratio"]["1"] == row["cpu"]["1"]["ms"] / row["ms"]
        )
        graphs, alone = rows["graphs"], rows["kernel_by_kernel"]
        assert graphs["captured"] and graphs["kernels_in_graphs"] > 0.0 and graphs["captures"] > 0
        assert not alone["captured"] and alone["kernels_in_graphs"] == alone["graphs"] == 0.0
        assert graphs["kernels"] + graphs["kernels_in_graphs"] == pytest.approx(alone["kernels"])
        stages = found["stages"][basis]
        assert stages["kernels"]["other"] == 0 and stages["sum_ms"] > 0.0
        assert all(
            stages["ms"][name] > 0.0
            for name in ("derivatives", "products", "factorisation", "solution", "trial")
        )
    assert all(row["peak_bytes"] == 12345 and row["plans"] == 2 for row in found["plans"].values())
    # nothing that is emulated is judged
    assert [one["met"] for one in found["must_show"]] == [None] * 10


@pytest.mark.slow
def test_the_kkt_matrix_by_other_ways(module):
    """The last section, which needs an array module with linalg."""
    bench = module("gpu_bench").Bench(EmulatedDevice(), True)
    for _, kkt in module("gpu_sections").SECTIONS["kkt"].run(bench):
        for times in kkt["milliseconds"].values():
            assert set(times) >= {
                "octo",
                "octo_float32",
                "inverses",
                "inverses_float32",
                "eigenvalues",
            }
            assert all(way["factor_ms"] > 0.0 and way["solve_ms"] > 0.0 for way in times.values())
        for row in kkt["accuracy"]:
            assert (
                not row["octo"]["wrong_inertia"]
                and row["octo"]["refinements"] <= 1
                and row["eigenvalues"]["refinements"] <= 1
            )
            assert row["octo"]["residuals"][0] < 1e-9 < row["octo_float32"]["residuals"][0]
            assert (
                max(row[way]["backward_error"] for way in ("octo", "inverses", "eigenvalues"))
                < 1e-11
            )


def test_the_sizes_are_the_papers(module):
    bench = module("gpu_bench")
    problem = bench.walk(octo.gallery.mammal(), 400, "hermite")
    # the last unit is a dummy
    assert problem.basis_object.units(400) == 40 + 1 and problem.steps * problem.dt == 10.0
    assert (
        bench.walk(octo.gallery.chain(), 800, "hermite", dt=0.05).basis_object.units(800) == 80 + 1
    )


def test_one_iteration_has_one_factorisation_and_is_the_same_everywhere(module):
    """The trial of the iteration that is measured: on the CPU and on the device to rounding."""
    bench = module("gpu_bench")
    own = bench.Bench(EmulatedDevice(), True)
    problem = bench.walk(own.mammal, 20, "nodes")
    iterate, _ = own.iterate(problem, 2)
    trials = []
    for backend in (CPU, own.backend):
        one = bench.OneIteration(backend, own.compiled(problem, 2), iterate)
        factored, made = [], one._factors
        one._factors = lambda made=made, factored=factored: (
            Counting((parts := made())[0], factored),
            parts[1],
        )
        one()
        assert factored == [2]
        trials.append(one.trial.numbers)
    np.testing.assert_allclose(trials[1], trials[0], rtol=1e-7)


class Counting:
    """Factors that write down how many members each factorisation is for."""

    def __init__(self, factors, log):
        self.factors = factors
        self.log = log
        self.clear = factors.clear
        self.attempt = factors.attempt

    def add(self, members, weight):
        self.log.append(members.sum())
        return self.factors.add(members, weight)


def test_a_section_that_fails_keeps_its_rows_and_the_rest_goes_on(script, plant, capsys):
    def failing(bench):
        yield "20 steps", {"ms": 1.0, "mean_ms": 2.0, "steps": 20}
        raise RuntimeError("planted\nmore words")

    plant("steps", failing)
    code, found = script("--only", "steps,dof")
    assert (
        code == 0
        and found["steps"]["why_not"] == "RuntimeError: planted"
        and found["steps"]["20 steps"]["ms"] == 1.0
    )
    assert (
        "why_not" not in found["dof"]
        and "not measured: RuntimeError: planted" in capsys.readouterr().err
    )
    by_name = {one["what"]: one["figure"] for one in found["must_show"]}
    assert by_name["chain of 40 s, solved"] == "not measured"


def test_a_row_that_fails_leaves_the_others(script, module, monkeypatch):
    bench = module("gpu_bench").Bench
    own = bench.iteration

    def failing(self, problem, *arguments, **named):
        if problem.steps == 10:
            raise MemoryError("planted")
        return own(self, problem, *arguments, **named)

    monkeypatch.setattr(bench, "iteration", failing)
    code, found = script("--only", "steps")
    assert (
        code == 0
        and found["steps"]["10 steps"] == {"why_not": "MemoryError: planted"}
        and found["steps"]["20 steps"]["ms"] > 0.0
    )


def test_as_many_plans_as_the_memory_holds(module):
    device = EmulatedDevice()
    bench = module("gpu_bench").Bench(device, True)
    device.memory = int(1.5 * bytes_of(bench.compiled(bench.walks["hermite"], 1)))
    rows = dict(module("gpu_sections").SECTIONS["plans"].run(bench))
    assert rows["hermite"]["plans"] == 1 and rows["hermite"]["wanted"] == 2


def test_another_process_goes_on_where_the_gpu_is_lost(script, plant, module, monkeypatch):
    """After an error that CUDA keeps, nothing works in the same process."""

    def losing(bench):
        def refuse(*_):
            raise RuntimeError("an illegal memory access was encountered")

        bench.device.array = refuse
        yield from module("gpu_sections").each(bench, {"first": 0, "second": 1}, refuse)

    started = []
    plant("dof", losing)
    monkeypatch.setattr(os, "execv", lambda path, words: started.append(words))
    _, found = script("--only", "dof,steps,kkt", "--budget", "500")
    words = started[0]
    assert words[1].endswith("gpu.py") and words[words.index("--only") + 1] == "steps,kkt"
    assert {"--emulate", "--short"} < set(words) and 400.0 < float(
        words[words.index("--budget") + 1]
    ) < 500.0
    assert (
        found["dof"]["first"]["why_not"] == "RuntimeError: an illegal memory access was encountered"
    )
    assert (
        "second" not in found["dof"] and "lost" in found["dof"]["why_not"] and "steps" not in found
    )


@pytest.mark.timed
def test_a_section_that_takes_too_long_is_stopped(script, plant, module, monkeypatch):
    def endless(bench):
        yield "first", {}
        time.sleep(60.0)

    plant("steps", endless)
    sections = module("gpu_sections").SECTIONS
    monkeypatch.setitem(sections, "steps", replace(sections["steps"], about=0.1))
    code, found = script("--only", "steps", "--budget", "0.5")
    assert (
        code == 0
        and found["steps"]["why_not"].startswith("stopped after")
        and found["steps"]["first"] == {}
    )


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_end_keeps_what_was_measured(script, plant, number):
    def ended(bench):
        yield "first", {"ms": 1.0, "mean_ms": 2.0}
        os.kill(os.getpid(), number)
        time.sleep(60.0)

    plant("dof", ended)
    code, found = script("--only", "dof,steps")
    assert code == 130 and found["dof"] == {
        "why_not": "interrupted",
        "first": {"ms": 1.0, "mean_ms": 2.0},
    }
    assert "steps" not in found


def test_the_json_is_there_before_a_section_ends(script, plant, tmp_path):
    seen = []

    def looking(bench):
        yield "first", {}
        seen.append(json.loads((tmp_path / "gpu.json").read_text())["steps"])

    plant("steps", looking)
    script("--only", "steps")
    assert seen == [{"why_not": "the program ended while this was measured", "first": {}}]


def test_sections_are_added_to_the_same_hardware_only(script, plant, tmp_path, capsys):
    plant("dof", lambda bench: iter([("first", {})]))
    plant("steps", lambda bench: iter([("second", {})]))
    script("--only", "dof")
    _, found = script("--only", "steps")
    assert found["dof"] == {"first": {}} and found["steps"] == {"second": {}}
    found["hardware"]["device"] = "another one"
    (tmp_path / "gpu.json").write_text(json.dumps(found))
    capsys.readouterr()
    assert script("--only", "dof")[0] == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and "another one" in said
    (tmp_path / "gpu.json").write_text("{}")
    assert script("--only", "dof")[0] == 2 and "did not write" in capsys.readouterr().err


def test_what_does_not_fit_into_the_budget_is_skipped(script, capsys):
    code, found = script("--budget", "1")
    said = capsys.readouterr().out
    assert code == 0 and said.count("skipped: ") == 11 and "not begun" in found["kkt"]["why_not"]
    assert all(
        "not begun" in one["figure"] or one["figure"] == "not measured"
        for one in found["must_show"]
    )


def test_the_limits_are_judged(module, tmp_path):
    """A made-up run of a real GPU: what is in its limit, and what is not."""
    figure = module("gpu_figure")
    row = {
        "steps": 400,
        "Z": 40,
        "ms": 0.8,
        "mean_ms": 1.5,
        "factorisations": 2.8,
        "bound_ms": {"waiting": 0.22},
        "bound_of": "H100",
        "batch": 64,
        "ratio": {"16": 12.0},
        "mean_ratio": {"16": 9.0},
    }
    solve = {"plans": 1, "converged": 1, "seconds": 4.0}
    found = {
        "short": False,
        "hardware": {"device": "a GPU", "cpu": "a CPU"},
        "date": "today",
        "iteration": {"hermite": row, "nodes": {**row, "ms": 1.2}},
        "chain": {
            "iteration": row,
            "solve from start 10": solve,
            "solve from start 11": {**solve, "seconds": 7.0},
        },
        "batch": {"hermite 64": row, "nodes 64": {**row, "mean_ratio": {"16": 11.0}}},
        "batches": {"hermite 256": {"ratio_to_64": 31.0}},
        "plans": {"why_not": "planted"},
    }
    figure.conclude(found)
    met = {one["what"]: one["met"] for one in found["must_show"]}
    assert list(met.values()) == [True, False, None, True, False, False, True, True, None, None]
    assert found["must_show"][-1]["figure"] == "planted" and any(
        "NOT MET" in line for line in figure.table(found)
    )
    path = tmp_path / "gpu.json"
    path.write_text(json.dumps(found))
    words = (
        "one iteration of a mammal's walk of 400 steps takes 0.80 ms in hermite and 1.20 ms "
        "in nodes; 4 of 10 aims met"
    )
    assert quote.gpu_words(path).startswith(f"on one a GPU, today: {words}")


def test_the_readme_says_what_was_measured():
    (words,) = quote.GPU.findall((quote.ROOT / "README.md").read_text())
    assert words == quote.gpu_words()


def test_what_is_no_measurement_is_not_written():
    done = run("--emulate", "--short")
    assert done.returncode == 2 and "no measurement" in done.stderr


@pytest.mark.skipif(cuda.reason() is None, reason="there is a GPU")
def test_without_a_gpu_it_says_why():
    done = run()
    assert done.returncode == 2 and "--emulate" in done.stderr


def test_float32_text_has_no_double(module):
    text = module("gpu_kkt").reduction_text(48, "float32", 232448)
    assert not re.search(r"\bdouble\b", text) and re.search(r"\b1\.0f", text)
    try:
        kernels = kernels_of(nvrtc.compile_text(text))
    except MissingExtraError:
        pytest.skip("nvidia-cuda-nvrtc is not installed")
    assert all(kernel.spill_stores == kernel.spill_loads == 0 for kernel in kernels.values())
