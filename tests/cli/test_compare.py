"""``octo compare`` on a tiny problem: the table, the list, the plot, and what is refused."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

import octo
from octo import native
from octo.bench.contest import Contest, joined
from octo.cli.compare import row
from octo.cli.main import main
from octo.reference.run import OPTIONS
from octo.result.solution import Solution

TINY = ["compare", "biped", "--goal", "stand", "--seconds", "0.5", "--dt", "0.05"]
FIELDS = (
    "status",
    "converged",
    "iterations",
    "energy",
    "terms",
    "violation",
    "pointwise_residual",
    "goal_error",
    "penetration",
    "slip",
    "seconds",
    "processor_seconds",
    "setup_seconds",
    "seconds_per_iteration",
    "solver",
    "basis",
    "seed",
    "pass",
    "tolerances",
    "iteration_limit",
)
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")


@pytest.mark.slow
@needs_compiler
def test_nodes_two_passes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("matplotlib")
    file = tmp_path / "out" / "compare.json"
    assert main([*TINY, "--passes", "2", "--with", "ipopt,fatrop", "--json", str(file)]) == 0
    records = json.loads(
        file.read_text(), parse_constant=lambda word: pytest.fail(f"{word} in the list")
    )
    assert [(r["solver"], r["pass"]) for r in records] == [
        (name, k) for k in (1, 2) for name in ("octo", "ipopt", "fatrop")
    ]
    for record in records:
        assert set(FIELDS) <= set(record)
        assert (
            record["basis"] == "nodes" and record["seed"] == 0 and record["iteration_limit"] == 1500
        )
        assert record["converged"] and record["seconds"] > 0.0 and record["processor_seconds"] > 0.0
        assert record["setup_seconds"] > 0.0
    for number in (1, 2):
        energies = [record["energy"] for record in records if record["pass"] == number]
        assert np.ptp(energies) <= 1e-6
    assert (tmp_path / "out" / "compare.png").stat().st_size > 10_000
    printed = capsys.readouterr().out
    assert (
        "octo/ipopt, medians over 1: iterations" in printed
        and "pass 2: converged of 1 starts: octo 1" in printed
    )


@needs_compiler
def test_hermite_and_seeds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # as where there is a GPU
    monkeypatch.setattr(sys.modules["octo.devices"].cuda, "reason", lambda: None)
    file = tmp_path / "list.json"
    assert (
        main(
            [
                *TINY,
                "--basis",
                "hermite",
                "--seeds",
                "2",
                "--seed",
                "3",
                "--max-iterations",
                "3",
                "--json",
                str(file),
            ]
        )
        == 0
    )
    records = json.loads(file.read_text())
    assert [(r["solver"], r["seed"], r["status"]) for r in records] == [
        (name, seed, "iteration_limit") for seed in (3, 4) for name in ("octo", "ipopt")
    ]
    assert all(r["device"] == "cpu" for r in records if r["solver"] == "octo")
    assert "octo 0, ipopt 0" in capsys.readouterr().out


@needs_compiler
def test_cycle(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "list.json"
    words = [
        "compare",
        "biped",
        "--cycle",
        "--period",
        "0.5",
        "--speed",
        "0.4",
        "--no-mirror",
        "--turn",
        "0.3",
        "--dt",
        "0.05",
    ]
    assert main([*words, "--max-iterations", "3", "--json", str(file)]) == 0
    records = json.loads(file.read_text())
    assert [(r["solver"], r["status"]) for r in records] == [
        (name, "iteration_limit") for name in ("octo", "ipopt")
    ]
    assert "biped, 10 steps of 0.05 s, nodes, cycle" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--cycle", "--with", "fatrop"], "fatrop cannot solve a cycle"),
        (["--cycle", "--turn", "0.3"], "a turning stride cannot be mirrored"),
        (["--turn", "0.3"], "--turn is given without --cycle"),
        (
            ["--with", "ipopt,fatrop", "--basis", "hermite"],
            "fatrop cannot solve in the hermite basis",
        ),
        (["--with", "snopt"], "solver 'snopt' is not known"),
        (["--out", "there"], "option '--out' is not known"),
        (["--json", "/proc/none/list.json"], "cannot be written"),
    ],
)
def test_refused(words: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*TINY, *words]) == 2
    assert said in capsys.readouterr().err


def test_joined_solutions_add_up(tmp_path: Path) -> None:
    """What led to a solve is part of it."""
    import octo

    problem = octo.Problem(octo.gallery.biped(), steps=4, dt=0.05, costs=[octo.Effort()])
    parts = [octo.solve(problem, passes=1, max_iterations=k, device="cpu") for k in (2, 3)]
    whole: Solution = joined(parts)
    assert whole.iterations == sum(part.iterations for part in parts)
    assert whole.seconds == pytest.approx(parts[0].seconds + parts[1].seconds)
    assert whole.processor_seconds == pytest.approx(
        parts[0].processor_seconds + parts[1].processor_seconds
    )
    assert (np.diff(whole.history["seconds"]) > 0).all() and (
        np.diff(whole.history["iteration"]) == 1
    ).all()


@needs_compiler
def test_solvers_of_a_problem_with_constraints() -> None:
    """A mass that is to be at 1 with a motor of 1 N: the last column says that all keep to it."""

    def law(x_next, x, x_prev, p):
        return p["mass"] * (x_next - 2.0 * x + x_prev) / p["dt"] ** 2

    mass = octo.CustomDynamics(law, nx=1, actuated=[0], parameters={"mass": 1.0})
    costs = [
        octo.CustomCost(lambda step, p: step.x_next - 1.0),
        octo.Effort(weight=1e-3, reference=1.0),
    ]
    problem = octo.Problem(
        mass,
        steps=20,
        dt=0.1,
        x0=np.zeros(1),
        costs=costs,
        constraints=[octo.TorqueLimits(limit=1.0)],
    )
    entries = list(Contest(problem, ("ipopt", "fatrop"), OPTIONS).run([0]))
    energies = [entry.solution.energy for entry in entries]
    assert energies == pytest.approx([energies[0]] * 3, rel=1e-3)
    assert max(abs(entries[1].solution.u.ravel())) > 0.99
    for entry in entries:
        assert entry.solution.converged and entry.solution.bounds[0].held
        assert row(entry).split()[-1] == f"{entry.solution.bounds[0].violation:.1e}"
