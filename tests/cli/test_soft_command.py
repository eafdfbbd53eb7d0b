"""Soft bodies in a shell: solve, compare, simulate, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from octo.cli.main import main
from octo.result.solution import Solution

BALL = "ball:divisions=2,modes=4"
SHORT = ["--seconds", "1.5", "--distance", "0.2", "--device", "cpu"]


@pytest.fixture(scope="module")
def rolled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("soft") / "roll"
    assert main(["solve", BALL, "--goal", "roll", *SHORT, "--out", str(folder)]) == 0
    return folder


def test_a_motion_is_written_with_its_pictures(rolled: Path) -> None:
    assert {file.name for file in rolled.iterdir()} == {
        "solution.npz",
        "report.json",
        "plot.png",
        "motion.html",
    }
    report = json.loads((rolled / "report.json").read_text())
    assert report["goal"] == "roll" and report["goal_met"] and report["robot"] == "ball"
    motion = Solution.load(rolled)
    assert motion.soft is not None and motion.com[-1, 0] == pytest.approx(0.2, abs=0.02)
    assert "bent" in (rolled / "motion.html").read_text()


def test_what_was_written_is_told_and_drawn_again(
    rolled: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["info", str(rolled)]) == 0
    assert "it bends by" in capsys.readouterr().out
    for name in ("again.html", "again.png", "again.csv"):
        assert main(["view", str(rolled), "--out", str(tmp_path / name)]) == 0
        assert (tmp_path / name).stat().st_size > 1000
    more = ["--start", str(rolled), "--out", str(tmp_path / "more")]
    assert main(["solve", BALL, "--goal", "roll", *SHORT, *more]) == 0
    assert Solution.load(tmp_path / "more").iterations < Solution.load(rolled).iterations


def test_another_solver_solves_the_same(tmp_path: Path) -> None:
    file = tmp_path / "compared.json"
    assert main(["compare", BALL, "--goal", "roll", *SHORT, "--json", str(file)]) == 0
    own, other = json.loads(file.read_text())
    assert (own["solver"], other["solver"]) == ("octo", "ipopt")
    assert own["status"] == "converged" and other["status"] == "converged"
    assert 0.0 < own["energy"] < 3.0 * other["energy"] < 30.0 * own["energy"]  # two local minima


def test_a_body_that_touches_nothing_is_written_too(tmp_path: Path) -> None:
    words = ["--height", "5", "--seconds", "0.2", "--dt", "0.005", "--out", str(tmp_path / "a")]
    assert main(["simulate", BALL, *words]) == 0
    motion = Solution.load(tmp_path / "a")
    assert motion.contact_force.shape == (40, 0, 3) and motion.contact_names == ()


def test_sizes_with_dots_have_folders_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for radius in ("0.15", "0.25"):
        words = [f"{BALL},radius={radius}", "--seconds", "0.1"]
        assert main(["simulate", *words]) == 0
    assert len(list(tmp_path.iterdir())) == 2


def test_a_body_falls(tmp_path: Path) -> None:
    folder = tmp_path / "fall"
    words = ["--height", "0.1", "--seconds", "0.5", "--dt", "0.005", "--out", str(folder)]
    assert main(["simulate", BALL, *words]) == 0
    motion = Solution.load(folder)
    assert motion.com[0, 2] - motion.com[:, 2].min() > 0.1
    assert not motion.loaded[0].any() and motion.loaded.any()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["solve", BALL], "goal of a soft body 'walk' is not known"),
        (["solve", BALL, "--goal", "jump", "--pose", "x"], "--pose is of a robot"),
        (
            ["solve", BALL, "--goal", "roll", "--height", "1"],
            "--height is of a jump, the goal is roll",
        ),
        (["solve", BALL, "--goal", "jump", "--limits", "hard"], "--limits is of a robot"),
        (["solve", BALL, "--goal", "jump", "--costs", "paper"], "--costs is of a robot"),
        (["solve", BALL, "--goal", "jump 3"], "goal of a soft body 'jump 3' is not known"),
        (["solve", BALL, "--goal", "jump", "--seconds", "1.51"], "must be whole"),
        (["solve", BALL, "--goal", "jump", "--basis", "hermite"], "--basis is of a robot"),
        (["solve", "ball:size=2", "--goal", "jump"], "size of soft body 'ball'"),
        (["solve", "none.msh", "--goal", "jump"], "mesh file none.msh does not exist"),
        (["solve", BALL, "--goal", "jump", "--seconds", "0.1"], "must be at least 8 steps"),
        (["compare", BALL, "--goal", "jump", "--with", "fatrop"], "fatrop needs the dynamics"),
        (["simulate", BALL, "--hold"], "--hold is of a robot"),
    ],
)
def test_what_is_not_possible_is_one_line(
    words: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(words) == 2
    told = capsys.readouterr().err
    assert said in told and told.count("\n") == 1
    assert not list(tmp_path.iterdir())
