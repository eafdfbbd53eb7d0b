"""The call and the command: what is repeated, what is refused, and that nothing is left
half-written."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import moving
import numpy as np
import pytest
import trimesh

import octo
from octo.cli.main import main
from octo.errors import (
    MissingExtraError,
    ModelError,
    OctoError,
    OutputError,
    ProblemError,
    ValueRangeError,
)
from octo.result.solution import Solution, recorded
from octo.result.stride import Stride


def stride(mirrored: bool) -> Solution:
    """A cycle in which nothing but the place changes: 0.1 m along x, to the other side where it is
    mirrored."""
    robot = octo.gallery.chain()
    motion = moving.moving(robot, 4)
    motion.x[:] = motion.x[1]
    motion.x[:, 0] = 0.025 * np.arange(-1, 5)
    motion.x[:, 1] = 0.05
    matrix, constant = np.eye(robot.nx), np.zeros(robot.nx)
    matrix[1, 1], constant[0] = -1.0 if mirrored else 1.0, 0.1
    cycle = Stride(
        period=0.1 * (1 + mirrored),
        speed=1.0,
        sideways=0.0,
        turn=0.0,
        mirrored=mirrored,
        matrix=matrix,
        constant=constant,
        torque=np.eye(robot.nu),
        rotation=np.diag([1.0, -1.0 if mirrored else 1.0, 1.0]),
        shift=constant[:3],
        contacts=np.arange(len(robot.terrain_contacts)),
    )
    object.__setattr__(motion, "cycle", cycle)
    return motion


def roots(path: Path) -> np.ndarray:
    """(frames, 3) m in octo's axes, from a BVH."""
    text = path.read_text().partition("Frame Time")[2].splitlines()[1:]
    return np.loadtxt(text, ndmin=2)[:, [0, 2, 1]] * (1.0, -1.0, 1.0)


@pytest.mark.parametrize("mirrored", [False, True])
def test_a_stride_is_repeated(mirrored: bool, tmp_path: Path) -> None:
    """Of a mirrored one both halves, also once."""
    for repeat in (1, 3):
        octo.export(stride(mirrored), tmp_path / "m.bvh", fps=40.0, repeat=repeat)
        pieces = repeat * (1 + mirrored)
        place = roots(tmp_path / "m.bvh")
        np.testing.assert_allclose(place[:, 0], 0.025 * np.arange(4 * pieces + 1), atol=1e-6)
        sides = np.sign(place[1::4, 1])
        assert sides.tolist() == [1.0, -1.0 if mirrored else 1.0] * (pieces // 2) + [1.0] * (
            pieces % 2
        )


REFUSED: list[tuple[dict[str, Any], type[OctoError], str]] = [
    ({"path": "m.fbx"}, OutputError, "path is 'm.fbx', must end in .glb, .bvh, .mp4 or .gif"),
    ({"path": 3}, OutputError, "path is 3, must be a file's path"),
    ({"fps": 0}, ValueRangeError, "fps is 0 a second, must be positive"),
    ({"fps": -1.0}, ValueRangeError, "fps is -1.0 a second, must be positive"),
    ({"fps": "30"}, ValueRangeError, "fps is '30' a second, must be positive"),
    ({"fps": 1e4}, ValueRangeError, "fps is 10000, must be at most 1000 of a .glb file"),
    ({"fps": 60, "path": "m.gif"}, ValueRangeError, "fps is 60, must be at most 50 of a .gif file"),
    ({"repeat": 0}, ValueRangeError, "repeat is 0, must be a whole number of at least 1"),
    ({"repeat": 2}, ProblemError, "repeat is 2, must be 1: this motion is no cycle"),
    ({"visuals": 1}, ValueRangeError, "visuals is 1, must be True or False"),
    ({"path": "no/m.glb"}, OutputError, "no/m.glb cannot be written: No such file"),
    ({"path": "no/m.bvh"}, OutputError, "no/m.bvh cannot be written: No such file"),
    ({"path": "no/m.mp4"}, OutputError, "no/m.mp4 cannot be written: No such file"),
    ({"solution": "nothing.npz"}, OctoError, "nothing.npz"),
]


@pytest.mark.parametrize(("changes", "kind", "message"), REFUSED)
def test_what_is_refused(
    changes: dict[str, Any],
    kind: type[OctoError],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    call = {"solution": moving.moving(octo.gallery.chain(), 2), "path": "m.glb", **changes}
    with pytest.raises(kind) as refused:
        octo.export(**call)
    assert message in str(refused.value)
    assert not list(tmp_path.iterdir())


def test_a_folder_and_a_motion_that_is_not_finite_are_refused(tmp_path: Path) -> None:
    motion = moving.moving(octo.gallery.chain(), 2)
    with pytest.raises(OutputError, match="which is a folder"):
        octo.export(motion, (tmp_path / "m.glb").mkdir() or tmp_path / "m.glb")
    motion.x[2, 4] = np.nan
    with pytest.raises(ValueRangeError, match="x of the motion is not finite at index 2, 4"):
        octo.export(motion, tmp_path / "m.bvh")


def test_a_cycle_that_would_not_end_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueRangeError, match=r"repeat is 10+, must be at most 250000 of this"):
        octo.export(stride(False), tmp_path / "m.bvh", repeat=10**8)


def test_dynamics_without_bodies_are_refused(tmp_path: Path) -> None:
    fields = {name: np.zeros((3, 0)) for name in ("u", "torque_limit")}
    motion = recorded(
        name="custom",
        character=None,
        dt=0.1,
        x=np.zeros((5, 2)),
        weight=0.0,
        length=1.0,
        contact_names=(),
        contact_force=np.zeros((3, 0, 3)),
        **fields,
    )
    with pytest.raises(ModelError, match="user-written"):
        octo.export(motion, tmp_path / "m.glb")


@pytest.mark.parametrize(
    ("name", "library"),
    [
        ("m.glb", "pygltflib"),
        ("m.glb", "trimesh"),
        ("m.mp4", "imageio_ffmpeg"),
        ("m.gif", "PIL.Image"),
    ],
)
def test_a_library_that_is_missing_is_named_by_its_extra(
    name: str, library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(MissingExtraError, match=r"needs the extra 'export': pip install"):
        octo.export(moving.moving(octo.gallery.chain(), 2), tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_a_page_says_who_writes_a_video(tmp_path: Path, capsys: Any) -> None:
    motion = moving.moving(octo.gallery.chain(), 2)
    with pytest.raises(OutputError, match=r"octo\.export\(solution, 'm\.mp4'\) writes a \.mp4"):
        octo.view(motion, "m.mp4")
    motion.save(tmp_path / "s.npz")
    assert main(["view", str(tmp_path / "s.npz"), "--out", str(tmp_path / "m.gif")]) == 2
    assert "octo export writes .gif files" in capsys.readouterr().err


def test_the_command(tmp_path: Path, capsys: Any) -> None:
    moving.moving(octo.gallery.chain(), 4).save(tmp_path / "s.npz")
    words = ["export", str(tmp_path / "s.npz"), "--fps", "20"]
    assert main([*words, "--out", str(tmp_path / "new" / "m.glb"), "--contacts"]) == 0
    assert trimesh.load_scene(tmp_path / "new" / "m.glb").geometry
    assert main([*words, "--out", str(tmp_path / "m.bvh")]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0].endswith("m.glb: bodies with their meshes, in metres, y up")
    assert said[1].endswith("m.bvh: the robot's skeleton, in metres and degrees, y up")
    for more in (["--out", "m.obj"], ["--fps", "0"], ["--repeat", "2"]):
        assert main([*words, "--out", str(tmp_path / "m.bvh"), *more]) == 2
        assert capsys.readouterr().err.count("\n") == 1
