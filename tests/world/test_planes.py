"""A plane made as a shape, a box, a grid and a mesh: a robot moves on each as on the plane."""

from __future__ import annotations

import numpy as np
import pytest

import octo
from octo import World, shapes
from octo.continuation.member import CONTACT

HALF, DEEP, CELL = 1.2, 1.0, 0.025  # m, of a plate and of the grids


def box_mesh() -> shapes.Mesh:
    """The plate as twelve triangles."""
    signs = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (0, 1)])
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = [half for a, b, c, d in quads for half in ([a, b, c], [a, c, d])]
    vertices = signs * [HALF, HALF, DEEP] - [0.0, 0.0, DEEP]
    return shapes.Mesh(vertices, faces, cell=CELL)


def grid() -> shapes.DistanceGrid:
    heights = CELL * np.arange(-10.0, 17.0)
    sides = 2 * round(HALF / CELL) + 1
    values = np.broadcast_to(heights, (sides, sides, len(heights)))
    return shapes.DistanceGrid(values, CELL, (-HALF, -HALF, heights[0]))


PLANES = {
    "ground": lambda: shapes.Ground(),
    "box": lambda: shapes.Box((2.0 * HALF, 2.0 * HALF, DEEP), position=(0.0, 0.0, -0.5 * DEEP)),
    "grid": grid,
    "mesh": box_mesh,
}


@pytest.fixture(scope="module")
def walked() -> tuple[octo.Problem, octo.Solution]:
    """A short walk on octo.Plane, with the contacts of its last pass, at its optimum."""
    terms = [octo.CenterOfMassVelocity((0.3, 0.0, 0.0)), octo.Effort(), octo.SlipPower()]
    problem = octo.Problem(octo.gallery.mammal(), steps=16, dt=0.05, costs=terms)
    found = octo.solve(problem, device="cpu")
    problem = problem.replace(parameters={name: found.parameters[name] for name in CONTACT})
    return problem, octo.solve(problem, start=found, device="cpu")


@pytest.mark.parametrize("name", PLANES)
def test_a_plane_is_a_plane(name: str) -> None:
    """φ is the height and its gradient looks up, far from the edges, which a spline feels."""
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-0.4, 0.4, (400, 2)), rng.uniform(-0.03, 0.15, 400)])
    jets = World([PLANES[name]()]).jets(points, 2)
    plane = np.column_stack([points[:, 2], np.zeros((400, 2)), np.ones(400), np.zeros((400, 6))])
    off = np.abs(jets - plane).max(axis=0)
    assert off[0] < 1e-5 and off[1:4].max() < 1e-3 and off[4:].max() < 0.03


@pytest.mark.parametrize("name", PLANES)
def test_a_robot_walks_on_it_as_on_the_plane(
    walked: tuple[octo.Problem, octo.Solution], name: str
) -> None:
    """From the optimum on the plane the solver stays there: E is the same. (From a cold start the
    last digit of a sum decides which of many optima is found, also on the plane itself.)"""
    problem, flat = walked
    own = octo.solve(problem.replace(terrain=World([PLANES[name]()])), start=flat, device="cpu")
    assert own.converged and own.iterations < 50
    assert own.energy == pytest.approx(flat.energy, rel=1e-3)
