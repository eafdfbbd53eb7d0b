"""What the commands write, print and return; the solver is a stand-in that returns a simulated
motion."""

from __future__ import annotations

import json
import sys
import types
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import octo.solve  # the module is patched below
from octo.cli import run, simulate
from octo.cli.main import main, parse
from octo.cli.output import OutputFolder
from octo.cli.solve import described
from octo.dynamics.simulate import Motion
from octo.errors import MissingExtraError, OutputError
from octo.problem.problem import Problem
from octo.result.solution import Solution
from octo.solver.status import Status

FILES = ["motion.html", "plot.png", "report.json", "solution.npz"]
NUMBERS = (
    "iterations",
    "factorizations",
    "energy",
    "violation",
    "pointwise_residual",
    "weight",
    "goal_error",
    "penetration",
    "penetration_max",
    "slip",
    "friction_use",
    "friction_use_95",
    "torque_excess",
    "seconds",
    "setup_seconds",
    "seconds_per_iteration",
    "steps",
    "dt",
    "seed",
)
OTHERS = (
    "status",
    "converged",
    "terms",
    "com_travel",
    "stages",
    "passes",
    "device",
    "basis",
    "robot",
    "starts",
)


def standing(problem: Problem, status: Status) -> Solution:
    """The start held still, as a solution with the given status."""
    x = np.repeat(problem.start[None], problem.steps + 2, axis=0)
    motion = Motion(
        x,
        np.zeros((problem.steps, problem.dynamics.nu)),
        problem.dt,
        np.ones(problem.steps, dtype=bool),
        np.zeros(1),
    )
    made = replace(simulate.measured_motion(problem, motion, 0.1, 0.2), status=status)
    return replace(made, starts=(made.report(),))


@pytest.fixture
def solver(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Sets what the solver and the pictures do."""

    def given(
        status: Status = Status.CONVERGED, view: bool = True, interrupt: bool = False
    ) -> None:
        def solve(problem: Problem, **options: Any) -> Solution:
            if interrupt:
                raise KeyboardInterrupt
            return standing(problem, status)

        def picture(solution: Solution, path: Path, **options: Any) -> None:
            if not view:
                raise MissingExtraError("a picture", "view")
            path.write_text("picture")

        monkeypatch.setattr(sys.modules["octo.solve"], "solve", solve)
        monkeypatch.setitem(sys.modules, "octo.plot", types.SimpleNamespace(plot=picture))
        monkeypatch.setitem(sys.modules, "octo.viewer", types.SimpleNamespace(view=picture))

    return given


def walk(out: Path, *more: str) -> int:
    """The stand-in stands whatever is asked: it meets one goal."""
    return main(
        [
            "solve",
            "chain",
            "--goal",
            "stand",
            "--costs",
            "paper",
            "--seconds",
            "0.1",
            "--out",
            str(out),
            *more,
        ]
    )


@pytest.mark.parametrize(
    ("status", "code"),
    [
        (Status.CONVERGED, 0),
        (Status.ACCEPTABLE, 0),
        (Status.STALLED, 1),
        (Status.ITERATION_LIMIT, 1),
        (Status.INTERRUPTED, 130),
    ],
)
def test_exit_codes_and_files(
    status: Status, code: int, solver: Callable[..., None], tmp_path: Path
) -> None:
    solver(status)
    assert walk(tmp_path / "walk") == code
    assert sorted(path.name for path in (tmp_path / "walk").iterdir()) == FILES
    assert Solution.load(tmp_path / "walk" / "solution.npz").status is status


def test_a_missed_goal_is_said_and_exits_with_1(
    solver: Callable[..., None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    solver()
    assert walk(tmp_path, "--goal", "walk") == 1
    said = capsys.readouterr().out
    assert (
        "goal walk missed: the centre of mass moves at (0.00, 0.00) m/s, asked for was "
        "(0.50, 0.00)" in said
    )
    assert "off by 0.5 m/s, 0.05 is allowed" in said
    assert sorted(path.name for path in tmp_path.iterdir()) == FILES
    assert walk(tmp_path, "--goal", "walk", "--accept-missed") == 0
    assert "goal walk missed" in capsys.readouterr().out
    assert walk(tmp_path) == 0 and "goal stand met: " in capsys.readouterr().out
    assert json.loads((tmp_path / "report.json").read_text())["goal_met"] is True
    solver(Status.STALLED)
    assert walk(tmp_path, "--accept-missed") == 1  # of the goal, not of the solver
    solver(Status.INTERRUPTED)
    assert walk(tmp_path, "--goal", "walk") == 130


def test_report_has_every_key_and_finite_numbers(
    solver: Callable[..., None], tmp_path: Path
) -> None:
    solver()
    assert walk(tmp_path, "--goal", "walk", "--accept-missed") == 0
    report = json.loads(
        (tmp_path / "report.json").read_text(),
        parse_constant=lambda word: pytest.fail(f"{word} in report.json"),
    )
    for name in NUMBERS:
        assert isinstance(report[name], (int, float)), name
    assert set(OTHERS) <= set(report)
    assert report["converged"] is True and report["status"] == "converged"
    assert report["goal_error"] == pytest.approx(1.0)  # it stands, and should walk
    assert report["goal_met"] is False
    assert all(
        value is None or isinstance(value, (int, float)) for value in report["gait"].values()
    )
    assert report["gait"]["joint_speed"] == 0.0 and report["gait"]["shortest_swing"] is None
    assert report["energy"] == pytest.approx(sum(report["terms"].values()))
    assert len(report["starts"]) == 1 and report["starts"][0]["status"] == "converged"


def test_without_pictures_one_line_says_so(
    solver: Callable[..., None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    solver(view=False)
    assert walk(tmp_path) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["report.json", "solution.npz"]
    said = [line for line in capsys.readouterr().err.splitlines() if "left out" in line]
    assert len(said) == 1 and "plot.png and motion.html" in said[0] and "'view'" in said[0]


def test_a_picture_that_fails_costs_no_numbers(
    solver: Callable[..., None],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def broken(solution: Solution, path: Path) -> None:
        path.write_text("half a picture")
        raise RuntimeError("no font\nat all")

    def full(solution: Solution, path: Path) -> None:
        raise OSError(28, "No space left on device")

    solver()
    monkeypatch.setitem(sys.modules, "octo.plot", types.SimpleNamespace(plot=broken))
    monkeypatch.setitem(sys.modules, "octo.viewer", types.SimpleNamespace(view=full))
    assert walk(tmp_path) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["report.json", "solution.npz"]
    said = [line for line in capsys.readouterr().err.splitlines() if "left out" in line]
    assert len(said) == 2 and said[0] == "octo: plot.png left out: RuntimeError: no font at all"
    assert "motion.html left out: OSError" in said[1]
    assert main(["view", str(tmp_path / "solution.npz"), "--out", str(tmp_path / "again.svg")]) == 2
    assert "again.svg cannot be drawn: RuntimeError: no font at all" in capsys.readouterr().err
    assert not (tmp_path / "again.svg").exists()


def test_interrupted_before_there_is_an_iterate(
    solver: Callable[..., None],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    solver(interrupt=True)
    words = [
        "solve",
        "chain",
        "--goal",
        "stand",
        "--seconds",
        "0.1",
        "--out",
        str(tmp_path / "walk"),
    ]
    monkeypatch.setattr(sys, "argv", ["octo", *words])
    with pytest.raises(SystemExit) as stopped:
        run()
    assert stopped.value.code == 130
    assert not (tmp_path / "walk").exists()
    assert "interrupted, nothing was written" in capsys.readouterr().err


def test_default_folder_and_why_the_cpu(
    solver: Callable[..., None],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    solver()
    monkeypatch.chdir(tmp_path)
    sys.modules["octo.devices"].say_cpu.cache_clear()
    words = ["solve", "chain", "--goal", "stand", "--seconds", "0.1"]
    assert main(words) == 0
    assert (tmp_path / "octo-chain-stand" / "report.json").is_file()
    assert "using the CPU" not in capsys.readouterr().err
    sys.modules["octo.devices"].say_cpu.cache_clear()
    assert main([*words, "--verbose"]) == 0
    said = [
        line
        for line in capsys.readouterr().err.splitlines()
        if line.startswith("octo: using the CPU: ")
    ]
    assert len(said) == 1


@pytest.mark.parametrize("goal", ["walk", "stride", "turn", "stand"])
@pytest.mark.parametrize("costs", ["natural", "paper", "robot"])
def test_every_goal_makes_a_problem(goal: str, costs: str) -> None:
    words = ["solve", "chain", "--goal", goal, "--costs", costs, "--speed", "-0.3"]
    robot = octo.gallery.chain()
    made = described(robot, octo.Goal(goal, -0.3, preset=costs), 40, parse(words))  # type: ignore[arg-type]
    labels = [term.label for term in made.costs]
    wanted = {"turn": "BaseAngularVelocity"}.get(goal, "CenterOfMassVelocity")
    at_rest = costs == "natural" and goal == "stand"  # nothing is asked but to end where it began
    assert (wanted in labels) != at_rest and (made.end is not None) == at_rest
    assert (
        "Effort" in labels
        and ("FootLift" in labels) == (costs == "robot")
        and ("BodyLoad" in labels) == (costs == "natural")
    )


def test_a_failed_write_leaves_the_old_files(tmp_path: Path) -> None:
    (tmp_path / "first").write_text("old")

    def fail(path: Path) -> None:
        raise OSError(28, "No space left on device")

    with pytest.raises(OutputError, match="cannot be written: No space left"):
        OutputFolder(tmp_path).write(
            {"first": lambda path: path.write_text("new") and None, "second": fail}
        )
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("first", "old")]


def test_checking_a_folder_leaves_nothing(tmp_path: Path) -> None:
    OutputFolder(tmp_path / "a" / "b").check()
    assert not list(tmp_path.iterdir())


def test_friction_and_terrain_reach_the_problem(tmp_path: Path) -> None:
    from octo.cli.arguments import law_of, terrain_of

    coulomb, viscous = law_of("0.4"), law_of("viscous:30")
    assert coulomb is not None and coulomb.parameters["mu"] == 0.4
    assert viscous is not None and viscous.parameters["w_par"] == 30 * viscous.parameters["w_perp"]
    assert law_of("viscous") is None and law_of("coulomb") is not None
    assert terrain_of("slope:10").parameters["normal_x"] == pytest.approx(-np.sin(np.deg2rad(10)))
    file = tmp_path / "hills.py"
    file.write_text(
        "import casadi as ca\ndef hills(point, p):\n    return point[2] - 0.1 * ca.sin(point[0])\n"
    )
    assert terrain_of(f"{file}:hills").parameters == {}


def test_poses_of_files(tmp_path: Path) -> None:
    from octo.cli.arguments import pose_of

    robot = octo.gallery.chain()
    pose = np.arange(robot.nx, dtype=float)
    np.save(tmp_path / "pose.npy", pose)
    np.savetxt(tmp_path / "pose.txt", pose)
    (tmp_path / "pose.json").write_text(json.dumps(pose.tolist()))
    for name in ("pose.npy", "pose.txt", "pose.json"):
        assert np.array_equal(pose_of(robot, str(tmp_path / name)), pose)
    assert np.array_equal(pose_of(replace(robot, poses={"home": pose}), "home"), pose)


def test_info_and_robots(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", "spider", "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert set(values) >= {"name", "nx", "nu", "mass", "bodies", "contacts", "pairs", "dropped"}
    assert (values["nx"], values["nu"]) == (18, 12)
    assert main(["robots"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == list(
        octo.gallery.CHARACTERS
    )
    assert main(["info", "--devices", "--json"]) == 0
    assert set(json.loads(capsys.readouterr().out)) == {"cpu", "cuda"}


def test_simulate_and_view(solver: Callable[..., None], tmp_path: Path) -> None:
    solver()
    assert (
        main(
            [
                "simulate",
                "biped",
                "--seconds",
                "0.5",
                "--hold",
                "--height",
                "0.05",
                "--out",
                str(tmp_path),
            ]
        )
        == 0
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "motion.html",
        "report.json",
        "solution.npz",
    ]
    motion = Solution.load(tmp_path / "solution.npz")
    assert motion.status is Status.SIMULATED and motion.com[-1, 2] < motion.com[0, 2] - 0.03
    picture = tmp_path / "pictures" / "fall.html"
    assert main(["view", str(tmp_path / "solution.npz"), "--out", str(picture)]) == 0
    assert picture.read_text() == "picture"
    assert main(["view", str(tmp_path / "solution.npz"), "--out", str(tmp_path / "fall.csv")]) == 0
    assert (tmp_path / "fall.csv").read_text().startswith("time (s),base_x (m),")


def test_help_says_the_defaults(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["solve", "--help"])
    assert stopped.value.code == 0
    printed = capsys.readouterr().out
    assert all(
        option in printed
        for option in (
            "--goal",
            "--terrain",
            "--max-iterations",
            "default 0.025",
            "octo-ROBOT-GOAL",
        )
    )
