"""Ctrl-C, SIGTERM, kill and full disks: what was found is not lost, and nothing half-written stays.
Names that lead elsewhere."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import threading
import time
import types
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from forgotten import forgotten

import octo
from octo.cli import run
from octo.cli.main import main
from octo.cli.output import RESCUED, OutputFolder, default_folder
from octo.errors import OutputError
from octo.files import SCRATCH, file_name, replacing
from octo.interrupts import like_ctrl_c, postponed
from octo.problem.compiled import CompiledProblem
from octo.problem.structure import program_of
from octo.reference.program import nlp
from octo.result.solution import Solution

ROOT = Path(octo.__file__).parents[1]
DEFAULTS = ("--seconds", "0.1", "--dt", "0.05")


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A solution.npz of a robot that stands."""
    path = tmp_path_factory.mktemp("saved") / "solution.npz"
    assert main(["simulate", "mammal", "--hold", *DEFAULTS, "--out", str(path.parent)]) == 0
    return path


@pytest.fixture
def interrupted(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """Every picture is interrupted while it is drawn, by the signal given."""

    def by(number: int) -> None:
        def draw(*words: Any, **options: Any) -> None:
            Path(words[1]).write_text("half a picture")
            os.kill(os.getpid(), number)
            time.sleep(1.0)
            pytest.fail("the signal was lost")

        monkeypatch.setitem(sys.modules, "octo.plot", types.SimpleNamespace(plot=draw))
        monkeypatch.setitem(sys.modules, "octo.viewer", types.SimpleNamespace(view=draw))
        monkeypatch.setitem(sys.modules, "octo.cli.mpc_plot", types.SimpleNamespace(plot_log=draw))

    return by


@pytest.fixture(autouse=True)
def signals() -> Iterator[None]:
    """As they were."""
    before = {
        number: signal.getsignal(number)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    }
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def command(words: list[str], monkeypatch: pytest.MonkeyPatch) -> int:
    """The exit code of ``octo``."""
    monkeypatch.setattr(sys, "argv", ["octo", *words])
    with pytest.raises(SystemExit) as end:
        run()
    return int(end.value.code or 0)


def commands(saved: Path) -> dict[str, tuple[list[str], list[str]]]:
    """Words of a command that draws, and the numbers that it writes."""
    solver = ["--max-iterations", "2", "--passes", "1", "--seconds", "0.3", "--device", "cpu"]
    return {
        "solve": (
            ["solve", "chain", "--goal", "stand", "--costs", "paper", *solver],
            ["report.json", "solution.npz"],
        ),
        "cycle": (
            [
                "cycle",
                "biped",
                "--steps",
                "4",
                "--seeds",
                "1",
                "--max-iterations",
                "2",
                "--passes",
                "1",
                "--device",
                "cpu",
            ],
            ["report.json", "solution.npz"],
        ),
        "simulate": (["simulate", "mammal", "--hold", *DEFAULTS], ["report.json", "solution.npz"]),
        "replay": (["replay", str(saved)], ["report.json"]),
        "mpc": (
            ["mpc", "mammal", "--plant", "octo", "--seconds", "0.04", "--horizon", "4"],
            ["log.npz", "report.json"],
        ),
    }


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("name", ["solve", "cycle", "simulate", "replay", "mpc"])
def test_an_interrupted_picture_costs_no_numbers(
    name: str,
    number: int,
    saved: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    interrupted: Callable[[int], None],
) -> None:
    interrupted(number)
    words, numbers = commands(saved)[name]
    assert command([*words, "--out", str(tmp_path / "out")], monkeypatch) == 130
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == numbers
    assert json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))
    if "solution.npz" in numbers:
        assert Solution.load(tmp_path / "out" / "solution.npz").steps > 0
    line = capsys.readouterr().err.splitlines()[-1]
    assert (
        line.startswith("octo: interrupted, ")
        and str(tmp_path / "out") in line
        and "report.json" in line
    )


def test_a_comparisons_numbers_outlive_its_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def draw(*words: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setitem(sys.modules, "octo.cli.convergence", types.SimpleNamespace(draw=draw))
    words = [
        "compare",
        "chain",
        "--goal",
        "stand",
        "--seconds",
        "0.3",
        "--max-iterations",
        "2",
        "--with",
        "ipopt",
    ]
    assert command([*words, "--json", str(tmp_path / "all.json")], monkeypatch) == 130
    assert [path.name for path in tmp_path.iterdir()] == ["all.json"]
    assert {record["solver"] for record in json.loads((tmp_path / "all.json").read_text())} == {
        "octo",
        "ipopt",
    }
    assert "all.json in" in capsys.readouterr().err


def test_a_signal_waits_until_the_numbers_are_written(tmp_path: Path) -> None:
    like_ctrl_c()

    def slow(path: Path) -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        path.write_text("numbers")

    with pytest.raises(KeyboardInterrupt, match="report.json"):
        OutputFolder(tmp_path).write(
            {"report.json": slow, "plot.png": lambda path: pytest.fail("drawn")}
        )
    assert [path.name for path in tmp_path.iterdir()] == ["report.json"]
    with pytest.raises(KeyboardInterrupt), postponed():  # a second one does not wait
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)
        pytest.fail("waited")


def test_old_pictures_do_not_stay_beside_new_numbers(tmp_path: Path) -> None:
    (tmp_path / "plot.png").write_text("old")
    (tmp_path / "mine.png").write_text("mine")

    def fail(path: Path) -> None:
        raise RuntimeError("no fonts")

    failed = OutputFolder(tmp_path).write(
        {"report.json": lambda path: path.write_text("{}"), "plot.png": fail}
    )
    assert list(failed) == ["plot.png"] and sorted(path.name for path in tmp_path.iterdir()) == [
        "mine.png",
        "report.json",
    ]
    # no new numbers: the old picture is still right
    failed = OutputFolder(tmp_path).write({"mine.png": fail})
    assert list(failed) == ["mine.png"] and (tmp_path / "mine.png").read_text() == "mine"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_solve_that_is_told_to_stop_writes_its_best_iterate(number: int, tmp_path: Path) -> None:
    if signal.getsignal(number) is signal.SIG_IGN:
        pytest.skip("the tests run under nohup: a hang-up stops nothing there")
    words = [
        "solve",
        "mammal",
        "--goal",
        "walk",
        "--costs",
        "paper",
        "--seconds",
        "4",
        "--device",
        "cpu",
    ]
    process = subprocess.Popen(
        [sys.executable, "-c", WATCHED, *words, "--out", str(tmp_path / "out")],
        stderr=subprocess.PIPE,
        text=True,
        stdout=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert process.stderr is not None
    for line in process.stderr:  # until it iterates
        if line.startswith("iterating"):
            break
    process.send_signal(number)
    process.communicate(timeout=60)
    assert process.returncode == 130
    solution = Solution.load(tmp_path / "out" / "solution.npz")
    assert solution.status.label == "interrupted" and solution.iterations > 0


WATCHED = """
import sys
from octo.solver import sqp
show = sqp.Monitor.show
def told(self, *words):
    print("iterating", file=sys.stderr, flush=True)
    return show(self, *words)
sqp.Monitor.show = told
sys.modules["octo.plot"] = sys.modules["octo.viewer"] = None
from octo.cli import run
sys.argv[0] = "octo"
run()
"""


def test_what_a_killed_command_left_is_removed_by_the_next(tmp_path: Path, saved: Path) -> None:
    words = ["simulate", "mammal", "--hold", *DEFAULTS, "--out", str(tmp_path)]
    die = (
        "import os, sys, octo.cli.main, octo.result.solution as s; s.Solution.save = lambda "
        "*w: os.kill(os.getpid(), 9);"
    )
    dead = subprocess.run(
        [sys.executable, "-c", f"{die} octo.cli.main.main({words!r})"],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert dead.returncode == -9
    assert [path.name.startswith(SCRATCH) for path in tmp_path.iterdir()] == [True]
    assert main(words) == 0
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(SCRATCH)]


def full(path: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_full_disk_does_not_lose_the_solution(
    saved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "home").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    out, save = tmp_path / "out", Solution.save
    monkeypatch.setattr(
        Solution,
        "save",
        lambda self, path: full(path) if out in Path(path).parents else save(self, path),
    )
    assert main(["simulate", "mammal", "--hold", *DEFAULTS, "--out", str(out)]) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    (rescued,) = (tmp_path / "home").iterdir()
    assert (
        rescued.name.startswith(RESCUED)
        and str(rescued) in line
        and "No space left on device" in line
        and str(out) in line
    )
    assert sorted(path.name for path in rescued.iterdir()) == ["report.json", "solution.npz"]
    np.testing.assert_array_equal(Solution.load(rescued / "solution.npz").x, Solution.load(saved).x)
    assert list(out.iterdir()) == []


@pytest.mark.parametrize(
    ("number", "said"), [(errno.EDQUOT, "quota"), (errno.EROFS, "Read-only"), (errno.EIO, "error")]
)
def test_other_disks_that_fail(
    number: int, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    out = tmp_path / "out"

    def fail(path: Path) -> None:
        if out in path.parents:
            raise OSError(number, os.strerror(number))
        path.write_text("{}")

    with pytest.raises(OutputError, match=said) as caught:
        OutputFolder(out).write(
            {"report.json": fail, "plot.png": lambda path: pytest.fail("drawn")}
        )
    assert (
        "\n" not in str(caught.value) and len(list(tmp_path.glob(f"{RESCUED}*/report.json"))) == 1
    )


def test_where_nothing_can_be_written_the_reason_is_said(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="No space left on device$"):
        OutputFolder(tmp_path).write({"report.json": full})
    assert list(tmp_path.iterdir()) == []
    with (
        pytest.raises(OutputError, match=r"walk\.npz cannot be written: No space"),
        replacing(tmp_path / "walk.npz") as beside,
    ):
        full(beside)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("out", ["x" * 300, "a\0b", "/dev/null/x", "/proc/x", "{file}/x"])
def test_folders_that_cannot_be(out: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="which cannot be written") as caught:
        OutputFolder(out.format(file=tmp_path / "file")).check()
    assert "\n" not in str(caught.value)


NAMES = {
    "../..": "unnamed",
    "/../../etc": "etc",
    "..": "unnamed",
    ".hidden": "hidden",
    "": "unnamed",
    "a/b\\c": "a_b_c",
    "name\n\x1b[31mred": "name_31mred",
    "con\0trol": "con_trol",
    "~root": "root",
    "$(rm -rf)": "rm_-rf",
    "köter": "köter",
    "go2.v1": "go2.v1",
    "x" * 500: "x" * 80,
    "é" * 100: "é" * 40,
    "\ud800": "unnamed",
    "-rf": "-rf",
}


@pytest.mark.parametrize("name", NAMES)
def test_names_become_parts_of_names_of_files(name: str) -> None:
    assert file_name(name) == NAMES[name]
    folder = Path(default_folder(name, "replay"))
    assert folder.parts == (f"octo-{NAMES[name]}-replay",)


@pytest.mark.parametrize("name", ["/../..", "../../../outside", "a/b/c", "x" * 400, "tab\there"])
def test_a_replay_stays_here_whatever_the_robot_is_called(
    name: str, saved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = tmp_path / "deep" / "here"
    here.mkdir(parents=True)
    replace(Solution.load(saved), name=name).save(tmp_path / "named.npz")
    monkeypatch.chdir(here)
    monkeypatch.setitem(sys.modules, "octo.viewer", None)
    assert main(["replay", str(tmp_path / "named.npz")]) == 0
    (made,) = here.iterdir()
    assert made.name == default_folder(name, "replay") and [
        path.name for path in made.iterdir()
    ] == ["report.json"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["deep", "named.npz"]


def test_names_in_a_table_do_not_break_its_columns(saved: Path, tmp_path: Path) -> None:
    found = Solution.load(saved)
    replace(
        found, contact_names=tuple(f'a,"b\n{k}' for k in range(len(found.contact_names)))
    ).to_csv(tmp_path / "x.csv")
    lines = (tmp_path / "x.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == found.steps + 2 and len({line.count(",") for line in lines}) == 1


def test_signals_are_left_alone_in_other_threads() -> None:
    seen: list[bool] = []

    def work() -> None:
        with postponed():
            seen.append(True)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as nohup does
    like_ctrl_c()
    assert seen == [True] and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN


def interrupting(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """CasADi's next look at a symbol's shape is disturbed by Ctrl-C; a list of what was sent."""
    usual, sent = ca.SX.shape.fget, []

    def shape(symbol: ca.SX) -> tuple[int, int]:
        if not sent:
            sent.append(signal.SIGINT)
            os.kill(os.getpid(), signal.SIGINT)
        return tuple(usual(symbol))

    monkeypatch.setattr(ca.SX, "shape", property(shape))
    return sent


def test_casadi_takes_ctrl_c_for_an_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    """What `postponed` is for; once CasADi does not, it can go."""
    x, y = ca.SX.sym("x", 2, 2), ca.SX.sym("y", 2, 2)
    sent = interrupting(monkeypatch)
    assert (x @ y).size() == (2, 2) and sent


@pytest.mark.parametrize(
    "build",
    [
        lambda problem: program_of(problem),
        lambda problem: problem.dynamics.lanes_text(),
        lambda problem: nlp(problem),
        lambda problem: CompiledProblem([problem]).kinematics,
    ],
    ids=["terms", "dynamics", "reference", "contacts"],
)
def test_ctrl_c_is_not_lost_while_symbols_are_built(
    monkeypatch: pytest.MonkeyPatch, build: Callable[[octo.Problem], object]
) -> None:
    forgotten(monkeypatch)
    robot = octo.gallery.biped()
    terms = [octo.CenterOfMassVelocity((0.4, 0.0, 0.0)), octo.Effort(), octo.Slip(name="a foot")]
    problem = octo.Problem(robot, steps=12, dt=0.03, x0=robot.default_pose, costs=terms)
    sent = interrupting(monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        build(problem)
    assert sent
