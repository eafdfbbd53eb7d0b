"""benchmarks.soft: what it says of a motion is so, and its pictures are drawn."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import soft

pytest.importorskip("skfem")


def test_a_ball_begins_to_roll(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    found = soft.measured(["ball, roll"], [0], tmp_path, most=25)["ball, roll"]
    own = found["starts"]["0"]
    assert found["limit"] == soft.CASES["ball, roll"].limit
    assert own["iterations"] == 25 and own["violation"] < 1.0
    assert own["in_the_air"] == 0.0 and 0.5 < own["way"][1] < 1.5
    assert own["largest_angles"][2] == pytest.approx(1.0 / 0.18, rel=0.2)  # rad, of 1 m
    assert (tmp_path / "soft_ball_roll.png").stat().st_size > 10_000
    assert json.loads(json.dumps(own)) == own


def test_the_chart_is_that_of_the_dynamics() -> None:
    problem, _ = soft.CASES["ball, jump"].problem()
    x = np.tile(problem.start, (3, 1))
    x[:, 3:6] = 0.3, -0.4, 0.5
    x[:, 2] = 0.1
    touches = problem.dynamics.touches(x, problem.p)
    places = problem.dynamics.body.deformed(x[0, 6:]) @ soft.turned(x[0, 3:6]).T + x[0, :3]
    np.testing.assert_allclose(touches.place, places[touches.vertex], atol=1e-12)
