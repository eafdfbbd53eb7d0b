"""A world as the ground is the same ground as an expression: FD, its derivatives, the terms over
contacts and whole solves, on every backend."""

from __future__ import annotations

import copy
import pickle

import casadi as ca
import numpy as np
import pytest
from walker import START, walker

import octo
from octo import native
from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.laws import Compliant, Coulomb, Smooth
from octo.errors import StaticPoseError, UnknownNameError
from octo.gpu.problem import DeviceProblem
from octo.model.gallery import CHARACTERS
from octo.model.kinematics import sphere_centers
from octo.model.terrain import signed_distance, world_at
from octo.problem.compiled import CompiledProblem
from tests import emulator
from tests.emulator import EmulatedDevice

SLOPE = octo.Plane(slope=0.05, direction=0.7)
PLACE, RADIUS = np.array([0.05, -0.04, -4.1]), 4.1


def ball(point, p):
    return ca.norm_2(point - PLACE) - RADIUS


GROUNDS = {
    "slope": (SLOPE, octo.World([octo.shapes.Ground(slope=0.05, direction=0.7)])),
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


def problem_on(terrain):
    return octo.Problem(
        walker(),
        steps=7,
        dt=0.02,
        costs=TERMS,
        terrain=terrain,
        x0=START,
        constraints=[octo.FrictionCone(mu=0.6)],
    )


def weighted(problems):
    """Compiled, with the rows of the constraint at work."""
    made = CompiledProblem(problems)
    rows = made.used_rows
    made.set_row_weights(np.where(rows, 2.0, 0.0), np.where(rows, 0.3, 0.0))
    return made


@pytest.fixture(scope="module")
def batch():
    """The same problem on both grounds of each pair, as expressions one by one and as worlds in one
    batch; unknowns at which contacts are at work; multipliers."""
    plain = [weighted([problem_on(one)]) for one, _ in GROUNDS.values()]
    worlds = weighted([problem_on(other) for _, other in GROUNDS.values()])
    rng = np.random.default_rng(5)
    nodes = np.repeat(worlds.start[:, None], worlds.steps + 2, axis=1)
    nodes = nodes + 0.02 * rng.standard_normal(nodes.shape)
    lam = rng.standard_normal((2, worlds.K, worlds.ma))
    return plain, worlds, worlds.unknowns(nodes), lam


def check(batch, made, convert=np.asarray, exact=True):
    """``made``, a form of the worlds' problem, against the expressions."""
    plain, _, unknowns, lam = batch
    multipliers = convert(lam) if exact else None
    at = made.evaluate(convert(unknowns))
    model = made.linearize(at, multipliers)
    for k, problem in enumerate(plain):
        expected = problem.evaluate(unknowns[k : k + 1])
        wanted = problem.linearize(expected, lam[k : k + 1] if exact else None)
        assert (np.abs(expected.terms).sum(axis=(0, 1)) > 0.0).sum() >= 6
        for name in ("fd", "terms", "rows", "C"):
            close(np.asarray(getattr(at, name))[k], getattr(expected, name)[0])
        for name in ("H", "A", "b", "C"):
            close(np.asarray(getattr(model, name))[k], getattr(wanted, name)[0], 1e-9)


@pytest.mark.parametrize("exact", [False, True])
def test_native(batch, exact):
    check(batch, batch[1], exact=exact)


@pytest.mark.parametrize("exact", [False, True])
def test_interpreted(batch, exact):
    check(batch, batch[1].interpreted(), exact=exact)


@pytest.mark.skipif(emulator.compiler() is None, reason="no C++ compiler")
@pytest.mark.parametrize("exact", [False, True])
def test_kernels(batch, exact):
    device = EmulatedDevice(32, 1)
    check(batch, DeviceProblem(batch[1], device), device.array, exact)


def test_members_keep_their_worlds(batch):
    _, worlds, unknowns, _ = batch
    whole, second = worlds.evaluate(unknowns), worlds.take(np.array([1]))
    np.testing.assert_array_equal(second.evaluate(unknowns[1:]).fd, whole.fd[1:])


@pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
def test_what_was_far_is_seen_when_it_comes_back():
    """Steps in a row, where looks are spared, and each step by itself, where none is known."""
    robot = CHARACTERS["mammal"]()
    box = octo.shapes.Box((0.4, 0.4, 0.2), position=(0.2, 0.1, 0.0))
    dynamics = RobotDynamics(robot, terrain=octo.World([octo.shapes.Ground(), box]))
    nodes = np.repeat(robot.start_pose[None], 41, axis=0)
    up = np.abs(np.sin(np.linspace(0.0, 9.0, len(nodes))))
    nodes[:, 2] += 0.3 * up - 0.005  # slowly, and at once where it comes down
    nodes[20:24, 2] += 5.0
    each = np.stack([nodes[k : k + 3] for k in range(len(nodes) - 2)])
    p = dynamics.bound(dynamics.layout.pack()[None])
    together = dynamics.evaluate(nodes[None], p, order=1)
    alone = dynamics.evaluate(each, np.repeat(p, len(each), axis=0), order=1)
    weight = robot.mass * 9.81
    assert (np.abs(together[0][0, :, 2]) > weight).sum() > 3  # some touch
    for one, other in zip(together[:2], alone[:2], strict=True):
        close(one[0], other[:, 0], 1e-12)


def test_an_address_of_another_process_is_not_followed():
    plain, world = GROUNDS["ball"]
    robot = CHARACTERS["chain"]()
    dynamics = RobotDynamics(robot, terrain=world)
    p = dynamics.layout.pack(**{"terrain.address": 4096.0})[None]
    nodes = nodes_of(robot, plain)
    expected = dynamics.evaluate(nodes, dynamics.layout.pack()[None])[0]
    np.testing.assert_array_equal(dynamics.evaluate(nodes, p)[0], expected)


def test_a_solve_is_that_on_the_expression():
    """The same iterations to the same motion; what is saved has no address."""
    costs = [octo.CenterOfMassVelocity((0.2, 0.0, 0.0)), octo.Effort()]
    runs = [
        octo.solve(
            octo.Problem(CHARACTERS["chain"](), steps=20, dt=0.02, costs=costs, terrain=one),
            max_iterations=40,
            passes=1,
        )
        for one in (octo.Plane(slope=0.1), octo.World([octo.shapes.Ground(slope=0.1)]))
    ]
    assert runs[0].iterations == runs[1].iterations
    np.testing.assert_allclose(runs[1].x, runs[0].x, atol=1e-6)
    np.testing.assert_allclose(runs[1].contact_force, runs[0].contact_force, atol=1e-3)
    assert "terrain.address" not in runs[1].parameters


@pytest.mark.parametrize("shape", ["heights", "grid", "box", "many"])
def test_phi_is_no_steeper_than_said(shape):
    """What lets a look-up be skipped: a point is no nearer than the way from one that is known."""
    rng = np.random.default_rng(8)
    shapes = octo.shapes
    boxes = [shapes.Box((0.3, 0.4, 0.5), position=p) for p in rng.uniform(-2.0, 2.0, (9, 3))]
    grid = np.linalg.norm(np.stack(np.meshgrid(*[np.arange(-1.0, 1.01, 0.1)] * 3)), axis=0) - 0.6
    worlds = {
        "heights": [shapes.HeightField(0.3 * rng.standard_normal((30, 20)), cell=0.2)],
        "grid": [shapes.DistanceGrid(grid, cell=0.1, origin=(-1.0, -1.0, -1.0))],
        "box": boxes[:1],
        "many": boxes,
    }
    world = octo.World(worlds[shape])
    points = rng.uniform(-2.0, 3.0, (2000, 3))
    steepest = max(one.steepest for one in world.shapes)
    assert np.linalg.norm(world.jets(points)[:, 1:], axis=1).max() <= steepest


@pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
def test_copies_of_a_batch_have_their_own_worlds():
    """Pickled or copied before and after its code is used: not the original's place in memory,
    which may be another process, or given back."""
    costs = [octo.Effort()]  # what CasADi pickles without more ado
    worlds = [problem_on(other) for _, other in GROUNDS.values()]
    made = CompiledProblem([one.replace(costs=costs, constraints=()) for one in worlds])
    nodes = np.repeat(made.start[:, None], made.steps + 2, axis=1)
    place = made.dynamics.layout.index("terrain.address")
    for _ in range(2):
        for again in (copy.deepcopy(made), pickle.loads(pickle.dumps(made))):
            at = made.evaluate_nodes(made.unknowns(nodes), nodes)
            found = again.evaluate_nodes(made.unknowns(nodes), nodes)
            np.testing.assert_array_equal(found.fd, at.fd)
            for own, problem in zip(again.p[:, place], again.problems, strict=True):
                assert world_at(own) is problem.terrain
            assert not set(again.p[:, place]) & set(made.p[:, place])


def test_nobody_says_where_a_world_is():
    """Code follows the address: another one would end the process."""
    problem, given = problem_on(GROUNDS["slope"][1]), {"terrain.address": 4096.0}
    controller = octo.mpc.Controller(
        problem.replace(costs=[octo.Effort(), octo.Posture()], constraints=())
    )
    for call in (
        lambda: problem.replace(parameters=given),
        lambda: octo.simulate(problem.model, START, steps=2, terrain=SLOPE, parameters=given),
        lambda: octo.simulate(
            problem.model, START, steps=2, terrain=problem.terrain, parameters=given
        ),
        lambda: controller.set_parameters(given),
    ):
        with pytest.raises(UnknownNameError, match="terrain.address"):
            call()
    assert "terrain.address" not in problem.values
    octo.simulate(problem.dynamics, START, steps=1, parameters=problem.values)


def test_a_robot_beside_its_world_is_told_so():
    box = octo.shapes.Box((1.0, 1.0, 1.0), position=(10.0, 0.0, -0.5))
    with pytest.raises(StaticPoseError, match="no shape or map there"):
        problem_on(octo.World([box])).replace(x0=None).start  # noqa: B018
    beyond = octo.shapes.HeightField(np.zeros((9, 9)), cell=0.1, origin=(10.0, 0.0))
    start = problem_on(octo.World([beyond])).replace(x0=None).start  # a map goes on
    np.testing.assert_allclose(start, problem_on(octo.Plane()).replace(x0=None).start, atol=1e-6)
