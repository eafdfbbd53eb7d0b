"""A robot and objects as one character: names, whose figures are whose, and what is refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import octo
from octo.dynamics.evaluate import RobotDynamics
from octo.errors import OctoError, UnknownNameError
from octo.model import store
from octo.model.feet import lowest_contacts, touching
from octo.model.kinematics import body_poses, center_of_mass, sphere_centers
from octo.model.quaternions import rotation_of
from octo.model.scene import Scene
from octo.model.solid import Solid
from octo.model.terrain import Plane
from octo.world.shapes import Box, Ground, Sphere
from octo.world.world import World


@pytest.fixture(scope="module")
def scene():
    """A mammal, two boxes of one name that rest on each other, a ball in the air and a door."""
    boxes = [octo.objects.box((0.3, 0.3, 0.2), 1.6, (1.0, 0.0, 0.1 + 0.2 * k)) for k in (0, 1)]
    ball = octo.objects.ball(0.1, 0.5, (1.0, 1.0, 1.5))
    return Scene(octo.gallery.mammal(), [*boxes, ball, octo.objects.door(position=(2.0, 0.0, 0.0))])


def test_the_robot_comes_first_and_names_differ(scene):
    robot, whole = octo.gallery.mammal(), scene.character
    assert whole.objects == ("box", "box2", "ball", "door")
    assert whole.bodies[: len(robot.bodies)] == scene.robot.bodies
    assert {joint.name for joint in whole.joints[-7:]} >= {"ball_x", "ball_yaw", "door_hinge"}
    assert [c.name for c in whole.contacts if c.name.startswith("box2")][0] == "box2_0"
    assert whole.nu == robot.nu and (whole.actuated == robot.actuated).all()
    assert whole.nx == robot.nx + 3 * 6 + 1
    assert (whole.loose == np.arange(robot.nx, whole.nx)).all()
    assert whole.start_pose[-19:-13] == pytest.approx([1.0, 0.0, 0.1, 0.0, 0.0, 0.0])


def test_what_is_asked_of_the_robot_is_the_robots(scene):
    robot, whole = octo.gallery.mammal(), scene.character
    pose = np.concatenate([robot.start_pose, whole.start_pose[robot.nx :]])
    assert whole.mass == pytest.approx(robot.mass) and whole.base_body == robot.base_body
    np.testing.assert_allclose(
        center_of_mass(whole, pose), center_of_mass(robot, robot.start_pose), atol=1e-12
    )
    assert whole.own_contacts == robot.terrain_contacts
    assert lowest_contacts(whole, pose) == lowest_contacts(robot, robot.start_pose)
    costs = [octo.Effort(), octo.BodyLoad(), octo.LoadSharing()]
    one, other = (octo.Problem(m, steps=4, dt=0.02, costs=costs) for m in (scene, robot))
    assert (one.weight, one.length, one.size) == (other.weight, other.length, other.size)
    assert one.row_scale[: len(other.row_scale)] == pytest.approx(other.row_scale)
    np.testing.assert_allclose(one.start[: robot.nx], other.start, atol=1e-9)
    ground = Plane()
    assert touching(whole, ground, one.start) == touching(robot, ground, other.start)
    assert one.values["contact.w_perp"] == other.values["contact.w_perp"]
    for cost in costs[1:]:
        assert cost.chosen(whole, [0, 1, 2, 3]) == cost.chosen(robot, [0, 1, 2, 3])


def test_objects_start_at_rest_where_they_stand(scene):
    """Boxes sink by millimetres, into the ground and into each other; the ball stays in the air."""
    problem = octo.Problem(scene, steps=4, dt=0.02, costs=[octo.Effort()])
    given, start, whole = scene.character.start_pose, problem.start, scene.character
    robot = octo.gallery.mammal().nx
    sunk = (given - start)[robot:]
    assert 5e-3 < sunk[2] < 0.03 and sunk[2] < sunk[8] < 0.05
    assert np.abs(np.delete(sunk, [2, 8])).max() < 1e-4
    nodes, p = np.repeat(start[None, None], 3, axis=1), problem.p[None]
    fd = problem.dynamics.evaluate(nodes, p)[0][0, 0]
    falls = whole.joint_index("ball_z")
    assert fd[falls] == pytest.approx(0.5 * 9.81)
    rest = np.setdiff1d(whole.unactuated, [falls])
    assert np.abs(fd[rest]).max() < 1e-4 * problem.weight


def test_an_object_on_the_robot_loads_it():
    robot = octo.gallery.mammal()
    trunk = robot.body_index("trunk")
    carrier = dataclasses.replace(robot, solids=(Solid("back", trunk, Box((0.3, 0.2, 0.1))),))
    place = octo.Problem(robot, steps=2, dt=0.02, costs=[octo.Effort()]).start[2]
    load = octo.objects.box((0.1, 0.1, 0.1), 0.5, (0.0, 0.0, place + 0.1))
    scene = Scene(carrier, [load], contacts=[("box", "trunk")])
    problem = octo.Problem(scene, steps=2, dt=0.02, costs=[octo.Effort()])
    assert problem.start[2] < place - 1e-4
    nodes = np.repeat(problem.start[None, None], 3, axis=1)
    fd = problem.dynamics.evaluate(nodes, problem.p[None])[0][0, 0]
    # the trunk leans a little: the box is held by friction, which creeps
    assert np.abs(fd[scene.character.unactuated]).max() < 1e-3 * problem.weight


def test_poses_of_the_robot_keep_the_objects():
    plain = octo.gallery.chain()
    robot = dataclasses.replace(plain, poses={"low": np.zeros(plain.nx)})
    whole = Scene(robot, [octo.objects.ball(0.1, 1.0, (1.0, 2.0, 3.0))]).character
    assert whole.poses["low"].tolist() == [0.0] * plain.nx + [1.0, 2.0, 3.0, 0.0, 0.0, 0.0]


def test_motors_of_a_file_are_taken_off():
    whole = Scene(octo.gallery.mammal(), [octo.gallery.chain()]).character
    assert whole.nu == octo.gallery.mammal().nu


@pytest.mark.parametrize(
    "make",
    [
        octo.objects.box((0.2, 0.3, 0.4), 2.0),
        octo.objects.ball(0.1, 2.0),
        octo.objects.cylinder(0.1, 0.3, 2.0),
        octo.objects.capsule(0.1, 0.3, 2.0),
    ],
    ids=lambda make: make.name,
)
def test_an_object_fills_its_solid(make):
    """Its spheres are inside of its solid and touch the surface; its inertia is that of points
    spread evenly in it."""
    (solid,), (body,) = make.solids, make.bodies
    world = World([solid.shape])
    centers = sphere_centers(make, np.zeros(6))
    radius = np.array([c.radius for c in make.contacts])
    np.testing.assert_allclose(world.distance(centers), -radius, atol=5e-3)
    points = np.random.default_rng(0).uniform(-0.26, 0.26, (400_000, 3))
    points = points[world.distance(points) < 0.0]
    second = body.mass * points.T @ points / len(points)
    expected = np.trace(second) * np.eye(3) - second
    np.testing.assert_allclose(body.inertia, expected, atol=0.02 * body.inertia.max())


def test_default_contacts_are_few():
    """Ends of limbs with each object, corners of two boxes, one sphere of a ball."""
    robot = octo.gallery.mammal()
    ends = [k for k, c in enumerate(robot.contacts) if "shoulder" not in c.name]
    boxes = [octo.objects.box((0.2, 0.2, 0.2), 1.0, (k, 0, 0)) for k in (1, 2)]
    ball = octo.objects.ball(0.1, 1.0)
    whole = Scene(robot, [*boxes, ball]).character
    assert len(whole.touches) == 3 * len(ends) + 16 + 2
    assert len(Scene(robot, boxes, contacts=[]).character.touches) == 0
    one = Scene(robot, boxes, contacts=[("front_left", "box2")]).character
    assert [(one.contacts[c].name, one.solids[s].name) for c, s in one.touches] == [
        ("front_left", "box2")
    ]


def test_a_scene_is_kept_in_files(scene, tmp_path):
    whole = scene.character
    back = store.from_plain(store.to_plain(whole))
    assert back.objects == whole.objects and back.touches == whole.touches
    for one, other in zip(back.solids, whole.solids, strict=True):
        assert (one.name, one.body, one.kind) == (other.name, other.body, other.kind)
        np.testing.assert_array_equal(one.numbers, other.numbers)
    one, other = RobotDynamics(back), RobotDynamics(whole)
    assert one.text() == other.text()
    plain = store.to_plain(whole)
    plain["solids"][0]["shape"]["kind"] = "Blob"
    with pytest.raises(UnknownNameError, match="Blob"):
        store.from_plain(plain)
    old = dict(store.to_plain(octo.gallery.mammal()))
    for name in ("solids", "touches", "objects"):
        del old[name]  # a file of before there were any
    assert store.from_plain(old).solids == ()


def test_a_turned_box_stands_as_it_was_asked_to():
    turn = np.array([0.5, 0.5, -0.5, 0.5])
    for rotation in (turn, np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0.0]])):
        box = octo.objects.box((0.1, 0.2, 0.3), 1.0, (1, 2, 3), rotation)
        found, place = body_poses(box, box.start_pose)
        expected = rotation if rotation.shape == (3, 3) else rotation_of(rotation)
        np.testing.assert_allclose(found[0], expected, atol=1e-12)
        np.testing.assert_allclose(place[0], [1, 2, 3], atol=1e-12)


ROBOT = octo.gallery.chain()
BOX = octo.objects.box((0.1, 0.1, 0.1), 1.0)
REFUSED = [
    (lambda: Scene("go2", [BOX]), "robot is 'go2'"),
    (lambda: Scene(ROBOT, BOX), "objects is"),
    (lambda: Scene(None, []), "neither a robot nor an object"),
    (lambda: Scene(ROBOT, [BOX], contacts=[("foot", "crate")]), "crate"),
    (lambda: Scene(ROBOT, [BOX], contacts=[("hand", "box")]), "hand"),
    (lambda: Scene(ROBOT, [BOX], contacts=["box"]), "pair of names"),
    (lambda: Scene(ROBOT, [BOX], contacts=[("box_0", ROBOT.bodies[0].name)]), "cannot touch"),
    (lambda: Scene(ROBOT, [BOX, octo.objects.ball(0.1, 1.0, (0.0, 0.03, 0.0))]), "in one place"),
    (lambda: octo.objects.box((0.1, 0.0, 0.1), 1.0), "positive"),
    (lambda: octo.objects.box((0.1, 0.1, 0.1), -1.0), "mass"),
    (lambda: octo.objects.box((0.1, 0.1, 0.1), 1.0, rounding=0.06), "rounding"),
    (lambda: octo.objects.ball(0.1, 1.0, (0.0, 0.0)), "position"),
    (lambda: Scene(ROBOT, [BOX], contacts=3), "contacts is 3"),
    (lambda: octo.objects.ball(0.1, 1.0, hollow="no"), "hollow is 'no'"),
    (lambda: octo.objects.box((0.1, 0.1, 0.1), 1.0, rotation=np.zeros((3, 3))), "no rotation"),
    (lambda: octo.objects.door(rotation=np.diag([1.0, 1.0, -1.0])), "door: rotation is no rot"),
    (lambda: octo.objects.box((0.1, 0.1, 0.1), 1.0, rotation=np.zeros(4)), "length 0"),
    (lambda: Solid("s", 0, "box"), "shape"),
    (lambda: Solid("s", 0, Ground()), "shape is a Ground, must be a Sphere"),
    (lambda: dataclasses.replace(BOX, touches=((0, 0),)), "on one body"),
    (lambda: dataclasses.replace(BOX, touches=((0, 4),)), "touch"),
    (lambda: dataclasses.replace(BOX, objects=("crate",)), "crate"),
    (lambda: dataclasses.replace(BOX, solids=(Solid("s", 3, Sphere(0.1)),)), "body index 3"),
]


@pytest.mark.parametrize("made", range(len(REFUSED)))
def test_what_is_wrong_is_said(made):
    make, words = REFUSED[made]
    with pytest.raises(OctoError, match=words):
        make()


def test_a_cycle_has_no_objects():
    scene = Scene(octo.gallery.mammal(), [octo.objects.ball(0.1, 1.0, (2.0, 0.0, 0.1))])
    with pytest.raises(OctoError, match="ball"):
        octo.Problem(scene, cycle=octo.Cycle(speed=0.5), steps=20, costs=[octo.Effort()])


def test_a_scene_shows_what_it_holds(scene):
    assert "4 objects: box, box2, ball, door" in repr(scene)
    assert "objects   4: box, box2, ball, door" in scene.character.summary()
    assert "touches   " in scene.character.summary()
    assert "<table>" in scene._repr_html_()
    assert octo.describe(scene.character)["objects"] == ["box", "box2", "ball", "door"]
