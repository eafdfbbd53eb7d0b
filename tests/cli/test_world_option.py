"""``--world``: names with their sizes, files with their places, what is listed, what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from octo import worlds
from octo.cli.main import main, parse
from octo.cli.world import check_covered, ground_of_words, world_of
from octo.errors import OctoError
from octo.model.terrain import Plane
from octo.result.solution import Solution
from octo.world.shapes import Box, Ground, HeightField
from octo.world.world import World


@pytest.fixture
def heights(tmp_path: Path) -> str:
    np.save(tmp_path / "map.npy", np.zeros((30, 30)) + 0.01 * np.eye(30))
    return str(tmp_path / "map.npy")


def test_a_name_is_made_with_its_sizes() -> None:
    made = world_of("stairs:rise=0.12,n=3,down=no,run=0.28")
    same = worlds.stairs(rise=0.12, n=3, down=False, run=0.28)
    np.testing.assert_array_equal(made.data, same.data)
    np.testing.assert_array_equal(world_of("gap").data, worlds.gap().data)


def test_a_file_is_put_into_its_place(heights: str) -> None:
    world = world_of(f"{heights}:cell=0.1,x=2,z=0.5")
    (shape,) = world.shapes
    assert isinstance(shape, HeightField)
    np.testing.assert_allclose(shape.position, (2.0, 0.0, 0.5))
    level, other = world_of(f"{heights}:ground=yes", 0.05).shapes
    assert isinstance(level, Ground) and isinstance(other, HeightField) and other.cell == 0.05


def test_every_command_takes_a_world_in_place_of_a_terrain() -> None:
    for command in ("solve", "mpc", "simulate", "compare"):
        arguments = parse([command, "mammal", "--world", "ditch:depth=0.2"])
        ground = ground_of_words(arguments)
        assert isinstance(ground, World) and isinstance(ground.shapes[1], Box)
        assert isinstance(ground_of_words(parse([command, "mammal"])), Plane)


def test_info_lists_the_shapes(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", "--world", "stairs:n=2"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4 and lines[0].startswith("ground  Ground")
    assert lines[2].split()[:3] == ["step", "2", "Box"] and lines[3].startswith("3 shapes")
    assert main(["info", "--world", "stairs:n=2", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [shape["kind"] for shape in found["shapes"]] == ["Ground", "Box", "Box"]
    assert found["shapes"][0]["bounds"][0] == [None, None, None]


def test_what_a_scene_has_beside_its_world_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "scene.xml").write_text(
        "<mujoco><worldbody><geom type='plane' size='1 1 1'/><body name='dog'><freejoint/>"
        "<geom size='0.1'/></body></worldbody></mujoco>"
    )
    assert main(["info", "--world", str(tmp_path / "scene.xml")]) == 0
    said = capsys.readouterr()
    assert "octo: scene.xml: no part of the world: what moves (dog)" in said.err
    assert said.out.startswith("world plane  Ground")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--world", "stares"], "did you mean stairs"),
        (["--world", "nothing"], "world 'nothing' is not known"),
        (["--world", "stairs:rize=0.1"], "size of world 'stairs' 'rize' is not known; did you"),
        (["--world", "stairs:rise"], "size 'rise' of world 'stairs' has no value"),
        (["--world", "stairs:n=2,n=3"], "size 'n' of world 'stairs' is given twice"),
        (["--world", "stairs:n=2.5"], "n of world 'stairs' is '2.5', must be a whole number"),
        (["--world", "stairs:down=maybe"], "must be yes or no"),
        (["--world", "stairs:rise=-1"], "rise of stairs is -1.0 m, must be positive"),
        (["--world", "stairs", "--cell", "0.1"], "--cell is of a map or a mesh"),
        (["--cell", "0.1"], "--cell is of a map or a mesh: it goes with --world FILE"),
        (["--world", "gap", "--terrain", "slope:5"], "does not go with --terrain"),
        (["--world", "no/such.stl"], "world file no/such.stl does not exist"),
    ],
)
def test_mistakes_are_one_line(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", "mammal", *words, "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_control_refuses_what_does_not_go_together(capsys: pytest.CaptureFixture[str]) -> None:
    for words, message in (
        (["--blind"], "--blind is of a controller on a world"),
        (["--world", "gap", "--bumps", "0.1"], "--bumps lie on a plane"),
    ):
        assert main(["mpc", "mammal", *words]) == 2
        assert message in capsys.readouterr().err
    with pytest.raises(OctoError, match="one of --world, FILE or --devices"):
        main_refused(["info", "mammal", "--world", "gap"])


def test_a_world_that_ends_before_the_walk_does_is_refused(
    heights: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "out")
    for command, more in (("solve", []), ("mpc", []), ("solve", ["--goal", "to", "2,0,0"])):
        words = [command, "mammal", *more, "--world", heights, "--cell", "0.1", "--out", out]
        assert main(words) == 2
        error = capsys.readouterr().err
        assert "the world has nothing below the way from 1.5 m on" in error
        assert error.count("\n") == 1 and not (tmp_path / "out").exists()
    check_covered(world_of(f"{heights}:x=1", 0.1), (2.4, 0.0))
    check_covered(world_of(f"{heights}:ground=yes", 0.1), (9.0, 0.0))
    check_covered(Plane(), (9.0, 0.0))


def main_refused(words: list[str]) -> None:
    arguments = parse(words)
    arguments.run(arguments)


def test_a_robot_settles_on_a_map(heights: str, tmp_path: Path) -> None:
    words = ["simulate", "mammal", "--world", f"{heights}:z=0.2", "--cell", "0.1", "--hold"]
    assert main([*words, "--seconds", "0.2", "--out", str(tmp_path / "out")]) == 0
    motion = Solution.load(tmp_path / "out")
    assert motion.world is not None and motion.world.shapes[0].name == "map"
    assert motion.com[-1, 2] > 0.3  # it stands on the map, which is raised
    np.testing.assert_allclose(motion.ground["z"], 0.2, atol=0.02)
