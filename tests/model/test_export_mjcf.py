"""What export_mjcf writes is the character: MuJoCo compiles it, and its masses, dynamics, motors
and contacts are octo's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from robot_packages import package, urdf_named
from test_imported_dynamics import SPRUNG, fd_errors

import octo
from octo.errors import ModelError, OutputError
from octo.model.character import Character
from octo.model.export_mjcf import depth_first, export_mjcf, plane_rotation
from octo.model.gallery import CHARACTERS
from octo.model.mass_matrix import mass_matrix

URDFS = ("go2.urdf", "anymal_c_simple_description/urdf/anymal.urdf", "hyq_no_sensors.urdf")
IMPORTED = ("sprung", "ant.xml", *URDFS)


def character_named(name: str, tmp_path: Path) -> Character:
    if name == "sprung":
        (tmp_path / "sprung.xml").write_text(SPRUNG)
        return octo.load(tmp_path / "sprung.xml")
    if name.endswith(".xml"):
        folder = package("gymnasium") or pytest.skip("gymnasium is not installed")
        return octo.load(folder / "envs" / "mujoco" / "assets" / name)
    return octo.load(urdf_named(name) if name.endswith(".urdf") else name)


def exported(character: Character, tmp_path: Path, **options) -> tuple[Path, mujoco.MjModel]:
    path = tmp_path / "exported.xml"
    export_mjcf(character, path, **options)
    return path, mujoco.MjModel.from_xml_path(str(path))


@pytest.mark.parametrize("name", [*CHARACTERS, *IMPORTED])
def test_masses_and_contacts_are_the_characters(name, tmp_path):
    robot = character_named(name, tmp_path)
    _, model = exported(robot, tmp_path)
    assert model.body_mass.sum() == pytest.approx(robot.mass, rel=1e-9)
    for body in robot.bodies:
        assert model.body(body.name).mass[0] == pytest.approx(body.mass, rel=1e-9)
        moments = np.sort(model.body(body.name).inertia)
        np.testing.assert_allclose(
            moments, np.sort(np.linalg.eigvalsh(body.inertia)), rtol=1e-6, atol=1e-9
        )
    for contact in robot.contacts:
        geom = model.geom(contact.name)
        assert geom.size[0] == pytest.approx(max(contact.radius, 1e-5), rel=1e-9)
        np.testing.assert_allclose(geom.pos, contact.position, atol=1e-9)
    assert model.npair == len(robot.pairs)


@pytest.mark.parametrize("name", ["mammal", "humanoid", *IMPORTED])
def test_fd_converges_to_the_inverse_dynamics_of_the_exported_model(name, tmp_path):
    robot = character_named(name, tmp_path)
    errors, extrapolated = fd_errors(robot, exported(robot, tmp_path)[1], (4e-3, 2e-3, 1e-3))
    np.testing.assert_allclose(errors[:-1] / errors[1:], 2.0, rtol=0.05)
    assert extrapolated < 1e-8


@pytest.mark.parametrize("name", ["mammal", "humanoid", *IMPORTED])
def test_loading_the_file_gives_the_character_back(name, tmp_path):
    robot = character_named(name, tmp_path)
    again = octo.load(exported(robot, tmp_path)[0])
    order = depth_first(robot)
    assert [body.name for body in again.bodies] == [robot.bodies[b].name for b in order]
    first = 6 * (robot.base == "floating")
    ours = [joint for b in order for joint in robot.bodies[b].joints]
    for joint, expected in zip(again.joints[first:], ours[first:], strict=True):
        assert (joint.name, joint.kind, joint.actuated) == (
            expected.name,
            expected.kind,
            expected.actuated,
        )
        for field in (
            "lower",
            "upper",
            "reference",
            "torque_limit",
            "gear",
            "armature",
            "damping",
            "stiffness",
            "rest",
        ):
            assert getattr(joint, field) == pytest.approx(getattr(expected, field), rel=1e-9), (
                joint.name,
                field,
            )
    places = np.concatenate(
        [np.arange(len(robot.bodies[b].joints)) + robot.first_joint[b] for b in order]
    )
    x = np.random.default_rng(0).uniform(-0.5, 0.5, robot.nx)
    expected = mass_matrix(robot, x)[np.ix_(places, places)]
    np.testing.assert_allclose(
        mass_matrix(again, x[places]), expected, atol=1e-8 * np.abs(expected).max()
    )
    if robot.default_pose is not None:
        np.testing.assert_allclose(again.poses["default"], robot.default_pose[places], atol=1e-9)


def test_motors_are_in_the_order_of_u_and_give_its_torques(tmp_path):
    robot = character_named("sprung", tmp_path)
    _, model = exported(robot, tmp_path)
    data = mujoco.MjData(model)
    data.ctrl[:] = 0.5 / robot.joints[robot.actuated[0]].gear
    mujoco.mj_forward(model, data)
    assert data.qfrc_actuator[model.joint("hinge").dofadr[0]] == pytest.approx(0.5)
    humanoid = octo.load("humanoid")
    _, model = exported(humanoid, tmp_path)
    names = [model.joint(model.actuator_trnid[a, 0]).name for a in range(model.nu)]
    assert names == [humanoid.joints[j].name for j in humanoid.actuated]
    np.testing.assert_allclose(model.actuator_ctrlrange[:, 1], humanoid.torque_limit)


def test_spheres_touch_the_ground_and_only_the_pairs_of_the_character_touch_each_other(tmp_path):
    robot = octo.load("mammal")
    _, model = exported(robot, tmp_path)
    data = mujoco.MjData(model)
    data.qpos[:] = model.key("default").qpos
    data.qpos[2] = 5.0
    legs = [
        model.joint(f"{leg}_thigh_abduction").qposadr[0] for leg in ("front_left", "front_right")
    ]
    data.qpos[legs] = -0.7, 0.7  # both front feet inwards
    mujoco.mj_forward(model, data)
    touching = {tuple(sorted(model.geom(g).name for g in (c.geom1, c.geom2))) for c in data.contact}
    allowed = {tuple(sorted(robot.contacts[k].name for k in pair)) for pair in robot.pairs}
    assert touching and touching <= allowed
    data.qpos[:] = model.key("default").qpos
    data.qpos[2] -= 0.002
    mujoco.mj_forward(model, data)
    touching = {model.geom(max(c.geom1, c.geom2)).name for c in data.contact}
    assert touching == {f"{end}_{side}" for end in ("front", "hind") for side in ("left", "right")}


def test_the_ground_is_the_plane(tmp_path):
    plane = octo.Plane(slope=0.2, direction=0.7, height=0.3)
    _, model = exported(
        octo.load("chain"),
        tmp_path,
        terrain=plane,
        friction=0.35,
        timestep=0.001,
        gravity=(0.1, 0.0, -3.7),
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    p = plane.parameters
    normal = np.array([p["normal_x"], p["normal_y"], p["normal_z"]])
    np.testing.assert_allclose(data.geom("ground").xmat.reshape(3, 3)[:, 2], normal, atol=1e-9)
    np.testing.assert_allclose(
        plane_rotation(plane).T @ plane_rotation(plane), np.eye(3), atol=1e-12
    )
    assert data.geom("ground").xpos @ normal == pytest.approx(0.3 * p["normal_z"])
    assert model.geom_friction[:, 0] == pytest.approx(0.35)
    assert model.opt.timestep == 0.001
    np.testing.assert_allclose(model.opt.gravity, (0.1, 0.0, -3.7))


def test_what_mjcf_cannot_say_is_refused(tmp_path):
    robot = octo.load("mammal")
    flat = replace(robot.bodies[1], inertia=np.diag([0.1, 0.1, 0.3]))
    with pytest.raises(ModelError, match="mass distribution"):
        export_mjcf(
            replace(robot, bodies=(robot.bodies[0], flat, *robot.bodies[2:])), tmp_path / "a.xml"
        )
    twin = replace(robot.bodies[1], name=robot.bodies[2].name)
    with pytest.raises(ModelError, match="two bodies are named"):
        export_mjcf(
            replace(robot, bodies=(robot.bodies[0], twin, *robot.bodies[2:])), tmp_path / "a.xml"
        )
    stiff = replace(robot.bodies[0].joints[0], armature=1.0)
    base = replace(robot.bodies[0], joints=(stiff, *robot.bodies[0].joints[1:]))
    with pytest.raises(ModelError, match="armature"):
        export_mjcf(replace(robot, bodies=(base, *robot.bodies[1:])), tmp_path / "a.xml")
    with pytest.raises(OutputError, match="cannot be written"):
        export_mjcf(robot, tmp_path / "no" / "a.xml")
    assert not list(tmp_path.iterdir())
