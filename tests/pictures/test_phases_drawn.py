"""Pictures and figures of phases with steps of several lengths: each moment at its own time."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import motions
import numpy as np
import pytest

import octo
from octo.plot import plot
from octo.result.even import ROWS, even
from octo.result.gait import measure_gait
from octo.result.solution import Solution

FIRST, SECOND = 0.04, 0.015  # s
END = 10 * FIRST + 40 * SECOND


@pytest.fixture(scope="module")
def joined() -> Solution:
    robot = octo.gallery.mammal()
    parts = [motions.wandering(robot, 10, FIRST), motions.wandering(robot, 40, SECOND)]
    rows = {name: np.concatenate([getattr(one, name) for one in parts]) for name in ROWS}
    x = np.concatenate([parts[0].x, parts[1].x[2:]])
    x[:, 0] = np.concatenate([[-FIRST], np.cumsum([0.0, *[FIRST] * 10, *[SECOND] * 40])])  # 1 m/s
    return dataclasses.replace(parts[0], dt=END / 50, x=x, **rows, phases=tuple(parts))


def test_times_and_velocities(joined):
    assert joined.times[[0, 10, 50]] == pytest.approx([0.0, 0.4, END])
    np.testing.assert_allclose(joined.v[:, 0], 1.0)
    qvel = joined.to_mujoco()[1]
    np.testing.assert_allclose(qvel[:, 0], 1.0)
    leap = joined.largest_step
    assert leap is not None and leap["time"] == pytest.approx(joined.times[leap["step"]])
    assert joined.sampling == "50 steps of 0.015 to 0.04 s in 2 phases"


def test_equal_steps(joined):
    same = even(joined)
    assert not same.phases and same.dt == pytest.approx(END / round(END / SECOND))
    np.testing.assert_allclose(same.v[:, 0], 1.0)
    np.testing.assert_allclose(same.x[1:, 0], same.times)
    middle = same.times[:-1] + 0.5 * same.dt
    step = np.searchsorted(joined.times, middle) - 1
    np.testing.assert_array_equal(same.u, joined.u[step])
    np.testing.assert_array_equal(same.normal_force, joined.normal_force[step])
    assert even(same) is same


def test_equal_steps_stay_as_they_are():
    part = motions.wandering(octo.gallery.mammal(), 10, FIRST)
    whole = even(dataclasses.replace(part, phases=(part,)))
    np.testing.assert_array_equal(whole.x, part.x)
    assert whole.dt == part.dt and not whole.phases


def test_a_gait_counts_seconds(joined):
    gait, same = measure_gait(joined), measure_gait(even(joined))
    assert gait is not None and gait == same
    on = joined.stance
    begun = (on[1:] & ~on[:-1]).sum(axis=0).max()
    assert gait.touchdowns == pytest.approx(begun / END) and begun > 0


def test_pictures(joined, tmp_path: Path):
    figure = plot(joined, tmp_path / "plot.png")
    panels = [axes for axes in figure.axes if axes.get_xlabel() == "time (s)"]
    for axes in panels:
        begun = [line for line in axes.lines if list(line.get_xdata()) == [0.4, 0.4]]
        assert len(begun) == 1, axes.get_title(loc="left")
    octo.filmstrip(joined, tmp_path / "strip.png", between=(0.2, 0.9))
    text = octo.view(joined).text
    assert f"of {END:.3f} s" in text
