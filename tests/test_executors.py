"""Work in other processes."""

import os
import signal
from pathlib import Path

from octo import executors


def _once(task: tuple[int, str]) -> int:
    """The process that is the first to do task 3 is killed."""
    number, folder = task
    if number == 3 and not (mark := Path(folder) / "killed").exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


def test_what_a_killed_process_did_is_done_again_and_nothing_twice(tmp_path, caplog) -> None:
    taken: dict[int, int] = {}

    def take(task: tuple[int, str], found: int) -> None:
        assert task[0] not in taken
        taken[task[0]] = found

    executors.run("octo.test", [(k, str(tmp_path)) for k in range(8)], _once, take)
    assert taken == {k: k * k for k in range(8)} and (tmp_path / "killed").exists()
    assert "a process was killed: what it did is done again" in caplog.text
