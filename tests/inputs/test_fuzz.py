"""Ten seconds of bad input made at random, and what the judge of it says."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from octo.errors import ValueRangeError

pytest.importorskip("mujoco")
ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT))

from tests.fuzz import judge  # noqa: E402
from tests.fuzz.worker import KINDS, kind_of  # noqa: E402


@pytest.mark.slow
def test_ten_seconds_of_fuzzing() -> None:
    words = [
        sys.executable,
        "-m",
        "tests.fuzz",
        "--cases",
        "2000",
        "--seed",
        "11",
        "--seconds",
        "10",
    ]
    done = subprocess.run(
        words, cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert " 0 faults" in done.stdout


def refusing(message: str) -> None:
    error = ValueRangeError("")
    error.args = (message,)
    raise error


FAULTS = {
    "traceback": lambda: 1 / 0,
    "the message holds": lambda: refusing("robot is <octo.Robot object at 0x7f>, must be another"),
    "the message has several lines": lambda: refusing("a\nb"),
    "the message has 9000": lambda: refusing("a" * 9000),
    "the message is empty": lambda: refusing(" "),
}


@pytest.mark.parametrize("name", FAULTS)
def test_the_judge_finds_what_is_wrong(name: str) -> None:
    with pytest.raises(judge.Fault, match=name):
        judge.call(FAULTS[name])


def test_the_judge_lets_refusals_and_answers_be() -> None:
    assert judge.call(lambda: refusing("x is 3, must be 2")) is None
    assert judge.call(lambda: 5) == 5


def test_every_kind_has_cases_and_they_are_the_same_again() -> None:
    kinds = [kind_of(1, k) for k in range(200)]
    assert set(kinds) == set(KINDS) and kinds == [kind_of(1, k) for k in range(200)]
