"""Bodies that touch each other, against what a person can work out with a pencil."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import octo
from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.laws import Coulomb, Smooth, Viscous
from octo.dynamics.simulate import Motion
from octo.dynamics.static_pose import static_pose
from octo.dynamics.symbolic import mass_matrix_of_points
from octo.model.character import Character
from octo.model.kinematics import body_poses

G = 9.81  # m/s²
FREE = {"gravity_z": 0.0}


def tilted(angle: float) -> dict[str, float]:
    """Gravity as it is on a slope of ``angle`` rad, seen along the slope: down along +x."""
    return {"gravity_x": G * np.sin(angle), "gravity_z": -G * np.cos(angle)}


def momenta(character: Character, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """Linear (N+1, 3) kg m/s and angular momentum (N+1, 3) kg m²/s about the world's origin of all
    bodies, at x_0 … x_N."""
    rotation, origin = body_poses(character, motion.x)
    linear, angular = np.zeros((len(motion.x) - 1, 3)), np.zeros((len(motion.x) - 1, 3))
    for b, body in enumerate(character.bodies):
        R, com = rotation[:, b], origin[:, b] + rotation[:, b] @ body.com
        v, turn = np.diff(com, axis=0) / motion.dt, np.diff(R, axis=0) / motion.dt
        linear += body.mass * v
        spin = turn @ mass_matrix_of_points(body) @ np.swapaxes(R[1:], -1, -2)
        own = [spin[:, k, i] - spin[:, i, k] for i, k in ((1, 2), (2, 0), (0, 1))]
        angular += body.mass * np.cross(com[1:], v) + np.stack(own, axis=-1)
    return linear, angular


def collide(objects, v0, seconds=0.4, law=None, **values):
    scene = octo.Scene(None, objects)
    x0 = scene.character.start_pose
    motion = octo.simulate(
        scene, x0, np.concatenate(v0), seconds=seconds, dt=1e-3, law=law, parameters=FREE | values
    )
    assert motion.converged.all()
    return scene.character, motion


@pytest.mark.parametrize("law", [Smooth(), Smooth(friction=Coulomb(mu=0.5))])
def test_two_boxes_collide_and_keep_their_momentum(law):
    """Off centre and turned: both turn afterwards, and nothing of the momentum is lost."""
    turn = (np.cos(0.3), 0.0, np.sin(0.3), 0.0)
    boxes = [
        octo.objects.box((0.2, 0.2, 0.2), 1.0, (0.0, 0.0, 1.0)),
        octo.objects.box((0.2, 0.3, 0.1), 2.0, (0.3, 0.06, 1.02), turn),
    ]
    v0 = [np.array([1.0, 0.1, 0.0, 0.0, 0.0, 0.0]), np.array([-0.5, 0.0, 0.1, 0.0, 0.5, 0.0])]
    character, motion = collide(boxes, v0, law=law)
    linear, angular = momenta(character, motion)
    assert np.abs(linear - linear[0]).max() <= 1e-8
    # both are turned and thrown about
    assert np.abs(motion.velocity[-1] - motion.velocity[0])[[0, 3, 6]].min() > 0.1
    assert np.abs(angular - angular[0]).max() < 5e-3 * np.abs(angular).max()  # to first order in dt


def test_two_balls_meet_as_the_textbook_says():
    """Central and frictionless: the heavier one keeps the common velocity and e of the rest."""
    balls = [octo.objects.ball(0.1, m, (x, 0.0, 1.0)) for m, x in ((1.0, 0.0), (3.0, 0.25))]
    v0 = [np.array([1.0, 0, 0, 0, 0, 0]), np.zeros(6)]
    frictionless = Smooth(w_perp=1e6, friction=Viscous(0.0))
    character, motion = collide(balls, v0, law=frictionless)
    linear, angular = momenta(character, motion)
    assert np.abs(linear - linear[0]).max() <= 1e-8 and np.abs(angular - angular[0]).max() < 1e-10
    apart = motion.velocity[-1, 6] - motion.velocity[-1, 0]
    bounce = apart / 1.0  # relative to the speed with which they came together
    assert 0.5 < bounce <= 1.0  # an elastic law, damped by backward Euler
    assert motion.velocity[-1, 0] == pytest.approx((1.0 - 3.0 * bounce) / 4.0, abs=1e-8)


def test_a_stack_of_three_boxes_stands():
    """Each on the four corners of the one above and its own four: w_perp d² times their number is
    what is above."""
    boxes = [octo.objects.box((0.2, 0.2, 0.2), 1.0, (0, 0, 0.1 + 0.2 * k)) for k in range(3)]
    dynamics = RobotDynamics(octo.Scene(None, boxes), Smooth(w_perp=1e5))
    start = static_pose(dynamics, dynamics.layout.pack())
    motion = octo.simulate(dynamics, start, seconds=3.0, dt=0.01)
    assert motion.converged.all()
    assert np.abs(motion.x[-1] - start).max() < 1e-4
    loads, corners = G * np.array([3.0, 2.0, 1.0]), np.array([4.0, 8.0, 8.0])
    depths = np.sqrt(loads / corners / 1e5)
    np.testing.assert_allclose(start[[2, 8, 14]] - [0.1, 0.3, 0.5], -np.cumsum(depths), atol=1e-5)


def slab_and_box(thick=0.1):
    return octo.Scene(
        None,
        [
            octo.objects.box((1.0, 0.6, thick), 4.0, (0.0, 0.0, 0.5 * thick), name="slab"),
            octo.objects.box((0.2, 0.2, 0.2), 1.0, (0.0, 0.0, thick + 0.1)),
        ],
    )


def held_slab():
    """The slab as a part of the world."""
    slab = slab_and_box().objects[0]
    body = dataclasses.replace(slab.bodies[0], joints=(), position=np.array([0.0, 0.0, 0.05]))
    return dataclasses.replace(slab, bodies=(body,), base="fixed", default_pose=None)


@pytest.mark.parametrize(
    ("friction", "speed"),
    [
        (Viscous(3e8), np.tan(0.2) / 30.0),
        (Coulomb(0.3, 0.02), 0.02 / np.sqrt((0.3 / np.tan(0.2)) ** 2 - 1.0)),
    ],
)
def test_a_box_on_a_slab_on_a_slope_creeps_twice_as_fast(friction, speed):
    """Each contact slides as fast as its law says for tan(slope), the upper one over the lower."""
    law = Smooth(w_perp=1e7, friction=friction)  # so hard that the slab hardly tilts
    dynamics = RobotDynamics(slab_and_box(), law)
    p = dynamics.layout.pack(dt=0.02)
    values = tilted(0.2)
    motion = octo.simulate(
        dynamics, static_pose(dynamics, p), seconds=2.0, dt=0.02, parameters=values
    )
    assert motion.converged.all()
    slab, box = motion.velocity[-1, 0], motion.velocity[-1, 6]
    assert slab == pytest.approx(speed, rel=1e-3)
    assert box == pytest.approx(2.0 * speed, rel=1e-3)


def test_a_box_slides_down_a_slab_as_fast_as_coulomb_says():
    """a = g (sin − mu cos), less what is left of sticking at low speed, on a slab that holds."""
    mu, creep, angle = 0.3, 1e-3, 0.5
    board = octo.objects.box((0.2, 0.2, 0.04), 1.0, (0.0, 0.0, 0.12), name="box")
    scene = octo.Scene(board, [held_slab()], contacts=[("box", "slab")])
    x0 = scene.character.start_pose
    x0[2] -= np.sqrt(G * np.cos(angle) / 4.0 / 1e7)  # what its corners sink
    law = Smooth(w_perp=1e7, friction=Coulomb(mu, creep))
    motion = octo.simulate(scene, x0, seconds=0.4, dt=1e-3, law=law, parameters=tilted(angle))
    assert motion.converged.all()
    a = G * (np.sin(angle) - mu * np.cos(angle))
    v = motion.velocity[:, 0]
    assert (v[-1] - v[100]) / 0.3 == pytest.approx(a, rel=2e-3)
    assert np.abs(motion.x[-1, 3:6]).max() < 0.03  # it leans on its lower corners and slides


@pytest.mark.parametrize("hollow", [False, True])
def test_a_ball_rolls_without_slip(hollow):
    """Down a slab that holds: a = g sin / (1 + I/mr²), 5/7 or 3/5 of g sin."""
    angle, radius = 0.1, 0.1
    ball = octo.objects.ball(radius, 1.0, (-0.3, 0.0, 0.1 + radius - 0.003), hollow=hollow)
    scene = octo.Scene(ball, [held_slab()], contacts=[("ball", "slab")])
    law = Smooth(w_perp=1e6, friction=Viscous(1e9))
    motion = octo.simulate(
        scene, scene.character.start_pose, seconds=0.8, dt=1e-3, law=law, parameters=tilted(angle)
    )
    assert motion.converged.all()
    v = motion.velocity
    share = 3.0 / 5.0 if hollow else 5.0 / 7.0
    assert (v[-1, 0] - v[200, 0]) / 0.6 == pytest.approx(share * G * np.sin(angle), rel=5e-3)
    rotation, _ = body_poses(scene.character, motion.x)
    turn = (rotation[-1, 0] @ rotation[-2, 0].T - np.eye(3)) / motion.dt
    assert turn[0, 2] * radius == pytest.approx(v[-1, 0], rel=0.02)  # of its depth, 3 %


def test_a_door_with_friction_stops_where_energy_says():
    """½ I ω² is the work of the friction, τ times the angle; then it stands."""
    mass, width, torque, rate = 6.0, 0.8, 3.0, 2.0
    door = octo.objects.door((width, 0.04, 1.0), mass, friction=torque, lower=-3.0, upper=3.0)
    hinge = mass * (width**2 + 0.04**2) / 12.0 + mass * (0.5 * width) ** 2
    scene = octo.Scene(None, [door])
    motion = octo.simulate(scene, np.zeros(1), np.array([rate]), seconds=3.0, dt=1e-3)
    assert motion.converged.all()
    angle = 0.5 * hinge * rate**2 / torque
    assert motion.x[-1, 0] == pytest.approx(angle, rel=5e-3) and angle > 0.8
    assert abs(motion.velocity[-1, 0]) < 1e-6


def test_a_door_stops_where_its_damping_says():
    """I ω' = −c ω: it turns by I ω/c; a ball that hits it opens it."""
    mass, width, damping, rate = 6.0, 0.8, 2.0, 1.0
    door = octo.objects.door((width, 0.04, 1.0), mass, damping=damping)
    hinge = mass * (width**2 + 0.04**2) / 12.0 + mass * (0.5 * width) ** 2
    motion = octo.simulate(
        octo.Scene(None, [door]), np.zeros(1), np.array([rate]), seconds=15.0, dt=2e-3
    )
    assert motion.x[-1, 0] == pytest.approx(hinge * rate / damping, rel=5e-3)
    ball = octo.objects.ball(0.1, 2.0, (0.6, -0.4, 0.5))
    scene = octo.Scene(ball, [door])
    x0, v0 = scene.character.start_pose, np.zeros(7)
    v0[1] = 2.0
    hit = octo.simulate(scene, x0, v0, seconds=1.0, dt=2e-3, parameters=FREE)
    assert hit.converged.all() and hit.x[-1, 6] > 0.3 and hit.velocity[-1, 1] < 0.5
