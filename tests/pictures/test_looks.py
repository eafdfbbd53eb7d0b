"""What a robot's file draws its bodies with: found, placed, kept, and drawn."""

from __future__ import annotations

import dataclasses
import logging
from pathlib import Path
from typing import Any

import motions
import mujoco
import numpy as np
import pytest
import trimesh

import octo
from octo.errors import OctoError
from octo.model import skins as drawing
from octo.model import store
from octo.model.character import Character
from octo.model.gallery import CHARACTERS
from octo.model.look import Look
from octo.model.skins import skins

URDF = """<robot name="r"><material name="red"><color rgba="1 0 0 1"/></material>
<link name="a"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
</inertial>{visuals}</link>
<link name="b"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>
</inertial><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<link name="c"><visual><origin xyz="0 0 0.1"/><geometry><cylinder radius="0.1" length="0.4"/>
</geometry><material name="red"/></visual></link>
<joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>
<origin xyz="0 0 -0.5"/><limit lower="-1" upper="1" effort="10" velocity="5"/></joint>
<joint name="k" type="fixed"><parent link="b"/><child link="c"/><origin xyz="0.3 0 0"/></joint>
</robot>"""
MESH = (
    '<visual><origin xyz="{xyz}" rpy="{rpy}"/><geometry><mesh filename="{file}" scale="{scale}"/>'
)
MESH += "</geometry></visual>"
CORNERS = np.array([(0.0, 0.0, 0.0), (0.4, 0.0, 0.0), (0.0, 0.2, 0.0), (0.0, 0.0, 0.1)])
FACES = np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])


def wedge(path: Path) -> Path:
    trimesh.Trimesh(CORNERS, FACES, process=False).export(path)
    return path


def robot(path: Path, *visuals: str) -> Character:
    file = path / "r.urdf"
    file.write_text(URDF.format(visuals="".join(visuals)), encoding="utf-8")
    return octo.load(file)


def points(character: Character, body: int) -> Any:
    return np.concatenate([skin.surface.vertices for skin in skins(character)[body]])


def nearest(wanted: Any, found: Any) -> float:
    """m, the farthest of the points wanted from those found."""
    apart = np.linalg.norm(wanted[:, None] - found[None], axis=2)
    return float(apart.min(axis=1).max())


def outward(surface: Any) -> bool:
    return bool(trimesh.Trimesh(surface.vertices, surface.faces, process=False).volume > 0.0)


@pytest.mark.parametrize("scale", ["1 1 1", "0.5 2 1", "1 -1 1"])
def test_a_mesh_of_a_urdf_is_where_its_visual_says(scale: str, tmp_path: Path) -> None:
    file = wedge(tmp_path / "w.stl")
    place = {"xyz": "0.1 0.2 0.3", "rpy": "0 0 1.57079632679"}
    found = robot(tmp_path, MESH.format(**place, file=file.name, scale=scale))
    own = CORNERS * [float(word) for word in scale.split()]
    turned = own[:, [1, 0, 2]] * (-1.0, 1.0, 1.0)  # a quarter turn about z
    assert nearest(turned + (0.1, 0.2, 0.3), points(found, 0)) < 1e-6
    assert all(outward(skin.surface) for skin in skins(found)[0])


def test_what_a_welded_link_draws_moves_with_its_parent(tmp_path: Path) -> None:
    found = robot(tmp_path)
    (look,) = found.looks
    assert (look.body, look.kind) == (1, "cylinder")
    np.testing.assert_allclose(look.position, (0.3, 0.0, 0.1), atol=1e-12)
    assert look.color is not None and look.color.tolist() == [1.0, 0.0, 0.0, 1.0]
    surface = points(found, 1)
    np.testing.assert_allclose(np.ptp(surface, axis=0), (0.2, 0.2, 0.4), atol=2e-3)
    np.testing.assert_allclose(surface.mean(axis=0), (0.3, 0.0, 0.1), atol=1e-3)
    # link a draws nothing, and is not guessed beside what its file draws
    assert not skins(found)[0] and skins(found, visuals=False)[0]


MJCF = """<mujoco><asset><mesh name="w" file="w.stl" scale="1 2 1"/>
<material name="m" rgba="0 1 0 1"/></asset><worldbody><body name="a" pos="0 0 1">
<freejoint/><geom type="mesh" mesh="w" pos="0.1 0 0.2" euler="20 30 40" material="m" contype="0"
conaffinity="0" group="1"/><geom type="box" size="0.1 0.2 0.3" group="3"/>
<geom type="sphere" size="0.1" rgba="0 0 1 0"/><geom type="ellipsoid" size="0.1 0.2 0.3"
rgba="0 0 1 1"/></body></worldbody></mujoco>"""


def test_an_mjcf_is_drawn_as_mujoco_draws_it(tmp_path: Path) -> None:
    wedge(tmp_path / "w.stl")
    file = tmp_path / "r.xml"
    file.write_text(MJCF, encoding="utf-8")
    found = octo.load(file)
    mesh, ellipsoid = found.looks
    assert mesh.color is not None and mesh.color.tolist() == [0.0, 1.0, 0.0, 1.0]
    assert (ellipsoid.kind, ellipsoid.size.tolist()) == ("ellipsoid", [0.1, 0.2, 0.3])
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    data.qpos[:] = [0.3, 0.1, 0.9, *(np.array([0.5, 0.1, -0.7, 0.2]) / np.sqrt(0.79))]
    mujoco.mj_kinematics(model, data)
    theirs = model.mesh_vert @ data.geom_xmat[0].reshape(3, 3).T + data.geom_xpos[0]
    own = (theirs - data.xpos[1]) @ data.xmat[1].reshape(3, 3)
    assert nearest(own, points(found, 0)) < 1e-6


def test_a_dae_has_its_own_colours_and_its_unit(tmp_path: Path) -> None:
    box = trimesh.creation.box((10.0, 20.0, 30.0))
    box.visual.face_colors = (0, 0, 255, 255)
    text = trimesh.exchange.dae.export_collada(box).decode()
    assert "<unit" not in text or 'meter="1' in text
    asset = text.index("</asset>")
    if "<unit" not in text:
        text = text[:asset] + '<unit name="centimeter" meter="0.01"/>' + text[asset:]
    else:
        text = text.replace('meter="1.0"', 'meter="0.01"').replace('meter="1"', 'meter="0.01"')
    (tmp_path / "b.dae").write_text(text)
    visual = MESH.format(xyz="0 0 0", rpy="0 0 0", file="b.dae", scale="1 1 1")
    found = robot(tmp_path, visual.replace("</visual>", '<material name="red"/></visual>'))
    (skin,) = skins(found)[0]
    np.testing.assert_allclose(np.ptp(skin.surface.vertices, axis=0), (0.1, 0.2, 0.3), atol=1e-9)
    assert skin.color is not None and skin.color.tolist() == [0.0, 0.0, 1.0]


def test_a_fine_mesh_is_drawn_coarser_and_as_large(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.2)
    ball.export(tmp_path / "b.stl")
    visual = MESH.format(xyz="0 0 0", rpy="0 0 0", file="b.stl", scale="1 1 1")
    (skin,) = skins(robot(tmp_path, visual), most=500)[0]
    assert len(skin.surface.faces) <= 520
    np.testing.assert_allclose(np.ptp(skin.surface.vertices, axis=0), 0.4, atol=0.01)


def test_a_file_that_is_gone_is_said_once_and_the_body_guessed(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = wedge(tmp_path / "gone.stl")
    visual = MESH.format(xyz="0 0 0", rpy="0 0 0", file=file.name, scale="1 1 1")
    found = dataclasses.replace(robot(tmp_path, visual), looks=robot(tmp_path, visual).looks[:1])
    file.unlink()
    drawing.READ.clear()
    with caplog.at_level(logging.WARNING, logger="octo"):
        assert all(skins(found)) and all(skins(found))
    (record,) = caplog.records
    assert "gone.stl is not drawn: " in record.getMessage()


def test_looks_are_kept_in_files_and_in_scenes(tmp_path: Path) -> None:
    file = wedge(tmp_path / "w.stl")
    visual = MESH.format(xyz="0.1 0 0", rpy="0 0 0", file=file.name, scale="1 1 1")
    found = robot(tmp_path, visual)
    again = store.from_plain(store.to_plain(found))
    assert len(again.looks) == 2
    for one, other in zip(found.looks, again.looks, strict=True):
        for field in dataclasses.fields(Look):
            assert np.array_equal(getattr(one, field.name), getattr(other, field.name))
    scene = octo.Scene(CHARACTERS["mammal"](), [found])
    whole = scene.character
    assert [whole.bodies[look.body].name for look in whole.looks] == ["a", "b"]
    drawn = skins(whole)
    assert all(drawn[: whole.body_index("a")])  # the mammal is guessed, as before


@pytest.mark.parametrize(
    "change",
    [{"kind": "cone"}, {"size": (1.0, 2.0)}, {"body": True}, {"file": "a.stl"}, {"color": (1.0,)}],
)
def test_a_look_that_is_none_is_refused(change: dict[str, Any]) -> None:
    plain: dict[str, Any] = {
        "body": 0,
        "kind": "box",
        "size": np.ones(3),
        "position": np.zeros(3),
        "rotation": np.eye(3),
    }
    with pytest.raises(OctoError):
        Look(**{**plain, **change})


def test_pictures_show_them_or_on_request_what_octo_computes_with(tmp_path: Path) -> None:
    file = wedge(tmp_path / "w.stl")
    visual = MESH.format(xyz="0 0 0", rpy="0 0 0", file=file.name, scale="3 3 3")
    motion = motions.wandering(robot(tmp_path, visual), 8)
    texts = [octo.view(motion, visuals=visuals).text for visuals in (True, False)]
    assert texts[0] != texts[1]
    stills = []
    for visuals in (True, False):
        octo.filmstrip(motion, tmp_path / "s.png", moments=1, visuals=visuals)
        stills.append((tmp_path / "s.png").read_bytes())
    assert stills[0] != stills[1]
