"""Control on a world: the map that is planned on, feet in turn, and a ground that is felt."""

from __future__ import annotations

import numpy as np
import pytest

import octo
from octo import shapes, worlds
from octo.errors import ValueRangeError
from octo.model.feet import low_contacts
from octo.model.kinematics import sphere_centers
from octo.mpc import Controller, VelocityCommand, run, smooth_ground, walking_problem
from octo.mpc.footing import Footing
from octo.mpc.gait import Gait
from octo.plant import MujocoPlant

BASE = np.array([0.0, 0.0, 0.3])  # m


def heights(world: octo.World, x: list[float]) -> np.ndarray:
    return world.below([[place, 0.0, 5.0] for place in x])


def test_the_map_has_ramps_for_edges_and_keeps_what_is_level():
    stairs = worlds.stairs(rise=0.1, run=0.3, n=1, landing=2.0)
    smooth = smooth_ground(stairs, BASE, 0.3)
    np.testing.assert_allclose(heights(smooth, [0.0, 0.2, 1.0, 1.6]), [0, 0, 0.1, 0.1], atol=1e-3)
    assert heights(smooth, [0.6]) == pytest.approx(0.05, abs=0.005)
    x = np.linspace(0.3, 0.9, 121)
    slope = np.gradient(heights(smooth, x.tolist()), x)
    normal = 0.1 / (0.25 * 0.3 * np.sqrt(2.0 * np.pi))  # a step's, under weights 0.25 ℓ wide
    assert normal * 0.9 < slope.max() < normal


def test_what_hangs_over_the_way_is_no_ground_and_stairs_are_climbed():
    arch = smooth_ground(worlds.arch(height=0.4), BASE, 0.3)
    assert heights(arch, [0.65]) == pytest.approx(0.0, abs=0.01)
    boards = [shapes.Box((0.4, 1, 0.02), position=(0.6 + 0.3 * k, 0, 0.2 * k)) for k in range(4)]
    open_stairs = octo.World([shapes.Ground(), *boards])
    seen = smooth_ground(open_stairs, BASE, 0.3)
    assert heights(seen, [1.55]) == pytest.approx(0.6, abs=0.05)  # not the ground under them


def test_planes_stay_and_a_world_that_is_too_wide_is_refused():
    plane = octo.World([shapes.Ground(slope=0.1)])
    assert smooth_ground(plane, BASE, 0.3) is plane
    wide = octo.World([shapes.Ground(), shapes.Box((190.0, 190.0, 0.1))])
    with pytest.raises(ValueRangeError, match="m wide, a controller has a map of at most"):
        smooth_ground(wide, BASE, 0.3)


def test_a_map_alone_says_its_heights_as_a_fall_onto_it_does():
    rng = np.random.default_rng(0)
    field = shapes.HeightField(0.1 * rng.random((20, 20)), 0.1, smooth=True)
    points = np.column_stack([rng.uniform(0, 1.9, (50, 2)), rng.uniform(-0.2, 1.0, 50)])
    far = shapes.Sphere(0.01, position=(0.0, 0.0, -30.0))  # with which the world falls
    alone, two = octo.World([field]).below(points), octo.World([field, far]).below(points)
    np.testing.assert_allclose(alone, two, atol=1e-5)


def test_diagonal_feet_swing_together_and_all_stand_without_a_command(robot):
    gait = Gait(robot, robot.default_pose, 0.3)
    places = sphere_centers(robot, robot.default_pose)[gait.feet]
    front, left = places[:, 0] > 0.0, places[:, 1] > 0.0
    assert len(set(gait.begins[front == left])) == len(set(gait.begins[front != left])) == 1
    times = np.linspace(0.0, gait.period, 101)
    found = gait.heights(times)
    np.testing.assert_allclose(found, gait.heights(times + gait.period), atol=1e-12)
    assert ((found > 0.0).sum(axis=0) <= 2).all() and found.max() == pytest.approx(0.075, rel=0.01)


@pytest.fixture(scope="module")
def blind(robot):
    guide = VelocityCommand((0.0, 0.0), feel=True)
    return Controller(walking_problem(robot, steps=20, gait=True), guide=guide)


def test_feet_stay_down_where_nothing_is_commanded(blind):
    blind.reset()
    assert not blind.reference("FootHeight front_left", "height").any()
    blind.guide.velocity[0] = 0.3
    for k in range(1, 50):
        blind.guide(blind, 0.01 * k, blind.problem.start)
    assert blind.reference("FootHeight front_left", "height").max() > 0.01
    blind.guide.velocity[0] = 0.0


def test_the_ground_that_is_felt_is_the_plane_under_the_feet(robot, blind):
    blind.reset()
    x = blind.problem.start
    footing = Footing(blind, x)
    footing.take(blind, 0.0, x)
    assert footing.rise == pytest.approx(0.0, abs=1e-6)
    assert footing.height == pytest.approx(0.0, abs=2e-3)
    higher = x.copy()
    higher[robot.base_coordinate + 2] += 0.1
    higher[robot.base_coordinate + 4] -= 0.1  # nose up: the front feet are higher
    for k in range(3):
        footing.take(blind, 0.1 * (k + 1), higher)
    feet = sphere_centers(robot, higher)[low_contacts(robot, x)]
    steep = np.polyfit(feet[:, 0], feet[:, 2], 1)[0]
    assert 0.5 * steep < footing.rise[0] < steep  # less than it: little is known of a slope
    plane = dict(zip(blind.problem.dynamics.layout.names, blind.compiled.p[0], strict=True))
    slope = -plane["terrain.normal_x"] / plane["terrain.normal_z"]
    assert slope == pytest.approx(footing.rise[0])
    assert plane["terrain.height"] == pytest.approx(footing.height) and footing.height > 0.08


@pytest.mark.parametrize("sees", [True, False])
def test_a_quadruped_climbs_onto_a_block(robot, sees):
    world = worlds.blocks(height=0.05, length=2.0, start=0.35)
    known = {"terrain": world} if sees else {"gait": True}
    problem = walking_problem(robot, **known)
    plant = MujocoPlant(robot, terrain=world)
    plant.reset_chart(problem.start)
    guide = VelocityCommand((0.4, 0.0), feel=not sees)
    log = run(Controller(problem, guide=guide), plant, 3.0)
    assert not log.falls
    assert (sphere_centers(robot, log.x[-1])[low_contacts(robot, problem.start), 2] > 0.05).all()
