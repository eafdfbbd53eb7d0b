"""Bodies with thousands of contacts: the numbers of all contacts one by one, from those near the
ground alone."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from forgotten import forgotten
from test_lanes import one_by_one

import octo
from octo import native
from octo.dynamics import crowd
from octo.dynamics.contact_numbers import contact_function, contact_numbers
from octo.dynamics.evaluate import MOST_WRITTEN, RobotDynamics
from octo.dynamics.laws import Compliant
from octo.errors import ModelError
from octo.gpu.problem import DeviceProblem
from octo.model.body import Body, ContactSphere, Joint, floating_base
from octo.problem.compiled import CompiledProblem
from tests import emulator
from tests.emulator import EmulatedDevice

pytestmark = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
SIZE = np.array([0.2, 0.16, 0.12])  # m, half axes of the body
COLUMNS = [(x, y) for x in (-0.3, 0.1, 0.5) for y in (-0.2, 0.25)]
ALL = 10**9  # contacts of one body, before it is a crowd


def hilly(point, p):
    return point[2] - 0.1 * ca.sin(6.0 * point[0]) * ca.cos(5.0 * point[1])


def grounds():
    boxes = [octo.shapes.Box((0.3, 0.3, 0.1), position=(x, y, 0.02)) for x, y in COLUMNS]
    return {
        "plane": octo.Plane(slope=0.1),
        "hills": octo.Terrain(hilly),
        "boxes": octo.World([octo.shapes.Ground(), *boxes]),
    }


def points_on(count):
    """(count, 3) m, evenly over an ellipsoid."""
    k = np.arange(count) + 0.5
    polar, around = np.arccos(1.0 - 2.0 * k / count), np.pi * (1.0 + 5.0**0.5) * k
    across = np.sin(polar)
    return SIZE * np.stack([np.cos(around) * across, np.sin(around) * across, np.cos(polar)], 1)


def stone(count, tail=0, radius=0.0):
    """A body of ``count`` contacts, which carries a second one of as many as ``tail``, two single
    ones included."""
    inertia = np.diag([0.02, 0.03, 0.04])
    bodies = [Body("stone", -1, floating_base(), mass=2.0, inertia=inertia)]
    spheres = [
        ContactSphere(f"v{k}", 0, point, radius * (k % 3))
        for k, point in enumerate(points_on(count))
    ]
    if tail:
        hinge = Joint("tail", "hinge", np.array([0.0, 1.0, 0.0]))
        place = np.array([0.25, 0.0, 0.0])
        bodies.append(Body("tail", 0, (hinge,), place, mass=0.5, inertia=0.1 * inertia))
        spheres += [
            ContactSphere(f"t{k}", 1, 0.5 * point, 0.0) for k, point in enumerate(points_on(tail))
        ]
        last = Body("tip", 1, (), place, mass=0.1, inertia=0.01 * inertia)
        bodies.append(last)
        spheres.insert(7, ContactSphere("tip", 2, np.zeros(3), 0.03))
    return octo.Character("stone", tuple(bodies), tuple(spheres))


def nodes_of(n, count, height=0.11, step=0.01, period=18.8):
    """(1, count, n) of a body that tumbles out of the ground and into it, in ``period`` nodes."""
    rng = np.random.default_rng(1)
    nodes = np.zeros((1, count, n))
    nodes[0, :, :3] = np.cumsum(rng.normal(0.0, step, (count, 3)), axis=0)
    nodes[0, :, 3:] = np.cumsum(rng.normal(0.0, 10.0 * step, (count, n - 3)), axis=0)
    nodes[0, :, 2] += height + 0.04 * np.sin(2.0 * np.pi / period * np.arange(count))
    return nodes


def close(found, expected, relative=1e-12):
    scale = max(float(np.abs(expected).max(initial=0.0)), 1e-300)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=relative * scale)


def test_a_tree_holds_every_point_once_and_what_is_below():
    points = np.random.default_rng(0).standard_normal((1001, 3))
    radii = np.random.default_rng(1).uniform(0.0, 0.1, 1001)
    tree = crowd.tree_of(points, radii)
    np.testing.assert_array_equal(np.sort(tree.member[tree.member >= 0]), np.arange(1001))
    for e, (member, skip) in enumerate(zip(tree.member, tree.skip, strict=True)):
        below = tree.member[e:skip][tree.member[e:skip] >= 0]
        away = np.linalg.norm(points[below] - tree.centers[e], axis=1)
        assert (away <= tree.around[e]).all() and radii[below].max() == tree.radii[e]
        assert (below == [member]).all() if member >= 0 else len(below) > 1


def test_a_walk_comes_to_few_points():
    tree = crowd.tree_of(points_on(5000), np.zeros(5000))
    entry, seen = 0, 0
    while entry < len(tree.skip):
        seen += 1
        near = tree.centers[entry, 2] + SIZE[2] < 1e-3 + tree.around[entry]
        entry = entry + 1 if near else tree.skip[entry]
    assert 20 < seen < 0.12 * 5000


def test_few_contacts_are_no_crowd():
    robot = stone(crowd.FEW)
    assert crowd.crowds_of(robot) == [] and "octo_crowd_start" not in RobotDynamics(robot).text()


@pytest.mark.parametrize("ground", grounds())
def test_five_thousand_are_all_of_them(ground, monkeypatch):
    """FD, its Jacobian and curvature, of several steps in lanes and of one after the other: of a
    body that tumbles, and of one that slowly sinks."""
    terrain, rng = grounds()[ground], np.random.default_rng(2)
    motions = [nodes_of(7, 21), nodes_of(7, 34, 0.14, step=5e-4, period=-136.0)]
    each = [(nodes, rng.standard_normal((1, nodes.shape[1] - 2, 7))) for nodes in motions]
    made = RobotDynamics(stone(5000, 40, 0.002), terrain=terrain)
    p = made.bound(made.layout.pack()[None])
    found = [made.evaluate(nodes, p, lam, order=2) for nodes, lam in each]
    scalar = [one_by_one(made, nodes, p, lam, 2) for nodes, lam in each]
    forgotten(monkeypatch)
    monkeypatch.setattr(crowd, "FEW", ALL)
    whole = RobotDynamics(stone(5000, 40, 0.002), terrain=terrain)
    expected = [whole.evaluate(nodes, p, lam, order=2) for nodes, lam in each]
    assert "octo_crowd_start" in made.text() and "octo_crowd_start" not in whole.text()
    for own, single, wanted in zip(found, scalar, expected, strict=True):
        assert np.abs(wanted[0]).max() > 100.0 * 20.0
        for got, other, number in zip(own, single, wanted, strict=True):
            close(got, number)
            close(other, number)


@pytest.mark.parametrize("ground", grounds())
def test_interpreted(ground):
    made = RobotDynamics(stone(18), Compliant(), grounds()[ground])
    nodes, lam = nodes_of(6, 9), np.random.default_rng(2).standard_normal((1, 7, 6))
    p = made.layout.pack()[None]
    expected = made.interpreted().evaluate(nodes, p, lam, order=2)
    for got, wanted in zip(made.evaluate(nodes, p, lam, order=2), expected, strict=True):
        close(got, wanted, 1e-10)


def test_what_is_written_as_one_expression_has_a_limit():
    made = RobotDynamics(stone(MOST_WRITTEN + 1)).interpreted()
    with pytest.raises(ModelError, match="stone: 1001 contacts with the terrain, at most 1000"):
        made.evaluate(nodes_of(6, 3), made.layout.pack()[None])


def test_a_pose_that_is_not_finite_is_not_skipped():
    for terrain in grounds().values():
        made, nodes = RobotDynamics(stone(100), terrain=terrain), nodes_of(6, 5, height=2.0)
        nodes[0, 2, 0] = np.nan
        fd = made.evaluate(nodes, made.layout.pack()[None])[0]
        assert np.isnan(fd[0, :, 0]).all()


TERMS = [
    octo.Slip(),
    octo.SlipPower(),
    octo.ForceRate(),
    octo.LoadSharing(),
    octo.FrictionCone(mu=0.3),
    octo.Clearance(contacts=("v3", "t5", "tip")),
]


def compiled(ground):
    costs = [*TERMS, octo.Effort()]
    x0 = np.array([0.0, 0.0, 0.11, 0.0, 0.0, 0.0, 0.0])
    robot, terrain = stone(17, 6), grounds()[ground]
    problem = octo.Problem(robot, steps=19, dt=0.02, costs=costs, terrain=terrain, x0=x0)
    return CompiledProblem([problem])


@pytest.fixture(scope="module", params=["plane", "boxes"])
def problems(request):
    """With crowds; E and its model without, at unknowns at which some contacts carry."""
    made = compiled(request.param)
    unknowns = made.unknowns(nodes_of(7, 21, height=0.13))
    lam = np.random.default_rng(5).standard_normal((1, made.K, made.ma))
    with pytest.MonkeyPatch.context() as patch:
        forgotten(patch)
        patch.setattr(crowd, "FEW", ALL)
        whole = compiled(request.param)
        at = whole.evaluate(unknowns)
        models = [whole.linearize(at, each) for each in (None, lam)]
    assert (np.abs(at.terms).sum(axis=(0, 1)) > 0.0).all()
    return made, unknowns, lam, at, models


def check(problems, made, convert=np.asarray):
    _, unknowns, lam, at, models = problems
    found = made.evaluate(convert(unknowns))
    for name in ("fd", "terms", "C"):
        close(np.asarray(getattr(found, name)), getattr(at, name), 1e-10)
    for multipliers, expected in zip((None, convert(lam)), models, strict=True):
        model = made.linearize(found, multipliers)
        for name in "HAbC":
            close(np.asarray(getattr(model, name)), getattr(expected, name), 1e-9)


def test_terms(problems):
    check(problems, problems[0])


def test_terms_interpreted(problems):
    check(problems, problems[0].interpreted())


@pytest.mark.skipif(emulator.compiler() is None, reason="no C++ compiler")
@pytest.mark.parametrize("threads", [1, 96])
def test_terms_by_the_kernels(problems, threads):
    device = EmulatedDevice(threads, 1)
    check(problems, DeviceProblem(problems[0], device), device.array)


@pytest.mark.parametrize("ground", grounds())
def test_contacts_of_reports(ground):
    made = RobotDynamics(stone(40, 20), terrain=grounds()[ground])
    nodes, p = nodes_of(7, 9)[0], made.bound(made.layout.pack())
    (force, point, *_), _ = contact_numbers(made, p, nodes[1:], nodes[:-1])
    whole = contact_function(made)
    for k in range(8):
        expected = whole(nodes[k + 1], nodes[k], made.seen(p, nodes[k + 1 : k + 2])[:, 0])
        close(force[k], np.asarray(expected[0]).T)
        close(point[k], np.asarray(expected[1]).T)


def test_a_mesh_that_falls_and_comes_to_rest():
    """Its many vertices are one foot of a report."""
    robot = stone(300)
    costs = [octo.JointAcceleration(weight=1e-6)]
    x0 = np.array([0.0, 0.0, 0.16, 0.0, 0.0, 0.0])
    problem = octo.Problem(robot, steps=30, dt=0.02, costs=costs, x0=x0)
    solution = octo.solve(problem, max_iterations=200)
    assert solution.status.converged
    np.testing.assert_allclose(solution.x[-1, 2], SIZE[2], atol=0.01)
    assert solution.loaded[-1].sum() >= 1 and "no foot" not in str(solution)
