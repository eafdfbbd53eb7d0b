"""The full finite-element model of a soft body, and its modes, beside what books and other ways of
computing say."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from scipy.optimize import brentq
from scipy.special import spherical_jn

from octo import soft
from octo.errors import ModelError, ProblemError, ShapeError, ValueRangeError
from octo.soft import modes
from octo.soft.build import reduced
from octo.soft.quadratic import EDGES, derivatives

pytest.importorskip("skfem")


@pytest.fixture(scope="module")
def beam() -> soft.Model:
    return soft.Model(soft.beam_mesh(0.6, 0.12, 0.1, (6, 2, 2)), 1e5, 0.4, 250.0)


@pytest.fixture(scope="module")
def ball() -> soft.Model:
    return soft.Model(soft.ball_mesh(0.2, 2), 1e4, 0.4, 250.0)


# -- modes -----------------------------------------------------------------------------------------


def test_frequencies_are_those_of_the_dense_matrices(beam: soft.Model) -> None:
    """The same matrices, solved whole: to 1e-8."""
    assert beam.stiffness.shape[0] > modes.SMALL  # by shift and invert
    values, _ = beam.modes(10)
    whole = scipy.linalg.eigvalsh(beam.stiffness.toarray(), beam.mass.toarray())
    assert np.abs(whole[:6]).max() < 1e-9 * whole[6]
    np.testing.assert_allclose(values, whole[6:16], rtol=1e-8)


def test_modes_solve_the_eigenproblem(beam: soft.Model) -> None:
    values, shapes = beam.modes(8)
    vectors = shapes.transpose(0, 2, 1).reshape(-1, 8)
    np.testing.assert_allclose(vectors.T @ (beam.mass @ vectors), np.eye(8), atol=1e-12)
    force = beam.stiffness @ vectors
    rest = force - (beam.mass @ vectors) * values
    assert np.abs(rest).max() < 1e-7 * np.abs(force).max()
    rigid = modes.rigid_motions(beam.mass, beam.nodes)
    assert np.abs(rigid.T @ (beam.mass @ vectors)).max() < 1e-12
    assert np.abs(beam.stiffness @ rigid).max() < 1e-10 * np.abs(force).max()


def test_a_ball_turns_and_stretches_as_lamb_says() -> None:
    """Lamb (1882): the lowest five modes of a free ball twist it, at x = ωR/c_s with
    (l − 1) j_l(x) = x j_(l+1)(x), l = 2."""
    model = soft.Model(soft.ball_mesh(0.2, 4), 1e4, 0.4, 250.0)
    wave = np.sqrt(1e4 / (2.0 * 1.4) / 250.0)
    expected = brentq(lambda x: spherical_jn(2, x) - x * spherical_jn(3, x), 2.0, 3.0)
    found = np.sqrt(model.modes(10)[0]) * 0.2 / wave
    np.testing.assert_allclose(found[:5], expected, rtol=3e-3)
    assert found[5] / found[4] > 1.05 and np.ptp(found[5:]) < 2e-3  # the five that stretch it


def test_a_slender_beam_swings_as_euler_says() -> None:
    """Free at both ends: ω = 4.730² √(EI/ρA)/L²."""
    model = soft.Model(soft.beam_mesh(1.0, 0.02, 0.02, (30, 1, 1)), 1e6, 0.0, 1000.0)
    euler = 4.730041**2 * np.sqrt(1e6 * 0.02**2 / 12.0 / 1000.0)
    np.testing.assert_allclose(np.sqrt(model.modes(2)[0]), euler, rtol=5e-3)


def test_signs_and_turns_do_not_depend_on_the_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """A square beam has pairs of modes of one frequency, of which any mixture is a mode."""
    long = soft.Model(soft.beam_mesh(0.6, 0.1, 0.1, (6, 2, 2)), 1e5, 0.4, 250.0)
    found, shapes = long.modes(6)
    monkeypatch.setattr(modes, "SMALL", 10**9)
    dense, same = long.modes(6)
    np.testing.assert_allclose(dense, found, rtol=1e-9)
    np.testing.assert_allclose(same, shapes, atol=1e-6 * np.abs(shapes).max())


def test_modes_of_one_frequency_are_settled() -> None:
    """Two vectors of one eigenvalue, turned: the same come out."""
    model = soft.Model(soft.ball_mesh(0.2, 2), 1e4, 0.4, 250.0)
    _, shapes = model.modes(2)
    pair = shapes.transpose(0, 2, 1).reshape(-1, 2)
    turn = np.array([[0.6, -0.8], [-0.8, -0.6]])
    one, other = (
        modes._settled(np.ones(2), vectors, model.mass, model.nodes)
        for vectors in (pair, pair @ turn)
    )
    np.testing.assert_allclose(one, other, atol=1e-9 * np.abs(one).max())


def test_more_modes_than_the_mesh_has() -> None:
    corner = np.concatenate([np.zeros((1, 3)), 0.1 * np.eye(3)])
    model = soft.Model(soft.Tetrahedra(corner, [[0, 1, 2, 3]]), 1e5, 0.3, 500.0)
    assert len(model.modes(24)[0]) == 24
    with pytest.raises(ValueRangeError, match=r"modes is 25, must be at most 24: mesh 'mesh' has"):
        model.modes(25)


def test_modes_that_are_not_found(beam: soft.Model, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = modes.eigsh
    monkeypatch.setattr(modes, "eigsh", lambda *a, **o: whole(*a, **{**o, "maxiter": 1, "ncv": 21}))
    with pytest.raises(ModelError, match="mesh 'beam' has modes that were not found: ARPACK error"):
        beam.modes(10)


# -- statics ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("poisson", "off"), [(0.0, 1e-3), (0.3, 1e-2)])
def test_a_clamped_beam_sags_as_beam_theory_says(poisson: float, off: float) -> None:
    """ρgAL⁴/8EI and Timoshenko's shear; what holds the clamped end from getting wider is left out
    there."""
    length, side, young, density = 1.0, 0.05, 1e6, 1000.0
    model = soft.Model(soft.beam_mesh(length, side, side, (30, 2, 2)), young, poisson, density)
    moved = model.sag(model.nodes[:, 0] < -0.5 * length + 1e-9)
    tip = -moved[model.nodes[:, 0] > 0.5 * length - 1e-9, 2].mean()
    load, shear = density * 9.81, young / (2.0 * (1.0 + poisson))
    share = 10.0 * (1.0 + poisson) / (12.0 + 11.0 * poisson)
    bent = load * 12.0 * length**4 / (8.0 * young * side**2)
    theory = bent + load * length**2 / (2.0 * share * shear)
    assert abs(tip / theory - 1.0) < off


def test_fewer_elements_sag_less() -> None:
    tips = []
    for blocks in ((5, 1, 1), (10, 1, 1), (20, 1, 1)):
        model = soft.Model(soft.beam_mesh(1.0, 0.05, 0.05, blocks), 1e6, 0.3, 1000.0)
        tips.append(np.abs(model.sag(np.flatnonzero(model.nodes[:, 0] < -0.499))).max())
    assert tips[0] < tips[1] < tips[2]


def test_what_is_held_is_checked(ball: soft.Model) -> None:
    with pytest.raises(ProblemError, match="three nodes at least"):
        ball.sag([0, 1])
    with pytest.raises(ValueRangeError, match=f"whole ones from 0 to {len(ball.nodes) - 1}"):
        ball.sag([0, 1, 10**6])
    with pytest.raises(ShapeError, match="acceleration"):
        ball.sag([0, 1, 2], [0.0, 9.81])


def test_few_modes_come_close_to_all_of_them(ball: soft.Model) -> None:
    """A ball that is pressed flat all through: the work of 6, 10, 60 and all modes."""
    force = np.zeros((len(ball.nodes), 3))
    force[:, 2] = -(ball.node_mass @ (ball.nodes - ball.center)[:, 2])
    moved = np.linalg.lstsq(ball.stiffness.toarray(), force.ravel(), rcond=1e-12)[0]
    whole = force.ravel() @ moved
    short = []
    for count in (6, 10, 60, 3 * len(ball.nodes) - 6):
        values, shapes = ball.modes(count)
        own = np.einsum("nrk,nk->r", shapes, force)
        short.append(1.0 - own @ (own / values) / whole)
    assert 0.5 < short[0] < 1.0  # five twist it, and one stretches it
    assert 0.0 < short[1] < 0.1 and 0.0 < short[2] < 2e-3
    assert abs(short[3]) < 1e-8


# -- inertia ---------------------------------------------------------------------------------------


def shape_functions(where: np.ndarray) -> np.ndarray:
    """(k, 10) at points (k, 3) of the unit element."""
    share = np.column_stack([1.0 - where.sum(axis=1), where])
    a, b = EDGES.T
    return np.concatenate([share * (2.0 * share - 1.0), 4.0 * share[:, a] * share[:, b]], axis=1)


def by_quadrature(model: soft.Model, count: int) -> np.ndarray:
    """∫ρ Y Yᵀ by Gauss' points of a cube, each element a cube with one side drawn to a point."""
    at, weight = np.polynomial.legendre.leggauss(7)
    at, weight = 0.5 * (at + 1.0), 0.5 * weight
    u, v, w = (grid.ravel() for grid in np.meshgrid(at, at, at, indexing="ij"))
    weights = np.einsum("i,j,k->ijk", weight, weight, weight).ravel() * (1 - u) ** 2 * (1 - v)
    where = np.column_stack([u, v * (1 - u), w * (1 - u) * (1 - v)])
    values, slopes = shape_functions(where), derivatives(where)
    _, shapes = model.modes(count)
    place = model.nodes - model.center
    spread = [place, shapes.reshape(len(place), -1), np.ones((len(place), 1))]
    every = np.concatenate(spread, axis=1)
    total = np.zeros((every.shape[1],) * 2)
    for cell in model.mesh.cells:
        volume = np.linalg.det(np.einsum("kna,nb->kab", slopes, model.nodes[cell]))
        there = values @ every[cell]
        total += model.density * (there.T * (weights * volume)) @ there
    return total


@pytest.mark.parametrize("name", ["ball", "beam"])
def test_inertia_is_that_of_quadrature(name: str, request: pytest.FixtureRequest) -> None:
    model = request.getfixturevalue(name)
    made = reduced(model, 4)["inertia"]
    expected = by_quadrature(model, 4)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs((made - expected) / scale).max() < 1e-12


def test_shape_functions_and_their_slopes_agree() -> None:
    where = np.array([[0.1, 0.2, 0.3], [0.5, 0.1, 0.2]])
    for axis in range(3):
        step = 1e-6 * np.eye(3)[axis]
        slope = (shape_functions(where + step) - shape_functions(where - step)) / 2e-6
        np.testing.assert_allclose(derivatives(where)[:, :, axis], slope, atol=1e-8)
