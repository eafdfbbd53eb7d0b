"""The package logs and is silent of itself; the command line prints its warnings."""

import logging
import os
import subprocess
import sys
from pathlib import Path

import pytest

import octo
from octo.cli import main as command_line

WORDS = "from octo import native; assert native.compiler() is None"


def without_compiler(words: str) -> str:
    """What ``words`` print on stderr where there is no compiler."""
    values = {"PYTHONPATH": str(Path(octo.__file__).parents[1]), "OCTO_NO_COMPILER": "1"}
    return subprocess.run(
        [sys.executable, "-c", words],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, **values},
    ).stderr


def test_silent_until_the_user_says_where_to() -> None:
    assert without_compiler(WORDS) == ""
    said = without_compiler(f"import logging; logging.basicConfig(); {WORDS}")
    assert said.startswith("WARNING:octo:OCTO_NO_COMPILER is set") and said.count("\n") == 1


@pytest.mark.parametrize("everything", [False, True])
def test_the_command_line_prints_warnings_and_if_asked_all(
    everything: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    log = logging.getLogger("octo")
    level, handlers = log.level, list(log.handlers)
    with command_line.logged_on_stderr(everything):
        log.warning("a warning")
        log.info("a remark")
    assert (log.level, log.handlers) == (level, handlers)
    assert capsys.readouterr().err == "octo: a warning\n" + everything * "octo: a remark\n"
