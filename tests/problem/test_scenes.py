"""Problems with objects: every backend has the same numbers, and a box is pushed to where it is
asked to be."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from matplotlib.quiver import Quiver
from walker import START, walker, wiggle_near_ground

import octo
from octo import native
from octo.dynamics.laws import Smooth, Viscous
from octo.errors import ProblemError
from octo.gpu.problem import DeviceProblem
from octo.model.character import Body, Character, ContactSphere, Joint
from octo.problem.compiled import CompiledProblem
from octo.problem.interpreted import Interpreted
from octo.viewer.scene import Actor, arrows_of
from tests import emulator
from tests.emulator import EmulatedDevice

TOLERANCE = 1e-10  # of the largest entry
AXES = np.eye(3)[[0, 2]]
LAW = Smooth(w_perp=2e4, onset=0.01, friction=Viscous(2e5))
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="no C compiler")


def crowd():
    """A walker whose foot is in a ball that lies on the ground beside a box."""
    robot = dataclasses.replace(walker(), default_pose=START)
    objects = [
        octo.objects.ball(0.12, 0.7, (0.05, 0.05, 0.1)),
        octo.objects.box((0.2, 0.2, 0.2), 0.8, (0.26, 0.05, 0.1)),
    ]
    pairs = [("foot", "ball"), ("ball", "box"), ("front", "box")]
    return octo.Scene(robot, objects, contacts=pairs)


def compiled(basis="nodes"):
    scene = crowd()
    costs = [
        octo.Effort(),
        octo.PointPosition(body="ball", target=(0.3, 0.0, 0.1)),
        octo.CenterOfMassVelocity((0.3, 0.0, 0.0)),
        octo.LoadSharing(),
    ]
    x0 = scene.character.start_pose
    problem = octo.Problem(scene, steps=6, dt=0.05, costs=costs, basis=basis, x0=x0)
    return CompiledProblem([problem, problem.replace(parameters={"contact.w_perp": 5e3})])


def interpreted_model(problem, at, lam):
    nc, ma = problem.nc, problem.ma
    shapes = ((3, nc, nc), (3, ma, nc), (nc,), (ma,))
    out = tuple(np.empty((2, problem.K, *shape)) for shape in shapes)
    Interpreted(problem.program, problem.plan, problem.data).linearize(at, lam, None, out)
    out[0][:, problem.fixed, 0] = np.eye(nc)
    return out


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize("threads", [5, 160])
def test_the_cuda_text_is_the_others(threads):
    """Run on the CPU: FD, and with multipliers H and A, that is Jacobian and curvature."""
    if emulator.compiler() is None:
        pytest.skip("no C++ compiler")
    problem, device = compiled(), EmulatedDevice(threads)
    unknowns = wiggle_near_ground(problem)
    lam = np.random.default_rng(0).standard_normal((2, problem.K, problem.ma))
    at, gpu = problem.evaluate(unknowns), DeviceProblem(problem, device)
    own = gpu.evaluate(device.array(unknowns))
    expected = interpreted_model(problem, at, lam)
    native_model, device_model = problem.linearize(at, lam), gpu.linearize(own, device.array(lam))
    np.testing.assert_allclose(own.fd, at.fd, rtol=0.0, atol=TOLERANCE * np.abs(at.fd).max())
    for name, value in zip("HAbC", expected, strict=True):
        for model in (native_model, device_model):
            atol = TOLERANCE * np.abs(value).max()
            np.testing.assert_allclose(getattr(model, name), value, rtol=0.0, atol=atol)


@needs_compiler
def test_hermite_controls_too():
    problem = compiled(octo.Hermite(3))
    unknowns = wiggle_near_ground(problem)
    lam = np.random.default_rng(0).standard_normal((2, problem.K, problem.ma))
    at = problem.evaluate(unknowns)
    model = problem.linearize(at, lam)
    for name, value in zip("HAbC", interpreted_model(problem, at, lam), strict=True):
        atol = TOLERANCE * np.abs(value).max()
        np.testing.assert_allclose(getattr(model, name), value, rtol=0.0, atol=atol)


def hand():
    """A ball on two driven slides, along x and up."""
    rails = [Joint(n, "slide", axis, torque_limit=50.0) for n, axis in zip("xz", AXES, strict=True)]
    body = Body("hand", -1, tuple(rails), mass=0.5, inertia=0.001 * np.eye(3))
    tip = ContactSphere("tip", 0, np.zeros(3), 0.05)
    pose = np.array([-0.145, 0.1])
    return Character("hand", (body,), (tip,), base="fixed", default_pose=pose)


@pytest.fixture(scope="module")
def push():
    """Half a metre along x in 1.2 s."""
    scene = octo.Scene(hand(), [octo.objects.box((0.2, 0.2, 0.2), 1.0, (0.0, 0.0, 0.1))])
    there = octo.PointPosition(body="box", target=(0.5, 0.0, 0.09), at="last", weight=10.0)
    costs = [there, octo.Effort(weight=1e-5)]
    return octo.Problem(scene, steps=60, dt=0.02, costs=costs, law=LAW)


@pytest.fixture(scope="module")
def pushed(push):
    return octo.solve(push, device="cpu")


def test_a_hand_pushes_a_box_to_a_place(push, pushed, tmp_path):
    solution = pushed
    assert solution.converged
    place = solution.x[-1, push.character.joint_index("box_x")]
    assert place == pytest.approx(0.5, abs=0.01)
    assert solution.weight == pytest.approx(0.5 * 9.81)  # the hand's
    # only the hand's own contact counts among its figures
    assert solution.loaded[:, 1:].sum() == 0
    assert solution.contact_names[1] == "box_0"
    solution.save(tmp_path / "push.npz")
    back = octo.Solution.load(tmp_path / "push.npz")
    assert back.character.touches == push.character.touches
    assert np.array_equal(back.touch_force, solution.touch_force)
    assert np.array_equal(back.touch_point, solution.touch_point)


def test_what_touches_a_box_and_what_it_lies_on_moves_it_as_newton_says(pushed):
    names = pushed.joint_names
    box = [names.index(f"box_{axis}") for axis in "xyz"]
    assert pushed.touch_names == (("tip", "box"),)
    on_ground = pushed.contact_force[:, ~pushed.own_contacts].sum(axis=1)  # (N, 3) N
    found = on_ground - pushed.touch_force.sum(axis=1) - (0.0, 0.0, 9.81 * 1.0)
    acceleration = np.diff(pushed.x[:, box], n=2, axis=0) / pushed.dt**2  # (N, 3) of 1 kg
    assert found == pytest.approx(acceleration, abs=1e-4 * pushed.weight)
    assert pushed.touched.any()
    force = np.where(pushed.touched[..., None], pushed.touch_force, 0.0)
    assert force[..., 0].max() <= 0.0  # the box is in front: it presses the hand back


def test_forces_between_bodies_are_drawn_on_both(pushed, tmp_path):
    actor = Actor.of(pushed, pushed.times, np.zeros(3))
    arrows = arrows_of(actor)  # (frames, c + 2, 2, 3)
    on, off = arrows[1:, -2], arrows[1:, -1]
    seen = pushed.touched[:, 0]
    assert (on[~seen] == off[~seen]).all() and (on[~seen, 0, 2] < -100.0).all()
    assert on[seen, 0] == pytest.approx(pushed.touch_point[seen, 0])
    assert on[seen, 1] - on[seen, 0] == pytest.approx(off[seen, 0] - off[seen, 1])
    octo.view(pushed, tmp_path / "push.html")
    moments = np.flatnonzero(seen)[[0, -1]] * pushed.dt + pushed.dt
    drawn = octo.filmstrip(pushed, tmp_path / "push.png", 2, tuple(moments))
    quivers = [
        [one.N for one in axes.collections if isinstance(one, Quiver)] for axes in drawn.axes
    ]
    assert quivers == [[2], [2]]  # at each moment, which has a picture of its own, one on each body


@needs_compiler
def test_octo_and_ipopt_agree(push):
    short = push.replace(steps=12)
    own = octo.solve(short, device="cpu", passes=1)
    other = octo.reference.ipopt(short, start=own.x)
    assert own.converged and other.solution.converged
    assert other.solution.energy == pytest.approx(own.energy, rel=1e-6)


@pytest.mark.parametrize("place", [(0.8, 0.0, 0.1), (0.4, 0.0, -0.5)])
def test_an_object_inside_a_wall_or_the_ground_is_refused(place):
    wall = octo.shapes.Box((0.6, 2.0, 2.0), position=(0.8, 0.0, 0.9))
    scene = octo.Scene(hand(), [octo.objects.box((0.2, 0.2, 0.2), 1.0, place)])
    world = octo.World([octo.shapes.Ground(), wall])
    problem = octo.Problem(scene, steps=2, dt=0.02, costs=[octo.Effort()], law=LAW, terrain=world)
    with pytest.raises(ProblemError, match="start is under the ground: contact 'box_"):
        problem.start  # noqa: B018
