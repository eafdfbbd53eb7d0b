"""octo compare: Ctrl-C in another solver, what it leaves of earlier files, pictures that fail."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import octo
from octo import native
from octo.cli import compare
from octo.cli.main import main
from octo.cli.output import OutputFolder
from octo.errors import OutputError
from octo.reference import Fatrop, Ipopt
from octo.reference.run import interruptible
from octo.solver.options import SqpOptions
from octo.solver.status import Status

needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
TINY = [
    "compare",
    "biped",
    "--goal",
    "stand",
    "--seconds",
    "0.5",
    "--dt",
    "0.05",
    "--with",
    "ipopt",
]
EARLIER = '[{"an": "earlier run"}]\n'
ENDLESS = SqpOptions(
    max_iterations=10**6, tolerance=1e-300, dual_tolerance=1e-300, plateau=63, plateau_change=0.0
)


def problem() -> octo.Problem:
    robot = octo.gallery.biped()
    terms = [octo.CenterOfMassVelocity((0.4, 0.0, 0.0)), octo.Effort()]
    return octo.Problem(robot, steps=24, dt=0.03, x0=robot.default_pose, costs=terms)


def press_ctrl_c(ready: Ipopt | Fatrop, iterations: int) -> threading.Thread:
    """Once the solver has seen so many points."""

    def press() -> None:
        while ready.library.handle.octo_log_size() < iterations:
            time.sleep(1e-3)
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=press, daemon=True)
    thread.start()
    return thread


@needs_compiler
@pytest.mark.parametrize("solver", [Ipopt, Fatrop])
@pytest.mark.parametrize("iterations", [1, 6])
def test_ctrl_c_in_another_solver_is_an_interruption(solver, iterations):
    """It would go on for a million iterations, and be called stalled if it were told to stop."""
    ready = solver(problem(), options=ENDLESS)
    handler = signal.getsignal(signal.SIGINT)
    press = press_ctrl_c(ready, iterations)
    run = ready.solve()
    press.join()
    assert run.solution.status is Status.INTERRUPTED and run.said == "stopped by Ctrl-C"
    assert not run.solution.converged and run.solution.iterations < 10**5
    assert signal.getsignal(signal.SIGINT) is handler
    limited = solver(problem(), options=SqpOptions(max_iterations=2)).solve()  # it is not stopped
    assert limited.solution.status is Status.ITERATION_LIMIT and limited.solution.iterations in (
        2,
        3,
    )


def test_ctrl_c_in_interpreted_callbacks_is_one_too():
    """Without compiled functions CasADi is told by an exception."""
    with pytest.raises(KeyboardInterrupt), interruptible(None) as told:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.1)
    assert told.caught and signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_sigterm_is_another_where_the_commands_have_it_so():
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt), interruptible(None) as told:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(0.1)
        assert told.caught and signal.getsignal(signal.SIGTERM) is signal.default_int_handler
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        with interruptible(None):
            assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    finally:
        signal.signal(signal.SIGTERM, before)


def test_a_solver_in_another_thread_gets_no_signals():
    seen = []

    def run() -> None:
        with interruptible(None) as told:
            seen.append((told.caught, signal.getsignal(signal.SIGINT)))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert seen == [(False, signal.default_int_handler)]


class StandIn:
    """A contest whose entries are given, and that is then interrupted."""

    def __init__(self, entries):
        self.plan, self.entries = [None], entries

    def run(self, seeds):
        yield from self.entries
        raise KeyboardInterrupt


@pytest.fixture(scope="module")
def entry():
    from octo.bench.contest import Entry

    described = octo.Problem(octo.gallery.biped(), steps=4, dt=0.05, costs=[octo.Effort()])
    solution = octo.solve(described, passes=1, max_iterations=1, device="cpu")
    return Entry("octo", 0, 1, solution, "iteration_limit")


def interrupted(monkeypatch, entries) -> None:
    monkeypatch.setattr("octo.bench.contest.Contest", lambda *given: StandIn(entries))


@pytest.mark.parametrize("there", [True, False])
def test_ctrl_c_before_the_first_row_leaves_an_earlier_file(there, tmp_path, monkeypatch, capsys):
    interrupted(monkeypatch, [])
    file = tmp_path / "a.json"
    if there:
        file.write_text(EARLIER)
    assert main([*TINY, "--json", str(file)]) == 130
    assert (file.read_text() if there else file.exists()) == (EARLIER if there else False)
    assert "nothing was written" in capsys.readouterr().err


def test_ctrl_c_in_the_first_solver_leaves_an_earlier_file(entry, tmp_path, monkeypatch, capsys):
    from dataclasses import replace

    stopped = replace(entry, solution=replace(entry.solution, status=Status.INTERRUPTED))
    interrupted(monkeypatch, [stopped])
    file = tmp_path / "a.json"
    file.write_text(EARLIER)
    assert main([*TINY, "--json", str(file)]) == 130
    assert file.read_text() == EARLIER and "nothing was written" in capsys.readouterr().err
    file.unlink()
    assert main([*TINY, "--json", str(file)]) == 130  # what there is, where there was nothing
    assert json.loads(file.read_text())[0]["status"] == "interrupted"


def test_ctrl_c_after_a_row_writes_it(entry, tmp_path, monkeypatch):
    interrupted(monkeypatch, [entry])
    file = tmp_path / "a.json"
    file.write_text(EARLIER)
    assert main([*TINY, "--json", str(file)]) == 130
    assert [record["solver"] for record in json.loads(file.read_text())] == ["octo"]


def test_an_old_picture_goes_where_no_new_one_can_be_drawn(entry, tmp_path, monkeypatch, capsys):
    def fail(*given):
        raise RuntimeError("no fonts")

    monkeypatch.setattr("octo.cli.convergence.draw", fail)
    (tmp_path / "a.png").write_bytes(b"of an earlier run")
    (tmp_path / "b.png").write_bytes(b"of another one")
    compare.write(tmp_path / "a.json", [entry], [{"solver": "octo"}])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.json", "b.png"]
    assert "a.png left out: RuntimeError: no fonts" in capsys.readouterr().err


def bad(path: Path) -> None:
    raise RuntimeError("no fonts")


def good(path: Path) -> None:
    path.write_text("new")


def test_pictures_of_every_command_go_with_their_numbers(tmp_path):
    folder = OutputFolder(tmp_path)
    for name in ("motion.html", "plot.png", "report.json"):
        (tmp_path / name).write_text("old")
    failed = folder.write({"report.json": good, "plot.png": bad, "motion.html": good})
    assert list(failed) == ["plot.png"] and not (tmp_path / "plot.png").exists()
    assert (tmp_path / "report.json").read_text() == (tmp_path / "motion.html").read_text() == "new"


def test_a_picture_alone_keeps_the_old_one(tmp_path):
    (tmp_path / "plot.png").write_text("old")
    assert list(OutputFolder(tmp_path).write({"plot.png": bad})) == ["plot.png"]
    assert (tmp_path / "plot.png").read_text() == "old"


def test_numbers_that_cannot_be_written_leave_everything(tmp_path):
    def full(path: Path) -> None:
        raise OSError(28, "No space left on device")

    for name in ("plot.png", "report.json"):
        (tmp_path / name).write_text("old")
    with pytest.raises(OutputError, match="No space left"):
        OutputFolder(tmp_path).write({"report.json": full, "plot.png": good})
    assert {path.read_text() for path in tmp_path.iterdir()} == {"old"}


def test_an_interrupted_run_that_is_not_finite_stays_interrupted():
    from octo.problem.compiled import CompiledProblem
    from octo.reference.run import Timed, history, solution_of

    compiled = CompiledProblem([problem()])
    unknowns = np.full((1, compiled.K, compiled.nc), np.nan)
    own = {
        "of": Timed({}, 0.0, 0.0, True),
        "iterations": 1,
        "setup_seconds": 0.0,
        "history": history(*np.zeros((3, 0))),
    }
    lam = np.zeros((compiled.K, compiled.ma))
    for status, expected in ((Status.INTERRUPTED,) * 2, (Status.STALLED, Status.NOT_FINITE)):
        assert solution_of(compiled, unknowns, lam, status, **own).status is expected


@pytest.mark.parametrize(
    ("flag", "value", "most"),
    [
        ("--seeds", "9" * 300, "100000"),
        ("--seeds", "100001", "100000"),
        ("--seed", "9" * 300, "18446744073709551615"),
        ("--seed", "18446744073709551616", "18446744073709551615"),
    ],
)
def test_starts_that_never_end_are_refused(
    capsys: pytest.CaptureFixture[str], flag: str, value: str, most: str
) -> None:
    assert main([*TINY, flag, value]) == 2
    assert f"{flag[2:]} is" in (said := capsys.readouterr().err)
    assert said.rstrip().endswith(f"must be at most {most}")
    assert len(said) < 500
