"""The file of a motion over shapes: the world comes back, damage is one line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from octo import World, shapes
from octo.errors import OctoError, RobotFileError
from octo.model.gallery import CHARACTERS
from octo.result.solution import Solution, recorded
from octo.world import store

TURN = Rotation.from_euler("xyz", [0.2, -0.3, 0.5]).as_matrix()


def world() -> World:
    axis = np.linspace(-0.3, 0.3, 9)
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    made: list[shapes.Shape] = [
        shapes.Ground(0.1, 0.2, -0.3, name="ground"),
        shapes.Box((0.3, 0.4, 0.5), 0.02, position=(1.0, 2.0, 0.1), rotation=TURN, name="box"),
        shapes.Sphere(0.2),
        shapes.Capsule(0.1, 0.3, rotation=TURN),
        shapes.Cylinder(0.1, 0.3, 0.03),
        shapes.HeightField(0.1 * x[:, :, 0] + 0.01, 0.1, (0.5, -0.5), smooth=True, name="map"),
        shapes.DistanceGrid(np.sqrt(x**2 + y**2 + z**2) - 0.2, 0.075, (-0.3,) * 3),
    ]
    return World(made, blend=0.02)


def motion(of: World | None) -> Solution:
    robot = CHARACTERS["mammal"]()
    zeros = np.zeros((3, len(robot.terrain_contacts), 3))
    return recorded(
        character=robot,
        dt=0.1,
        x=np.tile(robot.start_pose, (5, 1)),
        u=np.zeros((3, robot.nu)),
        weight=50.0,
        length=0.3,
        contact_force=zeros,
        world=of,
    )


def test_a_world_comes_back_with_its_motion(tmp_path: Path) -> None:
    made = world()
    motion(made).save(tmp_path / "a.npz")
    back = Solution.load(tmp_path / "a.npz").world
    assert back is not None and back.blend == made.blend
    names = [(type(shape), shape.name) for shape in made.shapes]
    assert [(type(shape), shape.name) for shape in back.shapes] == names
    np.testing.assert_allclose(back.data, made.data, rtol=1e-14, atol=1e-14)


def test_a_motion_on_a_plane_has_none(tmp_path: Path) -> None:
    motion(None).save(tmp_path / "a.npz")
    assert Solution.load(tmp_path / "a.npz").world is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"kind": "Torus"}, "kind of a shape 'Torus' is not known"),
        ({"edge": 1.0}, "field of a Box 'edge' is not known"),
        ({"rounding": -1.0}, "rounding of Box 'box' is -1.0"),
        ({"size": None}, "size"),
    ],
)
def test_damage_is_said_by_name(change: dict[str, Any], words: str, tmp_path: Path) -> None:
    plain, arrays = store.to_plain(world())
    plain = json.loads(json.dumps(plain))
    plain["shapes"][1].update(change)
    with pytest.raises(OctoError, match=words):
        store.from_plain(plain, arrays)
    with pytest.raises(OctoError):
        store.from_plain({"shapes": 3}, {})
    motion(world()).save(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz") as file:
        kept = {name: file[name] for name in file.files}
    fields = json.loads(str(kept["plain"]))
    fields["world"]["shapes"][1].update(change)
    np.savez(tmp_path / "b.npz", **{**kept, "plain": np.array(json.dumps(fields))})
    with pytest.raises(RobotFileError, match=r"b.npz is not a solution that octo saved"):
        Solution.load(tmp_path / "b.npz")
