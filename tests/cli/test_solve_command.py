"""``octo solve`` of natural terms: a walk around a stride, one problem where there is none, what
stops it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import octo
from octo.cli.main import main
from octo.result.solution import Solution
from octo.solver.sqp import Iterate
from octo.solver.status import Status

QUICK = ("--seeds", "1", "--device", "cpu", "--out")
SHORT = ("--seconds", "0.5", "--speed", "0.2")
HILLS = """
import casadi as ca

def hills(point, p):
    return point[2] - 0.02 * ca.sin(3 * point[0])
"""


def at_rest(solution: Solution) -> bool:
    """Whether it begins and ends without a velocity."""
    moved = np.abs(np.diff(solution.x, axis=0)).max(axis=1)
    return bool(moved[0] == 0.0 and moved[-1] < 1e-9)


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a walk of 2.5 s around strides of 0.6 s."""
    out = tmp_path_factory.mktemp("walk")
    assert main(["solve", "mammal", "--seconds", "2.5", "--period", "0.6", *QUICK, str(out)]) == 0
    return out


def test_a_walk_goes_from_rest_to_rest_in_strides(walked: Path) -> None:
    solution = Solution.load(walked / "solution.npz")
    report = json.loads((walked / "report.json").read_text())
    assert sorted(path.name for path in walked.iterdir()) == [
        "motion.html",
        "plot.png",
        "report.json",
        "solution.npz",
    ]
    assert at_rest(solution) and solution.steps == 100 and solution.cycle is None
    assert solution.com[-1] - solution.com[0] == pytest.approx([1.25, 0.0, 0.0], abs=1e-3)
    # it stands as it stood
    np.testing.assert_allclose(solution.x[-1, 6:], solution.x[1, 6:], atol=1e-9)
    assert solution.pointwise_residual < 1e-6 * solution.weight
    assert report["goal"] == "walk" and report["goal_met"] is True and report["goal_error"] < 0.01
    assert [record["period"] for record in report["starts"]] == pytest.approx([0.6])
    assert report["gait"]["touchdowns"] < 3.0 and report["gait"]["clearance"] > 0.01
    assert report["penetration"] < 0.004 and report["seconds"] > 0.1


def test_what_is_too_short_for_a_stride_is_one_problem(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["solve", "mammal", "--goal", "stride", *SHORT, *QUICK, str(tmp_path)]) == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "without a stride" in line]
    assert said == [
        "octo: 0.5 s are too short for a stride between rest and rest: solved as one "
        "problem, without a stride"
    ]
    solution = Solution.load(tmp_path / "solution.npz")
    assert at_rest(solution) and solution.converged
    assert solution.x[-1, :3] - solution.x[1, :3] == pytest.approx([0.0, 0.1, 0.0], abs=1e-6)


@pytest.mark.slow
def test_uneven_ground_has_no_stride(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "ground.py").write_text(HILLS)
    words = ["--seconds", "2.5", "--speed", "0.1", "--period", "0.6", "--time-limit", "1e-3"]
    words += ["--terrain", f"{tmp_path}/ground.py:hills"]
    # there was no time
    assert main(["solve", "mammal", *words, *QUICK, str(tmp_path / "walk")]) == 1
    said = [line for line in capsys.readouterr().err.splitlines() if "without a stride" in line]
    assert len(said) == 1 and "a cycle needs ground that is the same everywhere" in said[0]
    solution = Solution.load(tmp_path / "walk" / "solution.npz")
    assert at_rest(solution) and solution.status is Status.TIME_LIMIT
    assert solution.x[-1, 0] - solution.x[1, 0] == pytest.approx(0.25)
    # it stands higher there
    assert solution.x[-1, 2] - solution.x[1, 2] == pytest.approx(0.02 * np.sin(0.75), abs=0.01)


def test_a_turn_ends_turned() -> None:
    turned = octo.turn(octo.gallery.mammal(), -0.8, 0.5, starts=1, device="cpu")
    assert turned.converged and at_rest(turned)
    assert turned.yaw[-1] - turned.yaw[0] == pytest.approx(-0.4)


@pytest.mark.parametrize("pieces", [False, True])
def test_who_stops_it_gets_the_stride(pieces: bool) -> None:
    """A callback stops as Ctrl-C does; after it nothing is solved any more."""
    after: list[int] = []

    def stop(iterate: Iterate) -> bool:
        done = iterate.nodes.shape[1] > 20 or not pieces  # half a stride has 14 nodes
        if done:
            after.append(iterate.iteration)
        return done

    options = {"starts": 1, "period": (0.5, 0.6), "device": "cpu", "callback": stop}
    stopped = octo.walk(octo.gallery.mammal(), 0.5, 2.5, **options)
    assert stopped.status is Status.INTERRUPTED and after == [0]
    assert stopped.cycle is not None and len(stopped.starts) == (2 if pieces else 1)  # periods
    assert (stopped.violation < 1e-6 * stopped.weight) == pieces


def test_a_stand_ends_where_it_began(tmp_path: Path) -> None:
    words = ["--goal", "stand", "--seconds", "0.5", "--passes", "1"]
    assert main(["solve", "mammal", *words, *QUICK, str(tmp_path)]) == 0
    solution = Solution.load(tmp_path / "solution.npz")
    assert at_rest(solution) and np.array_equal(solution.x[1], solution.x[-1])
    assert {"LoadSharing", "BodyLoad", "SlipPower"} <= set(
        solution.terms
    ) and "CenterOfMassVelocity" not in solution.terms


def test_hermite_has_the_terms_of_the_paper(tmp_path: Path) -> None:
    words = ["--basis", "hermite", "--seconds", "0.5", "--max-iterations", "2"]
    assert main(["solve", "mammal", *words, *QUICK, str(tmp_path)]) in (0, 1)
    assert set(Solution.load(tmp_path / "solution.npz").terms) == {"CenterOfMassVelocity", "Effort"}
