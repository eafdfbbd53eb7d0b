"""L-BFGS: its direction is that of BFGS in full, its steps satisfy Wolfe's conditions, and it finds
minima whose place is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import rosen, rosen_der

from octo.learn import lbfgs


def valley(w: np.ndarray) -> tuple[float, np.ndarray]:
    return float(rosen(w)), rosen_der(w)


def minimised(loss, w: np.ndarray, iterations: int = 500) -> tuple[str, list[float], np.ndarray]:
    """Why it ended, the loss of each evaluation, and where it was least."""
    seen: list[tuple[float, np.ndarray]] = []

    def kept(at: np.ndarray) -> tuple[float, np.ndarray]:
        value, gradient = loss(at)
        seen.append((value, at.copy()))
        return value, gradient

    why = lbfgs.minimise(kept, w, iterations, 5, 0.1, lambda: False)
    least = min(seen, key=lambda one: one[0] if np.isfinite(one[0]) else np.inf)
    return why, [value for value, _ in seen], least[1]


def test_the_direction_is_that_of_bfgs() -> None:
    """H of algorithm 6.1 of Nocedal and Wright, from γ I on (7.20)."""
    random, n = np.random.default_rng(0), 6
    root = random.standard_normal((n, n))
    curved = root @ root.T + np.eye(n)
    memory = lbfgs.Memory(3, n)
    pairs = [(s, curved @ s) for s in random.standard_normal((5, n))]
    for s, y in pairs:
        memory.add(s, y)
    s, y = pairs[-1]
    H = (s @ y) / (y @ y) * np.eye(n)
    for s, y in pairs[-3:]:
        rho = 1.0 / (s @ y)
        V = np.eye(n) - rho * np.outer(y, s)
        H = V.T @ H @ V + rho * np.outer(s, s)
    gradient = random.standard_normal(n)
    np.testing.assert_allclose(memory.direction(gradient), -H @ gradient, rtol=1e-12)
    memory.add(s, -y)  # of negative curvature: left out
    np.testing.assert_allclose(memory.direction(gradient), -H @ gradient, rtol=1e-12)


@pytest.mark.parametrize("n", [2, 40])
def test_it_follows_a_curved_valley(n: int) -> None:
    why, values, at = minimised(valley, np.full(n, -0.5))
    np.testing.assert_allclose(at, 1.0, atol=1e-6)
    assert why in (lbfgs.CONVERGED, lbfgs.NO_STEP, lbfgs.LIMIT) and len(values) < 1000


def test_steps_satisfy_wolfe() -> None:
    w = np.array([-1.2, 1.0])
    value, gradient = valley(w)
    way = -gradient
    slope = float(way @ gradient)
    for first in (1e-8, 1e-3, 1.0, 100.0):
        size, new, there = lbfgs.step(valley, w, way, value, slope, first)
        assert new == rosen(w + size * way)
        assert new <= value + lbfgs.DECREASE * size * slope
        assert there @ way >= lbfgs.CURVATURE * slope


def test_a_wall_is_stepped_back_from() -> None:
    """log has no value beyond zero; there it is infinite."""

    def walled(w: np.ndarray) -> tuple[float, np.ndarray]:
        if (w <= 0.0).any():
            return np.inf, np.zeros_like(w)
        return float((w - 0.01 * np.log(w)).sum()), 1.0 - 0.01 / w

    why, values, at = minimised(walled, np.full(3, 5.0))
    assert not np.isfinite(values).all()
    np.testing.assert_allclose(at, 0.01, rtol=1e-6)
    assert why != lbfgs.LIMIT


def test_it_ends_where_it_is_told_to() -> None:
    calls: list[int] = []

    def watch() -> bool:
        calls.append(1)
        return len(calls) == 3

    assert lbfgs.minimise(valley, np.zeros(4), 99, 5, 0.1, watch) == lbfgs.WATCHED
    assert len(calls) == 3
    assert lbfgs.minimise(valley, np.zeros(4), 2, 5, 0.1, lambda: False) == lbfgs.LIMIT
    assert lbfgs.minimise(valley, np.ones(4), 9, 5, 0.1, lambda: False) == lbfgs.CONVERGED
