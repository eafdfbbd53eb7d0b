"""Contact between bodies: the same derivatives in every form that octo evaluates, and those of
CasADi's summed expression."""

from __future__ import annotations

import ctypes
import dataclasses

import numpy as np
import pytest
from test_lanes import one_by_one
from test_threads import BLOCK, ENTRY
from walker import START, walker

import octo
from octo import native
from octo.dynamics.evaluate import RobotDynamics, unfold
from octo.dynamics.laws import Compliant, Coulomb, Smooth
from octo.dynamics.slots import mutual_ends
from octo.model.scene import Scene
from octo.model.solid import Solid
from octo.world.shapes import Box, Capsule, Cylinder, Sphere

TOLERANCE = 1e-11  # of the largest entry
STEPS = 13
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")
TURNED = (0.9, 0.1, -0.2, 0.15)  # of a shape on its body

SHAPES = {
    "sphere": Sphere(0.11, position=(0.01, 0.02, -0.01)),
    "box": Box((0.22, 0.2, 0.18), 0.03, position=(0.01, 0.0, 0.01), rotation=TURNED),
    "capsule": Capsule(0.09, 0.1, rotation=TURNED),
    "cylinder": Cylinder(0.1, 0.2, 0.02, rotation=TURNED),
}
LAWS = {
    "viscous": Smooth(onset=0.02),
    "coulomb": Smooth(onset=0.02, friction=Coulomb(mu=0.6)),
    "compliant": Compliant(),
}


def crowd():
    """A walker that touches itself on one branch and on two, a ball, a box on it, a door and a
    stone; beside springs and a pair of spheres."""
    plain = walker()
    spring = octo.SpringDamper("base", (0.1, 0.0, 0.0), "shank", (0.0, 0.0, -0.2), 300.0, 6.0, 0.3)
    body = {body.name: k for k, body in enumerate(plain.bodies)}
    solids = (
        Solid("trunk", body["base"], Box((0.2, 0.2, 0.38), 0.02, position=(0.0, 0.0, 0.0))),
        Solid("shin", body["shank"], Capsule(0.18, 0.1, position=(0.0, 0.0, -0.1))),
    )
    index = {contact.name: k for k, contact in enumerate(plain.contacts)}
    touches = ((index["top"], 0), (index["back"], 1))
    robot = dataclasses.replace(plain, elements=(spring,), solids=solids, touches=touches)
    objects = [
        octo.objects.ball(0.12, 0.7, (0.05, 0.05, 0.1)),
        octo.objects.box((0.2, 0.25, 0.15), 0.8, (0.05, 0.08, 0.26)),
        octo.objects.door((0.4, 0.1, 0.26), 3.0, (-0.1, 0.16, 0.0)),
    ]
    pairs = [("foot", "ball"), ("ball", "box"), ("foot", "door"), ("box_2", "door")]
    return Scene(robot, objects, contacts=pairs).character


def nodes_of(character, start, seed=0):
    rng = np.random.default_rng(seed)
    spread = 0.03 * rng.standard_normal((1, STEPS + 2, character.nx))
    return start + spread + 0.02 * rng.standard_normal(character.nx), rng


def two(shape):
    """A ball and a free body of one shape that touch at most steps."""
    carrier = octo.objects.ball(0.1, 1.5, (0.0, 0.0, 1.0), name="carrier")
    carrier = dataclasses.replace(carrier, contacts=(), solids=(Solid("solid", 0, shape),))
    ball = octo.objects.ball(0.08, 1.0, (0.06, 0.05, 1.12))
    return Scene(ball, [carrier], contacts=[("ball", "carrier")]).character


def compare(found, expected, tolerance=TOLERANCE):
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=tolerance * np.abs(other).max())


def felt(dynamics, nodes, p, lam):
    """FD, its Jacobian and its curvature, after a look at whether the contacts matter."""
    found = dynamics.evaluate(nodes, p, lam, order=2)
    without = dataclasses.replace(dynamics.character, touches=())
    plain = RobotDynamics(without, dynamics.law).evaluate(nodes, p, lam, order=2)
    for one, other in zip(found, plain, strict=True):
        assert np.abs(one - other).max() > 1e-2 * np.abs(one).max()
    assert (found[0] == plain[0]).all(axis=2).any() or dynamics.character.nx > 12
    return found


@needs_compiler
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("shape", SHAPES)
def test_two_bodies_as_casadi_has_them(shape, law):
    dynamics = RobotDynamics(two(SHAPES[shape]), LAWS[law])
    nodes, rng = nodes_of(dynamics.character, dynamics.character.start_pose)
    nodes[:, 5, 2] += 1.0  # one step is apart
    lam, p = rng.standard_normal((1, STEPS, dynamics.nx)), dynamics.layout.pack(dt=0.02)[None]
    found = felt(dynamics, nodes, p, lam)
    compare(found, dynamics.interpreted().evaluate(nodes, p, lam, order=2))
    for order in (0, 1):  # stages of their own
        for one, other in zip(dynamics.evaluate(nodes, p, lam, order=order), found, strict=True):
            assert one is None or np.abs(one - other).max() <= 1e-13 * np.abs(other).max()


@pytest.fixture(scope="module")
def crowded():
    """Dynamics of the crowd, a motion in which it touches itself everywhere, p and multipliers."""
    dynamics = RobotDynamics(crowd(), Smooth(onset=0.02, friction=Coulomb()))
    start = dynamics.character.start_pose
    start[: len(START)] = START
    nodes, rng = nodes_of(dynamics.character, start)
    lam = rng.standard_normal((1, STEPS, dynamics.nx))
    return dynamics, nodes, dynamics.layout.pack(dt=0.02)[None], lam


@needs_compiler
def test_a_crowd_as_casadi_has_it(crowded):
    """Several roots, common ancestors, one body above the other, and elements beside."""
    dynamics, nodes, p, lam = crowded
    found = felt(dynamics, nodes, p, lam)
    character = dynamics.character
    paths = [(character.path[a], character.path[b]) for a, b in mutual_ends(character)]
    shared = [len({*a} & {*b}) for a, b in paths]
    assert 0 in shared and any(k == len(b) for k, (_, b) in zip(shared, paths, strict=True))
    compare(found, dynamics.interpreted().evaluate(nodes, p, lam, order=2))
    outside = ~dynamics.jacobian_pattern
    assert outside.any() and (found[1][..., outside] == 0.0).all()


@needs_compiler
def test_one_step_at_a_time_and_in_a_block_of_threads(crowded):
    dynamics, nodes, p, lam = crowded
    found = dynamics.evaluate(nodes, p, lam, order=2)
    for order in (0, 1, 2):
        compare(one_by_one(dynamics, nodes, p, lam, order), found[: order + 1], 1e-13)
    library = native.load(BLOCK + dynamics.text() + ENTRY)
    for threads in (1, 5, 60):
        out = [np.zeros_like(value[:, :1]) for value in found[:2]]
        out.append(np.zeros((1, 1, dynamics.curvature_blocks, dynamics.nx, dynamics.nx)))
        pointers = [ctypes.c_void_p(a.ctypes.data) for a in (nodes, p, lam, *out)]
        library.octo_block(threads, 2, *pointers)
        out[2] = unfold(out[2])
        compare(out, [value[:, :1] for value in found], 1e-13)


@needs_compiler
def test_derivatives_by_taylor(crowded):
    """What is left of FD beyond its first, and of the gradient of lamᵀFD, falls with h²."""
    dynamics, nodes, p, lam = crowded
    nodes, lam = nodes[:, 3:6], lam[:, :1]
    way = np.random.default_rng(1).standard_normal(nodes.shape)
    step = way[0, ::-1].ravel()  # next, now, previous
    fd, jac, hess = (value[0, 0] for value in dynamics.evaluate(nodes, p, lam, order=2))
    left = []
    for h in (1e-4, 1e-5):
        own = dynamics.evaluate(nodes + h * way, p, lam, order=1)
        first = np.abs(own[0][0, 0] - fd - h * jac @ step).max()
        second = np.abs(lam[0, 0] @ (own[1][0, 0] - jac) - h * hess @ step).max()
        left.append([first, second])
    assert np.log10(np.array(left[0]) / left[1]) == pytest.approx(2.0, abs=0.15)


@needs_compiler
def test_a_body_on_the_world_is_ground():
    """A solid that does not move is a wall: only the ball feels it."""
    post = dataclasses.replace(octo.objects.box((0.2, 0.2, 0.4), 1.0), default_pose=None)
    body = dataclasses.replace(post.bodies[0], joints=(), position=np.array([0.0, 0.0, 0.2]))
    post = dataclasses.replace(post, bodies=(body,), base="fixed")
    ball = octo.objects.ball(0.1, 1.0, (0.0, 0.02, 0.48))
    scene = Scene(ball, [post], contacts=[("ball", "box")])
    dynamics = RobotDynamics(scene, Smooth(onset=0.02))
    nodes, rng = nodes_of(dynamics.character, dynamics.character.start_pose)
    lam, p = rng.standard_normal((1, STEPS, 6)), dynamics.layout.pack(dt=0.02)[None]
    found = dynamics.evaluate(nodes, p, lam, order=2)
    compare(found, dynamics.interpreted().evaluate(nodes, p, lam, order=2))
    rest = octo.simulate(scene, dynamics.character.start_pose, seconds=1.0, dt=0.01)
    assert rest.x[-1, 2] == pytest.approx(0.5, abs=0.02)
