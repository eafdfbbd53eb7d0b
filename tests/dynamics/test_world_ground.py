"""A world as the ground is the same ground as an expression: FD, its derivatives, the terms over
contacts and whole solves, on every backend."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import octo
from octo import native
from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.laws import Compliant, Coulomb, Smooth
from octo.model.gallery import CHARACTERS
from octo.model.kinematics import sphere_centers
from octo.model.terrain import signed_distance
from octo.problem.compiled import CompiledProblem

SLOPE = octo.Plane(slope=0.2, direction=0.7, height=0.1)
PLACE, RADIUS = np.array([0.3, -0.2, -4.0]), 4.1


def ball(point, p):
    return ca.norm_2(point - PLACE) - RADIUS


GROUNDS = {
    "slope": (SLOPE, octo.World([octo.shapes.Ground(slope=0.2, direction=0.7, height=0.1)])),
    "ball": (octo.Terrain(ball), octo.World([octo.shapes.Sphere(RADIUS, position=PLACE)])),
}
LAWS = {"smooth": Smooth(onset=0.02), "coulomb": Smooth(friction=Coulomb()), "soft": Compliant()}
TERMS = [
    octo.Effort(),
    octo.Slip(),
    octo.Clearance(),
    octo.FootLift(),
    octo.ForceRate(),
    octo.SwingClearance(),
    octo.FrictionCone(mu=0.5),
]


def close(found, expected, relative=1e-10):
    scale = max(float(np.abs(expected).max(initial=0.0)), 1e-300)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=relative * scale)


def nodes_of(robot, ground, count=5):
    """Nodes about a pose in which some spheres are in the ground and others are not."""
    rng = np.random.default_rng(3)
    pose = np.zeros(robot.nx) if robot.default_pose is None else robot.default_pose
    pose = pose + 0.2 * rng.standard_normal(robot.nx)
    own = list(robot.terrain_contacts)
    heights = signed_distance(ground, sphere_centers(robot, pose)[own], ground.parameters) - [
        robot.contacts[k].radius for k in own
    ]
    pose[2] -= np.median(heights) + 0.01
    return pose + 0.02 * rng.standard_normal((1, count, robot.nx))


@pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("ground", GROUNDS)
def test_dynamics(ground, law):
    plain, world = GROUNDS[ground]
    robot = CHARACTERS["mammal"]()
    one, other = (RobotDynamics(robot, LAWS[law], each) for each in (plain, world))
    nodes = nodes_of(robot, plain)
    lam = np.random.default_rng(4).standard_normal((1, 3, robot.nx))
    expected = one.evaluate(nodes, one.layout.pack()[None], lam, order=2)
    for dynamics in (other, other.interpreted()):
        found = dynamics.evaluate(nodes, other.layout.pack()[None], lam, order=2)
        for got, wanted in zip(found, expected, strict=True):
            close(got, wanted)


def compiled(terrain):
    problem = octo.Problem(
        CHARACTERS["mammal"](),
        steps=7,
        dt=0.02,
        costs=TERMS,
        terrain=terrain,
        constraints=[octo.FrictionCone(mu=0.6)],
    )
    return CompiledProblem([problem])


@pytest.fixture(scope="module", params=GROUNDS)
def pair(request):
    """The same problem on both, and unknowns at which contacts are at work."""
    plain, world = (compiled(each) for each in GROUNDS[request.param])
    start = np.repeat(plain.problems[0].start[None], 9, axis=0)[None]
    wiggle = 0.02 * np.random.default_rng(5).standard_normal(start.shape)
    wiggle[..., 2] -= 0.01
    unknowns = plain.unknowns(start + wiggle)
    for one in (plain, world):
        rows = one.used_rows
        one.set_row_weights(np.where(rows, 2.0, 0.0), np.where(rows, 0.3, 0.0))
    return plain, world, unknowns


def test_the_start_is_the_same(pair):
    plain, world, _ = pair
    np.testing.assert_allclose(world.problems[0].start, plain.problems[0].start, atol=1e-7)


@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("interpreted", [False, True])
def test_terms_and_constraints(pair, exact, interpreted):
    plain, world, unknowns = pair
    if interpreted:
        world = world.interpreted()
    lam = np.random.default_rng(6).standard_normal((1, plain.K, plain.ma)) if exact else None
    at, expected = (problem.evaluate(unknowns) for problem in (world, plain))
    for name in ("fd", "terms", "rows", "C"):
        close(getattr(at, name), getattr(expected, name))
    assert (np.abs(expected.terms).sum(axis=(0, 1)) > 0.0).sum() >= 5
    model, wanted = world.linearize(at, lam), plain.linearize(expected, lam)
    for name in ("H", "A", "b", "C"):
        close(getattr(model, name), getattr(wanted, name), 1e-9)
