"""A solved cycle carried on: continuous, still a solution, in a file and tiled again; robots that
are not symmetric."""

from __future__ import annotations

import dataclasses
from functools import lru_cache

import numpy as np
import pytest

import octo
from octo.errors import ProblemError, ValueRangeError
from octo.problem.compiled import CompiledProblem
from octo.problem.cycle import Cycle
from octo.problem.problem import Problem
from octo.result import measure

CYCLES = {  # the cycle, the steps, the ground
    "mirrored": (Cycle(speed=0.5, period=0.6), 13, None),
    "slope": (Cycle(speed=0.4, period=0.6), 12, octo.Plane(slope=0.08, height=0.05)),
    "turning": (Cycle(speed=0.3, turn=0.4, period=0.6, mirror=False), 24, None),
}
CONTACTS = ("force", "point", "velocity", "normal", "depth")
every_cycle = pytest.mark.parametrize("name", CYCLES)


@lru_cache
def described(name: str) -> Problem:
    cycle, steps, ground = CYCLES[name]
    robot = octo.gallery.mammal()
    given = {"steps": steps, "cycle": cycle, "terrain": ground}
    return Problem(robot, costs=octo.costs.natural(), **given)


@lru_cache
def solved(name: str) -> octo.Solution:
    found = octo.solve(described(name), passes=1, device="cpu", max_iterations=600)
    assert found.converged and found.violation < 1e-4
    return found


def same_laws(problem: Problem, motion: octo.Solution) -> CompiledProblem:
    """The motion's start, fixed, under the cycle's own ground and contact law."""
    keep = {name: value for name, value in motion.parameters.items() if name != "dt"}
    start = {"x0": motion.x[1], "v0": (motion.x[1] - motion.x[0]) / motion.dt}
    size = {"steps": motion.steps, "dt": motion.dt, "parameters": keep}
    costs = problem.costs[:-1]  # without the anchor
    ground = {"terrain": problem.terrain}
    return CompiledProblem([Problem(problem.character, costs=costs, **start, **size, **ground)])


@every_cycle
def test_a_tiled_cycle_goes_on_without_a_seam(name):
    cycle, stride = solved(name), solved(name).cycle
    tiles = cycle.tile(20)
    pieces = 40 if stride.mirrored else 20
    assert tiles.steps == pieces * cycle.steps and len(tiles.u) == tiles.steps
    np.testing.assert_array_equal(tiles.x[: cycle.steps + 2], cycle.x)
    carried = stride.on(tiles.x[: -cycle.steps])
    np.testing.assert_allclose(tiles.x[cycle.steps :], carried, atol=1e-9)
    v = np.diff(tiles.x, axis=0) / cycle.dt
    np.testing.assert_allclose(v[cycle.steps :], v[: -cycle.steps] @ stride.matrix.T, atol=1e-9)
    travel = tiles.x[-1] - tiles.x[1]
    if name != "turning":
        assert travel[0] == pytest.approx(20 * stride.speed * stride.period, abs=1e-6)
    assert tiles.yaw[-1] - tiles.yaw[0] == pytest.approx(20 * stride.turn, abs=1e-8)


@every_cycle
def test_a_tiled_cycle_is_still_a_solution(name):
    """Twenty strides as a plain problem: its C, u and contacts are those that were carried
    along."""
    tiles = solved(name).tile(20)
    problem = same_laws(described(name), tiles)
    at = problem.evaluate(problem.unknowns(tiles.x[None]))
    np.testing.assert_allclose(at.nodes[0], tiles.x, atol=1e-12)
    reduced, rows = (float(values[0]) for values in measure.violations(problem, at))
    # moments are over ℓ, the base's height at the start: another one in mid-stride
    near = {"rtol": 0.2, "atol": 1e-7}
    np.testing.assert_allclose(reduced, solved(name).violation, **near)
    np.testing.assert_allclose(rows, solved(name).pointwise_residual, **near)
    assert tiles.pointwise_residual == pytest.approx(rows, rel=0.2, abs=1e-7)
    plain = measure.measured(problem, at, 0)
    np.testing.assert_allclose(tiles.u, plain["u"], atol=1e-6)
    for what in CONTACTS:
        found, expected = getattr(tiles, f"contact_{what}"), plain[f"contact_{what}"]
        scale = max(1.0, np.abs(expected).max())
        np.testing.assert_allclose(found, expected, atol=1e-8 * scale, err_msg=what)
    np.testing.assert_allclose(heights(tiles), heights(solved(name)), atol=1e-9)
    gait, tiled = solved(name).gait, tiles.gait
    assert gait is not None and tiled is not None


def heights(motion: octo.Solution) -> np.ndarray:
    """z (m) of the sampled plane over the origin, and its slopes."""
    x, y, z = (motion.ground[axis] for axis in "xyz")
    slopes = (z[-1, 0] - z[0, 0]) / (x[-1] - x[0]), (z[0, -1] - z[0, 0]) / (y[-1] - y[0])
    return np.array([z[0, 0] - slopes[0] * x[0] - slopes[1] * y[0], *slopes])


@every_cycle
def test_tiles_of_tiles_and_of_files(name, tmp_path):
    cycle = solved(name)
    cycle.save(tmp_path / "cycle.npz")
    loaded = octo.Solution.load(tmp_path / "cycle.npz")
    for field in dataclasses.fields(cycle.cycle):
        expected = getattr(cycle.cycle, field.name)
        np.testing.assert_array_equal(getattr(loaded.cycle, field.name), expected)
    six, twice = loaded.tile(6), cycle.tile(2).tile(3)
    twice.save(tmp_path / "tiles.npz")
    twice = octo.Solution.load(tmp_path / "tiles.npz")
    for field in ("x", "u", *(f"contact_{what}" for what in CONTACTS)):
        np.testing.assert_allclose(getattr(twice, field), getattr(six, field), atol=1e-9)
    np.testing.assert_allclose(twice.cycle.on(six.x[:2]), six.x[-2:], atol=1e-9)
    assert not six.cycle.mirrored and six.cycle.period == pytest.approx(cycle.cycle.period)


def test_refused():
    with pytest.raises(ValueRangeError, match="strides is 0, must be"):
        solved("mirrored").tile(0)
    plain = dataclasses.replace(solved("mirrored"), cycle=None)
    with pytest.raises(ProblemError, match="this motion is no cycle, it cannot be tiled"):
        plain.tile(2)


def lopsided() -> octo.Character:
    """A mammal whose trunk has its centre of mass 5 mm to the left, in a file that calls it
    symmetric."""
    robot = octo.gallery.mammal()
    trunk = robot.bodies[robot.base_body]
    aside = dataclasses.replace(trunk, com=trunk.com + [0.0, 0.005, 0.0])
    bodies = tuple(aside if body is trunk else body for body in robot.bodies)
    return dataclasses.replace(robot, bodies=bodies)


def test_the_image_of_a_robot_that_is_not_symmetric_says_so():
    """The mirrored half does not hold by itself; the whole stride, begun from both halves, does,
    and soon."""
    problem = Problem(
        lopsided(),
        steps=13,
        costs=octo.costs.natural(length=0.3),
        cycle=Cycle(speed=0.5, period=0.6),
    )
    half = octo.solve(problem, passes=1, device="cpu", max_iterations=600)
    assert half.converged and half.pointwise_residual < 1e-4
    stride = half.tile(1)
    at = same_laws(problem, stride)
    rows = float(measure.violations(at, at.evaluate(at.unknowns(stride.x[None])))[1][0])
    assert rows > 0.1
    assert stride.pointwise_residual == pytest.approx(rows, rel=0.2)  # ℓ is that of another start
    assert half.cycle.asymmetry == stride.pointwise_residual == stride.violation
    assert solved("mirrored").cycle.asymmetry < 1e-4
    whole = dataclasses.replace(problem.cycle, mirror=False)
    found = octo.solve(problem.replace(cycle=whole, steps=26), start=stride, passes=1, device="cpu")
    assert found.converged and found.iterations < 0.5 * half.iterations
    tiles = found.tile(5)
    at = same_laws(problem, tiles)
    assert measure.violations(at, at.evaluate(at.unknowns(tiles.x[None])))[1][0] < 1e-4
