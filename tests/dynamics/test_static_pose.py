"""Does a start stand: only the joints' own torques are left."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from octo.dynamics.evaluate import RobotDynamics
from octo.dynamics.laws import Coulomb, Smooth
from octo.dynamics.static_pose import UPRIGHT, inside_limits, static_pose
from octo.errors import ShapeError, StaticPoseError, ValueRangeError
from octo.model.character import Body, Character, ContactSphere, Joint, floating_base
from octo.model.gallery import CHARACTERS
from octo.model.kinematics import body_poses, center_of_mass, sphere_centers
from octo.model.load import load
from octo.model.terrain import Plane, Terrain


def unactuated_force(dynamics: RobotDynamics, p: np.ndarray, x: np.ndarray) -> float:
    """Largest unactuated row of FD(x, x, x), in mg (and mg·m)."""
    fd, _, _ = dynamics.evaluate(np.repeat(x[None, None], 3, axis=1), p[None])
    return float(np.max(np.abs(fd[0, 0, dynamics.unactuated]))) / (dynamics.character.mass * 9.81)


def vector(*values: float) -> np.ndarray:
    return np.array(values)


def point_footed(passive: bool) -> Character:
    """A trunk whose mass is ahead of its two point feet; with ``passive``, a sprung tail and a
    hanging arm besides."""
    bodies = [
        Body(
            "trunk",
            -1,
            floating_base(),
            mass=5.0,
            com=vector(0.03, 0.0, 0.1),
            inertia=0.05 * np.eye(3),
        )
    ]
    contacts = []
    for side in (1.0, -1.0):
        hip = Joint(f"hip_{side}", "hinge", vector(0, 1, 0), lower=-1.0, upper=1.0)
        leg = Body(
            f"leg_{side}",
            0,
            (hip,),
            vector(0, 0.1 * side, 0),
            mass=1.0,
            com=vector(0, 0, -0.2),
            inertia=0.01 * np.eye(3),
        )
        bodies.append(leg)
        contacts.append(ContactSphere(f"foot_{side}", len(bodies) - 1, vector(0, 0, -0.4), 0.05))
    if passive:
        tail = Joint("tail", "hinge", vector(0, 1, 0), actuated=False, stiffness=1.0, rest=0.3)
        arm = Joint("arm", "hinge", vector(1, 0, 0), actuated=False)
        inertia = 1e-3 * np.eye(3)
        bodies.append(
            Body(
                "tail",
                0,
                (tail,),
                vector(-0.1, 0, 0),
                mass=1.0,
                com=vector(-0.2, 0, 0),
                inertia=inertia,
            )
        )
        bodies.append(
            Body(
                "arm",
                0,
                (arm,),
                vector(0, 0.1, 0.2),
                mass=0.3,
                com=vector(0, 0.2, 0),
                inertia=inertia,
            )
        )
    return Character("point_footed", tuple(bodies), tuple(contacts))


def planar_walker() -> Character:
    """A trunk that slides in x and z and pitches, on two straight legs with flat feet."""
    root = (
        Joint("x", "slide", vector(1, 0, 0), actuated=False),
        Joint("z", "slide", vector(0, 0, 1), actuated=False),
        Joint("pitch", "hinge", vector(0, 1, 0), actuated=False),
    )
    bodies = [
        Body(
            "trunk",
            -1,
            root,
            vector(0, 0, 3.0),
            mass=4.0,
            com=vector(0, 0, 0.2),
            inertia=0.1 * np.eye(3),
        )
    ]
    contacts = []
    for side in ("left", "right"):
        hip = Joint(f"{side}_hip", "hinge", vector(0, 1, 0), lower=-1.0, upper=0.0)
        bodies.append(
            Body(
                f"{side}_leg", 0, (hip,), mass=2.0, com=vector(0, 0, -0.4), inertia=0.05 * np.eye(3)
            )
        )
        contacts += [
            ContactSphere(f"{side}_{x}", len(bodies) - 1, vector(x, 0, -0.9), 0.05)
            for x in (-0.15, 0.2)
        ]
    return Character("planar_walker", tuple(bodies), tuple(contacts), base="fixed")


@pytest.mark.parametrize("name", CHARACTERS)
def test_every_character_of_the_gallery_stands(gallery, name):
    dynamics, p = gallery(name)
    robot = dynamics.character
    x = static_pose(dynamics, p)
    assert unactuated_force(dynamics, p, x) < 1e-6
    np.testing.assert_array_equal(x[robot.actuated], robot.default_pose[robot.actuated])
    assert np.max(np.abs(x[4:6])) < 0.1  # rad: none leans
    assert np.all(x >= robot.lower) and np.all(x <= robot.upper)


@pytest.mark.parametrize("height", [-0.4, 3.0])
@pytest.mark.parametrize("name", ["mammal", "bird"])
def test_a_start_in_the_air_or_under_the_ground_is_put_on_it(gallery, name, height):
    dynamics, p = gallery(name)
    pose = dynamics.character.default_pose.copy()
    pose[:4] = 2.0, -1.0, height, 1.3
    x = static_pose(dynamics, p, pose)
    assert unactuated_force(dynamics, p, x) < 1e-6
    np.testing.assert_array_equal(x[[0, 1, 3]], [2.0, -1.0, 1.3])
    np.testing.assert_allclose(x[2], static_pose(dynamics, p)[2], atol=1e-8)


def test_random_poses_of_four_legs_stand_stably(gallery):
    rng = np.random.default_rng(0)
    dynamics, p = gallery("spider")
    for _ in range(6):
        pose = dynamics.character.default_pose.copy()
        pose[4:6] += rng.normal(0.0, 0.3, 2)
        pose[6:] += rng.normal(0.0, 0.15, 12)
        x = static_pose(dynamics, p, pose)
        assert unactuated_force(dynamics, p, x) < 1e-6
        carrying = np.sum(sphere_centers(dynamics.character, x)[:4, 2] < 0.02)
        assert carrying >= 3


@pytest.mark.parametrize("passive", [False, True])
def test_two_point_feet_are_balanced_and_passive_joints_hang(passive):
    robot = point_footed(passive)
    dynamics = RobotDynamics(robot)
    p = dynamics.layout.pack()
    x = static_pose(dynamics, p)
    assert unactuated_force(dynamics, p, x) < 1e-6
    feet = sphere_centers(robot, x)
    assert center_of_mass(robot, x)[0] == pytest.approx(feet[:, 0].mean(), abs=1e-4)  # m
    if passive:
        rotation, _ = body_poses(robot, x)
        # straight down, up to the trunk's tilt
        assert rotation[robot.body_index("arm"), :, 1] @ vector(0, 0, 1) < -0.99


def test_a_planar_robot_is_not_held_by_its_root():
    dynamics = RobotDynamics(planar_walker())
    p = dynamics.layout.pack()
    x = static_pose(dynamics, p)
    assert unactuated_force(dynamics, p, x) < 1e-6
    assert abs(x[2]) < 0.2
    # on its limit, 0: moved in by 5 % of the range
    np.testing.assert_allclose(x[3:], -0.05, atol=1e-12)


def test_a_fixed_base_keeps_its_pose_inside_the_limits():
    joint = Joint("shoulder", "hinge", vector(0, 1, 0), lower=0.1, upper=1.1)
    arm = Body("arm", -1, (joint,), mass=1.0, com=vector(0.1, 0, 0), inertia=0.01 * np.eye(3))
    robot = Character("arm", (arm,), base="fixed")
    dynamics = RobotDynamics(robot)
    np.testing.assert_allclose(static_pose(dynamics, dynamics.layout.pack()), [0.15])
    np.testing.assert_allclose(static_pose(dynamics, dynamics.layout.pack(), vector(0.7)), [0.7])
    np.testing.assert_allclose(inside_limits(robot, vector(2.0)), [1.05])


def test_joints_balance_a_robot_that_soft_ground_lets_tip_over():
    """A humanoid whose feet sink by 2.6 cm: with its joints held it would lean without bound."""
    robot = CHARACTERS["humanoid"]()
    dynamics, depth = RobotDynamics(robot), 0.0259
    w_perp = robot.mass * 9.81 / (4.0 * depth**2)
    p = dynamics.layout.pack(**{"contact.w_perp": w_perp, "contact.onset": depth})
    for pose in (None, robot.start_pose):
        x = static_pose(dynamics, p, pose)
        assert unactuated_force(dynamics, p, x) < 1e-6
        assert np.abs(x[4:6]).max() < 0.02
        assert 0.0 < np.abs((x - robot.start_pose)[robot.actuated]).max() < 0.05


def test_on_a_slope_the_robot_turns_with_the_ground_and_creeps(gallery):
    """Normal force and moments balance; the force along the slope is what lets it creep."""
    flat, p = gallery("mammal")
    slope = 0.2
    dynamics = RobotDynamics(flat.character, terrain=Plane(slope=slope))
    p = dynamics.layout.pack(**{"contact.w_perp": p[flat.layout.index("contact.w_perp")]})
    x = static_pose(dynamics, p)
    fd, _, _ = dynamics.evaluate(np.repeat(x[None, None], 3, axis=1), p[None])
    outward = vector(-np.sin(slope), 0.0, np.cos(slope))
    assert abs(fd[0, 0, :3] @ outward) < 1e-6 * flat.character.mass * 9.81
    rotation, _ = body_poses(flat.character, x)
    assert np.arccos(rotation[0, :, 2] @ outward) < 0.1  # rad


def test_a_default_pose_that_falls_gets_its_feet_below_it(gallery):
    flat, p = gallery("mammal")
    pose = flat.character.default_pose.copy()
    pose[7::3] += 1.0  # rad: all thighs back
    robot = replace(flat.character, default_pose=pose)
    dynamics = RobotDynamics(robot)
    with pytest.raises(StaticPoseError, match="trunk comes down on the ground"):
        static_pose(dynamics, p, pose)  # a pose that the user gives is taken as it is
    x = static_pose(dynamics, p)
    assert unactuated_force(dynamics, p, x) < 1e-6
    assert np.max(np.abs(x[4:6])) < UPRIGHT
    assert 0.0 < np.max(np.abs(x[robot.actuated] - pose[robot.actuated])) < 1.0


@pytest.mark.parametrize("file", ["ant.xml", "humanoid.xml", "walker2d_v5.xml"])
def test_robots_of_gymnasium_stand(file):
    """Legs sprawled, on two spheres for feet, and in a plane."""
    pytest.importorskip("mujoco")
    found = find_spec("gymnasium")
    if found is None or found.origin is None:
        pytest.skip("gymnasium is not installed")
    robot = load(Path(found.origin).parent / "envs" / "mujoco" / "assets" / file)
    dynamics = RobotDynamics(robot)
    weight = robot.mass * 9.81
    p = dynamics.layout.pack(
        **{"contact.w_perp": weight / 1.6e-3, "contact.w_par": weight / 1.6e-4}
    )
    x = static_pose(dynamics, p)
    assert unactuated_force(dynamics, p, x) < 1e-6
    tilts = [j for j in robot.unactuated if robot.joints[j].kind == "hinge"]
    assert np.max(np.abs(x[tilts])) < UPRIGHT
    assert np.all(x >= robot.lower) and np.all(x <= robot.upper)


def test_a_hill_written_by_the_user(block):
    """On the top of a paraboloid nothing slides."""
    hill = Terrain(
        lambda point, p: point[2] + p["bend"] * (point[0] ** 2 + point[1] ** 2), {"bend": 0.3}
    )
    dynamics = RobotDynamics(block, terrain=hill)
    x = static_pose(dynamics, dynamics.layout.pack())
    assert unactuated_force(dynamics, dynamics.layout.pack(), x) < 1e-6


@pytest.mark.parametrize("chart", ["zyx", "zxy"])
def test_both_charts_lie_flat_on_a_slope_of_any_direction(block, chart):
    body = replace(block.bodies[0], joints=floating_base(chart=chart))
    ground = Plane(slope=0.3, direction=2.0)
    dynamics = RobotDynamics(replace(block, bodies=(body,), chart=chart), terrain=ground)
    pose = vector(0.4, -0.2, 0.0, 0.7, 0.0, 0.0)
    rotation, _ = body_poses(
        dynamics.character, static_pose(dynamics, dynamics.layout.pack(), pose)
    )
    outward = vector(*(ground.parameters[f"normal_{axis}"] for axis in "xyz"))
    # friction's moment leans it by less than a degree
    assert rotation[0, :, 2] @ outward > np.cos(0.02)


def test_no_friction_at_all_slides_but_keeps_its_height(block):
    dynamics = RobotDynamics(block, Smooth(friction=Coulomb(mu=0.0)), Plane(slope=0.3))
    p = dynamics.layout.pack()
    x = static_pose(dynamics, p)
    fd, _, _ = dynamics.evaluate(np.repeat(x[None, None], 3, axis=1), p[None])
    assert abs(fd[0, 0, :3] @ vector(-np.sin(0.3), 0.0, np.cos(0.3))) < 1e-6 * 2.0 * 9.81
    np.testing.assert_allclose(x[4], -0.3, atol=1e-6)  # rad: flat on the slope


def seesaw() -> Character:
    """One foot under the end of a beam: no pose carries it."""
    beam = Body("beam", -1, floating_base(), mass=1.0, com=vector(0, 0, 0), inertia=0.1 * np.eye(3))
    leg = Body(
        "leg",
        0,
        (Joint("knee", "hinge", vector(0, 1, 0), lower=-0.1, upper=0.1),),
        vector(0.6, 0, 0),
        mass=0.1,
    )
    return Character("seesaw", (beam, leg), (ContactSphere("foot", 1, vector(0, 0, -0.3), 0.02),))


def test_a_robot_that_tips_over_is_refused():
    dynamics = RobotDynamics(seesaw())
    with pytest.raises(StaticPoseError, match="--pose NAME|FILE"):
        static_pose(dynamics, dynamics.layout.pack())


def test_nothing_to_stand_on():
    robot = Character(
        "stone", (Body("stone", -1, floating_base(), mass=1.0, inertia=0.1 * np.eye(3)),)
    )
    dynamics = RobotDynamics(robot)
    with pytest.raises(StaticPoseError, match="no contact to stand on"):
        static_pose(dynamics, dynamics.layout.pack())


def test_wrong_poses_are_refused(gallery):
    dynamics, p = gallery("chain")
    with pytest.raises(ShapeError, match="pose"):
        static_pose(dynamics, p, np.zeros(3))
    with pytest.raises(ValueRangeError, match="pose is not finite at index 0"):
        static_pose(dynamics, p, np.full(dynamics.nx, np.nan))


def test_a_pose_is_found_once_and_each_gets_its_own() -> None:
    """Of a robot that is made again; another stiffness or pose is another question."""
    made = [RobotDynamics(CHARACTERS["mammal"]()) for _ in range(2)]
    p = made[0].layout.pack()
    first, again = (static_pose(each, p) for each in made)
    np.testing.assert_array_equal(first, again)
    again[:] = np.nan
    assert np.isfinite(static_pose(made[0], p)).all()
    stiffness = made[0].layout.index("contact.w_perp")
    soft = made[0].layout.pack(**{"contact.w_perp": 0.5 * p[stiffness]})
    assert static_pose(made[0], soft)[2] < first[2]
    assert (static_pose(made[0], p, first + 0.01) != first).any()
