"""Collision shapes become few spheres with the same hull; who touches what."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from octo.errors import ValueRangeError
from octo.model import shapes
from octo.model.describe import describe
from octo.model.figure import surfaces
from octo.model.kinematics import sphere_centers
from octo.model.load import load

RNG = np.random.default_rng(0)
DIRECTIONS = RNG.normal(size=(500, 3))
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1)[:, None]


def height(spheres, directions=DIRECTIONS):
    """How far the hull of spheres reaches in each direction (m)."""
    centers, radii = spheres
    return (directions @ centers.T + radii).max(axis=1)


def box_height(half):
    return np.abs(DIRECTIONS) @ half


def cylinder_height(radius, half_length):
    return radius * np.linalg.norm(DIRECTIONS[:, :2], axis=1) + half_length * np.abs(
        DIRECTIONS[:, 2]
    )


@pytest.mark.parametrize(
    ("spheres", "true", "count", "most"),
    [
        (shapes.sphere(0.2), np.full(500, 0.2), 1, 1e-12),
        (shapes.capsule(0.1, 0.3), 0.1 + 0.3 * np.abs(DIRECTIONS[:, 2]), 2, 1e-12),
        (shapes.box(np.array([0.1, 0.2, 0.3])), box_height([0.1, 0.2, 0.3]), 8, 0.015),
        (shapes.box(np.array([0.15, 0.06, 0.01])), box_height([0.15, 0.06, 0.01]), 4, 0.0075),
        (shapes.cylinder(0.2, 0.1), cylinder_height(0.2, 0.1), 16, 0.02),
        (shapes.cylinder(0.2, 0.02), cylinder_height(0.2, 0.02), 8, 0.02),
        (shapes.cylinder(0.02, 0.2), cylinder_height(0.02, 0.2), 2, 0.0085),
        (shapes.ellipsoid(np.array([0.1, 0.1, 0.1])), np.full(500, 0.1), 1, 1e-12),
        (
            shapes.ellipsoid(np.array([0.2, 0.1, 0.1])),
            np.linalg.norm(DIRECTIONS * (0.2, 0.1, 0.1), axis=1),
            3,
            0.02,
        ),
    ],
)
def test_spheres_are_inside_the_shape_and_nearly_as_large(spheres, true, count, most):
    centers, radii = spheres
    assert len(np.unique(np.round(np.column_stack([centers, radii]), 9), axis=0)) == count
    gap = true - height(spheres)
    assert gap.min() > -1e-12
    assert gap.max() <= most


def test_faces_of_a_box_stay_in_place():
    half = np.array([0.1, 0.2, 0.3])
    assert np.allclose(height(shapes.box(half), np.eye(3)), half)
    assert np.allclose(height(shapes.box(half), -np.eye(3)), half)


def test_a_round_hull_is_one_sphere_a_cap_is_not():
    points = DIRECTIONS * 0.03 + (0.0, 0.0, 0.1)
    centers, radii = shapes.hull(points)
    assert np.allclose(centers, [[0, 0, 0.1]])
    assert np.allclose(radii, 0.03)
    cap = DIRECTIONS[DIRECTIONS[:, 2] > 0.8]
    assert len(shapes.hull(cap)[1]) == len(cap)


def test_pruning_keeps_the_hull_within_the_tolerance():
    cloud, radii = RNG.normal(size=(300, 3)) * (0.2, 0.1, 0.05), RNG.uniform(0.0, 0.02, 300)
    kept = shapes.prune(cloud, radii, 0.02, 100)
    gap = height((cloud, radii)) - height((cloud[kept], radii[kept]))
    assert gap.max() < 0.025  # the tolerance, and what lies between the sampled directions
    assert len(kept) < 40
    assert len(shapes.prune(cloud, radii, 0.0, 5)) == 5
    assert int(np.argmin(cloud[:, 2] - radii)) in shapes.prune(cloud, radii, 0.02, 1)


def test_pruning_a_symmetric_cloud_is_symmetric():
    half = RNG.normal(size=(40, 3)) * (0.2, 0.1, 0.05)
    cloud = np.concatenate([half, half * (1, -1, 1)])
    kept = cloud[shapes.prune(cloud, np.zeros(80), 0.02, 80)]
    mirrored = kept * (1, -1, 1)
    far = np.linalg.norm(kept[:, None] - mirrored, axis=-1).min(axis=1)
    assert (far > 1e-9).sum() <= 2  # the last of a tie may stay single


def test_rod_and_end_ball():
    centers, radii = shapes.rod(*shapes.box(np.array([0.02, 0.03, 0.2])))
    assert np.allclose(np.abs(centers[:, 2]), 0.175)
    assert np.allclose(radii, 0.025)
    assert len(shapes.rod(*shapes.box(np.array([0.1, 0.1, 0.11])))[1]) == 1
    corners = np.array(list(itertools.product((-0.02, 0.02), (-0.02, 0.02), (-0.03, 0.01))))
    center, radius = shapes.end_ball(corners, np.array([0.0, 0.0, -1.0]))
    assert np.allclose(center[0, 2] - radius, -0.03)
    assert radius == pytest.approx(0.02)


LEG = """<body name="{name}" pos="0 {y} 0"><joint name="{name}_hip" axis="0 1 0"/><geom
  name="{name}_thigh" type="capsule"
 fromto="0 0 0 0 0 -.3" size=".04"/><body name="{name}_shank" pos="0 0 -.3"><joint
   name="{name}_knee" axis="0 1 0"/>
<geom name="{name}_bone" type="box" pos="0 0 -.15" size=".02 .02 .13"/>
<body name="{name}_sole" pos="0 0 -.3"><geom name="{name}_foot" size=".03"/></body></body></body>"""


def walker(
    ground='<geom type="plane" size="1 1 1"/>',
    trunk='type="box" size=".2 .15 .05"',
    joint="<freejoint/>",
):
    legs = LEG.format(name="left", y=0.2) + LEG.format(name="right", y=-0.2)
    body = f'<body name="trunk" pos="0 0 1">{joint}<geom name="trunk" {trunk}/>{legs}</body>'
    return f"<mujoco><worldbody>{ground}{body}</worldbody></mujoco>"


@pytest.fixture
def robot(tmp_path):
    def write(text, base="auto"):
        path = tmp_path / "walker.xml"
        path.write_text(text)
        return load(path, base)

    return write


@pytest.fixture
def whole(robot, tmp_path):
    """A walker whose trunk is an open bowl, with all of its vertices."""
    turns = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
    rims = [
        np.stack([r * np.cos(turns), r * np.sin(turns), 0.0 * turns + z], 1)
        for r, z in ((0.1, 0.0), (0.2, 0.1), (0.15, 0.1))
    ]
    points = " ".join(f"{x:.9g}" for x in np.concatenate(rims).ravel())
    mesh = f'<asset><mesh name="bowl" inertia="shell" vertex="{points}"/></asset>'
    text = walker(trunk='type="mesh" mesh="bowl"').replace("<mujoco>", f"<mujoco>{mesh}")
    path = tmp_path / "bowl.xml"
    path.write_text(text)
    return load(path, contacts="vertices"), load(path), np.concatenate(rims)


def test_all_vertices_are_kept(whole):
    character, few, points = whole
    own = [c for c in character.contacts if c.body == 0]
    assert len([c for c in few.contacts if c.body == 0]) <= 8
    assert len({c.name for c in own}) == len(own) == len(points)
    assert all(c.radius == 0.0 and c.touches_terrain for c in own)
    found = np.array([c.position for c in own])
    assert np.ptp(found, axis=0) == pytest.approx(np.ptp(points, axis=0), abs=1e-6)
    other = [c for c in character.contacts if "bone" in c.name]
    assert len(other) == 16 and {c.radius for c in other} == {0.0}
    assert sorted(c.radius for c in character.contacts if "foot" in c.name) == [0.03, 0.03]


def test_info_counts_them(whole):
    character = whole[0]
    assert "600 on trunk" in character.summary() and "trunk_17" not in character.summary()
    assert len(describe(character)["contacts"]) == len(character.contacts)


def test_the_surface_of_many_is_their_hull(whole):
    surface = surfaces(whole[0])[0]
    assert surface is not None and len(surface.faces) < 2000
    assert np.ptp(surface.vertices, axis=0)[:2] == pytest.approx([0.4, 0.4], abs=0.03)


def test_what_contacts_may_be(tmp_path):
    with pytest.raises(ValueRangeError, match="contacts is 'all', must be one of few, vertices"):
        load("mammal", contacts="all")
    with pytest.raises(ValueRangeError, match="must be few: it has no meshes"):
        load("mammal", contacts="vertices")


def test_feet_come_first_and_shafts_are_rods(robot):
    character = robot(walker())
    names = [contact.name for contact in character.contacts]
    assert names[0] == "left_foot"
    assert sorted(name for name in names if "foot" in name) == ["left_foot", "right_foot"]
    assert sum("trunk" in name for name in names) in (4, 8)
    assert sum("bone" in name for name in names) <= 4
    assert [(names[a], names[b]) for a, b in character.pairs] == [("left_foot", "right_foot")]


def test_default_pose_and_contacts_agree_with_the_file(robot):
    character = robot(walker())
    centers = sphere_centers(character, character.default_pose)
    assert np.allclose(centers[character.contact_index("left_foot")], (0, 0.2, 0.4))


def test_trunk_of_many_shapes_is_a_box(robot):
    more = "".join(
        f'<geom pos="{x} {y} .1" size=".05"/>' for x in (-0.2, 0.0, 0.2) for y in (-0.1, 0.1)
    )
    trunk = f'type="box" size=".2 .15 .05"/>{more}<geom name="tail" size=".01"'
    character = robot(walker(trunk=trunk))
    own = [contact for contact in character.contacts if contact.body == 0]
    reach = [contact.position[2] + contact.radius for contact in own]
    assert len(own) == 8
    assert max(reach) == pytest.approx(0.15)


def test_only_geoms_that_touch_the_ground_count(robot):
    text = walker().replace('name="left_bone"', 'name="left_bone" contype="0" conaffinity="0"')
    assert not [c for c in robot(text).contacts if c.name.startswith("left_bone")]
    apart = walker(ground='<geom type="plane" size="1 1 1" contype="2" conaffinity="2"/>')
    assert not robot(apart).contacts
    pair = '<contact><pair geom1="floor" geom2="left_foot"/></contact></mujoco>'
    tied = walker(
        ground='<geom name="floor" type="plane" size="1 1 1" contype="2" conaffinity="2"/>'
    ).replace("</mujoco>", pair)
    assert [c.name for c in robot(tied).contacts] == ["left_foot"]


def test_fixed_base_touches_the_ground_only_where_the_file_has_one(robot):
    assert all(contact.touches_terrain for contact in robot(walker(), "fixed").contacts)
    alone = robot(walker(ground=""), "fixed")
    assert alone.contacts
    assert not alone.terrain_contacts
    assert any("contact with the terrain" in note for note in alone.dropped)
    assert robot(walker(ground="")).terrain_contacts


def test_spheres_that_two_links_share_are_one(robot):
    """The knee: the thigh's lower end and the shank's upper end stay together in every pose."""
    text = walker().replace(
        'type="box" pos="0 0 -.15" size=".02 .02 .13"',
        'type="capsule" fromto="0 0 0 0 0 -.3" size=".04"',
    )
    character = robot(text)
    knee = sphere_centers(character, character.default_pose) - (0, 0.2, 0.7)
    assert (np.linalg.norm(knee, axis=1) < 1e-6).sum() == 1
