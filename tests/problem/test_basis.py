"""Nodes and Hermite: nodes of unknowns, unknowns of nodes, rows of the test functions, refused
numbers of steps."""

from __future__ import annotations

import numpy as np
import pytest

from octo.errors import ProblemError, UnknownNameError
from octo.problem.basis import Hermite, Nodes, basis_named, node_values

STEPS, N = 12, 3


def random(*shape: int) -> np.ndarray:
    return np.random.default_rng(0).standard_normal(shape)


def test_nodes_are_their_own_unknowns():
    basis = Nodes()
    x0, before, unknowns = random(2, N), random(2, N) + 1.0, random(2, STEPS, N) + 2.0
    nodes = node_values(basis.stencil(STEPS), unknowns, basis.constant(STEPS, x0, before))
    np.testing.assert_array_equal(
        nodes, np.concatenate([before[:, None], x0[:, None], unknowns], axis=1)
    )
    np.testing.assert_array_equal(basis.fit(nodes), unknowns)


def test_hermite_nodes_lie_on_the_cubics():
    """A cubic polynomial in time is its own Hermite interpolant, also over several segments."""
    basis, dt = Hermite(4), 0.1
    times = dt * np.arange(STEPS + 1)
    cubic = np.stack([1.0 + times, times**2 - times, times**3], axis=-1)
    slope = np.stack([np.ones_like(times), 2 * times - 1.0, 3 * times**2], axis=-1)
    controls = np.concatenate([cubic, 4 * dt * slope], axis=-1)[4::4]
    unknowns = np.concatenate([controls, np.zeros((1, 2 * N))])[None]
    constant = basis.constant(STEPS, cubic[:1], cubic[:1] - dt * slope[:1])
    nodes = node_values(basis.stencil(STEPS), unknowns, constant)
    np.testing.assert_allclose(nodes[0, 1:], cubic, atol=1e-14)
    np.testing.assert_allclose(nodes[0, 0], cubic[0] - dt * slope[0], atol=1e-15)


def test_hermite_fit_keeps_a_straight_motion():
    basis = Hermite(4)
    nodes = (random(1, 1, N) * np.arange(-1, STEPS + 1)[:, None]) + 0.3
    fitted = node_values(
        basis.stencil(STEPS), basis.fit(nodes), basis.constant(STEPS, nodes[:, 1], nodes[:, 0])
    )
    np.testing.assert_allclose(fitted, nodes, atol=1e-13)


@pytest.mark.parametrize("basis", [Nodes(), Hermite(4)])
def test_rows_are_the_columns_of_the_middle_nodes(basis):
    """C = Sᵀ U_/ FD with S the map of the unknowns to x_0 … x_{N−1}, the fixed c_0 included; lags 0
    to 2 only."""
    stencil = basis.stencil(STEPS)
    rows = np.zeros((STEPS, stencil.units * stencil.parts))
    for k in range(stencil.test_row.shape[1]):
        live = np.flatnonzero(stencil.test_row[:, k] >= 0)
        rows[live, stencil.test_row[live, k] * stencil.parts + stencil.test_part[live, k]] += (
            stencil.test_coefficient[live, k]
        )
    columns = np.zeros((STEPS, stencil.units * stencil.parts))
    unit = np.eye(stencil.units * stencil.parts).reshape(-1, stencil.units, stencil.parts)
    # (columns, N+2)
    moved = node_values(stencil, unit, np.zeros((len(unit), STEPS + 2, 1)))[..., 0]
    if isinstance(basis, Hermite):  # row k is control c_k, unit k is c_{k+1}
        columns[:, stencil.parts :] = moved[: -stencil.parts, 1:-1].T
        np.testing.assert_array_equal(rows[:, stencil.parts :], columns[:, stencil.parts :])
    else:  # residual i is its own row, whose newest node is unit i
        np.testing.assert_array_equal(rows, np.eye(STEPS))
    for i in range(STEPS):
        touched = stencil.unit[i : i + 3][stencil.unit[i : i + 3] >= 0]
        tested = stencil.test_row[i][stencil.test_row[i] >= 0]
        for row in tested:
            assert ((row - touched >= 0) & (row - touched <= 2)).all()


def test_refused():
    with pytest.raises(
        ProblemError, match=r"steps is 25, must be a multiple of the Hermite segment of 10 steps"
    ):
        Hermite().check(25)
    with pytest.raises(ProblemError, match="steps_per_segment is 1, must be at least 2"):
        Hermite(1).check(4)
    with pytest.raises(ProblemError, match="at least 3 steps"):
        Nodes().fixed_end(2, np.zeros(N), np.zeros(N), 0.1)
    with pytest.raises(ProblemError, match="at least 20 steps"):
        Hermite().fixed_end(10, np.zeros(N), np.zeros(N), 0.1)
    with pytest.raises(UnknownNameError, match="hermite"):
        basis_named("hermit")
