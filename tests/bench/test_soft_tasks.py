"""benchmarks.soft and benchmarks.soft_checks: what they say of a motion is so, and their pictures
are drawn."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import soft, soft_checks

pytest.importorskip("skfem")


@pytest.mark.slow
def test_a_ball_begins_to_roll(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    found = soft.measured(["ball, roll"], [0], tmp_path, other=False, most=25)["ball, roll"]
    own = found["starts"]["0"]
    assert found["limit"] == soft.CASES["ball, roll"].limit
    assert own["iterations"] == 25 and own["violation"] < 1.0
    assert own["in_the_air"] == 0.0 and 0.5 < own["way"][0] < 1.5
    assert own["largest_angles"][2] == pytest.approx(1.0 / 0.18, rel=0.2)  # rad, of 1 m
    assert (tmp_path / "soft_ball_roll.png").stat().st_size > 10_000
    assert json.loads(json.dumps(own)) == own


def test_where_a_bouncing_height_is_lowest_and_highest() -> None:
    times = np.linspace(0.0, 3.0, 3001)
    found = soft_checks.turns(times, np.cos(2.0 * np.pi * times))
    np.testing.assert_allclose(found["low"], [[0.5, -1.0], [1.5, -1.0], [2.5, -1.0]], atol=1e-9)
    np.testing.assert_allclose(found["high"], [[1.0, 1.0], [2.0, 1.0]], atol=1e-9)


def test_a_body_that_grows_is_measured() -> None:
    own = soft_checks.grown(4, (3, 1, 1))
    assert own["modes"] == 4 and own["points"] > 30 and 0.0 < own["contacts"] <= own["points"]
    assert own["iteration"] > 0.0 and own["compile"] > 0.0
