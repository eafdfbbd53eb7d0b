"""``octo cycle``: what it writes, prints and returns; refusals in one line before anything is
compiled."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import octo
from octo import native
from octo.cli.cycle import described, period
from octo.cli.main import main, parse
from octo.problem.problem import Problem
from octo.result.gait import measure_gait
from octo.result.solution import Solution
from octo.solver.status import Status

FILES = ["motion.html", "plot.png", "report.json", "solution.npz"]
SHORT = ("--passes", "1", "--seeds", "1", "--device", "cpu")


@pytest.fixture(scope="module")
def stride(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a mirrored cycle."""
    out = tmp_path_factory.mktemp("stride")
    assert (
        main(
            [
                "cycle",
                "mammal",
                "--passes",
                "1",
                "--seeds",
                "2",
                "--device",
                "cpu",
                "--out",
                str(out),
            ]
        )
        == 0
    )
    return out


def test_the_four_files(stride: Path) -> None:
    assert sorted(path.name for path in stride.iterdir()) == FILES
    solution = Solution.load(stride / "solution.npz")
    report = json.loads((stride / "report.json").read_text())
    assert solution.cycle is not None and solution.cycle.mirrored and solution.steps == 16
    assert report["period"] == solution.cycle.period == 0.8
    assert report["speed"] == 0.5 and report["mirrored"] is True and report["converged"] is True
    assert [record["seed"] for record in report["starts"]] == [0, 1]
    assert report["energy"] == min(record["energy"] for record in report["starts"])


def test_the_gait_is_that_of_whole_strides(stride: Path) -> None:
    solution = Solution.load(stride / "solution.npz")
    report = json.loads((stride / "report.json").read_text())
    half, whole = measure_gait(solution), solution.gait
    assert half is not None and whole is not None
    assert half.rhythm < 0.9  # half a stride does not repeat itself: left and right change
    assert report["gait"] == pytest.approx(whole.report())
    assert report["gait"]["rhythm"] == pytest.approx(1.0) and report["gait"]["median_swing"] > 0.05
    assert solution.tile(6).gait.report() == pytest.approx(whole.report())
    assert solution.tile(2).gait.touchdowns == pytest.approx(whole.touchdowns)


def test_the_page_shows_whole_strides(stride: Path) -> None:
    assert "one cycle of 0.8 s, repeated" in (stride / "motion.html").read_text()


def test_what_is_printed(stride: Path) -> None:
    solution = Solution.load(stride / "solution.npz")
    said = (
        "mammal, a cycle of 0.8 s at 0.5 m/s, half of it solved for and mirrored, 16 steps "
        "of 0.025 s"
    )
    assert str(solution).startswith(said)
    assert "in half a stride the centre of mass travels (0.20, " in str(solution)
    assert str(solution.tile(3)).startswith(
        "mammal, 3 strides of 0.8 s at 0.5 m/s, 96 steps of 0.025 s"
    )


@pytest.mark.slow
def test_a_range_of_periods(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = main(
        ["cycle", "mammal", "--period", "0.5,0.8", "--steps", "10", "--out", str(tmp_path), *SHORT]
    )
    assert code == 0, capsys.readouterr().err
    report = json.loads((tmp_path / "report.json").read_text())
    periods = [record["period"] for record in report["starts"]]
    assert periods == pytest.approx(np.geomspace(0.5, 0.8, 5))
    assert all(record["dt"] == pytest.approx(record["period"] / 20) for record in report["starts"])
    chosen = [record for record in report["starts"] if record["period"] == report["period"]]
    assert chosen[0]["power"] == min(
        record["power"] for record in report["starts"] if record["converged"]
    )
    assert report["com_travel"][0] == pytest.approx(0.5 * report["period"] / 2, abs=1e-6)


def test_auto_is_a_range_around_the_usual_stride(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = parse(["cycle", "mammal", "--period", "auto", "--speed", "0.5"])
    cycle = described(octo.gallery.mammal(), arguments).cycle
    assert cycle is not None and isinstance(cycle.period, tuple)
    low, high = cycle.period
    assert low < 0.5 and 0.8 < high < 1.0 and high / low == pytest.approx(1.4**2)
    assert capsys.readouterr().err == "octo: legs of 0.25 m at 0.5 m/s: periods of 0.42 to 0.81 s\n"


def test_auto_without_a_speed_is_finite() -> None:
    arguments = parse(["cycle", "mammal", "--period", "auto", "--speed", "0", "--turn", "0.3"])
    cycle = described(octo.gallery.mammal(), arguments).cycle
    assert cycle is not None and isinstance(cycle.period, tuple) and cycle.period[1] < 2.0


def test_turning_and_sideways_are_whole_strides() -> None:
    for more in (("--turn", "0.3"), ("--sideways", "0.2")):
        problem = described(octo.gallery.mammal(), parse(["cycle", "mammal", *more]))
        assert problem.cycle is not None and not problem.cycle.mirrored and problem.steps == 32


def test_a_robot_without_a_mirror(
    lopsided: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = [
        "cycle",
        str(lopsided),
        "--steps",
        "20",
        "--max-iterations",
        "2",
        "--out",
        str(tmp_path / "out"),
        *SHORT,
    ]
    assert main([*command, "--mirror"]) == 2
    refused = capsys.readouterr().err
    assert (
        "no left-right mirror" in refused
        and len(refused.splitlines()) == 1
        and not (tmp_path / "out").exists()
    )
    assert main(command) == 1  # two iterations are not enough
    said = [line for line in capsys.readouterr().err.splitlines() if "mirror" in line]
    assert len(said) == 1 and "a whole stride is solved for, as with --no-mirror" in said[0]
    assert Solution.load(tmp_path / "out" / "solution.npz").cycle.mirrored is False
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == FILES
    assert main([*command, "--no-mirror"]) == 1
    assert "mirror" not in capsys.readouterr().err


@pytest.fixture
def lopsided(tmp_path: Path) -> Path:
    """A trunk on four legs, one of them longer."""
    legs = "".join(
        f'<body name="leg{k}" pos="{x} {y} 0"><joint name="hip{k}" axis="0 1 0" range="-1 1"/>'
        f'<geom type="capsule" fromto="0 0 0 0 0 -{length}" size=".02" mass=".3"/></body>'
        for k, (x, y, length) in enumerate(
            [(0.2, 0.1, 0.3), (0.2, -0.1, 0.33), (-0.2, 0.1, 0.3), (-0.2, -0.1, 0.3)]
        )
    )
    motors = "".join(f'<motor joint="hip{k}"/>' for k in range(4))
    path = tmp_path / "lopsided.xml"
    path.write_text(
        '<mujoco><compiler angle="radian"/><worldbody><body name="trunk" pos="0 0 .35"><freejoint/>'
        '<geom type="box" size=".2 .1 .05" '
        f'mass="3"/>{legs}</body></worldbody><actuator>{motors}</actuator></mujoco>'
    )
    return path


@pytest.mark.parametrize(
    ("status", "code"),
    [(Status.CONVERGED, 0), (Status.ACCEPTABLE, 0), (Status.STALLED, 1), (Status.INTERRUPTED, 130)],
)
def test_exit_codes(
    status: Status, code: int, stride: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def solve(problem: Problem, **options: Any) -> Solution:
        assert options["seeds"] == 5 and options["progress"] is True
        return replace(Solution.load(stride / "solution.npz"), status=status)

    monkeypatch.setattr(sys.modules["octo.solve"], "solve", solve)
    assert main(["cycle", "mammal", "--out", str(tmp_path)]) == code
    assert Solution.load(tmp_path / "solution.npz").status is status


REFUSED = {
    "mirrored turn": ("--mirror --turn 0.3", "cycle.turn is 0.3 rad", "mirror=False"),
    "mirrored, sideways": ("--mirror --sideways 0.2", "cycle.sideways is 0.2 m/s", "mirror=False"),
    "turning on a slope": ("--terrain slope:5 --turn 0.3", "turning", "level ground"),
    "uneven ground": ("--terrain hills.py:hills", "the same everywhere"),
    "no period": ("--period 0", "cycle.period is 0.0", "positive"),
    "negative period": ("--period=-0.8", "cycle.period is -0.8", "positive"),
    "period NaN": ("--period nan", "cycle.period is nan", "finite"),
    "a range backwards": ("--period 0.8,0.5", "cycle.period is (0.8, 0.5)", "shortest"),
    "an endless range": ("--period 0.8,inf", "cycle.period", "finite"),
    "three periods": ("--period 0.5,0.8,1", "--period", "'0.5,0.8,1'", "LOW,HIGH or auto"),
    "period in words": ("--period long", "--period", "'long'", "LOW,HIGH or auto"),
    "half a range": ("--period 0.5,", "--period", "'0.5,'"),
    "three steps": ("--steps 3", "steps is 3", "at least 4"),
    "no steps": ("--steps 0", "--steps", "at least 1"),
    "speed NaN": ("--speed nan", "--speed", "finite"),
    "no start": ("--seeds 0", "--seeds", "at least 1"),
    "unknown device": ("--device gpu", "device 'gpu'", "cpu"),
    "a step, which follows": ("--dt 0.02", "option '--dt'"),
    "unknown friction": ("--friction ice", "friction is 'ice'"),
    "a missing solution": ("--start nowhere.npz", "nowhere.npz", "does not exist"),
    "a file for a folder": ("--out hills.py", "hills.py", "cannot be written"),
}


@pytest.mark.parametrize("case", REFUSED.values(), ids=list(REFUSED))
def test_refused(
    case: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def load(*_: Any) -> None:
        raise AssertionError("compiled before it was refused")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(native, "load", load)
    Path("hills.py").write_text(
        "import casadi as ca\n\ndef hills(point, p):\n    return point[2] - 0.01 * "
        "ca.sin(point[0])\n"
    )
    options, *words = case
    assert main(["cycle", "mammal", *options.split()]) == 2
    error = capsys.readouterr().err
    assert error.startswith("octo: error: ") and len(error.splitlines()) == 1
    assert all(word in error for word in words), error
    assert [path.name for path in Path().iterdir()] == ["hills.py"]


def test_a_fixed_base_is_refused(
    tmp_path: Path, lopsided: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fixed = tmp_path / "fixed.xml"
    fixed.write_text(lopsided.read_text().replace("<freejoint/>", ""))
    assert main(["cycle", str(fixed), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert "cycle needs a floating base" in error and len(error.splitlines()) == 1


def test_words_of_a_period() -> None:
    assert period("auto") is None and period("0.8") == 0.8 and period("0.5,1.2") == (0.5, 1.2)
