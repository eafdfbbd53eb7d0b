"""``octo bench`` on tiny sizes: every record is there and finite, the figure is drawn, ratios are
of the baseline."""

from __future__ import annotations

import json
import math
import types
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from octo import native
from octo.bench import compilation, plan
from octo.bench.bounds import elimination_flops
from octo.bench.iteration import line
from octo.bench.run import MEASURES
from octo.bench.timing import Records, Timing, read
from octo.cli import bench
from octo.cli.main import main

needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
TINY = replace(
    plan.QUICK,
    rounds=1,
    burst=1,
    steps=20,
    robots=("chain",),
    staged=("chain",),
    nodes=(10, 20),
    hermite=(20, 30),
    links=(3, 5),
    motion_steps=10,
)
WANTED = (
    "machine.arithmetic",
    "machine.memory",
    "dynamics.chain.fd",
    "dynamics.chain.fd_jacobian",
    "dynamics.chain.curvature",
    "dynamics.chain.curvature/fd_jacobian",
    "iteration.nodes.20",
    "iteration.nodes.20.median",
    "iteration.nodes.20.linearize",
    "iteration.hermite.30.factor",
    "iteration.nodes.slope",
    "iteration.nodes.largest_error_of_fit",
    "iteration.nodes.20.factor.rate",
    "degrees.chain3",
    "degrees.chain5.solve",
    "degrees.power",
    "degrees.longest/shortest",
    "solvers.nodes.octo.time",
    "solvers.nodes.fatrop.E",
    "solvers.nodes.octo/ipopt.time",
    "solvers.nodes.octo/fatrop.E",
    "solvers.hermite.octo/ipopt.iterations",
    "compile.cached",
)


@pytest.mark.slow
@needs_compiler
def test_quick(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(plan, "QUICK", TINY)
    file, again = tmp_path / "out" / "bench.json", tmp_path / "out" / "again.json"
    assert main(["bench", "--quick", "--json", str(file)]) == 0
    content = json.loads(
        file.read_text(), parse_constant=lambda word: pytest.fail(f"{word} in the records")
    )
    records = {record["name"]: record for record in content["records"]}
    assert set(WANTED) <= set(records) and len(records) == len(content["records"])
    for record in records.values():
        assert set(record) == {"name", "value", "unit", "baseline_ratio"}
        assert math.isfinite(record["value"]) and isinstance(record["unit"], str)
    assert (
        content["processor"]
        and content["date"]
        and content["plan"]["motion_steps"] == TINY.motion_steps
    )
    for name in ("dynamics.chain.fd", "iteration.nodes.20", "degrees.chain5"):
        assert 0.0 < records[name]["value"] <= records[f"{name}.median"]["value"]
    for stage in ("linearize", "factor", "solve", "evaluate"):
        assert (
            0.0
            < records[f"iteration.nodes.20.{stage}"]["value"]
            < records["iteration.nodes.20.median"]["value"]
        )
    assert (tmp_path / "out" / "bench.png").stat().st_size > 10_000
    printed = capsys.readouterr()
    assert "dynamics.chain.fd_jacobian" in printed.out and "octo bench: " in printed.err

    assert (
        main(
            [
                "bench",
                "--quick",
                "--only",
                "dynamics",
                "--baseline",
                str(file),
                "--json",
                str(again),
            ]
        )
        == 0
    )
    for record in json.loads(again.read_text())["records"]:
        assert record["name"].startswith("dynamics.")
        assert record["baseline_ratio"] == pytest.approx(
            record["value"] / records[record["name"]]["value"]
        )


def test_no_ratio_of_other_sizes(tmp_path: Path) -> None:
    names = (
        "machine.memory",
        "iteration.nodes.20",
        "iteration.nodes.slope",
        "degrees.chain3",
        "degrees.power.factor",
        "solvers.nodes.octo.time",
        "dynamics.chain.fd",
        "compile.cached",
    )
    full = Records(plan=plan.FULL)
    for name in names:
        full.add(name, 2.0, "s")
    full.write(tmp_path / "full.json")
    assert set(read(tmp_path / "full.json", plan.FULL)) == set(names)
    quick = read(tmp_path / "full.json", plan.QUICK)
    assert set(quick) == {
        "machine.memory",
        "iteration.nodes.20",
        "degrees.chain3",
        "dynamics.chain.fd",
        "compile.cached",
    }
    fewer = read(tmp_path / "full.json", replace(plan.FULL, steps=20))
    assert set(names) - set(fewer) == {
        "degrees.chain3",
        "degrees.power.factor",
        "dynamics.chain.fd",
    }


@pytest.mark.parametrize("cold", [True, False])
def test_cached_is_measured_after_the_cache_is_filled(
    cold: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    seconds = iter((90.0, 1.0))

    def run(*words: object, **options: object) -> types.SimpleNamespace:
        return types.SimpleNamespace(stdout=json.dumps({"problem": next(seconds)}))

    monkeypatch.setattr(compilation.subprocess, "run", run)
    records = Records()
    compilation.measure(records, replace(plan.QUICK, cold=cold), lambda text: None)
    assert records["compile.cached"] == 1.0
    assert ("compile.cold" in records) == cold and (not cold or records["compile.cold"] == 90.0)


def test_every_group_has_its_measure() -> None:
    assert tuple(MEASURES) == plan.GROUPS
    assert bench.groups_of(["solvers", "machine,solvers"]) == ("machine", "solvers")


def test_the_line_is_the_line() -> None:
    records = Records()
    for steps in (10, 40, 160):
        records.add_timing(f"iteration.nodes.{steps}", Timing(7e-6 + 3e-6 * steps, 1.0), 1e3, "ms")
    line(records, "iteration.nodes", (10, 40, 160))
    assert records["iteration.nodes.slope"] == pytest.approx(3.0) and records[
        "iteration.nodes.constant"
    ] == pytest.approx(7.0)
    assert records["iteration.nodes.largest_error_of_fit"] < 1e-9


def test_flops_are_those_of_a_dense_elimination() -> None:
    """Counted while it is done: the pivots of one unit out of its window, the symmetric half
    only."""
    nc, ma, count = 3, 2, 0
    window = 3 * nc + ma
    matrix = np.eye(window) * window + np.ones((window, window))
    for pivot in range(nc + ma):
        for row in range(pivot + 1, window):
            for column in range(pivot + 1, row + 1):
                matrix[row, column] -= (
                    matrix[row, pivot] * matrix[column, pivot] / matrix[pivot, pivot]
                )
                count += 2
    assert elimination_flops(nc, ma) == count


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--only", "dynamic"], "group 'dynamic' is not known; did you mean dynamics"),
        (["--only", ","], "only is ',', must name some of machine, dynamics"),
        (["--only", ""], "only is '', must name some of machine, dynamics"),
        (["--only"], "--only: expected at least one argument"),
        (["--json", "/proc/none/bench.json"], "cannot be written"),
        (["--baseline", "nowhere.json"], "baseline is 'nowhere.json', which does not exist"),
        (["--baseline", "torn.json"], "baseline is 'torn.json', which octo bench did not write"),
        (["--baseline", "other.json"], "baseline is 'other.json', which octo bench did not write"),
        (["--quik"], "option '--quik' is not known"),
    ],
)
def test_refused(
    words: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("torn.json").write_text('{"records": [')
    Path("other.json").write_text("[1, 2]")
    assert main(["bench", *words]) == 2
    printed = capsys.readouterr()
    assert said in printed.err and printed.err.count("\n") == 1 and printed.out == ""


def test_without_a_compiler(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(native, "compiler", lambda: None)
    assert main(["bench", "--quick"]) == 2
    assert "octo bench needs a C compiler" in capsys.readouterr().err
