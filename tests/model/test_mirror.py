"""The left-right mirror of a robot: what is found, that its dynamics agree, and what is refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from robot_packages import loaded, mjcfs, urdf_named

import octo
from octo.dynamics.evaluate import RobotDynamics
from octo.errors import MirrorError, ProblemError, ShapeError, UnknownNameError
from octo.model.character import Body, Character, ContactSphere, Joint, floating_base
from octo.model.kinematics import axis_rotation, body_poses, sphere_centers
from octo.model.mirror import Mirror, mirror_of

M = np.diag([1.0, -1.0, 1.0])
X, Y, Z = np.eye(3)


def some_steps(robot: Character, seed: int) -> np.ndarray:
    """(3, nx) x_prev, x, x_next: off the x-z plane, turned, the lowest sphere 1 cm deep."""
    random = np.random.default_rng(seed)
    x = robot.start_pose + random.uniform(-0.15, 0.15, robot.nx)
    if robot.base == "floating":
        x[:2] += 0.3
        x[3] += 0.5
    if robot.base == "floating" and robot.contacts:
        bottom = sphere_centers(robot, x)[:, 2] - [contact.radius for contact in robot.contacts]
        x[2] -= bottom.min() + 0.01
    return x + random.uniform(-0.01, 0.01, (3, robot.nx)) * [[1.0], [0.0], [1.0]]


def difference(robot: Character, mirror: Mirror, seed: int = 0) -> float:
    """Of FD of mirrored steps from G FD, relative to the largest entry."""
    dynamics = RobotDynamics(robot)
    steps, p = some_steps(robot, seed), dynamics.layout.pack()
    fd, mirrored = (
        np.asarray(dynamics.symbolic(*nodes[::-1], p)).ravel() for nodes in (steps, mirror(steps))
    )
    return float(np.abs(mirrored - mirror.matrix @ fd).max() / np.abs(fd).max())


def changed(robot: Character, name: str, **fields: object) -> Character:
    """The robot with other fields in the body, or in the joint, of this name."""

    def body_of(body: Body) -> Body:
        if body.name == name:
            return replace(body, **fields)
        joints = [replace(j, **fields) if j.name == name else j for j in body.joints]
        return replace(body, joints=tuple(joints))

    return replace(robot, bodies=tuple(body_of(body) for body in robot.bodies))


@pytest.mark.parametrize("name", octo.gallery.CHARACTERS)
def test_dynamics_of_the_gallery(name: str) -> None:
    robot = octo.load(name)
    mirror = octo.mirror_of(robot)
    dynamics = RobotDynamics(robot)
    steps = np.array([some_steps(robot, seed) for seed in range(3)])  # (3, 3, nx)
    p = np.tile(dynamics.layout.pack(), (3, 1))
    fd = dynamics.evaluate(steps, p)[0]
    flying = dynamics.evaluate(steps + [0.0, 0.0, 2.0, *np.zeros(robot.nx - 3)], p)[0]
    assert np.abs(flying - fd).max() > 1.0  # N: there was contact
    mirrored = dynamics.evaluate(mirror(steps), p)[0]
    assert np.abs(mirrored - fd @ mirror.matrix.T).max() < 1e-9 * np.abs(fd).max()


@pytest.mark.parametrize("name", octo.gallery.CHARACTERS)
def test_matrix_is_a_reflection(name: str) -> None:
    robot = octo.load(name)
    mirror = mirror_of(robot)
    assert np.array_equal(mirror.matrix @ mirror.matrix, np.eye(robot.nx))
    assert np.array_equal(mirror.matrix, mirror.matrix.T)
    assert np.array_equal(np.diag(mirror.matrix)[:6], [1, -1, 1, -1, 1, -1])  # x y z yaw pitch roll
    assert not mirror.offset.any() and not mirror.alone
    x = some_steps(robot, 1)
    image = sphere_centers(robot, mirror(x))[:, mirror.contacts]
    assert np.allclose(image, sphere_centers(robot, x) @ M, atol=1e-12)


def test_names_and_signs() -> None:
    mirror = mirror_of(octo.gallery.mammal())
    assert mirror.joints["front_left_thigh_abduction"] == ("front_right_thigh_abduction", -1)
    assert mirror.joints["hind_right_thigh_pitch"] == ("hind_left_thigh_pitch", 1)
    chain = mirror_of(octo.gallery.chain()).joints
    assert chain["front_outer_yaw"] == ("front_outer_yaw", -1)
    assert chain["front_outer_pitch"] == ("front_outer_pitch", 1)


def test_the_other_chart() -> None:
    biped = changed(octo.gallery.biped(), "trunk", joints=floating_base(chart="zxy"))
    robot = replace(biped, chart="zxy")
    mirror = mirror_of(robot)
    assert np.array_equal(np.diag(mirror.matrix)[:6], [1, -1, 1, -1, -1, 1])  # x y z yaw roll pitch
    assert difference(robot, mirror) < 1e-12


def test_axes_and_zero_positions_may_differ() -> None:
    """A knee about -y that is zero elsewhere, and a leg that is mounted turned."""
    mammal = octo.gallery.mammal()
    knee = {"axis": -Y, "reference": 0.3, "lower": 0.5, "upper": 2.8}
    robot = changed(mammal, "front_left_shank_knee", **knee)
    mirror = mirror_of(robot)
    knees = [robot.joint_index(f"front_{side}_shank_knee") for side in ("left", "right")]
    assert mirror.joints["front_left_shank_knee"] == ("front_right_shank_knee", -1)
    assert np.allclose(mirror.offset[knees], 0.3) and np.count_nonzero(mirror.offset) == 2
    assert difference(robot, mirror) < 1e-12

    turned = changed(mammal, "hind_left_shank", rotation=axis_rotation(Y, np.array(0.4)))
    turned = changed(turned, "hind_left_shank_knee", lower=-2.9, upper=-0.6)
    with pytest.raises(MirrorError):
        mirror_of(turned)  # neither the zero nor the default pose is symmetric
    pose = turned.start_pose.copy()
    pose[turned.joint_index("hind_left_shank_knee")] -= 0.4
    mirror = mirror_of(replace(turned, default_pose=pose))
    assert mirror.offset[turned.joint_index("hind_left_shank_knee")] == pytest.approx(-0.4)
    assert mirror.offset[turned.joint_index("hind_right_shank_knee")] == pytest.approx(0.4)
    assert np.allclose(mirror(mirror(pose + 0.1)), pose + 0.1)


def test_limits_of_a_whole_turn() -> None:
    robot = changed(octo.gallery.chain(), "front_inner_yaw", lower=0.0, upper=2.0 * math.pi)
    mirror = mirror_of(robot)
    j = robot.joint_index("front_inner_yaw")
    assert mirror.offset[j] == pytest.approx(2.0 * math.pi)
    assert mirror.matrix[j, j] == -1.0 and np.count_nonzero(mirror.offset) == 1


def without_contact(robot: Character, name: str) -> Character:
    return replace(robot, contacts=tuple(c for c in robot.contacts if c.name != name), pairs=())


def with_arm(robot: Character, axis: np.ndarray) -> Character:
    arm = Body("arm", 0, (Joint("elbow", "hinge", axis),), position=0.1 * Y, mass=0.3, com=0.1 * X)
    pose = np.append(robot.start_pose, 0.0)
    return replace(robot, bodies=(*robot.bodies, arm), default_pose=pose)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda r: with_arm(r, Z), "joint 'elbow' has no image on the other side"),
        (lambda r: with_arm(r, Y), "the centre of mass of body 'arm' is no mirror image"),
        (
            lambda r: changed(r, "front_left_thigh", position=np.array([0.15, 0.09, 0.0])),
            "joint 'front_.*_thigh_abduction' has no image on the other side",
        ),
        (
            lambda r: changed(r, "hind_left_shank_knee", axis=Y + 0.02 * X),
            "joint 'hind_.*_shank_knee' has no image on the other side",
        ),
        (
            lambda r: changed(r, "hind_left_shank_knee", actuated=False),
            "joint 'hind_.*_shank_knee' has no image on the other side",
        ),
        (lambda r: changed(r, "hind_left_shank_knee", armature=0.1), "knee'.* differ in armature"),
        (lambda r: changed(r, "hind_left_shank", mass=1.0), "mass of body 'hind_.*_shank' and of"),
        (lambda r: changed(r, "trunk", com=0.1 * Y), "the centre of mass of body 'trunk' is no"),
        (
            lambda r: changed(r, "trunk", inertia=r.bodies[0].inertia + 0.2 * np.ones((3, 3))),
            "the inertia of body 'trunk' is no",
        ),
        (lambda r: without_contact(r, "front_left"), "contact 'front_right' has no image"),
    ],
)
def test_refused(change: Callable[[Character], Character], sentence: str) -> None:
    refusal = f"^robot 'mammal' has no left-right mirror: .*{sentence}"
    with pytest.raises(MirrorError, match=refusal):
        mirror_of(change(octo.gallery.mammal()))


def test_a_sphere_away_from_the_feet_may_be_alone() -> None:
    robot = without_contact(octo.gallery.mammal(), "front_left_shoulder")
    mirror = mirror_of(robot)
    k = robot.contact_index("front_right_shoulder")
    assert mirror.alone == ("front_right_shoulder",) and mirror.contacts[k] == k
    feet = [robot.contact_index(name) for name in ("hind_left", "hind_right")]
    assert list(mirror.contacts[feet]) == feet[::-1]


def rotors() -> Character:
    """A block with two equal rotors about y on one axis, and a foot."""
    ball = {"mass": 0.1, "inertia": 1e-4 * np.eye(3), "position": 0.1 * X}
    rotors = [Body(name, 0, (Joint(f"{name}_turn", "hinge", Y),), **ball) for name in ("a", "b")]
    block = Body("block", -1, floating_base(), mass=1.0, inertia=0.01 * np.eye(3))
    foot = ContactSphere("foot", 0, -0.1 * Z, 0.02)
    return Character("rotors", (block, *rotors), (foot,))


def test_pairs_by_hand() -> None:
    assert mirror_of(rotors()).joints["a_turn"] == ("a_turn", 1)
    assert mirror_of(rotors(), {"a_turn": "b_turn"}).joints["b_turn"] == ("a_turn", 1)
    mammal = octo.gallery.mammal()
    bent = changed(mammal, "hind_left_shank_knee", axis=(Y + 0.02 * X) / math.hypot(0.02, 1.0))
    mirror = mirror_of(bent, {"hind_left_shank_knee": "hind_right_shank_knee"})
    assert np.array_equal(mirror.matrix, mirror_of(mammal).matrix)
    with pytest.raises(MirrorError, match="knee' and the image that pairs gives it, '.* not alike"):
        mirror_of(mammal, {"hind_left_shank_knee": "front_left_shank_knee"})
    with pytest.raises(UnknownNameError, match="joint 'hind_knee' is not known"):
        mirror_of(mammal, {"hind_knee": "hind_right_shank_knee"})
    with pytest.raises(ProblemError, match="joint 'b_turn' the images 'a_turn' and 'b_turn', must"):
        mirror_of(rotors(), {"a_turn": "b_turn", "b_turn": "b_turn"})


def test_a_fixed_base() -> None:
    def arm(axis: np.ndarray, y: float) -> Character:
        link = Body("link", -1, (Joint("shoulder", "hinge", axis),), y * Y, mass=1.0, com=0.2 * X)
        return Character("arm", (link,), base="fixed")

    assert mirror_of(arm(Y, 0.0)).joints == {"shoulder": ("shoulder", 1)}
    assert mirror_of(arm(Z, 0.0)).joints == {"shoulder": ("shoulder", -1)}
    for other in (arm(Z, 0.5), arm((Y + Z) / math.sqrt(2.0), 0.0)):
        with pytest.raises(MirrorError, match="joint 'shoulder' has no image"):
            mirror_of(other)


def test_shape_is_checked() -> None:
    with pytest.raises(ShapeError, match="x has shape"):
        mirror_of(octo.gallery.mammal())(np.zeros(17))


@pytest.mark.parametrize(
    ("end", "left", "right", "asymmetry"),
    [
        ("go2_description/urdf/go2.urdf", "FL_hip_joint", "FR_hip_joint", 1e-3),
        ("go1_description/urdf/go1.urdf", "RL_calf_joint", "RR_calf_joint", 1e-3),
        ("anymal_c_simple_description/urdf/anymal.urdf", "LF_HAA", "RF_HAA", 1e-3),
        # the trunk's centre of mass is aside
        ("hyq_no_sensors.urdf", "lh_hfe_joint", "rh_hfe_joint", 0.1),
        ("talos_reduced.urdf", "leg_left_4_joint", "leg_right_4_joint", 1e-2),
        ("g1_29dof_rev_1_0.urdf", "left_elbow_joint", "right_elbow_joint", 1e-3),
        ("kinova.urdf", "j2s6s200_joint_2", "j2s6s200_joint_2", 1e-3),  # limits of 0 to 2π
    ],
)
def test_urdfs(end: str, left: str, right: str, asymmetry: float) -> None:
    robot = loaded(urdf_named(end))
    mirror = mirror_of(robot)
    assert mirror.joints[left][0] == right
    assert sorted(mirror.contacts) == list(range(len(robot.contacts)))
    assert difference(robot, mirror) < asymmetry


@pytest.mark.parametrize("end", ["assets/ant.xml", "suite/humanoid.xml", "suite/quadruped.xml"])
def test_mjcfs(end: str) -> None:
    path = next((p for p in mjcfs() if str(p).endswith(end)), None)
    if path is None:
        pytest.skip("gymnasium or dm_control is not installed")
    robot = loaded(path)
    assert difference(robot, mirror_of(robot)) < 1e-12


def test_an_arm_file_is_refused() -> None:
    with pytest.raises(MirrorError, match="robot 'ur5' has no .* body 'upper_arm_link' is no"):
        mirror_of(loaded(urdf_named("ur5_robot.urdf")))


def test_bodies_move_as_their_images() -> None:
    robot = loaded(urdf_named("go2_description/urdf/go2.urdf"))
    mirror = mirror_of(robot)
    x = some_steps(robot, 3)
    for left, right in (("FL_calf", "FR_calf"), ("RL_hip", "RR_hip")):
        b, c = robot.body_index(left), robot.body_index(right)
        origin, mirrored = body_poses(robot, x)[1], body_poses(robot, mirror(x))[1]
        assert np.allclose(origin[:, b] @ M, mirrored[:, c], atol=1e-9)
