"""``octo mpc``: the four files, the numbers of report.json, and what is refused in one line."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from octo.cli.main import main


def test_a_run_writes_four_files(tmp_path, capsys):
    code = main(
        [
            "mpc",
            "mammal",
            "--goal",
            "walk",
            "--speed",
            "0.2",
            "--seconds",
            "6",
            "--horizon",
            "20",
            "--push",
            "10,0.2,90",
            "--noise",
            "1",
            "--delay",
            "1",
            "--payload",
            "0.1",
            "--bumps",
            "0.01",
            "--out",
            str(tmp_path / "walk"),
        ]
    )
    assert code == 0
    assert sorted(path.name for path in (tmp_path / "walk").iterdir()) == [
        "log.npz",
        "motion.html",
        "plot.png",
        "report.json",
    ]
    report = json.loads((tmp_path / "walk" / "report.json").read_text())
    assert (
        set(report["latency"]) == {"p50", "p95", "p99", "max"}
        and 0.0 < report["latency"]["p50"] < 1.0
    )
    assert report["rate"] == 100.0 and report["falls"] == 0
    assert report["pushes"] == [pytest.approx(2.0)]
    assert sum(report["statuses"].values()) == 600
    assert report["memory_end"] >= 0 and report["memory_start"] >= 0
    assert report["velocity"][0] == pytest.approx(0.2, abs=0.06)
    assert "0 falls" in capsys.readouterr().out


def test_octo_s_own_simulation_and_a_turn(tmp_path):
    words = [
        "mpc",
        "mammal",
        "--goal",
        "turn",
        "--speed",
        "0.3",
        "--seconds",
        "0.5",
        "--plant",
        "octo",
        "--horizon",
        "12",
    ]
    assert main([*words, "--out", str(tmp_path / "turn")]) == 0
    report = json.loads((tmp_path / "turn" / "report.json").read_text())
    assert report["plant"] == "octo" and report["command"][2] == pytest.approx(0.3)


def test_it_walks_in_octo_s_own_simulation_at_the_defaults(tmp_path):
    assert (
        main(
            ["mpc", "mammal", "--seconds", "2", "--plant", "octo", "--out", str(tmp_path / "walk")]
        )
        == 0
    )
    report = json.loads((tmp_path / "walk" / "report.json").read_text())
    assert report["falls"] == 0 and report["velocity"][0] == pytest.approx(0.5, abs=0.15)


def test_two_ticks_are_a_motion(tmp_path):
    assert (
        main(
            [
                "mpc",
                "mammal",
                "--seconds",
                "0.02",
                "--horizon",
                "12",
                "--out",
                str(tmp_path / "short"),
            ]
        )
        == 0
    )
    assert len(list((tmp_path / "short").iterdir())) == 4


def test_falls_are_no_failure(tmp_path):
    """A push of 400 N knocks a robot of 5 kg over: exit code 0, and the fall is in the report."""
    words = [
        "mpc",
        "mammal",
        "--goal",
        "stand",
        "--seconds",
        "6",
        "--horizon",
        "12",
        "--push",
        "400,0.2,90",
    ]
    assert main([*words, "--out", str(tmp_path / "fall")]) == 0
    assert json.loads((tmp_path / "fall" / "report.json").read_text())["falls"] >= 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--goal", "jump"], "goal 'jump' is not known"),
        (["--push", "50,0.2"], "push is '50,0.2', must be newtons, positive seconds and degrees"),
        (["--push", "50,-1,0"], "push is '50,-1,0'"),
        (["--plant", "gazebo"], "plant 'gazebo' is not known"),
        (["--basis", "hermite"], "basis is 'hermite', must be 'nodes'"),
        (["--basis", "splines"], "basis 'splines' is not known; did you mean nodes?"),
        (["--noise", "-1"], "noise is -1.0, must not be negative"),
        (["--bumps", "0.02", "--plant", "octo"], "bumps need --plant mujoco"),
        (["--rate", "300"], "rate is 300.0 Hz"),
        (["--payload", "-1"], "payload is -1.0 of the trunk's mass, must be over -1"),
        (["--seconds", "0.001"], "seconds is 0.001, must be at least two ticks: 0.02"),
        (["--seconds", "2", "--push", "50,0.2,0"], "push begins at t = 5 s, seconds is 2"),
        (["--horizon", "2"], "'2', must be a whole number of at least 3"),
        (["--dt", "0"], "'0', must be positive"),
        (["--plan-friction", "-1"], "must be positive"),
        (
            ["--seconds", "0.02", "--delay", "2"],
            "delay is 2 ticks, must be less than those of the motion: 2",
        ),
        (["--device", "gpu"], "device 'gpu' is not known"),
        (["--device", "cuda"], "no control loop on a GPU, use device 'cpu'"),
        (["--terrain", "slope:100"], "slope must be a number of degrees"),
        (["--base", "fixed"], "base is 'fixed'"),
    ],
)
def test_refused_in_one_line_before_anything_is_compiled(
    words, said, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr("octo.mpc.controller.CompiledProblem", None)
    assert main(["mpc", "mammal", "--horizon", "4", *words, "--out", str(tmp_path / "none")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and error.startswith("octo: error: ") and said in error
    assert not (tmp_path / "none").exists()


def test_a_missing_mujoco_is_said_before_anything_is_compiled(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("octo.mpc.controller.CompiledProblem", None)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    assert main(["mpc", "mammal", "--out", str(tmp_path / "none")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "a plant in MuJoCo needs the extra 'robots'" in error


def test_without_a_compiler_it_says_once_that_it_is_slow(tmp_path):
    words = ["mpc", "mammal", "--seconds", "0.1", "--horizon", "5", "--out", str(tmp_path / "slow")]
    code = "import sys; from octo.cli.main import main; sys.exit(main(sys.argv[1:]))"
    environment = {**os.environ, "OCTO_NO_COMPILER": "1"}
    done = subprocess.run(
        [sys.executable, "-c", code, *words],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0 and "10 solved" in done.stdout
    assert done.stderr.count("\n") == 1 and "OCTO_NO_COMPILER is set" in done.stderr
    assert len(list((tmp_path / "slow").iterdir())) == 4


def test_ctrl_c_in_mid_run_writes_what_there_was(tmp_path):
    """A real signal, once the loop runs; the next second, not the hundred asked for, is written."""
    code = (
        "import os, signal, sys, threading\nfrom octo.cli.main import main\nfrom "
        "octo.mpc.loop import _Loop\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\nbegin = _Loop._begin\n"
        "def begun(self):\n    begin(self)\n    threading.Timer(1.0, os.kill, (os.getpid(), "
        "signal.SIGINT)).start()\n"
        "_Loop._begin = begun\nsys.exit(main(sys.argv[1:]))"
    )
    words = [
        "mpc",
        "mammal",
        "--realtime",
        "--horizon",
        "12",
        "--seconds",
        "100",
        "--out",
        str(tmp_path / "cut"),
    ]
    done = subprocess.run(
        [sys.executable, "-c", code, *words], capture_output=True, text=True, check=False
    )
    assert done.returncode == 130 and done.stderr.count("\n") == 1
    assert (
        "octo: interrupted at t = " in done.stderr
        and "of 100: what there was is written" in done.stderr
    )
    report = json.loads((tmp_path / "cut" / "report.json").read_text())
    assert report["interrupted"] and 0.02 <= report["seconds"] < 20.0
    assert len(list((tmp_path / "cut").iterdir())) == 4
