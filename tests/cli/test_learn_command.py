"""``octo learn``: what it writes and returns, how it goes on, what it refuses in one line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from octo import learn
from octo.cli.main import main

FILES = ["motion.html", "plot.png", "rounds.json", "solution.npz", "transition.npz"]
SHORT = ["--seconds", "1", "--iterations", "5", "--training", "5", "--hidden", "6", "--rounds", "1"]


def test_files_of_two_calls(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "walk"
    # five iterations do not converge
    assert main(["learn", "biped", *SHORT, "--loss", "recurrent", "--out", str(out)]) == 1
    assert sorted(path.name for path in out.iterdir()) == FILES
    assert "round 1" in capsys.readouterr().out
    again = [*SHORT, "--resume", str(out), "--out", str(out)]
    assert main(["learn", "biped", *again]) in (0, 1)
    rounds = json.loads((out / "rounds.json").read_text())["rounds"]
    assert [one["number"] for one in rounds] == [1, 2]
    found = learn.Learned.load(out)
    assert found.transition.hidden == (6,) and found.motion.basis == "hermite"


REFUSED = [
    (["--goal", "jump"], "--goal is 'jump', must be one of walk, stride, turn, stand"),
    (["--hidden", "a"], "must be whole numbers with commas"),
    (["--hidden", "0"], "Transition.hidden is 0"),
    (["--loss", "none"], "loss 'none'"),
    (["--weight", "-1"], "weight is -1.0, must not be negative"),
    (["--state", "mind"], "Transition.state 'mind'"),
    (["--resume", "nowhere"], "does not exist"),
]


@pytest.mark.parametrize(("words", "said"), REFUSED, ids=[said for _, said in REFUSED])
def test_refused_in_one_line(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["learn", "biped", *SHORT, *words, "--out", str(tmp_path / "no")]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1
    assert not (tmp_path / "no").exists()
