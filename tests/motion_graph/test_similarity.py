"""Kovar's metric in closed form, against a numerical minimum."""

import numpy as np
import pytest
from scipy.optimize import minimize

import octo
from octo.errors import ShapeError, ValueRangeError
from octo.motion_graph.similarity import aligned, points_of, windows

WINDOWS, FRAMES, POINTS = 3, 5, 7


def _clouds(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((WINDOWS, FRAMES, POINTS, 3))


def _moved(points: np.ndarray, yaw: float, shift: np.ndarray) -> np.ndarray:
    c, s = np.cos(yaw), np.sin(yaw)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return points @ turn.T + np.append(shift, 0.0)


def _numerical(p: np.ndarray, q: np.ndarray, w: np.ndarray) -> float:
    """The least root mean square distance, over yaw and place, from eight starts."""

    def square(v: np.ndarray) -> float:
        away = p - _moved(q, v[0], v[1:])
        return float((w * (away**2).sum(axis=-1)).sum() / w.sum())

    starts = np.linspace(-np.pi, np.pi, 8, endpoint=False)
    how = {"gtol": 1e-10}
    found = [minimize(square, [yaw, 0.0, 0.0], method="BFGS", options=how).fun for yaw in starts]
    return float(np.sqrt(min(found)))


@pytest.mark.parametrize("weighted", [False, True])
def test_the_closed_form_is_the_least_over_yaw_and_place(weighted):
    p, q = _clouds(0), _clouds(1)
    w = np.random.default_rng(2).random((FRAMES, POINTS)) if weighted else None
    found = aligned(p, q, w)
    weights = np.ones((FRAMES, POINTS)) if w is None else w
    for a in range(WINDOWS):
        for b in range(WINDOWS):
            least = _numerical(p[a], q[b], weights)
            assert found.distance[a, b] == pytest.approx(least, rel=1e-9)
            away = p[a] - _moved(q[b], found.yaw[a, b], found.shift[a, b])
            own = np.sqrt((weights * (away**2).sum(axis=-1)).sum() / weights.sum())
            assert found.distance[a, b] == pytest.approx(own, rel=1e-12)


def test_a_motion_carried_along_and_turned_is_the_same():
    p = _clouds(3)
    found = aligned(p, _moved(p, 0.7, np.array([2.0, -3.0])))
    assert np.abs(np.diag(found.distance)).max() < 1e-7
    assert np.allclose(np.diag(found.yaw), -0.7)


def test_a_robot_walks_on_its_own_cloud():
    robot = octo.load("mammal")
    x = np.zeros((6, robot.nx))
    x[:, 0] = np.arange(6)
    points = points_of(robot, x)
    own = windows(points, np.array([0, 3]), 3)
    assert own.shape == (2, 3, points.shape[1], 3)
    assert (windows(points, np.array([0]), 3, -1) == points[0]).all()  # held before the first
    assert aligned(own, own).distance == pytest.approx(np.zeros((2, 2)), abs=1e-7)


def test_what_does_not_fit_is_refused():
    p = _clouds(0)
    with pytest.raises(ShapeError, match="other"):
        aligned(p, p[:, 1:])
    with pytest.raises(ValueRangeError, match="weights"):
        aligned(p, p, -np.ones((FRAMES, POINTS)))
