"""What a motion misses of what was asked is printed, reported, and ends a command with 1."""

from __future__ import annotations

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

import octo
from octo.cli import solve as command
from octo.cli.main import main
from octo.cli.written import write_json
from octo.goals import Goal
from octo.model.gallery import mammal
from octo.problem.asked import Asked
from octo.problem.costs import Cost
from octo.result.solution import Solution
from octo.solve import evaluated
from octo.solver.status import Status

ROBOT = mammal()
N, DT = 10, 0.05  # s


def moved(
    *terms: Cost, x: float = 0.0, y: float = 0.0, yaw: float = 0.0, top: float = 0.0
) -> Solution:
    """A robot that glides: x, y (m) and yaw (rad) in N steps, and up by ``top`` (m) half way."""
    pose = ROBOT.default_pose
    nodes = np.repeat(pose[None], N + 1, axis=0)
    part = np.linspace(0.0, 1.0, N + 1)
    nodes[:, 0] += x * part
    nodes[:, 1] += y * part
    nodes[:, 2] += 4.0 * top * part * (1.0 - part)
    nodes[:, 3] += yaw * part
    problem = octo.Problem(ROBOT, steps=N, dt=DT, x0=pose, costs=[octo.Effort(), *terms])
    return evaluated(problem, nodes, Status.CONVERGED)


GOALS = {  # of 0.5 s
    "walk": (Goal("walk", 0.5), {"x": 0.25}, {"x": 0.15}),
    "walk backwards": (Goal("walk", -0.5), {"x": -0.25}, {"x": 0.25}),
    "walk that drifts": (Goal("walk", 0.5), {"x": 0.25, "y": 0.01}, {"x": 0.25, "y": 0.1}),
    "stride": (Goal("stride", 0.3), {"y": 0.15}, {"y": 0.08}),
    "turn": (Goal("turn", 0.8), {"yaw": 0.4}, {"yaw": 0.3}),
    "turn the other way": (Goal("turn", -0.8), {"yaw": -0.4}, {"yaw": 0.4}),
    "stand": (Goal("stand"), {}, {"x": 0.02}),
    "jump": (
        Goal("jump", distance=0.5, height=0.2),
        {"x": 0.5, "top": 0.2},
        {"x": 0.3, "top": 0.2},
    ),
    "high jump": (Goal("jump", distance=0.0, height=0.3), {"top": 0.3}, {"top": 0.2}),
    "long jump that is flat": (
        Goal("jump", distance=1.0, height=0.1),
        {"x": 1.0, "top": 0.1},
        {"x": 1.0},
    ),
}


@pytest.mark.parametrize("name", GOALS)
def test_every_goal_says_that_it_was_missed(name, tmp_path):
    goal, right, wrong = GOALS[name]
    met, missed = goal.said(moved(**right)), goal.said(moved(**wrong))
    assert goal.met(met) and f"goal {goal.kind}" not in str(met)
    assert not goal.met(missed) and f"goal {goal.kind} missed: " in str(missed)
    record = missed.report()["asked"][0]
    assert record["met"] is False and record["name"] == f"goal {goal.kind}"
    json.dumps(record, allow_nan=False)
    missed.save(tmp_path / "a.npz")
    assert Solution.load(tmp_path / "a.npz").asked == missed.asked


SPEED = octo.CenterOfMassVelocity
TERMS: dict[str, tuple[Cost, dict[str, float], dict[str, float], str]] = {
    "speed": (SPEED((0.5, 0.0, 0.0)), {"x": 0.25}, {"x": 0.1}, r"\(0.20, 0.00\) m/s, asked"),
    "speeds": (
        SPEED(np.linspace([0.0, 0, 0], [1.0, 0, 0], N)),
        {"x": 0.25},
        {"x": 0.4},
        "0.80, 0.00",
    ),
    "place": (
        octo.CenterOfMassPosition(tuple(moved().com[0] + [0.4, 0.0, 0.0])),
        {"x": 0.4},
        {"x": 0.2},
        "off by 0.2 m",
    ),
    "way": (octo.CenterOfMassDisplacement((0.0, 0.3, 0.0)), {"y": 0.3}, {"y": -0.3}, "by 0.6 m"),
    "rate": (
        octo.BaseAngularVelocity((0, 0, 1.0), axes=(0, 0, 1)),
        {"yaw": 0.5},
        {"yaw": 0.3},
        "the base turns at 0.60 rad/s",
    ),
    "point": (
        octo.PointPosition(body="trunk", target=tuple(ROBOT.default_pose[:3] + [0.5, 0.0, 0.0])),
        {"x": 0.5},
        {"x": 0.1},
        "the point of body 'trunk' gets to",
    ),
    "pose": (
        octo.PoseTarget(moved(x=0.5).x[-1]),
        {"x": 0.5},
        {"x": 0.3},
        "the configuration gets to; off by 0.2 rad and m",
    ),
}
QUIET = {
    "still": SPEED((0.0, 0.0, 0.0)),  # nothing is to move: no goal
    "off": SPEED((9.0, 0.0, 0.0), weight=0.0),
    "height": octo.BaseHeight(),
    "posture": octo.Posture(),
    "slip": octo.Slip(),
}
ALL = [
    replace(term, name=name)
    for name, term in {**{name: given[0] for name, given in TERMS.items()}, **QUIET}.items()
]


@pytest.mark.parametrize("name", TERMS)
def test_a_term_says_what_it_asked_for(name):
    _, right, wrong, said = TERMS[name]
    met, missed = moved(*ALL, **right), moved(*ALL, **wrong)
    assert next(one for one in met.asked if one.name == name).met
    assert not next(one for one in missed.asked if one.name == name).met
    assert f"{name} missed: " not in str(met)
    with pytest.raises(AssertionError, match=f"{name} missed: .*{said}"):
        raise AssertionError(str(missed))


def test_what_asks_for_nothing_misses_nothing():
    found = moved(*ALL, x=0.1, y=0.3, yaw=1.0)
    assert [one.name for one in found.asked] == list(TERMS)


def test_the_last_step_that_weighs_is_the_one_that_counts():
    """As the top of a jump, half way."""
    top = np.zeros(N)
    top[N // 2 - 1] = 3.0
    above = octo.CenterOfMassDisplacement((0.25, 0.0, 0.2), weight=top)
    assert moved(above, x=0.5, top=0.2).asked[0].met
    assert not moved(above, x=0.5, top=0.05).asked[0].met


def test_what_is_not_finite_is_missed():
    assert not Asked.of("a", "b", np.nan, 1.0, "m").met
    assert not Asked.of("a", "b", (1.0, np.nan), (1.0, 1.0), "m", each=True).met


def test_a_slope_may_be_climbed_by_a_walk_on_the_level():
    term = octo.CenterOfMassVelocity((0.5, 0.0, 0.0))
    assert moved(term, x=0.25, top=0.0).asked[0].met
    up = octo.CenterOfMassVelocity((0.5, 0.0, 0.2))
    assert not moved(up, x=0.25).asked[0].met


def written(folder, solution, report):
    """The report without the pictures."""
    folder.write({"report.json": lambda path: write_json(path, report())})


@pytest.mark.parametrize("kind", ["walk", "stride", "turn", "jump", "stand"])
def test_the_command_prints_reports_and_exits_with_1(kind, tmp_path, monkeypatch, capsys):
    """The solver is a stand-in that slides a little instead of what was asked."""
    stand_in = moved(x=0.03)
    monkeypatch.setattr(command, "from_rest_to_rest", lambda *given: stand_in)
    monkeypatch.setattr(command, "as_one_problem", lambda *given: stand_in)
    monkeypatch.setattr(command, "write", written)
    words = ["solve", "mammal", "--goal", kind, "--device", "cpu", "--out", str(tmp_path)]
    assert main(words) == 1
    assert capsys.readouterr().out.count(f"goal {kind} missed: ") == 1
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["goal"] == kind and report["goal_met"] is False and report["goal_error"] > 0.1
    assert [one["met"] for one in report["asked"]] == [False]
    assert main([*words, "--accept-missed"]) == 0
    assert f"goal {kind} missed: " in capsys.readouterr().out
    stalled = replace(stand_in, status=Status.STALLED)
    monkeypatch.setattr(command, "as_one_problem", lambda *given: stalled)
    monkeypatch.setattr(command, "from_rest_to_rest", lambda *given: stalled)
    assert main([*words, "--accept-missed"]) == 1


def test_a_front_door_says_it_too(monkeypatch):
    """octo.walk, stride, turn and jump, without the shell."""
    assert callable(octo.jump)
    monkeypatch.setattr("octo.motions.steady.from_rest_to_rest", lambda *given: moved(x=0.02))
    monkeypatch.setattr(
        sys.modules["octo.jump"], "solve_jump", lambda *given, **options: moved(x=0.02)
    )
    found = {
        "walk": octo.walk(ROBOT, 0.5),
        "stride": octo.stride(ROBOT, 0.5),
        "turn": octo.turn(ROBOT, 0.5),
        "jump": octo.jump(ROBOT, 0.2, 0.5),
    }
    for kind, solution in found.items():
        assert f"goal {kind} missed: " in str(solution)
        assert solution.report()["asked"][0]["met"] is False
