"""`octo replay`: files, exit codes, and what is refused."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import octo
from octo.cli import simulate
from octo.cli.main import main
from octo.dynamics.simulate import Motion
from octo.problem.problem import Problem
from octo.replay import replay
from octo.result.solution import Solution
from octo.solver.status import Status


@pytest.fixture(scope="module")
def standing() -> Solution:
    """A mammal that stands still for half a second: the start with the torques and forces that hold
    it."""
    problem = Problem(octo.gallery.mammal(), steps=20, dt=0.025, costs=[octo.Effort()])
    x = np.repeat(problem.start[None], problem.steps + 2, axis=0)
    motion = Motion(x, np.zeros((20, 12)), 0.025, np.ones(20, dtype=bool), np.zeros(1))
    made = simulate.measured_motion(problem, motion, 0.1, 0.2)
    return replace(made, status=Status.CONVERGED)


@pytest.fixture
def folder(standing: Solution, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    standing.save("standing.npz")
    (tmp_path / "walk").mkdir()
    standing.save("walk/solution.npz")
    replace(standing, character=None).save("custom.npz")
    base = replace(standing.character, base="fixed")
    replace(standing, character=base).save("fixed.npz")
    parameters = {
        name: value
        for name, value in standing.parameters.items()
        if not name.startswith("terrain.")
    }
    replace(standing, parameters=parameters).save("hills.npz")
    (tmp_path / "text.npz").write_text("no archive")
    return tmp_path


def test_it_writes_two_files_and_says_who_stood(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", "walk", "--starts", "2", "--seed", "3", "--out", "out"]) == 0
    report = json.loads((folder / "out" / "report.json").read_text())
    assert sorted(path.name for path in (folder / "out").iterdir()) == [
        "motion.html",
        "report.json",
    ]
    assert report["falls"] == 0
    assert report["seconds_upright"] == pytest.approx(0.5)
    assert [start["start"] for start in report["starts"]] == [0, 1]
    assert all(start["tracking_error"] > 0.0 for start in report["starts"])
    assert report["tracking_error"] == pytest.approx(
        np.mean([start["tracking_error"] for start in report["starts"]])
    )
    assert report["drift"] < 0.05
    assert report["feedback"] == "base" and report["perturbed"] is True and report["seed"] == 3
    assert "2 of 2 stood" in capsys.readouterr().out
    page = (folder / "out" / "motion.html").read_text()
    assert "mammal in MuJoCo" in page


def test_a_fall_is_no_failure(standing: Solution, folder: Path) -> None:
    names = (
        "u",
        *(f"contact_{name}" for name in ("force", "point", "velocity", "normal", "depth")),
    )
    longer = {name: np.repeat(getattr(standing, name), 5, axis=0) for name in names}
    longer["u"] = np.zeros_like(longer["u"])
    replace(standing, x=np.repeat(standing.x, 5, axis=0)[:102], **longer).save("limp.npz")
    assert (
        main(
            [
                "replay",
                "limp.npz",
                "--feedback",
                "none",
                "--kp",
                "0.01",
                "--kd",
                "0.001",
                "--out",
                "out",
            ]
        )
        == 0
    )
    report = json.loads((folder / "out" / "report.json").read_text())
    assert report["falls"] == 1 and report["perturbed"] is False
    assert 0.1 < report["seconds_upright"] < 2.5
    assert report["starts"][0]["fell"] is True


def test_a_plan_that_did_not_converge_is_named(
    standing: Solution, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    replace(standing, status=Status.STALLED).save("stalled.npz")
    assert main(["replay", "stalled.npz", "--out", "out"]) == 0
    assert "the plan is stalled" in capsys.readouterr().err


CASES = {
    "no plan": ("replay", "SOLUTION"),
    "a missing plan": ("replay nowhere.npz", "nowhere.npz", "does not exist"),
    "a folder without a plan": ("replay .", "solution.npz", "folder . holds no"),
    "no archive": ("replay text.npz", "text.npz", "not a solution"),
    "another plant": ("replay standing.npz --plant bullet", "plant 'bullet'", "mujoco"),
    "another feedback": ("replay standing.npz --feedback bse", "feedback 'bse'", "base"),
    "no stiffness": ("replay standing.npz --kp 0", "--kp", "positive"),
    "negative damping": ("replay standing.npz --kd -1", "--kd", "positive"),
    "no friction": ("replay standing.npz --friction 0", "--friction", "positive"),
    "no starts": ("replay standing.npz --starts 0", "--starts", "at least 1"),
    "half a seed": ("replay standing.npz --seed 0.5", "--seed", "whole number"),
    "no time step": ("replay standing.npz --timestep 0", "--timestep", "positive"),
    "a time step that does not fit": (
        "replay standing.npz --timestep 0.002",
        "timestep is 0.002",
        "0.025",
    ),
    "user-written dynamics": ("replay custom.npz", "robot", "floating base"),
    "a fixed base": ("replay fixed.npz", "floating base"),
    "a terrain that is no plane": ("replay hills.npz", "terrain", "plane"),
    "a folder that cannot be": (
        "replay standing.npz --out /dev/null/x",
        "/dev/null/x",
        "cannot be written",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_refused(name: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words, *expected = CASES[name]
    before = sorted(folder.rglob("*"))
    assert main(words.split()) == 2
    printed = capsys.readouterr()
    lines = printed.err.splitlines()
    assert len(lines) == 1 and lines[0].startswith("octo: error: "), printed.err
    assert printed.out == ""
    for fragment in expected:
        assert fragment in lines[0], f"{fragment!r} is not in {lines[0]!r}"
    assert sorted(folder.rglob("*")) == before


def test_without_mujoco_one_line_says_what_is_missing(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert main(["replay", "standing.npz", "--out", "out"]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and "extra 'robots'" in lines[0] and "MuJoCo" in lines[0]
    assert not (folder / "out").exists()


def test_options_are_refused_in_python_too(standing: Solution) -> None:
    with pytest.raises(octo.errors.UnknownNameError, match="feedback"):
        replay(standing, feedback="none_")
    with pytest.raises(octo.errors.ValueRangeError, match="kp"):
        replay(standing, kp=-1.0)
    with pytest.raises(octo.errors.ValueRangeError, match="starts"):
        replay(standing, starts=0)
