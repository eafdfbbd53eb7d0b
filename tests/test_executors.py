"""Work in other processes."""

import os
import signal
import subprocess
import sys
import time
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


KILLED = """
import os, time
from pathlib import Path
from octo import executors

def work(folder):
    (Path(folder) / str(os.getpid())).touch()
    time.sleep(60.0)

if __name__ == "__main__":
    executors.run("octo.test", [{0!r}, {0!r}], work, print)
"""


def _alive(number: int) -> bool:
    """Whether a process runs: one that ended and that nobody asked after does not."""
    try:
        return Path(f"/proc/{number}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_nobody_works_on_for_a_process_that_was_killed(tmp_path) -> None:
    (tmp_path / "script.py").write_text(KILLED.format(str(tmp_path / "at")))
    (tmp_path / "at").mkdir()
    with subprocess.Popen([sys.executable, str(tmp_path / "script.py")]) as script:
        until = time.monotonic() + 60.0
        while not (found := os.listdir(tmp_path / "at")) and time.monotonic() < until:
            time.sleep(0.05)
        workers = [int(name) for name in found]
        assert workers and all(map(_alive, workers))
        script.kill()
    until = time.monotonic() + 20.0
    while any(map(_alive, workers)) and time.monotonic() < until:
        time.sleep(0.05)
    assert not any(map(_alive, workers))
