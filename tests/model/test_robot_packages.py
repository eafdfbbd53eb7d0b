"""Every robot of example-robot-data, gymnasium and dm_control: masses, poses and mass matrices
against the files and MuJoCo."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from mujoco_oracle import (
    mass_matrix_by_differences,
    mass_matrix_of,
    pose_errors,
    relative_difference,
    urdf_model,
)
from robot_packages import URDFS, compiled, loaded, mjcfs, package, urdf_named

from octo.errors import ModelError, RobotFileError
from octo.model.character import Character
from octo.model.kinematics import sphere_centers
from octo.model.load import load
from octo.model.mass_matrix import mass_matrix

# A finger without mass hangs on a hinge; a file with macros only.
REFUSED = {
    "romeo.urdf": "LFinger11Link",
    "romeo_laas_small.urdf": "l_gripper",
    "ur3.urdf": "no <link>",
}


def label(path: Path) -> str:
    return "/".join(path.parts[-3:])


def mass_written(path: Path) -> float:
    masses = [
        link.find("inertial/mass") for link in ElementTree.parse(path).getroot().findall("link")
    ]
    return sum(float(mass.get("value", "nan")) for mass in masses if mass is not None)


def some_pose(character: Character, seed: int) -> np.ndarray:
    """A configuration (nx,) off the reference, with every middle angle well inside its chart."""
    return np.random.default_rng(seed).uniform(-0.7, 0.7, character.nx)


@pytest.mark.skipif(not URDFS, reason="example-robot-data is not installed")
def test_most_urdfs_are_there():
    assert len(URDFS) - len(REFUSED) >= 60


@pytest.mark.parametrize("path", [p for p in URDFS if p.name in REFUSED], ids=label)
def test_refused_urdf_names_what_is_wrong(path):
    with pytest.raises(ModelError, match=f"{path.name}: .*{REFUSED[path.name]}"):
        load(path)


@pytest.mark.parametrize("path", [p for p in URDFS if p.name not in REFUSED], ids=label)
def test_urdf(path):
    character = loaded(path)
    assert character.mass == pytest.approx(mass_written(path), rel=1e-12)
    assert character.base == "floating" and character.nu == character.nx - 6
    model, x = urdf_model(path), some_pose(character, 0)
    assert pose_errors(character, model, x) < 1e-9
    # MuJoCo keeps an inertia as a quaternion and three moments, good to about 1e-7.
    assert (
        relative_difference(mass_matrix(character, x), mass_matrix_of(character, model, x)) < 2e-6
    )


def mass_of_the_driven(model) -> float:
    """kg, of the trees that joint actuators drive, of all that move where they drive none: the
    others are world."""
    trees = [b for b in range(1, model.nbody) if model.body_rootid[b] == b]
    moving = [root for root in trees if model.body_dofnum[model.body_rootid == root].any()]
    joints = [
        model.actuator_trnid[a, 0]
        for a in range(model.nactuator)
        if model.actuator_trntype[a] in (0, 1)
    ]
    driven = {int(model.body_rootid[model.jnt_bodyid[j]]) for j in joints}
    return float(model.body_subtreemass[list(driven) or moving].sum())


@pytest.mark.parametrize("path", mjcfs(), ids=label)
def test_mjcf(path):
    character, model = loaded(path), compiled(path)
    x = some_pose(character, 1)
    assert pose_errors(character, model, x) < 1e-9
    left_out = [note for note in character.dropped if note.startswith("free body")]
    if not left_out:
        assert character.mass == pytest.approx(mass_of_the_driven(model), rel=1e-12)
        if character.nx == model.nv:
            assert (
                relative_difference(mass_matrix(character, x), mass_matrix_of(character, model, x))
                < 2e-6
            )


@pytest.mark.parametrize(
    "name", ["go2.urdf", "hyq_no_sensors.urdf", "solo12.urdf", "g1_29dof_rev_1_0.urdf"]
)
def test_mass_matrix_is_that_of_the_poses(name):
    character = loaded(urdf_named(name))
    x = some_pose(character, 2)
    assert (
        relative_difference(mass_matrix(character, x), mass_matrix_by_differences(character, x))
        < 1e-9
    )


def test_all_models_of_the_two_packages_are_there():
    if package("gymnasium") is None or package("dm_control") is None:
        pytest.skip("gymnasium or dm_control is not installed")
    assert len(mjcfs()) >= 45
    for path in mjcfs():
        loaded(path)


@pytest.mark.parametrize(
    ("name", "feet"),
    [
        ("go2.urdf", ["FL_foot", "FR_foot", "RL_foot", "RR_foot"]),
        (
            "anymal_c_simple_description/urdf/anymal.urdf",
            ["LF_FOOT", "RF_FOOT", "LH_FOOT", "RH_FOOT"],
        ),
        ("hyq_no_sensors.urdf", ["lf_foot", "rf_foot", "lh_foot", "rh_foot"]),
        ("solo12.urdf", ["FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT"]),
        ("bolt.urdf", ["FL_FOOT", "FR_FOOT"]),
    ],
)
def test_feet_are_one_sphere_each_and_lowest(name, feet):
    character = loaded(
        next((p for p in URDFS if str(p).endswith(name)), None)
        or pytest.skip("example-robot-data is not installed")
    )
    x = character.default_pose
    bottom = sphere_centers(character, x)[:, 2] - [contact.radius for contact in character.contacts]
    lowest = [character.contacts[k].name for k in np.argsort(bottom)[: len(feet)]]
    assert sorted(lowest) == sorted(feet)
    assert len(character.contacts) <= 40
    named = {
        tuple(sorted((character.contacts[a].name, character.contacts[b].name)))
        for a, b in character.pairs
    }
    assert named <= {tuple(sorted((a, b))) for a in feet for b in feet}
    assert named


def test_walkers_are_mirror_images():
    """Left and right legs get the same contacts: pruning is not allowed to take sides."""
    character = loaded(urdf_named("anymal_c_simple_description/urdf/anymal.urdf"))
    centers = sphere_centers(character, character.default_pose)
    mirrored = centers * (1.0, -1.0, 1.0)
    distance = np.linalg.norm(centers[:, None] - mirrored, axis=-1).min(axis=1)
    assert distance.max() < 2e-3


def test_pairs_do_not_touch_in_the_default_pose():
    for path in [p for p in (*URDFS, *mjcfs()) if p.name not in REFUSED]:
        character = loaded(path)
        centers = sphere_centers(character, character.default_pose)
        for a, b in character.pairs:
            gap = (
                np.linalg.norm(centers[a] - centers[b])
                - character.contacts[a].radius
                - character.contacts[b].radius
            )
            assert gap > 1e-3, (
                f"{path.name}: {character.contacts[a].name}, {character.contacts[b].name}"
            )


def test_names_are_unique():
    for path in [p for p in (*URDFS, *mjcfs()) if p.name not in REFUSED]:
        character = loaded(path)
        for things in (character.bodies, character.joints, character.contacts):
            names = [thing.name for thing in things]
            assert len(names) == len(set(names)), path.name


def test_template_without_bodies_is_refused():
    folder = package("dm_control")
    if folder is None:
        pytest.skip("dm_control is not installed")
    with pytest.raises(RobotFileError, match="has no <body>"):
        load(folder / "suite" / "lqr.xml")
