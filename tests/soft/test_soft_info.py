"""``octo info`` of a soft body: ball, beam, and mesh files, with sizes behind a colon."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from octo import soft
from octo.cli.main import main

meshio = pytest.importorskip("meshio")
pytest.importorskip("skfem")


def said(capsys: pytest.CaptureFixture[str], *words: str, code: int = 0) -> str:
    assert main(["info", *words]) == code
    out, err = capsys.readouterr()
    return err if code else out


@pytest.mark.parametrize("name", ["ball", "beam"])
def test_the_table_of_a_body(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    made = getattr(soft, name)()
    lines = said(capsys, name).splitlines()
    assert f"elements  {made.elements} quadratic tetrahedra, {made.nodes} nodes" in lines
    assert f"surface   {len(made.points)} points, {len(made.faces)} triangles" in lines
    assert f"mass      {made.mass:.6g} kg" in lines
    assert lines[-11] == "mode      Hz  of the critical damping"
    assert [float(line.split()[1]) for line in lines[-10:]] == pytest.approx(
        list(made.frequencies), rel=1e-3
    )


def test_json_and_sizes(capsys: pytest.CaptureFixture[str]) -> None:
    found = json.loads(said(capsys, "beam:length=1,modes=4,beta=0.001", "--json"))
    made = soft.beam(1.0, modes=4, damping=(0.0, 0.001))
    assert found["coordinates"] == 10 and found["size"] == pytest.approx([1.0, 0.1, 0.1])
    assert found["frequencies"] == pytest.approx(list(made.frequencies))
    assert found["damping_ratios"] == pytest.approx(list(made.damping_ratios))
    assert found["units"]["frequency"] == "Hz"
    assert found["elasticity"] == "linear"
    assert "St. Venant–Kirchhoff" in said(capsys, "ball:divisions=2,modes=2,elasticity=stvk")


def test_a_mesh_file(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    mesh = soft.beam_mesh(0.4, 0.2, 0.2, (2, 1, 1))
    path = tmp_path / "block.msh"
    meshio.Mesh(1000.0 * mesh.nodes, [("tetra10", mesh.cells)]).write(path, file_format="gmsh")
    found = json.loads(said(capsys, f"{path}:scale=0.001,modes=3,density=400", "--json"))
    assert (found["name"], found["elements"], found["modes"]) == ("block", 12, 3)
    assert found["mass"] == pytest.approx(400.0 * 0.4 * 0.2 * 0.2)
    refusal = said(capsys, str(path), code=2)
    assert "larger than 20 m: it must be in metres; scale=0.001" in refusal
    assert refusal.count("\n") == 1


def test_what_is_refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert "size of soft body 'ball' 'colour' is not known" in said(capsys, "ball:colour=1", code=2)
    assert "modes of soft body 'ball' is '2.5', must be a whole" in said(
        capsys, "ball:modes=2.5", code=2
    )
    missing = str(tmp_path / "none.msh")
    assert f"mesh file {missing} does not exist" in said(capsys, missing, code=2)
    assert "poisson is 0.6, must be" in said(capsys, "beam:poisson=0.6", code=2)


def test_a_stiff_body_is_warned_of(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", "beam:young=1e8"]) == 0
    assert "beam is stiff: its lowest mode has" in capsys.readouterr().err


@pytest.mark.slow
def test_the_examples_of_the_page_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = Path(__file__).parents[2] / "docs" / "soft.md"
    blocks = re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)
    mesh = soft.beam_mesh(0.2, 0.1, 0.05, (3, 2, 1))
    meshio.Mesh(1000.0 * mesh.nodes, [("tetra10", mesh.cells)]).write(
        tmp_path / "foot.msh", file_format="gmsh"
    )
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for block in blocks:
        exec(block, names)
    assert names["bent"].shape == names["octo"].soft.beam().points.shape
    assert names["foot"].size == pytest.approx([0.2, 0.1, 0.05]) and names["tip"] < 0.0
